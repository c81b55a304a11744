"""What a certificate proves, in plain lines and as data, from its file alone.

Numbers are those of a double, in the digits that are read back as it; names, units and titles that
are not plain are quoted, as JSON has them. What is too long for lines, the cells and their inputs,
the options of a law and its table, is told by its SHA-256: two files that prove different things
never have the same statement.
"""

from __future__ import annotations

import array
import ast
import copy
import hashlib
import json
import re
from collections.abc import Iterable, Iterator, Sequence
from fractions import Fraction
from typing import Any

from holdfast_check.intervals import Expression
from holdfast_check.reading import Values

LONGEST, MOST_OF_LAW = 200, 1500
"""Of a title and of a law that are printed."""
_PLAIN = re.compile(r"[A-Za-z0-9_%^*/.-]+( [A-Za-z0-9_%^*/.-]+)*")


def statement(h: Values, entries: Sequence[Any]) -> Values:
    """Plain data, of which `lines` makes text."""
    hold, target = h["hold"], [_limit(c) for c in h["target"]]
    law, holds = h["law"], h["holds"]
    said = {
        "kind": "flowpipe" if "start" in h else "cells",
        "title": _quoted(h["title"][:LONGEST]),
        "rates": {
            q["name"]: _readable(e) for q, e in zip(h["states"], h["rates"], strict=True)
        },
        "states": {
            q["name"]: {"unit": _quoted(q["unit"]), **axis, "measured_within": error}
            for q, axis, error in zip(h["states"], _axes(h), h["errors"], strict=True)
        },
        "always": [_limit(c) for c in h["constraints"]],
        "target": target,
        "whatever": {
            q["name"]: {
                "unit": _quoted(q["unit"]), "least": q["range"][0], "greatest": q["range"][1],
                "varies": group == "disturbances",
            }
            for group in ("disturbances", "parameters") for q in h[group]
        },
        "inputs": {q["name"]: {"unit": _quoted(q["unit"])} for q in h["inputs"]},
        "held_for": hold,
        "late_by": h.get("delay", 0.0),
        "holds": holds,
        "for_seconds": None if holds is None else holds * hold,
        "cells_kept": h.get("cells_kept"),
        "law": bool(law["modes"]),
        "law_knows": _knows(h),
        "options": _options(h),
        "inputs_tried": len(h.get("candidates", ())),
        "digest": _digest(h, entries),
    }  # fmt: skip
    tried = [(min(c), max(c)) for c in zip(*h.get("candidates", ()), strict=True)]
    under_way = law["under_way"] if law["modes"] and said["late_by"] else tried
    for q, (least, most) in zip(h["inputs"], under_way, strict=False):
        said["inputs"][q["name"]] |= {"least": least, "greatest": most}
    return said


def _options(h: Values) -> list[str]:
    """What the law gives, and where; the digest alone tells what is too long."""
    law, rows = h["law"], list[str]()
    names = list(map(_quoted, law["names"]))
    for mode, options in zip(names, law["modes"], strict=True):
        for when, inputs, to in options:
            if isinstance(inputs, dict):
                row = "what the program of a safeguard gives"
            else:
                each = zip(h["inputs"], inputs, strict=True)
                row = ", ".join(f"{q['name']} = {_readable(e)}" for q, e in each)
            row += " where " * bool(when) + " and ".join(f"{_readable(c)} <= 0" for c in when)
            rows.append(f"in {mode}: {row}, then {names[to]}" if len(names) > 1 else row)
    if sum(map(len, rows)) > MOST_OF_LAW:
        return ["longer than is printed: the SHA-256 tells it"]
    return rows


def _knows(h: Values) -> str:
    """What is uncertain and a law uses all the same, as it is."""
    used = set[str]().union(*(e.names for e in _expressions(h["law"])))
    unsure = {q["name"] for k in ("disturbances", "parameters") for q in h[k]
              if q["range"][0] < q["range"][1]}  # fmt: skip
    names = ", ".join(sorted(used & unsure))
    return f", which knows {names} as it is at its sample" if names else ""


def _expressions(part: Any) -> Iterator[Expression]:
    if isinstance(part, Expression):
        yield part
    several = part.values() if isinstance(part, dict) else part if isinstance(part, list) else ()
    for inner in several:
        yield from _expressions(inner)


def _axes(h: Values) -> Sequence[Values]:
    if "start" in h:
        return [{"least": low, "greatest": high} for low, high in h["start"]]
    return [
        {"least": axis[0], "greatest": axis[-1], "cells": len(axis) - 1, "comes_back": turns}
        for axis, turns in zip(h["edges"], h["periodic"], strict=True)
    ]


