"""What a law may do at a sample all over a box that is measured, and that it does something."""

from __future__ import annotations

import functools
import itertools
import math
from collections.abc import Iterator, Mapping, Sequence
from fractions import Fraction
from typing import Any

from flint import arb

from holdfast_check import safeguard
from holdfast_check.intervals import (
    UNKNOWN,
    Expression,
    Interval,
    Row,
    Tape,
    dot,
    down,
    hull,
    interval,
    inverse,
    mul,
    point,
    sub,
    up,
)
from holdfast_check.reading import NotValidError, Values

MOST_OPEN, MOST_BOXES, MOST_PARTS, MOST_SETS = 10, 64, 2000, 800
"""Signs that are not decided over a box, into how many boxes one is divided for that, into how many
parts the inputs that a law leaves free, and the sets of a program's conditions."""

ANY: Interval = (arb("-inf"), arb("inf"))

Known = dict[str, Interval]
Given = tuple[Row, int]
"""Inputs that may be given, and the mode of the law then."""


class Option:
    """Conditions, what is given, and the mode then; free: whether any input meets these."""

    def __init__(self, names: list[str], when: list[Expression], inputs: Any, to: int) -> None:
        self.when, self.to, self.names = when, to, names
        self.program = inputs if isinstance(inputs, dict) else None
        p, m = self.program, len(names)
        outputs, counts = inputs, [len(inputs)]
        if p is not None:
            rows, wanted, box = p["rows"], p["wanted"] or [], p["box"] or []
            every = (wanted, *rows, p["scales"], *box)
            outputs = [e for several in every for e in several]
            counts = [*(len(row) - 1 for row in rows), len(p["scales"]), len(p["limits"])]
            counts += [len(p["wanted"])] if wanted else []
            counts += [len(box)] if p["box"] is not None else []
            if sum(math.comb(len(rows), k) for k in range(m + 1)) > MOST_SETS:
                raise NotValidError("the program of a safeguard has too many conditions")
            if not 0 <= p["hard"] <= len(rows):
                raise NotValidError("the program of a safeguard has fewer conditions than it says")
        if {*counts} != {m}:
            raise NotValidError("an option of the law has not as many inputs as the header")
        self.given = outputs
        self.tape = Tape([*self.when, *outputs])
        self.limits = Tape(p["limits"]) if p else None
        self.zero = [[Tape([e]).is_zero for e in row[:m]] for row in p["rows"]] if p else []
        used = {o[2] for o in self.tape.operations if o[0] == "symbol"}
        self.free = not used.isdisjoint(self.names)
        self.among = any(not e.names.isdisjoint(self.names) for e in when)
        if p and self.free:
            raise NotValidError("the program of a safeguard uses the inputs that it gives")
        self.expressions = [*self.when, *outputs, *(p["limits"] if p else [])]

    @functools.cached_property
    def asks(self) -> Tape:
        """The conditions alone."""
        return Tape(self.when)

    @functools.cached_property
    def gives(self) -> Tape:
        """What is given alone."""
        return Tape(self.given)

    def values(self, row: Row) -> safeguard.Values:
        """Those of its program, from the numbers of its expressions."""
        p, m = self.program or {}, len(self.names)
        wanted, row = (row[:m], row[m:]) if p["wanted"] is not None else (None, row)
        count, rows = (
            len(p["rows"]),
            [row[k : k + m + 1] for k in range(0, len(p["rows"]) * (m + 1), m + 1)],
        )
        scales, ends = row[count * (m + 1) :][:m], row[count * (m + 1) + m :]
        box = list(zip(ends[0::2], ends[1::2], strict=True)) if p["box"] is not None else None
        normals, offsets = [r[:m] for r in rows], [r[m] for r in rows]
        return safeguard.Values(wanted, normals, self.zero, offsets, p["hard"], scales, box)


