"""Does a test fail when a decision of the code is another? A mutation run, part by part.

    python benchmarks/mutation.py                                  # every part, 40 mutants of each
    python benchmarks/mutation.py --part filter --count 200 --seed 3
    python benchmarks/mutation.py --part checker --begin 17        # goes on where a run was stopped
    python benchmarks/mutation.py --part checker --only 17 --seed 1

A mutant is one file of `src` in which one comparison has another link (< for <=, == for !=), a part
of an `and` or `or` is gone, a condition is turned around, + is -, * is /, `min` is `max`, or a
number is one more. Mutants are drawn from (seed, number); their tests run in a copy of the tree
until one fails. A mutant that all of them pass survives: either the tests hold nothing there, or it
says the same, and `mutation.toml` says why. `mutation.json` has the counts, the survivors and how
many of those that were drawn have been tried.

Exit status 1 if a mutant survives of which `mutation.toml` says nothing.
"""

from __future__ import annotations

import argparse
import ast
import copy
import json
import math
import os
import random
import resource
import shutil
import sys
import tempfile
import tomllib
from collections.abc import Iterable, Iterator
from pathlib import Path

import llvmlite.binding
import numpy
import pytest
import sympy

LIBRARIES = (llvmlite.binding, numpy, sympy)
"""What every run of the tests needs, and takes most of a second to load."""

ROOT = Path(__file__).parent.parent
RECORD, REASONS = (Path(__file__).with_suffix(ending) for ending in (".json", ".toml"))
LONGER = 4
"""A mutant that takes so many times the time of a processor as the true code goes on for ever."""

MARKS = ("not heavy", "heavy")
"""The tests of the second mark are run where all of the first pass."""

PARTS = {
    # part: its files below src, or functions and classes of one, and the tests that hold it
    "quadratic program": (
        ["holdfast/execution/simulation/quadratic_program.py"],
        ["tests/execution/simulation/test_quadratic_program.py",
         "tests/maths/control/test_priority.py"],
    ),
    "filter": (
        ["holdfast/analysis/online/safety_filter.py::crossings_of _along _most SafetyFilter",
         "holdfast/maths/control/safety_filter.py::HeldGains conditions _longest _latest in_order "
         "_levels safeguard asked_of _level _depth _Unknown limit_rates _steps _rates"],
        [*(f"tests/maths/control/test_{name}.py" for name in (
            "held_gain", "held_conditions", "later_inputs", "rate_limits", "safety_filter",
            "priority")),
         *(f"tests/analysis/online/test_{name}.py" for name in (
             "filter_of_parts", "overshoot", "safety_filter"))],
    ),
    "verdicts of marches": (
        ["holdfast/analysis/reachability/one_march.py::OneMarch _ends_reached _check_growth"],
        [*(f"tests/analysis/reachability/test_{name}.py" for name in (
            "march_report", "convergence_of_a_march", "ends_of_a_grid", "checkpoint_in_parts",
            "checkpoint")),
         "tests/known_solutions/test_exact_kernels.py"],
    ),
    "checker": (
        ["holdfast_check/checker.py::Checker well_formed _of_flowpipe _of_cells",
         "holdfast_check/held.py", "holdfast_check/law.py", "holdfast_check/safeguard.py",
         "holdfast_check/flowpipe.py"],
        [f"tests/analysis/certificates/test_{name}.py" for name in (
            "checker_numbers", "certificate", "horizon", "reaching", "forged_laws", "judged_laws",
            "refining", "statement", "flowpipe", "safeguards_over_boxes", "kept_on_the_way",
            "options_of_a_law")],
    ),
}  # fmt: skip

