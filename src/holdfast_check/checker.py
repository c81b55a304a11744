"""`holdfast-check FILE`: whether a certificate proves what it says.

A certificate names a vehicle's rates f(x, u, d), bounds of d, constraints c(x) <= 0, a grid of
cells, and for each cell of a set an input. It is valid if for each such cell X, its input u held
for T and any disturbance within the bounds

1. c <= 0 all over X;
2. a box B contains every state on the way: X + [0, T] f(B, u, D) lies in B (`held.py`, in steps);
3. c <= 0 on the way: all over B, or from both ends by the least and greatest rate of c over B;
4. every state at the end lies in cells of the set (of a level one lower, for a finite horizon).

Then the set is never left. Where a law gives the inputs, an entry is a cell and the mode of the law
before the sample, and all that the law may do all over the cell leads to entries (`law.py`).
Numbers are intervals whose ends are those of Arb (python-flint) with 80 bits (`intervals.py`).
"""

from __future__ import annotations

import argparse
import bisect
import functools
import importlib
import itertools
import json
import math
import random
import secrets
import sys
from collections.abc import Callable, Iterator, Sequence
from typing import Any

import flint
from flint import arb

from holdfast_check.flowpipe import Flowpipe, parts
from holdfast_check.held import HeldFlow
from holdfast_check.intervals import (
    NAMES,
    Row,
    Tape,
    add,
    down,
    interval,
    point,
    sub,
    up,
    within,
)
from holdfast_check.law import Law
from holdfast_check.reading import NO_LAW, NotValidError, Values, content_of, read
from holdfast_check.statement import lines, statement
from holdfast_check.taylor import NoModelError

BITS = 80
NOT_VALID, NOT_READ, OTHER, LEAST_CHANCE, MOST_STEPS, MOST_HALVES = 1, 2, 3, 1e-3, 64, 8
MOST_TURNED, MOST_TOUCHED, SHOWN = 1e12, 1 << 20, 2000
Tell = Callable[[int, int], None]
GROUPS = ("states", "inputs", "disturbances", "parameters")


