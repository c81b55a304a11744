"""Every refusal of the checker has a file that passes without it: the checker is mutated.

Files are forged by changing leaves of honest headers. A checker without a refusal says something
else of one of them.
"""

import ast
import copy
import importlib
import itertools
import json
import sys
from pathlib import Path

import pytest

import holdfast as hf
from holdfast_check import checker
from tests.certified_systems import changed
from tests.laws_to_judge import slider, thermostat

SOURCE = Path(checker.__file__).parent
H = float.hex
X, TH, U, D = (hf.symbol(n) for n in ("x", "th", "u", "d"))


def line(name="x", unit="m", rate=None):
    quantity = hf.Quantity(name, unit)
    return hf.System(
        "line", (quantity,), (hf.Quantity("u", f"{unit}/s"),), {name: U + D if rate is None else rate},
        disturbances=(hf.Quantity("d", f"{unit}/s"),), input_bounds=hf.Box((-1.0,), (1.0,)),
        disturbance_bounds=hf.Box((-0.1,), (0.1,)),
    )  # fmt: skip


def written(folder):
    """Small honest files of several kinds."""
    import sympy as sp

    system = line()
    ends = hf.Region("line", system.states, tuple(
        hf.Inequality(n, e, "m") for n, e in (("l", -1 - X), ("r", X - 1))
    ))  # fmt: skip
    near = hf.Region("near", system.states, (hf.Inequality("n", sp.Abs(X) - 0.3, "m"),))
    given = {"box": {"x": (-1, 1)}, "sample_time": 0.2, "inputs": 3}
    turn = line("th", "rad", U + D * sp.cos(TH))
    any_th = hf.Region("any", turn.states, (hf.Inequality("c", sp.sin(TH) - 2),))
    pushed, on_line = slider()
    guarded = hf.safeguard(
        pushed, hf.Law("push", pushed.states, {"v": 0.5 + 0 * X}), on_line, worst=("w",),
        gains=(2.0, 4.0), margins={"left": 0.1, "right": 0.1},
    )  # fmt: skip
    files = {
        "keep": hf.certify(system, ends, cells=10, **given),
        "late": hf.certify(system, ends, cells=40, delay=0.02, errors={"x": 0.001}, **given),
        "brief": hf.certify(system, ends, cells=10, horizon=0.6, **given),
        "reach": hf.certify(system, ends, cells=20, target=near, horizon=4.0, **given),
        "halved": hf.certify(system, ends, cells=5, refine=2, **given),
        "turn": hf.certify(turn, any_th, box={"th": (-3.2, 3.2)}, cells=8, sample_time=0.2, inputs=3),
        "modes": hf.judge_law(
            pushed, on_line, thermostat(), box={"x": (-1, 1)}, cells=20, sample_time=0.1
        ).certificate,
        "pipe": hf.flowpipe(
            pushed, on_line, start={"x": (-0.2, 0.2)}, horizon=0.2, law=thermostat(),
            sample_time=0.1, degrees=(1, 2), target=on_line,
        ),
        "closed": hf.flowpipe(
            turn, any_th, start={"th": (0.1, 0.2)}, horizon=0.2, degrees=(1, 2),
            law=hf.Law("back", turn.states, {"u": -TH}),
        ),
        "guard": hf.judge_law(
            pushed, on_line, guarded, box={"x": (-1, 1)}, cells=20, sample_time=0.1
        ).certificate,
    }  # fmt: skip
    return {name: found.write(folder / f"{name}.holdfast") for name, found in files.items()}


NASTY = (None, True, 0, -1, 70, 10**9, "", "x", "x +", "x**3", "x**x", "x**(1/3)", "f(x)", "y",
         "log(x - 9)", "2**64**2", "u", H(0.0), H(-1.0), H(1e300), "nan", "a b", "sin", [], {}, [[]])  # fmt: skip


def leaves(value, place=()):
    yield place
    if isinstance(value, dict | list):
        for key, inner in value.items() if isinstance(value, dict) else enumerate(value):
            yield from leaves(inner, (*place, key))


def forged(paths):
    """(name, bytes) of files with one part changed or gone, entries that are none, cut ones."""
    yield "of nothing", b""
    for name, path in paths.items():
        raw = path.read_bytes()
        yield name, raw
        yield f"{name} cut", raw[:-1]
        yield f"{name} of another version", raw.replace(b"certificate 1", b"certificate 2", 1)
        header = json.loads(raw.split(b"\n")[1])
        for place in leaves(header):
            if not place or (place[0] == "edges" and len(place) > 2 and place[2] not in (1, 3)):
                continue
            for nasty in (*NASTY, "GONE", "TWICE"):

                def change(h, place=place, nasty=nasty):
                    *way, last = place
                    for key in way:
                        h = h[key]
                    if nasty == "GONE":
                        del h[last]
                    elif nasty == "TWICE" and isinstance(h, list):
                        h.append(copy.deepcopy(h[last]))
                    else:
                        h[last] = nasty

                yield f"{name} {place} {nasty!r}", changed(path, change).read_bytes()
        for k, entry in itertools.product(
            range(3), (b"\xff" * 10, b"\x00" * 10, b"\x01\0\0\0\0\0\x09\0\0\0")
        ):

            def entries(packed, k=k, entry=entry):
                return packed[: 10 * k] + entry + packed[10 * k + 10 :]

            yield (
                f"{name} entry {k} {entry[:4]}",
                changed(path, lambda h: None, entries=entries).read_bytes(),
            )


