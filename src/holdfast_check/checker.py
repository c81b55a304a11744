"""`holdfast-check FILE`: whether a certificate proves what it says.

A certificate names a vehicle's rates f(x, u, d), bounds of d, constraints c(x) <= 0, a grid of
cells, and for each cell of a set an input. It is valid if for each such cell X, its input u held
for T and any disturbance within the bounds

1. c <= 0 all over X;
2. a box B contains every state on the way: X + [0, T] f(B, u, D) lies in the interior of B;
3. c <= 0 on the way: all over B, or from both ends by the least and greatest rate of c over B;
4. every state at the end lies in cells of the set (of a level one lower, for a finite horizon).

Then the set is never left. Where a law gives the inputs, an entry is a cell and the mode of the law
before the sample, and all that the law may do all over the cell leads to entries. Numbers are balls
of Arb (python-flint) with 80 bits. The states at the end are a Taylor polynomial of the middle and
what others differ from it by (mean value form).
"""

from __future__ import annotations

import argparse
import array
import ast
import base64
import bisect
import contextlib
import functools
import hashlib
import itertools
import json
import math
import os
import random
import secrets
import struct
import sys
import zlib
from collections.abc import Callable, Iterator, Sequence
from fractions import Fraction
from operator import add, mul, sub, truediv
from typing import Any

import flint
from flint import arb, arb_series

MAGIC = "holdfast-certificate 1"
BITS = 80
NOT_VALID, NOT_READ, LEAST_CHANCE, MOST_POWER, DRAWN = 1, 2, 1e-3, 64, 32
MOST_OF_ENTRIES, MOST_OF_NODES, ROOM = 16, 64, 1 << 20


Balls = list[Any]
Values = dict[str, Any]


class NotValidError(Exception):
    """Where and why a certificate does not prove what it says."""


Choice = tuple[list["Expression"], list["Expression"], int, Sequence[tuple[Any, ...]]]
"""Conditions, inputs, the mode of a law afterwards, and what inputs that are left free may be."""


def read(path: str) -> tuple[Values, list[Any]]:
    """What a file says: its header, and entries of a cell, the number of its input, and a level.

    Raises `NotValidError` if a bit of it is not as it was written.
    """
    if not os.path.isfile(path):
        raise OSError("it is no file")
    with open(path, "rb") as file:
        content = file.read()
    first, _, rest = content.partition(b"\n")
    words = first.decode("ascii", "replace").split(" ")
    if " ".join(words[:2]) != MAGIC or len(words) != 3:
        raise NotValidError(f"{path} is not a certificate of this version")
    if hashlib.sha256(rest).hexdigest() != words[2]:
        raise NotValidError(f"{path} was changed: its digest is not that of its content")
    text, _, packed = rest.partition(b"\n")
    said = {"depth": 0} | json.loads(text, object_pairs_hook=_once)
    header = formed(said, HEADER, "the header")
    count = max(header["entries"], 0)
    numbers = _unpacked(packed, MOST_OF_ENTRIES)
    if len(numbers) != 10 * count or count < 1:
        raise NotValidError(f"{path} has not the {count} entries that it says")
    return header, list(struct.iter_unpack("<IHI", numbers))


def _once(pairs: Any) -> Values:
    if len(dict(pairs)) < len(pairs):
        raise NotValidError("a key of the header stands twice")
    return dict(pairs)


def formed(value: Any, form: Any, where: str) -> Any:
    """What a file says there, if it has this form.

    That is {key: form}, {...: form} of any keys, [form] of any length, [form, form] of two values,
    (none, form, what none means), a type, or a function that fails for what it does not read.
    """
    match form:
        case dict() if type(value) is dict and form.keys() in ({...}, value.keys()):
            return {k: formed(v, form.get(k) or form[...], k) for k, v in value.items()}
        case list() if type(value) is list and len(form) in (1, len(value)):
            return [formed(v, f, where) for v, f in zip(value, itertools.cycle(form))]
        case tuple([none, other, meaning]):
            return meaning if value == none else formed(value, other, where)
        case _ if type(value) is form:
            return value
        case _ if callable(form) and form not in (str, int, bool):
            try:
                return form(value)
            except Exception as error:  # whatever a file contains
                raise NotValidError(f"{where} is {value!r:.60}: {error}") from None
    odd = [*value.keys() ^ form.keys()] if type(value) is type(form) is dict else value
    raise NotValidError(f"{where} has another form: {odd!r:.60}")


def ball(low: float, high: float) -> Any:
    return arb(low).union(arb(high))


def _sign(x: Any) -> Any:
    return arb(1) if x >= 0 else arb(-1) if x <= 0 else ball(-1, 1)


