"""Every refusal of the checker, and every part of its condition, has a file that shows it.

The checker is mutated: a refusal is gone, a part of its condition is dropped, a bound is moved by
one; so are conditions in functions that decide for it (`DECIDES`). Files are forged by changing leaves of honest headers, and several at once. A mutant says
something else of one of them.
"""

import ast
import copy
import itertools
import json
import math
import re
import signal
from collections import Counter
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import pytest
import sympy as sp
from mutation import replaced

import holdfast as hf
from holdfast_check import checker
from tests.analysis.certificates.mutants import SOURCE, beside, others
from tests.certified_systems import changed
from tests.laws_to_judge import slider, thermostat

H = float.hex
X, TH, U, D = (hf.symbol(n) for n in ("x", "th", "u", "d"))


def line(state, rate):
    return hf.System(
        "line", (state,), (hf.Quantity("u"),), {state.name: rate}, disturbances=(hf.Quantity("d"),),
        input_bounds=hf.Box((-1.0,), (1.0,)),
        disturbance_bounds=hf.Box((-0.1,), (0.1,)),
    )  # fmt: skip


def written(folder):
    """Small honest files of several kinds."""
    system = line(hf.Quantity("x"), U + D)
    ends = hf.Region("line", system.states, tuple(
        hf.Inequality(n, e) for n, e in (("l", -1 - X), ("r", X - 1))
    ))  # fmt: skip
    near = hf.Region("near", system.states, (hf.Inequality("n", sp.Abs(X) - 0.3),))
    given = {"box": {"x": (-1, 1)}, "sample_time": 0.2, "inputs": 3}
    turn = line(hf.Quantity("th", "rad"), U + D * sp.cos(TH))
    any_th = hf.Region("any", turn.states, (hf.Inequality("c", sp.sin(TH) - 2),))
    drawn = replace(
        system, parameters=(hf.Parameter("k", "1", value=0.125),),
        rates={"x": U * hf.symbol("k") - X / 4 + D},
    )  # fmt: skip
    y = hf.Quantity("y")
    pair = hf.System("pair", (*system.states, y), (), {"x": -X, "y": -y.symbol})
    biased = hf.System(
        "biased", (*system.states, y), system.inputs, {"x": y.symbol + U / 8 - X / 4, "y": sp.S.Zero},
        input_bounds=system.input_bounds,
    )  # fmt: skip
    inner, square = {"x": (-0.9, 0.9)}, {"x": (-0.9, 0.9), "y": (-0.1, 0.1)}
    pushed, on_line = slider()
    guarded = hf.safeguard(
        pushed, hf.Law("push", pushed.states, {"v": 0.5 + 0 * X}), on_line, worst=("w",),
        gains=(2.0, 4.0), margins={"left": 0.1, "right": 0.1},
    )  # fmt: skip
    files = {
        "keep": hf.certify(system, ends, cells=10, **given),
        "late": hf.certify(system, ends, cells=40, delay=0.02, errors={"x": 0.001}, **given),
        "brief": hf.certify(system, ends, cells=10, horizon=0.6, **given),
        "drift": hf.certify(
            replace(system, rates={"x": 1 + U / 2 + D}), ends, cells=20, horizon=0.6, **given
        ),
        "reach": hf.certify(system, ends, cells=20, target=near, horizon=8.0, **given),
        "halved": hf.certify(system, ends, cells=5, halvings=2, **given),
        "whole": hf.certify(drawn, ends, cells=1, **{**given, "box": inner}),
        "still": hf.certify(biased, ends, cells=2, **{**given, "box": square}),
        "stepped": hf.certify(system, ends, cells=10, steps=2, **given),
        "turn": hf.certify(
            turn, any_th, box={"th": (-math.pi, math.pi)}, cells=8, sample_time=0.2, inputs=3
        ),
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
        "pair": hf.flowpipe(
            pair, ends, start={"x": (0.1, 0.2), "y": (0.1, 0.2)}, horizon=0.2, degrees=(1, 2)
        ),
        "slow": hf.judge_law(
            pushed, on_line, hf.Law("back", pushed.states, {"v": -pushed.states[0].symbol}),
            box={"x": (-1, 1)}, cells=20, sample_time=0.1, delay=0.02,
        ).certificate,
        "guard": hf.judge_law(
            pushed, on_line, guarded, box={"x": (-1, 1)}, cells=64, sample_time=0.1
        ).certificate,
    }  # fmt: skip
    return {name: found.write(folder / f"{name}.holdfast") for name, found in files.items()}