OTHER_LINK = {
    ast.Lt: ast.LtE, ast.LtE: ast.Lt, ast.Gt: ast.GtE, ast.GtE: ast.Gt,
    ast.Eq: ast.NotEq, ast.NotEq: ast.Eq, ast.Is: ast.IsNot, ast.IsNot: ast.Is,
}  # fmt: skip
OTHER_OPERATION = {ast.Add: ast.Sub, ast.Sub: ast.Add, ast.Mult: ast.Div, ast.Div: ast.Mult}
OTHER_NAME = {"min": "max", "max": "min", "any": "all", "all": "any"}


def others(node: ast.AST) -> Iterator[ast.AST]:
    """What may stand in place of a node."""
    match node:
        case ast.Compare():
            for k, op in enumerate(node.ops):
                if (other := OTHER_LINK.get(type(op))) is not None:
                    ops = [*node.ops[:k], other(), *node.ops[k + 1 :]]
                    yield ast.Compare(node.left, ops, node.comparators)
        case ast.BoolOp():
            for k in range(len(node.values)):
                rest = node.values[:k] + node.values[k + 1 :]
                yield rest[0] if len(rest) == 1 else ast.BoolOp(node.op, rest)
        case ast.UnaryOp(op=ast.Not()):
            yield node.operand
        case ast.BinOp() if (operation := OTHER_OPERATION.get(type(node.op))) is not None:
            yield ast.BinOp(node.left, operation(), node.right)
        case ast.Call(func=ast.Name(id=name)) if name in OTHER_NAME:
            yield ast.Call(ast.Name(OTHER_NAME[name], ast.Load()), node.args, node.keywords)
        case ast.Constant(value=int() | float()) if not isinstance(node.value, bool):
            yield ast.Constant(node.value + 1)


def mutants(file: Path, within: str) -> list[tuple[str, ast.Module, ast.AST, ast.AST]]:
    """(what is other, tree, node, another in its place) of a file, or of a part of that name."""
    tree = ast.parse(file.read_text("utf-8"))
    nodes = list(ast.walk(tree))
    roots = [n for n in nodes if getattr(n, "name", "") == within] if within else [tree]
    inside = {id(inner) for root in roots for inner in ast.walk(root)}
    annotations = {
        id(inner) for node in nodes for name in ("annotation", "returns")
        if (hint := getattr(node, name, None)) is not None for inner in ast.walk(hint)
    }  # fmt: skip
    functions, statements = _enclosing(tree, ast.FunctionDef), _enclosing(tree, ast.stmt)
    every = []
    for node in nodes:
        if id(node) in annotations or id(node) not in inside:
            continue
        for other in others(node):
            function = getattr(functions.get(id(node)), "name", "")
            line = ast.unparse(statements[id(node)]).splitlines()[0][:80]
            says = f"{file.stem} {function}: {ast.unparse(node)} -> {ast.unparse(other)}, {line}"
            every.append((says, tree, node, other))
    return every


def _enclosing(tree: ast.Module, kind: type[ast.AST]) -> dict[int, ast.AST]:
    """The smallest node of a kind around every node, by its identity."""
    around: dict[int, ast.AST] = {}
    for outer in ast.walk(tree):  # from the outside in
        if isinstance(outer, kind):
            around |= {id(inner): outer for inner in ast.walk(outer)}
    return around


def replaced(tree: ast.Module, node: ast.AST, other: ast.AST) -> str:
    """The source of a tree with another node in place of one."""
    fresh, place = copy.deepcopy(tree), [*ast.walk(tree)].index(node)
    target = [*ast.walk(fresh)][place]

    class Exchange(ast.NodeTransformer):
        def visit(self, part: ast.AST) -> ast.AST:
            return copy.deepcopy(other) if part is target else self.generic_visit(part)

    return ast.unparse(ast.fix_missing_locations(Exchange().visit(fresh)))