def _wrapped(x: Any) -> Any:
    turns = (x / (2 * arb.pi()) - arb(1) / 2).ceil()
    return x - 2 * arb.pi() * turns if turns.is_exact() else arb.pi() * ball(-1, 1) + 0 * x


def _angle(y: Any, x: Any, _: Any) -> Any:
    if not (x > 0 or y > 0 or y < 0):
        return arb.pi() * ball(-1, 1) + 0 * x + 0 * y
    ends = itertools.product((y.lower(), y.upper()), (x.lower(), x.upper()))
    return functools.reduce(arb.union, itertools.starmap(arb.atan2, ends))


CHOICES = {"least": arb.min, "greatest": arb.max}
KINKS: dict[str, tuple[Callable[[Any], Any], Callable[[Any], Any]]] = {
    "magnitude": (abs, _sign), "Abs": (abs, _sign),
    "tanh": (arb.tanh, lambda x: 1 - x.tanh() ** 2),
}  # fmt: skip
"""Functions that have a slope here, and no series of more terms."""
ONE_OF_TWO = {*CHOICES, "magnitude", "Abs"}
"""Functions that are one of two others: of a and b, or of x and -x."""
JUMPS: dict[str, Callable[..., Any]] = {
    "wrap": _wrapped, "angle": _angle, "atan2": lambda y, x: _angle(y, x, None),
    "length": lambda x, y, _: (x**2 + y**2).sqrt(),
}  # fmt: skip
"""Functions of balls that have no slope everywhere."""
SMOOTH = ("sin", "cos", "tan", "atan", "exp", "log", "sqrt")
PLAIN = {n: getattr(arb, n) for n in SMOOTH} | {n: k[0] for n, k in KINKS.items()} | CHOICES | JUMPS
NAMES = {*PLAIN, "pi"}


def applied(name: str, *x: Any) -> Any:
    """A function of balls, or of Taylor series: those of two terms have the slopes of kinks too."""
    if not any(isinstance(v, arb_series) for v in x):
        return PLAIN[name](*map(arb, x))
    if name in SMOOTH:
        return getattr(x[0], name)()
    terms = [v if isinstance(v, arb_series) else arb_series([v]) for v in x]
    a, b = terms[0], terms[-1] if name in CHOICES else -terms[0]
    if name in ONE_OF_TWO and (a[0] >= b[0] or b[0] >= a[0]):  # one and the same all over the balls
        return b if (a[0] >= b[0]) == (name == "least") else a
    if name in JUMPS or flint.ctx.cap > 2:
        raise ValueError
    if name in CHOICES:
        return arb_series([CHOICES[name](a[0], b[0]), a[1].union(b[1])])
    value, slope = KINKS[name]
    return arb_series([value(terms[0][0]), slope(terms[0][0]) * terms[0][1]])


def _times(a: Any, b: Any) -> Any:
    """A product; of two balls by their ends, which is narrower than that of middles and radii."""
    if any(isinstance(q, arb_series) for q in (a, b)):
        if flint.ctx.cap > 2:
            return a * b
        (p, p_slope), (q, q_slope) = map(_value_and_slope, (a, b))
        return arb_series([_times(p, q), _times(p, q_slope) + _times(p_slope, q)])
    if any(q.is_exact() or not q.is_finite() for q in (a, b)):
        return a * b
    ends = itertools.product((a.lower(), a.upper()), (b.lower(), b.upper()))
    return functools.reduce(arb.union, itertools.starmap(mul, ends))


def _raised(base: Any, power: int) -> Any:
    """A power; of a ball by its ends: an even one is nowhere negative."""
    if isinstance(base, arb_series):
        if flint.ctx.cap > 2:
            return functools.reduce(mul, power * [base], arb(1))
        value, slope = _value_and_slope(base)
        derivative = power * _raised(value, power - 1) if power else arb(0)
        return arb_series([_raised(value, power), _times(derivative, slope)])
    ends = [functools.reduce(mul, power * [end], arb(1)) for end in (base.lower(), base.upper())]
    hull = ends[0].union(ends[1])
    return hull.union(arb(0)) if power % 2 == 0 < power and base.contains(0) else hull


def _value_and_slope(q: Any) -> tuple[Any, Any]:
    """Of a series that ends before its slope, that is no number: it reads as 0 there."""
    if isinstance(q, arb_series):
        return q[0], q[1] if q.prec > 1 else arb("nan")
    return arb(q), arb(0)