class Checker:
    """The claims of a certificate, cell by cell."""

    def __init__(self, h: Values, entries: list[Any]) -> None:
        self.edges, self.turning = h["edges"], h["periodic"]
        self.constraints, self.target = (
            [c["expression"] for c in h[k]] for k in ("constraints", "target")
        )
        self.states, self.input_names = ([q["name"] for q in h[k]] for k in ("states", "inputs"))
        free = [*h["disturbances"], *h["parameters"]]
        self.ranges = {q["name"]: q["range"] for q in free}
        self.bounds = {name: interval(*ends) for name, ends in self.ranges.items()}
        self.middles = {name: point((a + b) / 2) for name, (a, b) in self.ranges.items()}
        self.hold, self.delay, errors = h["hold"], h["delay"], h["errors"]
        self.errors = [interval(-e, e) for e in errors]
        self.kept: dict[tuple[int, int], int] = {}
        self.flow = HeldFlow(h["rates"], self.states, self.constraints, h["steps"])
        self.halves = h["halves"]
        both = Tape([*self.constraints, *self.target])
        self.ends = functools.cache(lambda cell: self._holds(both, cell) is None)
        self.inside = Tape(self.constraints)
        self.shape, depth = [len(e) - 1 for e in self.edges], min(h["depth"], 31)
        self.total, self.widths = math.prod(self.shape), [2**k for k in range(depth + 1)]
        self.still = [r.text == "0" and e == 0 for r, e in zip(h["rates"], errors, strict=True)]
        self._choices(h["candidates"], h["law"])
        self._well_formed(h, [*self.states, *self.input_names, *(q["name"] for q in free)])
        self._keep(entries, h["holds"], bool(h["law"]["modes"]))
        first, ends = h["law"]["initial"], h["holds"] or 0
        if not any(self.target or v == ends for (_, k), v in self.kept.items() if k == first):
            raise NotValidError("no cell of it lasts for the horizon")
        last = {c for (c, k), v in self.kept.items() if k == first and (self.target or v == ends)}
        places = ((c, *self._place(c)) for c in last)
        whole = [w for c, w, place in places if c == max(last.intersection(self._numbers(place)))]
        if sum(wide ** len(self.shape) for wide in whole) != h["cells_kept"]:
            raise NotValidError("the cells of the horizon are not as many as it says")

    def _choices(self, tried: list[list[float]], law: Values) -> None:
        """What may be given: inputs that were tried, or the options of a law's modes."""
        self.tried = [list(map(point, row)) for row in tried]
        self.law = Law(law, self.input_names)
        self.choices = len(self.law.modes) or len(tried)
        ends = law["under_way"] or [(min(c), max(c)) for c in zip(*tried, strict=True)]
        ways = zip(self.input_names, ends, strict=self.delay > 0)
        self.under_way = {name: (interval(a, b), point((a + b) / 2)) for name, (a, b) in ways}

    def _well_formed(self, h: Values, names: list[str]) -> None:
        well_formed(h, self.law, names)
        if any(e != sorted({*e}) or len(e) < 2 for e in (*self.edges, *h["law"]["parts"])):
            raise NotValidError("the edges of cells, or of parts of inputs, do not grow")
        if any(a > b for a, b in h["law"]["under_way"]):
            raise NotValidError("a range is reversed")
        if not 0 <= self.halves <= MOST_HALVES:
            raise NotValidError(f"a cell may be halved {self.halves} times, not 0 to {MOST_HALVES}")
        times = 0 <= self.delay < self.hold and 1 <= h["steps"] <= MOST_STEPS
        holds = h["holds"] > 0 if h["holds"] is not None else not self.target
        law = bool(h["law"]["modes"])
        inputs = law != bool(h["candidates"]) and (law or h["law"] == NO_LAW)
        holds = holds and math.isfinite(self.hold * (h["holds"] or 1))
        if not (times and holds and inputs):
            raise NotValidError("the hold, the horizon, the constraints or the inputs are none")
        for angle in zip(self.states, self.edges, self.turning, strict=True):
            self._turns(*angle)

    def _keep(self, entries: list[Any], most: int | None, law: bool) -> None:
        count, better = self.total * len(self.widths), min if self.target else max
        for cell, choice, level in entries:
            horizon = level == 0 if most is None else 1 <= level <= most
            if not (cell < count and choice < self.choices and horizon):
                raise NotValidError(f"entry of cell {cell}: no such cell, input or level")
            place = cell, choice if law else 0
            self.kept[place] = better(level, self.kept.get(place, level))

    def _turns(self, name: str, axis: list[float], turns: bool) -> None:
        """An angle: all rates have it in sines and cosines alone, and a turn is in the axis."""
        if turns and not arb(axis[-1]) - arb(axis[0]) >= 2 * arb.pi():
            raise NotValidError(f"the axis of {name} is less than a turn")
        for e in (*self.flow.expressions, *self.target, *self.law.expressions):
            if turns and not Tape([e]).comes_back(name):
                raise NotValidError(f"{name} comes back after a turn, {e.text} not")

    def _holds(self, tape: Tape, cell: int) -> int | None:
        """The first expression that may be above 0 where a cell is measured."""
        x = zip(self.states, self._with_errors(self._seen(cell)), strict=True)
        values = tape.of(tape.values(self.bounds | dict(x)))
        return next((k for k, v in enumerate(values) if not v[1] <= 0), None)

    def entry(self, cell: int, choice: int, level: int) -> None:
        """Raises `NotValidError` unless this input, or the law, keeps this cell."""
        box, seen = self._box(cell), self._seen(cell)
        at = ", ".join(f"{n} = {a:g} to {b:g}" for n, (a, b) in zip(self.states, box, strict=True))
        where = f"cell {cell} ({at})"
        if (k := self._holds(self.inside, cell)) is not None:
            raise NotValidError(f"{where} is not inside constraint {k}")
        try:
            ranges = self.bounds | dict(zip(self.states, seen, strict=True))
            pairs = self.law.given(ranges, choice) if self.law.modes else [(self.tried[choice], 0)]
        except NotValidError as error:
            raise NotValidError(f"{where}: {error}") from None
        middle = [point((a + b) / 2) for a, b in box]
        for inputs, mode in pairs:
            u = dict(zip(self.input_names, inputs, strict=True))
            mids = {name: point(((a + b) / 2).mid()) for name, (a, b) in u.items()}
            hold = sub(point(self.hold), point(self.delay))
            legs = [(hold, self.bounds | u, self.middles | mids)]
            if self.delay > 0:  # first any input that may be under way
                if not all(within(q, self.under_way[name][0]) for name, q in u.items()):
                    raise NotValidError(f"{where}: an input is none that may be under way")
                any_u, mids = ({name: q[k] for name, q in self.under_way.items()} for k in (0, 1))
                legs.insert(0, (point(self.delay), self.bounds | any_u, self.middles | mids))
            if fails := self._fails(self._with_errors(seen), middle, legs, mode, level):
                raise NotValidError(f"{where}{fails}")

    def _fails(
        self, x: Row, middle: Row, legs: list[Any], mode: int, level: int, halved: int = 0
    ) -> str:
        """What may fail from a box; nothing if both of its halves keep what it promises.

        Each state is in one of the halves. Of a file that says that cells may be halved, the way
        is followed closely too before that.
        """
        why = self._may_fail(self.flow.held(x, middle, legs), mode, level)
        if why and self.halves:
            why = self._may_fail(self.flow.held(x, middle, legs, closely=True), mode, level)
        if not why or halved == self.halves:
            return why
        (low, high), axis = x[halved % len(x)], halved % len(x)
        cut = ((low + high) / 2).mid()
        for ends in ((low, cut), (cut, high)):
            half = [*x[:axis], ends, *x[axis + 1 :]]
            center = [point(((a + b) / 2).mid()) for a, b in half]
            if self._fails(half, center, legs, mode, level, halved + 1):
                return why
        return ""

    def _may_fail(self, held: tuple[Row | None, int | None], mode: int, level: int) -> str:
        end, fails = held
        if end is None:
            return ": no box of the states on the way was found"
        if fails is not None:
            return f": constraint {fails} may fail on the way"
        for led in self._cells(self._with_errors(end)):
            if led is None or not self._reached(led, mode, level):
                return f" may lead to {led and led[0]}, which is not kept"
        return ""

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

    def _seen(self, cell: int) -> Row:
        return [interval(*ends) for ends in self._box(cell)]

    def _with_errors(self, x: Row) -> Row:
        return [add(q, e) for q, e in zip(x, self.errors, strict=True)]

    def _reached(self, cells: list[int], mode: int, level: int) -> bool:
        """Whether a cell is of the set, or part of one that is.

        Where time is counted, of a level one closer to its end.
        """
        levels = [self.kept[cell, mode] for cell in cells if (cell, mode) in self.kept]
        if any(k < level if self.target else k >= level - 1 for k in levels):
            return True
        # level 0: in the region, and in the target where there is one
        return (level == 1 or bool(self.target)) and self.ends(cells[0])

    def _cells(self, end: Row) -> Iterator[list[int] | None]:
        """The smallest cells that a box touches, and those they are in; None beyond the grid."""
        ranges = []
        each = zip(end, self.edges, self.turning, self.still, strict=True)
        for q, axis, turns, still in each:  # a state that is still does not leave the grid
            low, high = down(q), up(q)
            finite = math.isfinite(low) and math.isfinite(high)
            if turns:
                finite &= max(-low, high) < MOST_TURNED and high - low < axis[-1] - axis[0]
            beyond = not (turns or still) and (low < axis[0] or high > axis[-1])
            around = math.floor((low - axis[0]) / math.tau) if turns and finite else 0
            places = set()
            for k in (around - 1, around, around + 1) if turns else (0,):
                turn = (2 * k * arb.pi()).lower(), (2 * k * arb.pi()).upper()
                there = sub(q, turn) if k else q
                first = max(bisect.bisect_left(axis, down(there)) - 1, 0)
                last = min(bisect.bisect_right(axis, up(there)), len(axis) - 1)
                places |= set(range(first, last))
            if beyond or not (places and finite):
                yield None
                return
            ranges.append(sorted(places))
        if math.prod(map(len, ranges)) > MOST_TOUCHED:
            raise NotValidError("an input leads to more cells than are counted")
        yield from map(list, map(self._numbers, itertools.product(*ranges)))