def lines(said: Values) -> list[str]:
    """The statement as text."""
    n, hold = said["cells_kept"], _n(said["held_for"])
    end = (
        "for ever"
        if said["holds"] is None
        else f"for {said['holds']} holds, {_n(said['for_seconds'])} s"
    )
    what = f"from each of {n} cells the constraints are kept {end}"
    if said["target"]:
        within = f"within {said['holds']} holds, {_n(said['for_seconds'])} s"
        what = f"from each of {n} cells the target is reached {within}, and the constraints are "
        what += "kept until then"
    if said["kind"] == "flowpipe":
        seconds = f"{_n(said['for_seconds'])} s"
        what = f"from every state of a box at time 0 the constraints are kept for {seconds}"
        what += ", and the target holds at exactly that time" if said["target"] else ""
    rows = [
        ("proves", [what]),
        ("title", [said["title"] + ", which says nothing of what is proved"]),
    ]
    rows += [("rates", [f"{name}' = {text}" for name, text in said["rates"].items()])]
    states = "start" if said["kind"] == "flowpipe" else "states"
    rows += [(states, [_state(name, q) for name, q in said["states"].items()])]
    rows += [("constraints", said["always"]), ("target", said["target"])]
    rows += [("whatever", [
        f"{name} [{q['unit']}] is, from {_n(q['least'])} to {_n(q['greatest'])}, "
        + ("another at every instant" if q["varies"] else "one number all the time")
        for name, q in said["whatever"].items()
    ])]  # fmt: skip
    by = (
        "what the law gives" + said["law_knows"]
        if said["law"]
        else f"one of {said['inputs_tried']} that were tried"
    )
    rows += [("inputs", [
        f"{name} [{q['unit']}]: " + by
        + (f", from {_n(q['least'])} to {_n(q['greatest'])}" if "least" in q else "")
        for name, q in said["inputs"].items()
    ] or ["none"])]  # fmt: skip
    rows += [("law", said["options"])]
    late = f"{_n(said['late_by'])} s late at most, before which any input between these may act"
    sampled = [
        f"every {hold} s exactly, and inputs are held until the next sample",
        late if said["late_by"] else "an input acts from its sample on, as it is",
    ]
    if said["kind"] == "flowpipe" and not said["inputs"]:
        sampled = ["nothing: a law, if there is one, is in the rates, of the exact state"]
    rows += [("sampled", sampled)]
    rows += [("SHA-256", [f"{said['digest']} of all of it but the title"])]
    return [f"  {name if k == 0 else '':<12} {text}" for name, texts in rows
            for k, text in enumerate(texts)]  # fmt: skip


def _state(name: str, q: Values) -> str:
    around = ", where it comes back to itself" if q.get("comes_back") else ""
    wrong = f"within {_n(q['measured_within'])}" if q["measured_within"] else "exactly"
    ends = f"from {_n(q['least'])} to {_n(q['greatest'])}"
    ends += f" in {q['cells']} cells" if "cells" in q else ""
    return f"{name} [{q['unit']}] {ends}{around}, measured {wrong}"


def _limit(c: Values) -> str:
    return f"{_readable(c['expression'])} <= 0 [{_quoted(c['unit'])}] ({_quoted(c['name'])})"


def _readable(e: Expression) -> str:
    """The text as it is read, with fractions that are floats in their decimal digits."""
    try:
        return ast.unparse(_Decimals().visit(copy.deepcopy(e.tree)))
    except RecursionError:  # of very long sums
        return e.text


class _Decimals(ast.NodeTransformer):
    """Quotients a/b and a*x/b of whole numbers as a float and its product, where one is exact."""

    def visit_BinOp(self, node: ast.BinOp) -> ast.expr:
        self.generic_visit(node)
        match node:
            case ast.BinOp(left=left, op=ast.Div(), right=ast.Constant(value=int(under))) if under:
                match left:
                    case ast.Constant(value=int(over)) if _exact(over, under):
                        return ast.Constant(over / under)
                    case ast.UnaryOp(op=ast.USub(), operand=ast.Constant(value=int(over))) if (
                        _exact(over, under)
                    ):
                        return ast.UnaryOp(ast.USub(), ast.Constant(over / under))
                    case ast.BinOp(
                        left=ast.Constant(value=int(over)), op=ast.Mult(), right=factor
                    ) if _exact(over, under):
                        return ast.BinOp(ast.Constant(over / under), ast.Mult(), factor)
                    case ast.BinOp(
                        left=ast.UnaryOp(op=ast.USub(), operand=ast.Constant(value=int(over))),
                        op=ast.Mult(), right=factor,
                    ) if _exact(over, under):  # fmt: skip
                        minus = ast.UnaryOp(ast.USub(), ast.Constant(over / under))
                        return ast.BinOp(minus, ast.Mult(), factor)
        return node


def _exact(over: int, under: int) -> bool:
    """Whether a quotient is a float."""
    try:
        return Fraction(over / under) == Fraction(over, under)
    except OverflowError:
        return False


def _quoted(text: str) -> str:
    """A text that is plain, or quoted, without control characters."""
    return text if _PLAIN.fullmatch(text) else json.dumps(text)


def _n(number: float) -> str:
    return repr(number).removesuffix(".0")


def _digest(h: Values, entries: Iterable[Any]) -> str:
    """Of all that a file says, but the title and what is not checked."""
    rest = {key: _plain(part) for key, part in h.items() if key not in ("title", "cells_in_region")}
    in_order = list(entries) if "start" in h else sorted(entries)
    return hashlib.sha256(json.dumps([sorted(rest.items()), in_order]).encode()).hexdigest()


def _plain(part: Any) -> Any:
    """A part of a header with the texts of its expressions."""
    if isinstance(part, dict):
        return {key: _plain(value) for key, value in sorted(part.items())}
    if isinstance(part, list | tuple | array.array):
        return list(map(_plain, part))
    return part.text if isinstance(part, Expression) else part