def _root(node: ast.expr, x: Any) -> Any:
    """The root; a ball around what is never negative may reach below 0, but its values do not."""
    if isinstance(x, arb_series) and flint.ctx.cap == 2:
        value, slope = _value_and_slope(x)
        root = _root(node, value)
        return arb_series([root, _times(slope, 1 / (2 * root))])
    if isinstance(x, arb) and x.is_finite() and not x >= 0 and _never_negative(node):
        return arb(0).union(x.upper().sqrt())
    return applied("sqrt", x)


def _never_negative(node: ast.expr) -> bool:
    """Whether the form of a text says so: sums and quotients of squares, and roots."""
    match node:
        case ast.Constant(value=int(number)):
            return number >= 0
        case ast.BinOp(left=a, op=ast.Add() | ast.Mult() | ast.Div(), right=b):
            return _never_negative(a) and _never_negative(b)
        case ast.BinOp(op=ast.Pow(), right=ast.Constant(value=int(exponent))):
            return exponent % 2 == 0
        case ast.Call(func=ast.Name(id=name)):
            return name in ("sqrt", "exp", "magnitude", "Abs", "length")
    return False


OPERATIONS = {ast.Add: add, ast.Sub: sub, ast.Mult: _times, ast.Div: truediv}


class _Squares(ast.NodeTransformer):
    """A product of a text with itself is its square, which is nowhere negative."""

    def visit_BinOp(self, node: ast.BinOp) -> ast.expr:
        self.generic_visit(node)
        if isinstance(node.op, ast.Mult) and ast.dump(node.left) == ast.dump(node.right):
            return ast.BinOp(node.left, ast.Pow(), ast.Constant(2))
        return node


class Expression:
    """A text of names, whole numbers, + - * / **, and functions."""

    def __init__(self, text: Any) -> None:
        tree = text if isinstance(text, ast.expr) else ast.parse(text, mode="eval").body
        self.tree: ast.expr = _Squares().visit(tree)
        self.names = {n.id for n in ast.walk(self.tree) if isinstance(n, ast.Name)} - NAMES
        self.at(dict.fromkeys(self.names, arb(0)))  # fails for what is not known
        self.parts: tuple[str, list[Expression]] | None = None
        match self.tree:  # the arguments of a least or a greatest
            case ast.Call(func=ast.Name(id="least" | "greatest" as name), args=both):
                self.parts = name, list(map(Expression, both))

    def at(self, values: Values) -> Any:
        """Raises `ValueError` for a function that has no Taylor series, or no slope."""
        return self._value(self.tree, values)

    def _value(self, node: ast.expr, values: Values) -> Any:
        match node:
            case ast.Constant(value=int(number)) if type(number) is int:
                return arb(number)
            case ast.Name(id=name):
                return arb.pi() if name == "pi" else values[name]
            case ast.UnaryOp(op=ast.USub(), operand=inner):
                return -self._value(inner, values)
            case ast.BinOp(left=base, op=ast.Pow(), right=exponent):
                return self._power(base, self._value(base, values), exponent)
            case ast.BinOp(left=a, op=operation, right=b):
                return OPERATIONS[type(operation)](self._value(a, values), self._value(b, values))
            case ast.Call(func=ast.Name(id="sqrt"), args=[inner], keywords=[]):
                return _root(inner, self._value(inner, values))
            case ast.Call(func=ast.Name(id=name), args=arguments, keywords=[]):
                return applied(name, *(self._value(a, values) for a in arguments))
        raise SyntaxError(f"it has {ast.unparse(node)}")

    def _power(self, node: ast.expr, base: Any, exponent: ast.expr) -> Any:
        twice = 2 * Fraction(ast.unparse(exponent).replace(" ", ""))
        if twice.denominator != 1 or abs(twice) > 2 * MOST_POWER:
            raise SyntaxError(f"the exponent {twice / 2} is no half of a whole number, or large")
        whole, half = divmod(abs(int(twice)), 2)
        found = _raised(base, whole)
        if half:
            found = found * _root(node, base)
        return 1 / found if twice < 0 else found


def _number(text: str) -> float:
    if math.isfinite(value := float.fromhex(text)):
        return value
    raise ValueError("it is not finite")


def _unpacked(packed: bytes, times: int) -> bytes:
    """What is packed: so many times as long at most, so that a small file takes little memory."""
    most = times * len(packed) + ROOM
    numbers = zlib.decompressobj().decompress(packed, most + 1)
    if len(numbers) > most:
        raise NotValidError(f"it unpacks to more than {times} times its length")
    return numbers


def _nodes(text: str) -> Sequence[float]:
    numbers = array.array("d", _unpacked(base64.b64decode(text), MOST_OF_NODES))
    if sys.byteorder == "big":
        numbers.byteswap()
    return numbers