def well_formed(h: Values, law: Law, names: Sequence[str]) -> None:
    """Names, ranges, tables, constraints and errors, of cells and of flowpipes."""
    every = [*names, *law.nodes, "time_in_mode"]
    if len({n for n in every if n.isascii() and n.isidentifier()} - NAMES) < len(every):
        raise NotValidError("a name stands twice, is none, or is that of a function or number")
    ranges = [q["range"] for q in (*h["disturbances"], *h["parameters"])]
    if any(a > b for a, b in (*ranges, *h.get("start", ()))):
        raise NotValidError("a range is reversed")
    size = math.prod(n for *_, n, _ in law.axes)
    if any(len(end) != size for ends in law.nodes.values() for end in ends):
        raise NotValidError("a table has not the nodes that its axes say")
    errors, states = h["errors"], len(h["states"])
    if not (h["constraints"] and len(errors) == states and all(e >= 0 for e in errors)):
        raise NotValidError("the constraints or the errors are none")


def _of_flowpipe(h: Values, levels: Sequence[Any], share: float, drawn: random.Random) -> Values:
    """Follows the parts of a box, all or some."""
    pipe, law = Flowpipe(h), h["law"]
    well_formed(h, pipe.law, [q["name"] for k in GROUPS for q in h[k]])
    fits = bool(law["modes"]) == bool(h["inputs"]) and (law["modes"] or law == NO_LAW)
    fits = fits and (law["modes"] or not any(h["errors"])) and h["states"]
    rows = {len(h["rates"]), len(h["start"]), len(h["states"])}
    if not (fits and len(rows) == 1 and h["holds"] >= 1 and 0 < h["hold"] * h["holds"] < math.inf):
        raise NotValidError("the hold, the horizon, the start or the inputs are none")
    several = list(parts(h, pipe)) if len(h["splits"]) < 2 * len(levels) else []
    spans = list(itertools.pairwise(itertools.accumulate((n for _, n in several), initial=0)))
    if not spans or spans[-1][1] != len(levels):
        raise NotValidError("the parts of the box have not as many steps as it says")
    every = list(zip(several, spans, strict=True))
    some = every if share == 1 else drawn.sample(every, max(round(share * len(every)), 1))
    for (box, _), (begin, end) in some:
        try:
            pipe.follow(box, [level for (level,) in levels[begin:end]])
        except (NotValidError, NoModelError) as error:
            raise NotValidError(f"from {pipe.named(box)}: {error}") from None
    return {"parts": len(every), "checked": len(some), "entries": len(every)}