class Law:
    """The options of a law in each of its modes, of inputs by their names."""

    def __init__(self, law: Values, names: list[str]) -> None:
        self.names, self.initial = names, law["initial"]
        self.modes = [[Option(names, *o) for o in mode] for mode in law["modes"]]
        self.parts = [[interval(*e) for e in itertools.pairwise(edges)] for edges in law["parts"]]
        if math.prod(map(len, self.parts)) > MOST_PARTS:
            raise NotValidError(
                "the inputs of the law are divided into more parts than are counted"
            )
        self.axes = [(Tape([place]), *more) for place, *more in law["table"]["axes"]]
        self.nodes = law["table"]["nodes"]
        if bool(self.axes) != bool(self.nodes):
            raise NotValidError("a table has axes without nodes, or nodes without axes")
        places = [place for place, *_ in law["table"]["axes"]]
        self.expressions = [*places, *(e for m in self.modes for o in m for e in o.expressions)]
        ends = [o.to for mode in self.modes for o in mode] + [self.initial] * bool(self.modes)
        if not all(0 <= to < len(self.modes) == len(law["names"]) for to in ends):
            raise NotValidError("the law has a mode that there is none of")
        self.tapes = [Tape([e for o in mode for e in o.when]) for mode in self.modes]
        self.atoms = [_atoms(tape) for tape in self.tapes]

    def given(self, at: Known, mode: int) -> list[Given]:
        """All that may be given where this is measured. Raises `NotValidError` where the law does
        nothing in a part of it."""
        here = self.all_known(at)
        choices: list[Given] = []
        for option in self.modes[mode]:
            sure = False
            for may, surely, inputs in self._of(option, here):
                if may:
                    choices.append((inputs, option.to))
                sure |= surely
                if surely and not option.free:
                    break
            if sure:
                return choices
        if not self.covered(at, mode):
            raise NotValidError("the law does nothing in a part of it")
        return choices

    def _of(self, option: Option, here: Known) -> Iterator[safeguard.Given]:
        if option.free:
            yield from (self._with(option, here, list(part)) for part in self._every_part())
            return
        row = option.tape.of(option.tape.values(here))
        when, row = row[: len(option.when)], row[len(option.when) :]
        may, sure = not any(v[0] > 0 for v in when), all(v[1] < 0 for v in when)
        if option.program is None or not may:
            yield may, sure, row
            return
        p, met = option.values(row), False
        if not all(s[0] > 0 for s in p.scales):
            raise NotValidError("a scale of a safeguard is not above 0")
        if p.wanted is None and not self._parts_contain(p.box):
            raise NotValidError("the parts of the inputs are not all that these may be")
        for part in self._every_part() if p.wanted is None else ():
            left = [sub(dot(n, part), b) for n, b in zip(p.normals, p.offsets, strict=True)]
            met |= all(v[1] < 0 for v in left)
            yield not any(v[0] > 0 for v in left), False, list(part)
        for possible, surely, u in safeguard.choices(p) if not met else ():
            yield possible, sure and surely, self._limited(option, here, u) if possible else []
            if sure and surely:
                return
        yield False, sure, []  # one of them is what the program gives

    def _parts_contain(self, box: Sequence[tuple[Interval, Interval]] | None) -> bool:
        """Whether free inputs may be all between their bounds, where they have bounds."""
        ends = zip(box or (), self.parts, strict=False)
        return all(part[0][0] <= low[0] and high[1] <= part[-1][1] for (low, high), part in ends)

    def _every_part(self) -> Iterator[tuple[Interval, ...]]:
        if len(self.parts) != len(self.names):
            raise NotValidError("the parts of the inputs of the law are not as many as these")
        return itertools.product(*self.parts)

    def _with(self, option: Option, here: Known, part: Row) -> safeguard.Given:
        """Any input of a part that meets the conditions."""
        ranges = {**here, **dict(zip(self.names, part, strict=True))}
        values = option.tape.of(option.tape.values(ranges))
        when, row = values[: len(option.when)], values[len(option.when) :]
        return not any(v[0] > 0 for v in when), all(v[1] < 0 for v in when), row

    def _limited(self, option: Option, here: Known, u: Row) -> Row:
        """Inputs as actuators limit them; of what is unknown these make something too."""
        u = [q if q[0] <= q[1] else ANY for q in u or (hull(*part) for part in self.parts)]
        assert option.limits is not None
        return option.limits.of(
            option.limits.values({**here, **dict(zip(self.names, u, strict=True))})
        )

    def all_known(self, at: Mapping[str, Interval]) -> Known:
        return {**at, "time_in_mode": (point(0)[0], arb("inf")), **self._looked_up(at)}

    def _looked_up(self, at: Mapping[str, Interval]) -> Known:
        """The values of a table, between those at the nodes around a place."""
        around = [0]
        for tape, (low, step), n, turns in self.axes:
            q = mul(sub(tape.of(tape.values(at))[0], point(low)), inverse(point(step)))
            first, last = (k if turns else min(max(k, 0), n - 1)
                           for k in (math.floor(down(q)), math.ceil(up(q))))  # fmt: skip
            block = range(first, min(last, first + n) + 1)  # not more than all of them
            around = [before * n + k % n for before in around for k in block]
        return {name: hull(*(interval(low[k], high[k]) for k in around))
                for name, (low, high) in self.nodes.items()}  # fmt: skip

    # -- whether some option is taken everywhere -------------------------------------------------

    def covered(self, at: Known, mode: int) -> bool:
        """Whether, of any signs that the conditions may have somewhere, some option's hold."""
        waiting, whole, count = [at], at, 0
        while waiting:
            box = waiting.pop()
            if self._every_sign(box, mode):
                continue
            widths = {
                name: _width(q) / _width(whole[name]) for name, q in box.items() if _width(q) > 0
            }
            count += 2
            if not widths or count > MOST_BOXES:
                return False
            name = max(widths, key=widths.__getitem__)
            low, high = box[name]
            middle = ((low + high) / 2).mid()
            waiting += [{**box, name: (low, middle)}, {**box, name: (middle, high)}]
        return True

    def _every_sign(self, box: Known, mode: int) -> bool:
        here, tape, atoms = self.all_known(box), self.tapes[mode], self.atoms[mode]
        values = tape.of(tape.values(here | dict.fromkeys(self.names, UNKNOWN)))
        signs: dict[Any, set[int]] = {}
        always = set()  # where both a condition and its negative hold
        for (atom, sign), (low, high) in zip(atoms, values, strict=True):
            if low == high == 0:
                always.add(atom)
            may = {-sign} if high <= 0 else {sign} if low >= 0 else {-1, 1}
            is_number = bool(low <= high)  # of what may be no number no condition holds
            signs[atom] = signs.get(atom, {-1, 1}) & may if is_number else set()
        undecided = [atom for atom, may in signs.items() if len(may) > 1]
        if len(undecided) > MOST_OPEN:
            return False
        needs, k = [], 0
        for option in self.modes[mode]:
            conditions, k = atoms[k : k + len(option.when)], k + len(option.when)
            if not option.among:
                needs.append([(atom, -sign) for atom, sign in conditions if atom not in always])
        for some in itertools.product((-1, 1), repeat=len(undecided)):
            now = {atom: next(iter(may), 0) for atom, may in signs.items()}
            now |= dict(zip(undecided, some, strict=True))
            if not any(all(now[atom] == sign for atom, sign in needed) for needed in needs):
                return False
        return True