def outcome(check, path):
    """What a checker says of a file, and where it refuses it."""
    try:
        return check(str(path)), None
    except Exception as error:  # of a checker that lacks something
        frames = [error]
        while frames[-1].__context__ is not None:
            frames.append(frames[-1].__context__)
        trace = frames[-1].__traceback__
        while trace.tb_next is not None:
            trace = trace.tb_next
        where = Path(trace.tb_frame.f_code.co_filename).name, trace.tb_lineno
        return f"{type(error).__name__}: {error}", where


def mutants():
    """(name, file, changed source): a refusal that is gone."""
    for file in sorted(SOURCE.glob("*.py")):
        tree = ast.parse(file.read_text(encoding="utf-8"))
        for function in ast.walk(tree):
            if not isinstance(function, ast.FunctionDef):
                continue
            for node in ast.walk(function):
                name = f"{file.name} {function.name} {getattr(node, 'lineno', 0)}"
                if isinstance(node, ast.Raise) and "Error(" in ast.unparse(node):
                    yield f"{name}: {ast.unparse(node)}", file, replaced(tree, node, ast.Pass())


def replaced(tree, node, other):
    """The source of a tree with another node in place of one."""

    class Exchange(ast.NodeTransformer):
        def visit(self, part):
            return other if part is node else self.generic_visit(part)

    fresh, place = copy.deepcopy(tree), [*ast.walk(tree)].index(node)
    node = [*ast.walk(fresh)][place]
    return ast.unparse(ast.fix_missing_locations(Exchange().visit(fresh)))


def mutated(folder, number, file, source):
    """The check of a checker with another source of one file, beside the true one."""
    name = f"mutant{number}"
    (folder / name).mkdir()
    for path in SOURCE.glob("*.py"):
        text = source if path == file else path.read_text(encoding="utf-8")
        (folder / name / path.name).write_text(text.replace("holdfast_check", name))
    found = importlib.import_module(f"{name}.checker").check
    for module in [m for m in sys.modules if m.split(".")[0] == name]:
        del sys.modules[module]
    return found


ELSEWHERE = {
    "a table has not the nodes": "test_judged_laws.py",
    "an input is none that may be under way": "test_judged_laws.py",
    "leads to more cells than are counted": "",
    "has a number that is too long": "test_checker_numbers.py",
    "uses the inputs that it gives": "test_judged_laws.py",
    "has too many conditions": "test_forged_laws.py",
    "has fewer conditions than it says": "test_judged_laws.py",
    "more parts than are counted": "",
    "axes without nodes": "test_forged_laws.py",
    "is not above 0": "test_forged_laws.py",
    "are not all that these may be": "test_forged_laws.py",
    "are not as many as these": "test_judged_laws.py",
    "it is no file": "test_forged_laws.py",
    "stands twice": "test_certificate.py",
    "comes back after a turn": "test_certificate.py",
    "unpacks to more than": "test_forged_laws.py",
    "no law with a safeguard": "test_flowpipe.py",
    "is nested too deep": "test_flowpipe.py",
    "directions that cannot be told": "",
}
"""Refusals of which other tests have the files, two that bound time and memory alone, and
one against what rounding might do."""


@pytest.mark.heavy
def test_every_refusal_has_a_file_that_passes_without_it(tmp_path, monkeypatch):
    monkeypatch.syspath_prepend(tmp_path)
    files, told, refused = [], {}, 0
    for _, content in forged(written(tmp_path)):
        path = tmp_path / "one.holdfast"
        path.write_bytes(content)
        _, where = outcome(checker.check, path)
        refused += where is not None
        if told.setdefault(where, 0) < (4 if where else 40):
            told[where] += 1
            kept = tmp_path / f"file{len(files)}.holdfast"
            kept.write_bytes(content)
            files.append((kept, outcome(checker.check, kept)[0]))
    assert refused > 10_000
    files.sort(key=lambda file: not file[1].startswith("NotValid"))
    alive = []
    for number, (name, file, source) in enumerate(mutants()):
        check = mutated(tmp_path, number, file, source)
        if all(outcome(check, path)[0] == said for path, said in files):
            alive.append(name)
    assert number > 40
    assert not [name for name in alive if not any(part in name for part in ELSEWHERE)]