def _of_cells(
    h: Values, every: Sequence[Any], share: float, drawn: random.Random, tell: Tell | None
) -> Values:
    """Checks the entries, all or some."""
    checker, count = Checker(h, list(every)), max(round(share * len(every)), 1)
    entries = every if share == 1 else drawn.sample(every, count)
    for k, entry in enumerate(entries):
        if tell is not None and k % SHOWN == 0:
            tell(k, len(entries))
        checker.entry(*entry)
    return {"checked": len(entries), "entries": len(every)}


def begin() -> None:
    """Numbers have so many bits from now on."""
    flint.ctx.prec = BITS


def proved(
    content: bytes, share: float = 1.0, seed: int | None = None, tell: Tell | None = None
) -> Values:
    """What the content of a file proves, and how much of it was checked.

    tell: is called with how many entries were checked, of how many.

    Raises `NotValidError` where the certificate is wrong, or says what this program does not know.
    """
    begin()
    seed = secrets.randbits(32) if seed is None else seed
    header, every = read(content)
    try:
        cells = functools.partial(_of_cells, tell=tell)
        how = _of_flowpipe if "start" in header else cells
        done = how(header, every, share, random.Random(seed))
        said = statement(header, every)
    except KeyError as name:
        raise NotValidError(f"an expression uses the undeclared name {name.args[0]}") from name
    except (ArithmeticError, LookupError, TypeError, ValueError) as error:
        raise NotValidError(f"its parts do not go together: {error!r}") from error
    said |= done | {"valid": done["checked"] == done["entries"]}
    return said if said["valid"] else said | {"seed": seed}