def _width(q: Interval) -> float:
    return float((q[1] - q[0]).mid())


Product = tuple[Any, ...]
"""What is multiplied: operations by their numbers, and sums by their terms."""


def _atoms(tape: Tape) -> list[tuple[Any, int]]:
    """Of each condition what has one sign where the condition has it, and its own sign beside it.

    A sum is its products, each with its number; a factor that is a sum counts as the sum whose
    first number is 1.
    """
    every: list[dict[Product, Fraction]] = []
    for k, (name, arguments, of) in enumerate(tape.operations):
        parts = [every[j] for j in arguments]
        terms: dict[Product, Fraction]
        if name == "number":
            terms = {(): of} if of else {}
        elif name == "negative":
            terms = {key: -value for key, value in parts[0].items()}
        elif name in ("+", "-"):
            terms = dict(parts[0])
            for key, value in parts[1].items():
                terms[key] = terms.get(key, Fraction(0)) + (value if name == "+" else -value)
            terms = {key: value for key, value in terms.items() if value}
        elif name == "*" and all(parts):
            (p, a), (q, b) = map(_factor, parts)
            terms = {tuple(sorted((*p, *q), key=repr)): a * b}
        else:
            terms = {} if name == "*" else {(k,): Fraction(1)}
        every.append(terms)
    atoms = []
    for k in tape.results:
        several = sorted(every[k].items(), key=repr)
        first = several[0][1] if several else Fraction(1)
        atom = tuple((key, value / first) for key, value in several)
        atoms.append((atom, 1 if first > 0 else -1))
    return atoms


def _factor(terms: dict[Product, Fraction]) -> tuple[Product, Fraction]:
    if len(terms) == 1:
        return next(iter(terms.items()))
    several = sorted(terms.items(), key=repr)
    first = several[0][1]
    return (tuple((key, value / first) for key, value in several),), first