ENDS, NAMED = [_number, _number], {"name": str, "unit": str}
RANGED, LIMIT = NAMED | {"range": ENDS}, NAMED | {"expression": Expression}
TABLE = {"axes": [[Expression, ENDS, int, bool]], "nodes": {...: [_nodes, _nodes]}}
LAW: Values = {
    "names": [str], "initial": int, "where": [[str, Expression]],
    "modes": [[[[Expression], [Expression], int]]], "parts": [[_number]], "under_way": [ENDS],
    "table": (None, TABLE, {"axes": [], "nodes": {}}),
}  # fmt: skip
NO_LAW = {key: [] for key in LAW} | {"initial": 0, "table": LAW["table"][2]}
HEADER = {
    "title": str, "states": [NAMED], "inputs": [NAMED], "disturbances": [RANGED],
    "parameters": [RANGED], "rates": [Expression], "constraints": [LIMIT], "target": [LIMIT],
    "law": ([], LAW, NO_LAW), "hold": _number, "delay": _number, "errors": [_number],
    "holds": (None, int, None), "edges": [[_number]], "periodic": [bool], "candidates": [[_number]],
    "depth": int, "cells_in_region": int, "cells_kept": int, "entries": int,
}  # fmt: skip


class Checker:
    """The claims of a certificate, cell by cell."""

    def __init__(self, h: Values, entries: list[Any]) -> None:
        self.edges, self.rates, self.turning = h["edges"], h["rates"], h["periodic"]
        limits = [[c["expression"] for c in h[k]] for k in ("constraints", "target")]
        self.constraints, self.target = limits
        self.states, self.input_names = ([q["name"] for q in h[k]] for k in ("states", "inputs"))
        free = [*h["disturbances"], *h["parameters"]]
        self.ranges = {q["name"]: q["range"] for q in free}
        self.bounds = {name: ball(*ends) for name, ends in self.ranges.items()}
        self.hold, self.delay, *self.errors = map(arb, (h["hold"], h["delay"], *h["errors"]))
        self.kept: dict[tuple[int, int], int] = {}
        both = [*self.constraints, *self.target]
        self.ends = functools.cache(lambda cell: all(self._holds(c, cell) for c in both))
        self.shape, depth = [len(e) - 1 for e in self.edges], min(h["depth"], 31)
        self.total, self.widths = math.prod(self.shape), [2**k for k in range(depth + 1)]
        self.still = [ast.unparse(r.tree) == "0" and e == 0
                      for r, e in zip(self.rates, self.errors, strict=True)]  # fmt: skip
        self._choices(h["candidates"], h["law"])
        self._well_formed(h, [*self.states, *self.input_names, *(q["name"] for q in free)])
        self._keep(entries, h["holds"], bool(h["law"]["modes"]))
        first, ends = h["law"]["initial"], h["holds"] or 0
        last = {c for (c, k), v in self.kept.items() if k == first and (self.target or v == ends)}
        places = ((c, *self._place(c)) for c in last)
        whole = [w for c, w, place in places if c == max(last.intersection(self._numbers(place)))]
        if not last or sum(wide ** len(self.shape) for wide in whole) != h["cells_kept"]:
            raise NotValidError("the cells of the horizon are not as many as it says")

    def _choices(self, tried: list[list[float]], law: Values) -> None:
        """What may be given: inputs that were tried, one each, or the options of a law's modes."""
        names = [Expression(ast.Name(name)) for name in self.input_names]
        self.choices: list[list[Choice]] = [[([], names, 0, [tuple(map(arb, r))])] for r in tried]
        under_way = law["under_way"] or [(min(c), max(c)) for c in zip(*tried, strict=True)]
        self.under_way = list(itertools.starmap(ball, under_way))
        self.where, (self.axes, self.nodes) = law["where"], (law["table"][k] for k in TABLE)
        parts = [list(itertools.starmap(ball, itertools.pairwise(e))) for e in law["parts"]]
        if law["modes"]:
            self.choices = [[self._option(parts, *o) for o in mode] for mode in law["modes"]]
        both = [e for mode in law["modes"] for when, u, _ in mode for e in (*when, *u)]
        self.told = [*both, *(e for _, e in self.where), *(place for place, *_ in self.axes)]

    def _option(self, parts: list[Balls], when: Any, inputs: Any, to: int) -> Choice:
        """Its conditions and inputs, the mode then, and what inputs that it leaves free may be."""
        free = any(e.names & {*self.input_names} for e in (*when, *inputs))
        return when, inputs, to, list(itertools.product(*parts)) if free else [()]

    def _well_formed(self, h: Values, names: list[str]) -> None:
        names += [*self.nodes, "time_in_mode", *(name for name, _ in self.where)]
        known = {n for n in names if n.isascii() and n.isidentifier()} - NAMES
        if len(known) < len(names):
            raise NotValidError("a name stands twice, is none, or is that of a function or number")
        if any(e != sorted({*e}) or len(e) < 2 for e in (*self.edges, *h["law"]["parts"])):
            raise NotValidError("the edges of cells, or of parts of inputs, do not grow")
        if any(a > b for a, b in (*self.ranges.values(), *h["law"]["under_way"])):
            raise NotValidError("a range is reversed")
        size = math.prod(n for *_, n, _ in self.axes)
        if any(len(end) != size for ends in self.nodes.values() for end in ends):
            raise NotValidError("a table has not the nodes that its axes say")
        times = 0 <= self.delay < self.hold and all(e >= 0 for e in self.errors)
        holds = h["holds"] > 0 if h["holds"] is not None else not self.target
        given = bool(h["law"]["modes"]) != bool(h["candidates"]) and self.constraints
        if not (times and holds and given):
            raise NotValidError("the hold, the horizon, the constraints or the inputs are none")
        for angle in zip(self.states, self.edges, self.turning, strict=True):
            self._turns(*angle)

    def _keep(self, entries: list[Any], most: int | None, law: bool) -> None:
        count, better = self.total * len(self.widths), min if self.target else max
        for cell, choice, level in entries:
            horizon = level == 0 if most is None else 1 <= level <= most
            if not (cell < count and choice < len(self.choices) and horizon):
                raise NotValidError(f"entry of cell {cell}: no such cell, input or level")
            place = cell, choice if law else 0
            self.kept[place] = better(level, self.kept.get(place, level))

    def _turns(self, name: str, axis: list[float], turns: bool) -> None:
        """An angle: all rates have it in sines and cosines alone, and a turn is in the axis."""
        if turns and not arb(axis[-1]) - arb(axis[0]) >= 2 * arb.pi():
            raise NotValidError(f"the axis of {name} is less than a turn")
        for e in (*self.rates, *self.constraints, *self.target, *self.told):
            if turns and not _turns_with(e.tree, name):
                raise NotValidError(f"{name} comes back after a turn, {ast.unparse(e.tree)} not")

    def entry(self, cell: int, choice: int, level: int) -> None:
        """Raises `NotValidError` unless this input, or the law, keeps this cell."""
        ranges = self.ranges | dict(zip(self.states, self._box(cell), strict=True))
        at = {name: ball(*ends) for name, ends in ranges.items()}
        seen = [at[name] for name in self.states]
        where = f"cell {cell} ({', '.join(f'{n} = {at[n].str(4)}' for n in self.states)})"
        for k, c in enumerate(self.constraints):
            if not self._holds(c, cell):
                raise NotValidError(f"{where} is not inside constraint {k}")
        given = list(self._given(at, choice))
        if not any(sure for *_, sure in given):  # no option holds all over the cell
            chance = random.SystemRandom()  # a file that knows the places could lie elsewhere
            for _ in range(DRAWN):
                place = {n: arb(chance.uniform(*ends)) for n, ends in ranges.items()}
                since = self.hold * chance.choice((0, 10 ** chance.uniform(-3, 5)))
                if next(self._given(place, choice, since), None) is None:
                    raise NotValidError(f"{where}: the law does nothing in a part of it")
        for inputs, mode, _ in given:
            x = self._with_errors(seen)
            legs = [(self.hold - self.delay, inputs)]
            if self.delay > 0:  # first any input that may be under way
                if not all(q.contains(u) for q, u in zip(self.under_way, inputs, strict=True)):
                    raise NotValidError(f"{where}: an input is none that may be under way")
                legs.insert(0, (self.delay, self.under_way))
            for leg, (hold, u) in enumerate(legs):
                fixed = {**self.bounds, **dict(zip(self.input_names, u, strict=True))}
                way = self._way(x, fixed, hold, where)
                end = self._end(x, way, fixed, hold)
                begun, ends = cell if leg == 0 else None, leg == len(legs) - 1
                for k, c in enumerate(self.constraints):
                    if not self._kept(c, begun, (x, way, end), fixed, hold, ends):
                        raise NotValidError(f"{where}: constraint {k} may fail on the way")
                x = end
            for led in self._cells(self._with_errors(x)):
                if led is None or not self._reached(led, mode, level):
                    raise NotValidError(f"{where} may lead to {led and led[0]}, which is not kept")

    def _given(
        self, at: Values, choice: int, since: Any = None
    ) -> Iterator[tuple[Balls, int, bool]]:
        """All inputs that may be given where this is measured, and the mode of the law then.

        Of a law these are of the first option whose conditions hold: at last whether one surely is.
        since: the time in the mode at a place, where a condition that is no number does not hold;
        None is any time, all over a cell.
        """
        time = arb("nan") if since is None else since
        at = at | {"time_in_mode": time} | self._looked_up(at)
        for name, e in self.where:
            at[name] = e.at(at)
        for when, inputs, to, parts in self.choices[choice]:
            sure = False
            for part in parts:
                at.update(zip(self.input_names, part, strict=bool(part)))
                values = [e.at(at) for e in when]
                if not any(v > 0 or (since is not None and v.is_nan()) for v in values):
                    sure |= all(v < 0 for v in values)
                    yield [e.at(at) for e in inputs], to, sure
            if sure:
                return

    def _looked_up(self, at: Values) -> Values:
        """The values of a law's table, between those at the nodes around a place."""
        around = [0]
        for place, (low, step), n, turns in self.axes:
            q = (place.at(at) - low) / step
            first, last = (k if turns else min(max(k, 0), n - 1)
                           for k in (math.floor(_down(q)), math.ceil(-_down(-q))))  # fmt: skip
            block = range(first, min(last, first + n) + 1)  # not more than all of them
            around = [before * n + k % n for before in around for k in block]
        return {name: functools.reduce(arb.union, (ball(low[k], high[k]) for k in around))
                for name, (low, high) in self.nodes.items()}  # fmt: skip

    def _place(self, cell: int) -> tuple[int, list[int]]:
        """The width of a cell in the smallest ones, and the place of the first of these in it."""
        doubled, rest = divmod(cell, self.total)
        wide, place = self.widths[doubled], list[int]()
        for count in reversed(self.shape):
            rest, k = divmod(rest, count)
            if k % wide or k + wide > count:
                raise NotValidError(f"there is no cell {cell}")
            place.insert(0, k)
        return wide, place

    def _numbers(self, place: Sequence[int]) -> Iterator[int]:
        """The cells of all sizes that one of the smallest is in, itself the first."""
        for doubled, wide in enumerate(self.widths):
            cell = doubled
            for k, count in zip(place, self.shape, strict=True):
                cell = cell * count + k - k % wide
            yield cell

    def _box(self, cell: int) -> list[tuple[float, float]]:
        wide, place = self._place(cell)
        return [(e[k], e[k + wide]) for e, k in zip(self.edges, place, strict=True)]

    def _with_errors(self, x: Balls) -> Balls:
        return [q + e * ball(-1, 1) for q, e in zip(x, self.errors, strict=True)]

    def _holds(self, c: Expression, cell: int) -> bool:
        """Whether c <= 0 all over where a cell is measured, or at the corner that c grows to."""
        if parts := c.parts:
            which = any if parts[0] == "least" else all
            return which(self._holds(part, cell) for part in parts[1])
        box = [(a - e, b + e) for (a, b), e in zip(self._box(cell), self.errors, strict=True)]
        x = [a.union(b) for a, b in box]
        with contextlib.suppress(ValueError):
            slopes = self._slopes(c, x, self.bounds, self.states)
            x = [b if s >= 0 else a if s <= 0 else q
                 for q, (a, b), s in zip(x, box, slopes, strict=True)]  # fmt: skip
        return bool(c.at({**self.bounds, **dict(zip(self.states, x, strict=True))}) <= 0)

    def _reached(self, cells: list[int], mode: int, level: int) -> bool:
        """Whether a cell is of the set, or part of one that is.

        Where time is counted, of a level one closer to its end.
        """
        known = [self.kept[cell, mode] for cell in cells if (cell, mode) in self.kept]
        if any(k < level if self.target else k >= level - 1 for k in known):
            return True
        # level 0: in the region, and in the target where there is one
        return (level == 1 or bool(self.target)) and self.ends(cells[0])

    def _rates(self, x: Balls, fixed: Values) -> Balls:
        values = {**fixed, **dict(zip(self.states, x, strict=True))}
        return [r.at(values) for r in self.rates]

    def _way(self, x: Balls, fixed: Values, hold: Any, where: str) -> Balls:
        """A box that contains every state on the way."""
        guess = x
        for grown in (1.1, 1.1, 1.2, 1.5, 2.0):
            rates = self._rates(guess, fixed)
            moved = [q + _during(hold, r) for q, r in zip(x, rates, strict=True)]
            if all(g.contains_interior(m) for g, m in zip(guess, moved, strict=True)):
                return moved
            guess = [m + (m - m.mid()) * (grown - 1) for m in moved]
        raise NotValidError(f"{where}: no box of the states on the way was found")

    def _end(self, x: Balls, way: Balls, fixed: Values, h: Any) -> Balls:
        """Every state at the end."""
        plain = [q + h * r for q, r in zip(x, self._rates(way, fixed), strict=True)]
        middle, n = [q.mid() for q in x], len(x)
        still = {k: v.mid() for k, v in fixed.items()}
        free = [name for name, q in fixed.items() if not q.is_exact()]
        try:
            slopes = [self._slopes(r, way, fixed, [*self.states, *free]) for r in self.rates]
        except ValueError:
            return plain
        a = [row[:n] for row in slopes]
        try:
            first, rest = self._series(middle, still, 3), self._series(way, still, 4)
            nominal = [c[0] + c[1] * h + c[2] * h**2 + r[3] * h**3
                       for c, r in zip(first, rest, strict=True)]  # fmt: skip
        except ValueError:
            begun, during = self._rates(middle, still), self._rates(way, still)
            nominal = [c + h * f + h**2 / 2 * _dot(row, during)
                       for c, f, row in zip(middle, begun, a, strict=True)]  # fmt: skip
        off = [fixed[name] - still[name] for name in free]
        w = [_dot(row[n:], off) for row in slopes]
        e0 = [q - c for q, c in zip(x, middle, strict=True)]
        e = [q - q for q in way]  # of two states on the way: balls know no identity
        for _ in range(2):
            e = [s + _during(h, _dot(row, e) + more)
                 for s, row, more in zip(e0, a, w, strict=True)]  # fmt: skip
        moving = [_dot(row, e) + more for row, more in zip(a, w, strict=True)]
        twice = [[_dot(row, [other[j] for other in a]) for j in range(n)] for row in a]
        found = []
        for i in range(n):
            grown = [h * a[i][j] + h**2 / 2 * twice[i][j] + int(i == j) for j in range(n)]
            total = nominal[i] + _dot(grown, e0) + h * w[i] + h**2 / 2 * _dot(a[i], w)
            total += h**3 / 6 * _dot(twice[i], moving)
            found.append(_common(_common(total, plain[i]), way[i]))
        return found

    def _slopes(self, e: Expression, way: Balls, fixed: Values, names: Sequence[str]) -> Balls:
        """The derivatives of an expression by these names over a box."""
        flint.ctx.cap = 2
        values = {**fixed, **dict(zip(self.states, way, strict=True))}
        zero = arb_series([0])
        return [(e.at({**values, n: arb_series([values[n], 1])}) + zero)[1] for n in names]

    def _rate(self, c: Expression, way: Balls, fixed: Values) -> Any:
        """The derivative of an expression by time over a box: two enclosures, what both say."""
        rates = self._rates(way, fixed)
        slopes = _dot(self._slopes(c, way, fixed, self.states), rates)
        flint.ctx.cap = 2
        moving = {n: arb_series([q, r]) for n, q, r in zip(self.states, way, rates, strict=True)}
        return _common(slopes, (c.at({**fixed, **moving}) + arb_series([0]))[1])

    def _series(self, x: Balls, fixed: Values, terms: int) -> list[Balls]:
        """Taylor coefficients of the trajectory from x."""
        flint.ctx.cap = terms
        coefficients = [[q] for q in x]
        for k in range(terms - 1):
            values = {n: arb_series([v]) for n, v in fixed.items()}
            values |= {n: arb_series(c) for n, c in zip(self.states, coefficients, strict=True)}
            for c, r in zip(coefficients, self.rates, strict=True):
                c.append((r.at(values) + arb_series([0]))[k] / (k + 1))
        return coefficients

    def _kept(self, c: Expression, cell: Any, boxes: Any, fixed: Values, h: Any, ends: Any) -> bool:
        """Whether c <= 0 on (start, way, end), from a cell if there; ends: known at the end."""
        if parts := c.parts:
            which, known = (any, False) if parts[0] == "least" else (all, ends)
            if which(self._kept(p, cell, boxes, fixed, h, known) for p in parts[1]):
                return True
        places = [{**fixed, **dict(zip(self.states, q, strict=True))} for q in boxes]
        first, during, last = (c.at(place) for place in places)
        if during <= 0:
            return True
        begins = bool(first <= 0) if cell is None else self._holds(c, cell)
        ends = ends or bool(last <= 0)
        try:
            rate = self._rate(c, boxes[1], fixed)
        except ValueError:
            return False
        if rate <= 0 or rate >= 0:
            return begins if rate <= 0 else ends
        if not (rate.is_finite() and begins and ends):
            return False
        up, down = rate.upper(), rate.lower()
        c0, c1 = (v.upper().min(arb(0)) for v in (first, last))
        return bool(c0 + up * (c1 - c0 - h * down) / (up - down) <= 0)

    def _cells(self, end: Balls) -> Iterator[list[int] | None]:
        """The smallest cells that a box touches, and those they are in; None beyond the grid."""
        ranges = []
        each = zip(end, self.edges, self.turning, self.still, strict=True)
        for q, axis, turns, still in each:  # a state that is still does not leave the grid
            beyond = not (turns or still) and (_down(q) < axis[0] or -_down(-q) > axis[-1])
            around = math.floor((_down(q) - axis[0]) / math.tau) if turns and q.is_finite() else 0
            places = set()
            for k in (around - 1, around, around + 1) if turns else (0,):
                low, high = _down(q - 2 * k * arb.pi()), -_down(2 * k * arb.pi() - q)
                first = max(bisect.bisect_left(axis, low) - 1, 0)
                places |= set(range(first, min(bisect.bisect_right(axis, high), len(axis) - 1)))
            if beyond or not (places and q.is_finite()):  # doubles count some turns only
                yield None
                return
            ranges.append(sorted(places))
        yield from map(list, map(self._numbers, itertools.product(*ranges)))