def passes(copied: Path, tests: list[str], mark: str, seconds: int) -> bool:
    """Whether all tests of a mark pass with the sources of a copy, in so many seconds of a
    processor.

    They run in a child of this process, which has the libraries already (`LIBRARIES`).
    """
    child = os.fork()
    if child == 0:
        with open(os.devnull, "w") as nowhere:
            os.dup2(nowhere.fileno(), 1)
            os.dup2(nowhere.fileno(), 2)
        resource.setrlimit(resource.RLIMIT_CPU, (seconds, seconds))
        places = [str(copied / name) for name in ("src", "benchmarks", ".")]
        sys.path[:1] = places
        os.environ["PYTHONPATH"] = os.pathsep.join(places)
        os.chdir(copied)
        words = ["-x", "-q", "-n", "0", "-p", "no:cacheprovider", "-m", mark, *tests]
        status = pytest.main(words)
        os._exit(0 if status == pytest.ExitCode.NO_TESTS_COLLECTED else int(status))
    return os.waitpid(child, 0)[1] == 0


def used() -> float:
    """Seconds of processors that programs run from here have taken."""
    of = resource.getrusage(resource.RUSAGE_CHILDREN)
    return of.ru_utime + of.ru_stime


def outcomes(
    part: str, count: int, seed: int, asked: Iterable[int]
) -> Iterator[tuple[int, str, bool]]:
    """(number, what is other, whether all tests passed it) of mutants of a part."""
    files, tests = PARTS[part]
    with tempfile.TemporaryDirectory() as folder:
        copied = Path(folder) / "tree"
        shutil.copytree(ROOT, copied, ignore=shutil.ignore_patterns(".git", "runs", "__pycache__"))
        seconds = {}
        for mark in MARKS:
            begun = used()
            if not passes(copied, tests, mark, 3600):
                raise SystemExit(f"the tests of the {part} fail as they are: {' '.join(tests)}")
            seconds[mark] = math.ceil(LONGER * (used() - begun))
        every = [
            (copied / "src" / name, *mutant)
            for name, _, places in (entry.partition("::") for entry in files)
            for within in places.split() or [""]
            for mutant in mutants(ROOT / "src" / name, within)
        ]
        drawn = random.Random(f"{seed} {part}").sample(every, min(count, len(every)))
        for number in asked:
            file, says, *exchange = drawn[number]
            true = file.read_text("utf-8")
            file.write_text(replaced(*exchange), "utf-8")
            lives = all(passes(copied, tests, mark, seconds[mark]) for mark in MARKS)
            file.write_text(true, "utf-8")
            print(f"{part} {number}: {'LIVES' if lives else 'found'}: {says}", flush=True)
            yield number, says, lives


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--part", choices=PARTS, action="append", help="only this one (or several)")
    parser.add_argument("--count", type=int, default=40, help="mutants of each part")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--begin", type=int, default=0, help="go on with this mutant of the record")
    parser.add_argument("--only", type=int, help="one mutant, by its number, without a record")
    asked = parser.parse_args()
    if not 0 <= (asked.only or asked.begin) < asked.count:
        parser.error(f"expected a number below --count, {asked.count}")
    numbers = range(asked.begin, asked.count) if asked.only is None else [asked.only]
    reasons = tomllib.loads(REASONS.read_text("utf-8"))
    open_questions = []
    for part in asked.part or PARTS:
        record = json.loads(RECORD.read_text("utf-8"))
        alive = record[part]["survivors"] if asked.begin else []
        for number, says, lives in outcomes(part, asked.count, asked.seed, numbers):
            alive += [says] if lives else []
            if asked.only is None:  # after every one, so that it can be stopped
                record = json.loads(RECORD.read_text("utf-8"))
                whole = {"seed": asked.seed, "of": asked.count, "mutants": number + 1}
                record[part] = whole | {"survivors": sorted(alive)}
                RECORD.write_text(json.dumps(record, indent=1) + "\n", "utf-8")
        unexplained = [says for says in alive if says not in reasons.get(part, {})]
        open_questions += unexplained
        print(f"{part}: {len(alive)} survive, {len(unexplained)} unexplained")
    sys.exit(1 if open_questions else 0)


if __name__ == "__main__":
    main()