NASTY = (None, True, 0, -1, 12, 64, 65, 70, 10**9, "", "x", "v", "ä", "x +", "x**3", "x**x", "x**(1/3)", "f(x)", "y",
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


def together(paths):
    """(name, bytes) of files of which several parts are changed, or one to a value of its own."""
    headers = {n: json.loads(p.read_bytes().split(b"\n")[1]) for n, p in paths.items()}
    modes, guard = headers["modes"]["law"], headers["guard"]["law"]
    other = {"name": "ä", "unit": "m", "range": [H(0.0), H(0.0)]}
    none = {k: [] for k in ("states", "rates", "start", "errors")}
    edges = headers["turn"]["edges"][0]
    for name, header in (
        ("whole", {"parameters": [*headers["whole"]["parameters"], other]}),
        ("closed", {"hold": H(-0.1), "holds": -2}),
        ("closed", {"hold": H(1e300), "holds": 10**9}),
        ("closed", {"splits": [0] * 1000}),
        *(("closed", {"degrees": [1, degree]}) for degree in (12, 13)),
        ("pair", {"degrees": [12, 12]}),
        ("pair", {"law": {**modes, "modes": []}}),
        ("pair", {"errors": [H(0.1), H(0.1)]}),
        ("pair", none),
        ("keep", {"hold": H(1e300), "holds": 10**9}),
        ("brief", {"hold": H(1e300), "holds": 10**9}),
        ("keep", {"law": {**modes, "modes": []}}),
        *(("stepped", {"steps": steps}) for steps in (64, 65)),
        *(("keep", {"halves": halves}) for halves in (-1, 0, 8, 9)),
        ("still", {"errors": [H(0.0), H(0.01)]}),
        ("keep", {"entries": 70}),
        ("keep", {"edges": [[*headers["keep"]["edges"][0][::-1]]]}),
        ("reach", {"holds": headers["reach"]["holds"] + 5}),
        ("turn", {"edges": [[*edges[:-1], H(3.0)]]}),
        ("turn", {"rates": ["1000*d"]}),
        ("turn", {"rates": ["10**14 + u + d*cos(th)"]}),
        *(
            ("slow", {"law": {**headers["slow"]["law"], "under_way": [[H(a), H(b)]]}})
            for a, b in ((1.0, 1.0), (1.0, -1.0))
        ),
        *(
            ("keep", {"rates": [f"u + d + {more}"]})
            for more in ("0*x**64", "0*x**65", "0*x**(-1)", "0*x**0", "2**9000 - 2**9000")
        ),
        *(("pair", {"rates": [f"-x + 0*({more})", "-y"]}) for more in ("x**64", "x**65", "x**0")),
        *(
            ("pair", {"rates": [f"-x + 2**(-40)*{more}", "-y"]})
            for more in ("wrap(x + 3)", "atan2(x - 3/20, -1)", "Abs(1/(x - 3/20))", "Abs(0*x + 1)")
        ),
        ("modes", {"law": {**modes, "names": [*modes["names"], "third"]}}),
        ("pipe", {"law": guard}),
    ):
        yield f"{name} {header}", changed(paths[name], lambda h, c=header: h.update(c))
    (when, gives, _), *options = modes["modes"][0]
    for to in (2, 3):
        law = {**modes, "modes": [[[when, gives, to], *options], *modes["modes"][1:]]}
        yield f"modes to {to}", changed(paths["modes"], lambda h, c=law: h.update(law=c))
    count = len(guard["modes"][0][0][1]["rows"])
    for hard in (-1, 0, count, count + 1):
        law = copy.deepcopy(guard)
        law["modes"][0][0][1]["hard"] = hard
        yield f"guard hard {hard}", changed(paths["guard"], lambda h, c=law: h.update(law=c))
    first, _, rest = paths["keep"].read_bytes().partition(b"\n")
    yield "keep with a word more", first + b" x\n" + rest
    yield "keep nothing", changed(paths["keep"], lambda h: None, entries=lambda rows: b"")
    for level in (3, 4):  # of three holds
        yield (
            f"brief level {level}",
            changed(
                paths["brief"], lambda h: None,
                entries=lambda rows, k=level: rows[:6] + k.to_bytes(4, "little") + rows[10:],
            ),
        )  # fmt: skip
    for cell in (8, 18, 28):  # of 10 cells, wider ones that are not whole
        row = cell.to_bytes(4, "little") + bytes(6)
        path = changed(paths["keep"], lambda h: h.update(depth=2), entries=lambda _, r=row: r)
        yield f"keep deep {cell}", path


def outcome(check, path):
    """What a checker says of a file, and where it refuses it."""
    try:
        with limited():
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


@contextmanager
def limited(seconds=20):
    """A mutant may go on for ever."""

    def stop(*_):
        raise TimeoutError("it goes on for ever")

    before = signal.signal(signal.SIGALRM, stop)
    signal.setitimer(signal.ITIMER_REAL, seconds)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
        signal.signal(signal.SIGALRM, before)


def mutants():
    """(name, file, line, changed source): without a refusal, or with another condition of one."""
    for file in sorted(SOURCE.glob("*.py")):
        tree = ast.parse(file.read_text(encoding="utf-8"))
        for function in ast.walk(tree):
            if not isinstance(function, ast.FunctionDef):
                continue
            for node in ast.walk(function):
                if refuses(node):
                    name = f"{file.name} {function.name} {node.lineno}: {ast.unparse(node)}"
                    yield name, file, node.lineno, replaced(tree, node, ast.Pass())
            for node, other, what in others(conditions(function)):
                name = f"{file.name} {function.name}: {what}"
                yield name, file, node.lineno, replaced(tree, node, other)


def refuses(node):
    return isinstance(node, ast.Raise) and "Error(" in ast.unparse(node)


DECIDES = ("_reached", "_cells", "_holds", "covered", "within")
"""Functions of which the answers refuse: every condition in them counts."""


def conditions(function):
    """Of refusals: what `if` asks, and what the names in that were set to."""
    if function.name in DECIDES:
        return [function]
    asked = [
        n.test for n in ast.walk(function) if isinstance(n, ast.If) and any(map(refuses, n.body))
    ]
    names = {n.id for test in asked for n in ast.walk(test) if isinstance(n, ast.Name)}
    for node in ast.walk(function):
        ends = node.targets if isinstance(node, ast.Assign) else [getattr(node, "target", None)]
        if (
            isinstance(node, ast.Assign | ast.AugAssign)
            and {n.id for end in ends for n in ast.walk(end) if isinstance(n, ast.Name)} & names
        ):
            asked.append(node.value)
    return asked


ELSEWHERE = {
    "a table has not the nodes": "test_judged_laws.py",
    "an input is none that may be under way": "test_judged_laws.py",
    "has a number that is too long": "test_checker_numbers.py",
    "uses the inputs that it gives": "test_judged_laws.py",
    "has too many conditions": "test_forged_laws.py",
    "axes without nodes": "test_forged_laws.py",
    "is not above 0": "test_forged_laws.py",
    "are not all that these may be": "test_forged_laws.py",
    "p.wanted is None and": "test_forged_laws.py",
    "are not as many as these": "test_judged_laws.py",
    "it is no file": "test_forged_laws.py",
    "stands twice": "test_certificate.py",
    "comes back after a turn": "test_certificate.py",
    "unpacks to more than": "test_forged_laws.py",
    "no law with a safeguard": "test_flowpipe.py",
    "is nested too deep": "test_flowpipe.py",
}
"""Refusals of which other tests have the files."""

NO_FILE = {
    "leads to more cells than are counted": "bounds time and memory alone",
    "more parts than are counted": "bounds time and memory alone",
    "directions that cannot be told": "against what rounding might do",
    "> MOST_TOUCHED with another": "bounds memory alone",
    "> MOST_MONOMIALS with another": "bounds memory alone",
    "> MOST_PARTS with another": "bounds memory alone",
    "> MOST_SETS with another": "bounds time alone",
    "> most with another": "bounds memory alone",
    "LONGEST_NUMBER with another": "bounds time alone",
    "level > FINEST with another": "bounds time alone",
    ">= 2 * arb.pi() with another": "no axis is a turn to the last bit",
    "a < b with another": "a width of 0 is followed too: it says the same",
    "> MOST_BOXES with another": "bounds time alone",
    "covered: not widths or": "every cell has a width",
    "_width(q) > 0 with another": "what has no width is divided into itself",
    "isfinite(low) and math.isfinite(high) without": "what is no number has neither end",
    "turns and finite without": "it says the same of what does not turn, and fails of no number",
    "turns or still without still": "against rounding at the edge of the grid",
    "high > axis[-1] with another": "no end is the edge of the grid to the last bit",
    "places and finite without places": "what is no number alone is in no place",
    "< MOST_TURNED with another": "no end is that far to the last bit",
    "< axis[-1] - axis[0] with another": "no width is a turn to the last bit",
    "s[0] > 0 with another": "a scale of 0 is refused or not: no weight tells inputs apart",
}
"""Refusals and bounds that no file of a moderate size can show, and why."""


@pytest.mark.heavy
@pytest.mark.timeout(3600)
@pytest.mark.skipif(not hasattr(signal, "setitimer"), reason="mutants that do not end need it")
def test_every_refusal_has_a_file_that_passes_without_it(tmp_path, monkeypatch):
    monkeypatch.syspath_prepend(tmp_path)
    honest = written(tmp_path)
    assert all(outcome(checker.check, path)[1] is None for path in honest.values())
    files, told, refused = [], Counter(), 0
    for name, content in itertools.chain(forged(honest), together(honest)):
        path = tmp_path / "one.holdfast"
        path.write_bytes(content if isinstance(content, bytes) else content.read_bytes())
        where = outcome(checker.check, path)[1]
        refused += where is not None
        words = re.findall("[a-z]+", name.rpartition(" ")[0]) if where else name.split()[:1]
        told[where, *words] += 1
        if told[where, *words] <= 2 or isinstance(content, Path) or "more" in words:
            kept = tmp_path / f"file{len(files)}.holdfast"
            kept.write_bytes(path.read_bytes())
            files.append((kept, outcome(checker.check, kept)[0], where or ("", 0)))
    assert refused > 10_000
    alive = []
    for number, (name, file, line, source) in enumerate(mutants()):
        check = beside(tmp_path, number, file, source).check
        near = sorted(files, key=lambda f: (f[2][0] != file.name, abs(f[2][1] - line)))
        if all(outcome(check, path)[0] == said for path, said, _ in near):
            alive.append(name)
    assert number > 150
    explained = (*ELSEWHERE, *NO_FILE)
    assert not [name for name in alive if not any(part in name for part in explained)]