def _turns_with(node: ast.AST, name: str, summed: bool = False) -> bool:
    """Whether an angle stands as a summand inside sines and cosines alone."""
    if isinstance(node, ast.Name):
        return summed or node.id != name
    sine = isinstance(node, ast.Call) and ast.unparse(node.func) in ("sin", "cos")
    op = getattr(node, "op", None)
    summed = sine or (summed and isinstance(op, ast.Add | ast.Sub | ast.USub))
    return all(_turns_with(inner, name, summed) for inner in ast.iter_child_nodes(node))


def _during(hold: Any, rate: Any) -> Any:
    """[0, T] times a rate: no wider than it must be, unlike a product of balls."""
    return (hold * rate).union(arb(0))


def _dot(a: Balls, b: Balls) -> Any:
    return sum((_times(p, q) for p, q in zip(a, b, strict=True)), arb(0))


def _common(a: Any, b: Any) -> Any:
    """What two balls of one number have in common; one of them where the other says nothing."""
    if a.is_finite() and b.is_finite() and a.overlaps(b):
        return a.intersection(b)
    return a if a.is_finite() else b


def _down(q: Any) -> float:
    value = float(q.lower())
    return value if arb(value) <= q.lower() else math.nextafter(value, -math.inf)


def check(path: str, share: float = 1.0, seed: int | None = None) -> str:
    """What was checked, in a sentence. Raises `NotValidError` where the certificate is wrong."""
    flint.ctx.prec = BITS
    seed = secrets.randbits(32) if seed is None else seed
    header, every = read(path)
    count = max(round(share * len(every)), 1)
    entries = every if share == 1 else random.Random(seed).sample(every, count)
    try:
        checker = Checker(header, every)
        for k, entry in enumerate(entries):
            checker.entry(*entry)
            if k % 2000 == 1999 and sys.stderr.isatty():
                print(f"\r{k + 1} of {len(entries)} ", end="", file=sys.stderr)
    except KeyError as name:
        raise NotValidError(f"an expression uses the undeclared name {name.args[0]}") from name
    except (ArithmeticError, LookupError, TypeError, ValueError) as error:
        raise NotValidError(f"its parts do not go together: {error!r}") from error
    holds = header["holds"]
    how = "reach the target within" if checker.target else "for"
    lasts = "for ever" if holds is None else f"{how} {holds * float(checker.hold.mid()):g} s"
    told = f"{header['cells_kept']} cells {lasts}: {len(entries)} of {len(every)} entries hold"
    worst = -math.expm1(math.log(LEAST_CHANCE) / len(entries))
    sure = f"with {100 * (1 - LEAST_CHANCE):g} % confidence at most {100 * worst:.3g} %"
    part = f", drawn with seed {seed}: {sure} of them are wrong; this is no proof"
    return told if len(entries) == len(every) else told + part


def main() -> None:
    """The command."""
    parser = argparse.ArgumentParser("holdfast-check", description="Check a certificate.")
    parser.add_argument("file")
    parser.add_argument("--share", type=float, default=1.0, help="part of the entries to check")
    parser.add_argument("--seed", type=int, help="of the entries that are drawn, to repeat it")
    asked = parser.parse_args()
    if not 0 < asked.share <= 1:
        parser.error("--share: expected above 0, at most 1")
    try:
        told = check(asked.file, asked.share, asked.seed)
    except NotValidError as wrong:
        print(f"NOT valid: {wrong}")
        sys.exit(NOT_VALID)
    except Exception as error:  # whatever a file contains
        print(f"holdfast-check: {asked.file} cannot be read: {error!r}", file=sys.stderr)
        sys.exit(NOT_READ)
    except KeyboardInterrupt:
        sys.exit(130)
    print(f"{'valid' if asked.share == 1 else 'not refuted'}: {told}")
