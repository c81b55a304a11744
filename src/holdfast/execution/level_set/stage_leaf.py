"""The leaf of a stage of a step: from the nodes of a run to their new values, in one pass.

Nothing between slopes, rate and step (`stage_steps.py`) is stored. Slopes and step may be fused to
multiplications with addition, the rate may not (`rate_leaves.py`).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from holdfast.execution.arithmetic.steps import FLOAT, TRUTH, Steps, Value
from holdfast.execution.codegen.llvm_body import Body, Format, Module, repeated
from holdfast.execution.level_set.stage_steps import NUMBERS, Stage, names_of_numbers

PLACES = (
    "value", "base", "before", "lower", "upper", "out", "rest", "changed", "odd", "moves", "along",
    "of_row", "outer", "numbers",
)  # fmt: skip
"""The addresses that a stage asks for, in the order of `sweep.py`. Two slopes for each axis follow,
and of a filtered scheme two plain differences for each."""

PITCH = 272
"""From a row of what depends on the last axis, or on a row of it, to the next; as in `sweep.py`."""


def stage_text(stage: Stage) -> str:
    """Two functions: `stage`, and `measured`, which also finds the largest move."""
    module = Module()
    found = [_Text(stage, module, measured).function for measured in (False, True)]
    return module.text(found)


class _Text:
    """The function of a stage. Each of its three parts has steps and a format of its own."""

    def __init__(self, stage: Stage, module: Module, measured: bool) -> None:
        self.stage, self.module, self.measured = stage, module, measured
        self.rates = stage.rates
        single, algebraic = stage.rates.rate.single, stage.rates.rate.algebraic
        self.lanes = stage.lanes
        self.real = "float" if single else "double"
        self.size = 4 if single else 8
        self.own = Format(self.lanes, self.real, fused=True)
        self.of_rate = Format(self.lanes, self.real if algebraic else "double")
        self.entry: list[str] = []
        self.lines: list[str] = []
        self.label = "loop"
        self._loaded: set[str] = set()
        self._same: set[str] = set()

    @property
    def function(self) -> str:
        for name in PLACES:
            self.entry += self._address(name, PLACES.index(name))
        for k, name in enumerate(names_of_numbers(self.stage.axes)):
            self._uniform(name, "numbers", k, self.own)
        sides = self._sides("", 0)
        slopes = self._slopes(sides, "s")
        rate = self._rate(slopes, 0, "r")
        if self.stage.filtered:
            rate = self._filtered(rate, sides)
        self._step(rate, slopes)
        name = "measured" if self.measured else "stage"
        return "\n".join(
            [
                f"define void @holdfast_{name}(ptr %places, i64 %count) nounwind {{",
                "entry:",
                *self.entry,
                "  br label %loop",
                "loop:",
                f"  %lane = phi i64 [ 0, %entry ], [ %next, %{self.label} ]",
                *self.lines,
                f"  %next = add nuw nsw i64 %lane, {self.lanes}",
                "  %more = icmp ult i64 %next, %count",
                "  br i1 %more, label %loop, label %done",
                "done:",
                "  ret void",
                "}",
            ]
        )

    def _sides(self, kind: str, place: int) -> dict[str, str]:
        """Of each axis the slopes at both sides of a node, or what else is there of this kind; they
        follow so many others."""
        found = {}
        for i in range(self.stage.axes):
            for k, name in enumerate((f"{kind}below{i}", f"{kind}above{i}")):
                self.entry += self._address(name, len(PLACES) + place + 2 * i + k)
                found[name] = self._load(name)
        return found

    def _slopes(self, sides: dict[str, str], letter: str) -> list[str]:
        """The names of means, then of gaps."""
        given = {f"half{i}": f"%half{i}" for i in range(self.stage.axes)} | sides
        if self.stage.one_slope:
            given["value"] = self._load("value")
        return self._printed(*self.stage.slopes(), self.own, given, letter)

    def _rate(self, slopes: Sequence[str], result: int, letter: str) -> str:
        """One of the two results of the leaf of the rate."""
        rate, along, of_row = self.rates.rate, self.rates.along, self.rates.of_row
        wanted = rate.results[result]
        needed = {rate.steps.list[k].given for k in rate.steps.needed([wanted.number])}
        given = {}
        for k, name in enumerate(rate.arguments["w"]):
            if name not in needed:
                continue
            if k < along:
                found = self._load("along", k)
            elif k < along + of_row:
                found = self._load("of_row", k - along)
            else:
                found = slopes[k - along - of_row]
            given[name] = self._converted(found, self.own, self.of_rate, f"{letter}w{k}")
        for k, name in enumerate(rate.arguments["u"]):
            if name in needed:
                self._uniform(name, "outer", k, self.of_rate)
                given[name] = f"%{name}"
        (found,) = self._printed(rate.steps, [wanted], self.of_rate, given, letter)
        return self._converted(found, self.of_rate, self.own, f"{letter}rate")

    def _filtered(self, rate: str, sides: dict[str, str]) -> str:
        """The rate within the leeway of the monotone one, which is computed where a lane needs it.

        A lane that does not need it has the rate of the scheme whether it is computed or not.
        """
        n, stage, truth, of = self.stage.axes, self.stage, self.own.vector(TRUTH), self.own
        plain = self._sides("plain_", 2 * n)
        given = sides | plain | {x: f"%{x}" for x in ("leeway", "share", "bent")}
        for i in range(n):
            given[f"half{i}"] = f"%half{i}"
            given[f"speed{i}"] = self._rate([], 2 + i, f"t{i}")
        apart, leeway, far = self._printed(*stage.apart(), self.own, given, "d")
        reduce = f"@llvm.vector.reduce.or.v{self.lanes}i1"
        self.module.intrinsics.add(f"declare i1 {reduce}({truth})")
        before, loaded = self.label, set(self._loaded)
        self.lines += [
            f"  %any.far = call i1 {reduce}({truth} {far})",
            "  br i1 %any.far, label %far, label %near",
            "far:",
        ]
        self.label = "far"
        slopes = self._slopes({k.removeprefix("plain_"): v for k, v in plain.items()}, "p")
        monotone = self._rate(slopes, 1, "q")
        given = {"rate": rate, "monotone": monotone, "apart": apart, "leeway": leeway}
        (filtered,) = self._printed(*stage.filter(), self.own, given, "f")
        vector = of.vector(FLOAT)
        self.lines += [
            "  br label %near",
            "near:",
            f"  %filtered = phi {vector} [ {rate}, %{before} ], [ {filtered}, %{self.label} ]",
        ]
        self.label, self._loaded = "near", loaded
        return "%filtered"

    def _step(self, rate: str, slopes: Sequence[str]) -> None:
        n, stage = self.stage.axes, self.stage
        given = {name: f"%{name}" for name in NUMBERS} | {"rate": rate}
        given["value"] = value = self._load("value")
        for name in ("base", "before"):
            given[name] = value if stage.from_start else self._load(name)
        for name, there in (("lower", stage.lower), ("upper", stage.upper)):
            if there:
                given[name] = self._load(name)
        for i in range(n):
            given |= {f"mean{i}": slopes[i], f"gap{i}": slopes[n + i], f"step{i}": f"%step{i}"}
        found = self._printed(*stage.step(self.measured), self.own, given, "n")
        self._store(found[0])
        for name, truths in zip(("changed", "odd"), found[1:3], strict=True):
            self._store_truths(name, truths)
        if self.measured:
            self._keep_largest(found[3])

    def _printed(
        self, steps: Steps, results: Sequence[Value], form: Format, given: dict[str, str], of: str
    ) -> list[str]:
        body = Body(self.module, steps, results, form, given, of, label=self.label)
        self.lines += body.lines
        self.label = body.label
        return [body.names[v.number] for v in results]

    def _converted(self, name: str, form: Format, to: Format, new: str) -> str:
        if form.real == to.real:
            return name
        cast = "fpext" if to.real == "double" else "fptrunc"
        of, into = form.vector(FLOAT), to.vector(FLOAT)
        self.lines.append(f"  %{new}.c = {cast} {of} {name} to {into}")
        return f"%{new}.c"

    def _address(self, name: str, place: int) -> Iterator[str]:
        yield f"  %{name}.p = getelementptr i64, ptr %places, i64 {place}"
        yield f"  %{name}.a = load ptr, ptr %{name}.p, align 8"

    def _uniform(self, name: str, array: str, row: int, form: Format) -> None:
        """A number that is the same at all nodes; all of these are in double precision."""
        if name in self._same:
            return
        self._same.add(name)
        value = f"%{name}.d"
        self.entry += [
            f"  %{name}.q = getelementptr double, ptr %{array}.a, i64 {row}",
            f"  {value} = load double, ptr %{name}.q, align 8",
        ]
        if form.real == "float":
            self.entry.append(f"  %{name}.f = fptrunc double {value} to float")
            value = f"%{name}.f"
        self.entry += repeated(form, f"%{name}", value)

    def _load(self, array: str, row: int = 0) -> str:
        """The values of a row at the present lanes."""
        name = f"%{array}.{row}"
        if name not in self._loaded:
            self._loaded.add(name)
            self.lines += [
                f"  {name}.l = getelementptr {self.real}, ptr %{array}.a, i64 %lane",
                f"  {name}.r = getelementptr {self.real}, ptr {name}.l, i64 {row * PITCH}",
                f"  {name} = load {self.own.vector(FLOAT)}, ptr {name}.r, align {self.size}",
            ]
        return name

    def _store(self, name: str) -> None:
        """Whole lanes where they belong, the rest apart: what follows in memory is not of the run.

        All lanes have been read before.
        """
        self.lines += [
            f"  %to.l = getelementptr {self.real}, ptr %out.a, i64 %lane",
            "  %left = sub i64 %count, %lane",
            f"  %whole = icmp uge i64 %left, {self.lanes}",
            "  %to = select i1 %whole, ptr %to.l, ptr %rest.a",
            f"  store {self.own.vector(FLOAT)} {name}, ptr %to, align {self.size}",
        ]

    def _store_truths(self, array: str, name: str) -> None:
        """One bit for each node."""
        whole = f"i{self.lanes}"
        self.lines += [
            f"  %{array}.b = bitcast {self.own.vector(TRUTH)} {name} to {whole}",
            f"  %{array}.k = lshr i64 %lane, 3",
            f"  %{array}.l = getelementptr i8, ptr %{array}.a, i64 %{array}.k",
            f"  store {whole} %{array}.b, ptr %{array}.l, align 1",
        ]

    def _keep_largest(self, name: str) -> None:
        """Of the nodes of the run, in each lane."""
        of, truth = self.own.vector(FLOAT), self.own.vector(TRUTH)
        whole = f"<{self.lanes} x i64>"
        lanes = ", ".join(f"i64 {k}" for k in range(self.lanes))
        self.lines += [
            f"  %left.i = insertelement {whole} poison, i64 %left, i32 0",
            f"  %left.s = shufflevector {whole} %left.i, {whole} poison, "
            f"<{self.lanes} x i32> zeroinitializer",
            f"  %inside = icmp ult {whole} <{lanes}>, %left.s",
            f"  %moved = select {truth} %inside, {of} {name}, {of} zeroinitializer",
            f"  %largest = load {of}, ptr %moves.a, align {self.size}",
            f"  %more.moved = fcmp ogt {of} %moved, %largest",
            f"  %largest.n = select {truth} %more.moved, {of} %moved, {of} %largest",
            f"  store {of} %largest.n, ptr %moves.a, align {self.size}",
        ]
