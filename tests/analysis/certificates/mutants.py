"""Mutants of the checker: another condition in its source, and the changed program beside it."""

import ast
import importlib
import itertools
import sys
from pathlib import Path

from holdfast_check import checker

SOURCE = Path(checker.__file__).parent
MOVED = {ast.Lt: ast.LtE, ast.LtE: ast.Lt, ast.Gt: ast.GtE, ast.GtE: ast.Gt}


def others(roots):
    """(node, other node, what is other) of the conditions in some nodes of a tree."""
    for node in itertools.chain(*map(ast.walk, roots)):
        if isinstance(node, ast.BoolOp) and not isinstance(
            node.values[-1], ast.List | ast.Constant
        ):
            for k, part in enumerate(node.values):
                rest = [v for j, v in enumerate(node.values) if j != k]
                other = rest[0] if len(rest) == 1 else ast.BoolOp(node.op, rest)
                yield node, other, f"{ast.unparse(node)} without {ast.unparse(part)}"
        if isinstance(node, ast.Compare):
            sides = [node.left, *node.comparators]
            links = [ast.Compare(sides[k], [op], [sides[k + 1]]) for k, op in enumerate(node.ops)]
            for k, op in enumerate(node.ops):
                says = f"{ast.unparse(node)} with another link {k}"
                rest = links[:k] + links[k + 1 :]
                if rest:
                    other = rest[0] if len(rest) == 1 else ast.BoolOp(ast.And(), rest)
                    yield node, other, f"{ast.unparse(node)} without link {k}"
                if type(op) in MOVED:
                    ops = [*node.ops[:k], MOVED[type(op)](), *node.ops[k + 1 :]]
                    yield node, ast.Compare(node.left, ops, node.comparators), says


def beside(folder, number, file, source, module="checker"):
    """A module of the checker with another source of one file, beside the true one."""
    name = f"mutant{number}"
    (folder / name).mkdir()
    for path in SOURCE.glob("*.py"):
        text = source if path == file else path.read_text(encoding="utf-8")
        (folder / name / path.name).write_text(text.replace("holdfast_check", name))
    changed = importlib.import_module(f"{name}.{module}")
    for other in [m for m in sys.modules if m.split(".")[0] == name]:
        del sys.modules[other]
    return changed