def checked(
    path: str, share: float = 1.0, seed: int | None = None, tell: Tell | None = None
) -> Values:
    """What a file proves, as `proved` says."""
    return proved(content_of(path), share, seed, tell)


def verdict(said: Values) -> str:
    """What was checked, in a sentence."""
    how = "reach the target within" if said["target"] else "for"
    lasts = "for ever" if said["holds"] is None else f"{how} {said['for_seconds']:g} s"
    if said["kind"] == "flowpipe":
        end = " and then in the target" if said["target"] else ""
        what = f"all from a box, for {said['for_seconds']!r} s{end}: "
        what += f"{said['checked']} of {said['entries']} parts hold"
        if said["valid"]:
            return what
        return f"{what}, drawn with seed {said['seed']}; this is no proof"
    checked = f"{said['checked']} of {said['entries']} entries hold"
    text = f"{said['cells_kept']} cells {lasts}: {checked}"
    if said["valid"]:
        return text
    worst = -math.expm1(math.log(LEAST_CHANCE) / said["checked"])
    sure = f"with {100 * (1 - LEAST_CHANCE):g} % confidence at most {100 * worst:.3g} %"
    return text + f", drawn with seed {said['seed']}: {sure} of them are wrong; this is no proof"


def check(path: str, share: float = 1.0, seed: int | None = None) -> str:
    """What was checked, in a sentence. Raises `NotValidError` as `checked` does."""
    return verdict(checked(path, share, seed))


def main() -> None:
    """The command."""
    parser = argparse.ArgumentParser("holdfast-check", description="Check a certificate.")
    parser.add_argument("file")
    parser.add_argument("--share", type=float, default=1.0, help="part of the entries to check")
    parser.add_argument("--seed", type=int, help="of the entries that are drawn, to repeat it")
    parser.add_argument("--json", action="store_true", help="print the verdict as JSON")
    parser.add_argument(
        "--expect", metavar="SCENARIO", help="a scenario that it has to be of, which holdfast reads"
    )
    asked = parser.parse_args()
    if not 0 < asked.share <= 1:
        parser.error("--share: expected above 0, at most 1")
    try:
        tell = _tell if sys.stderr.isatty() else None
        said = checked(asked.file, asked.share, asked.seed, tell)
        if asked.expect:
            holdfast = importlib.import_module("holdfast.studies.law_certification")
            holdfast.check_of_scenario(asked.file, asked.expect)
            said["of_scenario"] = asked.expect
    except NotValidError as wrong:
        _end(asked, {"valid": False, "why": str(wrong)}, f"NOT valid: {wrong}", NOT_VALID)
    except Exception as error:  # whatever a file contains
        if asked.expect and type(error).__module__ == "holdfast.errors":
            why = f"{asked.file} is not of {asked.expect}: {error}"
            _end(asked, said | {"of_scenario": False, "why": why}, f"NOT as expected: {why}", OTHER)
        cause = f"{type(error).__name__}: {error}"
        print(f"holdfast-check: {asked.file} cannot be read ({cause:.200})", file=sys.stderr)
        sys.exit(NOT_READ)
    except KeyboardInterrupt:
        sys.exit(130)
    word = "valid" if said["valid"] else "not refuted"
    of = f", of {json.dumps(asked.expect)}" if asked.expect else ""
    _end(asked, said, "\n".join([f"{word}{of}: {verdict(said)}", *lines(said)]), 0)


def _tell(done: int, of: int) -> None:
    print(f"\r{done} of {of} \r", end="", file=sys.stderr, flush=True)


def _end(asked: argparse.Namespace, said: Values, text: str, status: int) -> None:
    print(json.dumps(said, indent=1) if asked.json else text)
    sys.exit(status)
