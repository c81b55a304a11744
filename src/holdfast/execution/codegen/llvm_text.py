"""Steps as the text of an LLVM function over columns: eight values of each step at a time.

The function has no calls and no branches but those of rare cases, so that its steps become vector
instructions of the processor. No instruction has a flag that would let LLVM contract or reorder it,
but a product and a sum of steps that may be fused.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from types import MappingProxyType

from holdfast.execution.arithmetic.steps import (
    FLOAT,
    TRUTH,
    WHERE,
    WHOLE,
    Function,
    Step,
    Steps,
    Value,
    in_single,
)

_SAME = "!invariant.load !0"

LANES = 8
"""Values of a step that are computed together: one register of AVX-512, two of AVX2."""


@dataclass(frozen=True)
class Format:
    """How the values of a leaf are computed. lanes: of a step; real: the type of floats."""

    lanes: int = LANES
    real: str = "double"

    def vector(self, kind: str) -> str:
        of = {FLOAT: self.real, WHOLE: "i64", TRUTH: "i1"}[kind]
        return f"<{self.lanes} x {of}>"

    def splat(self, of: str, value: str) -> str:
        return f"<{', '.join([f'{of} {value}'] * self.lanes)}>"

    def constant(self, step: Step) -> str:
        if step.kind == WHOLE:
            return self.splat("i64", str(step.given))
        value = step.given
        if self.real == "float":  # written as the double that it is
            value = in_single(value)
        (pattern,) = struct.unpack("<Q", struct.pack("<d", value))
        return self.splat(self.real, f"0x{pattern:016X}")


_TWO = {
    "add": "fadd", "sub": "fsub", "mul": "fmul", "div": "fdiv", "lt": "fcmp olt", "le": "fcmp ole",
    "eq": "fcmp oeq", "ne": "fcmp une", "both": "and", "either": "or", "iadd": "add",
    "isub": "sub", "imul": "mul", "iand": "and", "ior": "or", "ixor": "xor", "shl": "shl",
    "shr": "lshr", "ieq": "icmp eq",
}  # fmt: skip
_ONE = {"abs": "fabs", "sqrt": "sqrt", "floor": "floor", "ceil": "ceil", "rint": "rint"}


@dataclass
class Module:
    """The functions and tables that the leaves of one text share; double: their usual format."""

    double: Format = Format()
    functions: dict[str, str] = field(default_factory=dict)
    tables: dict[tuple[int, ...], str] = field(default_factory=dict)
    intrinsics: set[str] = field(default_factory=set)
    constants: dict[int, int] = field(default_factory=dict)

    def text(self, bodies: Sequence[str]) -> str:
        """These functions, and what they share."""
        tables = [
            f"{name} = private unnamed_addr constant [{len(table)} x i64] "
            f"[{', '.join(f'i64 {w}' for w in table)}]"
            for table, name in self.tables.items()
        ]
        if self.constants:
            listed = ", ".join(f"i64 {pattern}" for pattern in self.constants)
            count = len(self.constants)
            tables += [
                f"@holdfast.constants = private constant [{count} x i64] [{listed}]",
                "@holdfast.where = private global ptr @holdfast.constants",
                "!0 = !{}",
            ]
        return (
            "\n\n".join([*tables, *self.functions.values(), *bodies, *sorted(self.intrinsics)])
            + "\n"
        )


def repeated(kind: Format, name: str, number: str) -> list[str]:
    """A number in every lane."""
    vector, mask = kind.vector(FLOAT), f"<{kind.lanes} x i32> zeroinitializer"
    return [
        f"  {name}.i = insertelement {vector} poison, {kind.real} {number}, i32 0",
        f"  {name} = shufflevector {vector} {name}.i, {vector} poison, {mask}",
    ]


class Body:
    """The lines of the steps that some results need.

    form: of the steps; of_fused: of those that may be fused, if it is another. load: the lines that
    give an input its value; without it they belong before these lines. label: of the block of
    instructions in which the lines end; they begin in `loop`.
    """

    def __init__(
        self,
        module: Module,
        steps: Steps,
        results: Sequence[Value],
        form: Format | None = None,
        of_fused: Format | None = None,
        read: Mapping[int, str] = MappingProxyType({}),
        load: Callable[[str, str, Format], Sequence[str]] | None = None,
    ) -> None:
        self.module, self.steps, self.read, self.load = module, steps, read, load
        usual = form or module.double
        self.forms = {False: usual, True: of_fused or usual}
        self.lines: list[str] = []
        self.names: dict[int, str] = {}
        self.inputs: dict[str, int] = {}
        self.label = "loop"
        self._has_table = False
        self._converted: dict[int, str] = {}
        self._print_all(steps.needed([v.number for v in results], read, always=True))

    def _print_all(self, numbers: Iterable[int]) -> None:
        for number in numbers:
            if number in self.read:
                self.names[number], self.inputs[self.read[number]] = f"%v{number}", number
            else:
                self._print(number, self.steps.list[number])

    def form(self, number: int) -> Format:
        return self.forms[self.steps.list[number].fused]

    def name(self, number: int, real: str) -> str:
        """The name of a value, as one of this type if it is a float."""
        of = self.form(number)
        if of.real == real or self.steps.list[number].kind != FLOAT:
            return self.names[number]
        if number not in self._converted:
            cast = "fpext" if real == "double" else "fptrunc"
            to, name = Format(of.lanes, real).vector(FLOAT), f"%v{number}.c"
            self._line(f"{name} = {cast} {of.vector(FLOAT)} {self.names[number]} to {to}")
            self._converted[number] = name
        return self._converted[number]

    def _constant(self, name: str, value: float, form: Format) -> None:
        """A constant from the table of the module, which is an operand of instructions then.

        The address of the table is read, so that LLVM does not put the constants into the
        instructions: each would be moved through three registers.
        """
        (pattern,) = struct.unpack("<Q", struct.pack("<d", value))
        place = self.module.constants.setdefault(pattern, len(self.module.constants))
        table = "%v.constants"
        if not self._has_table:
            self._has_table = True
            self.lines.insert(0, f"  {table} = load ptr, ptr @holdfast.where, align 8, {_SAME}")
        self._line(f"{name}.p = getelementptr double, ptr {table}, i64 {place}")
        self._line(f"{name}.d = load double, ptr {name}.p, align 8, {_SAME}")
        self.lines += repeated(form, name, f"{name}.d")

    def _print(self, number: int, step: Step) -> None:
        name = self.names[number] = f"%v{number}"
        form = self.forms[step.fused]
        if step.operation == WHERE:
            self._only_where(number, step, form)
            return
        a = [self.name(k, form.real) for k in step.arguments]
        kind = form.vector(step.kind) if step.kind in (FLOAT, WHOLE, TRUTH) else ""
        operation = step.operation
        if operation == "input":
            self.inputs[step.given] = number
            if self.load:
                self.lines += self.load(name, step.given, form)
        elif operation == "constant":
            if form.real == "double" and step.kind == FLOAT and step.given != 0.0:
                self._constant(name, step.given, form)
            else:
                self.names[number] = form.constant(step)
        elif operation in _TWO:
            of = form.vector(self.steps.list[step.arguments[0]].kind)
            fused = " contract" if step.fused and operation in ("add", "sub", "mul") else ""
            self._line(f"{name} = {_TWO[operation]}{fused} {of} {a[0]}, {a[1]}")
        elif operation in _ONE:
            bits = 32 if form.real == "float" else 64
            function = f"@llvm.{_ONE[operation]}.v{form.lanes}f{bits}"
            self.module.intrinsics.add(f"declare {kind} {function}({kind})")
            self._line(f"{name} = call {kind} {function}({kind} {a[0]})")
        elif operation == "neg":
            self._line(f"{name} = fneg {kind} {a[0]}")
        elif operation == "not":
            self._line(f"{name} = xor {kind} {a[0]}, {form.splat('i1', 'true')}")
        elif operation in ("bits", "from_bits"):
            of = form.vector(self.steps.list[step.arguments[0]].kind)
            self._line(f"{name} = bitcast {of} {a[0]} to {kind}")
        elif operation == "choose":
            self._line(f"{name} = select {form.vector(TRUTH)} {a[0]}, {kind} {a[1]}, {kind} {a[2]}")
        elif operation == "entry":
            self._entry(name, a[0], step.given)
        elif operation == "rare":
            self._rare(number, a, step)
        elif operation == "result":
            self.names[number] = f"{a[0]}.{step.given}"
        else:
            raise ValueError(operation)

    def _line(self, text: str) -> None:
        self.lines.append(f"  {text}")

    def _entry(self, name: str, place: str, table: tuple[int, ...]) -> None:
        where = self.module.tables.setdefault(table, f"@table{len(self.module.tables)}")
        double = self.module.double
        kind, partial = double.vector(WHOLE), "zeroinitializer"
        for lane in range(double.lanes):
            stem = f"{name}.{lane}"
            self._line(f"{stem}.i = extractelement {kind} {place}, i32 {lane}")
            self._line(
                f"{stem}.p = getelementptr [{len(table)} x i64], ptr {where}, i64 0, i64 {stem}.i"
            )
            self._line(f"{stem}.w = load i64, ptr {stem}.p, align 8")
            into = name if lane == double.lanes - 1 else f"{stem}.v"
            self._line(f"{into} = insertelement {kind} {partial}, i64 {stem}.w, i32 {lane}")
            partial = into

    def _rare(self, number: int, a: Sequence[str], step: Step) -> None:
        function: Function = step.given
        double = self.module.double
        count = len(function.kinds)
        when, usual, arguments = a[0], a[1 : 1 + count], a[1 + count :]
        self._function(function)
        kinds = [double.vector(k) for k in function.kinds]
        several, truth = f"{{ {', '.join(kinds)} }}", double.vector(TRUTH)
        operands = ", ".join(f"{double.vector(FLOAT)} {x}" for x in arguments)
        name, before = f"%v{number}", self.label
        place = f"v{number}"
        self._if_any(name, when, double, place)
        self._line(f"{name}.all = call {several} @{function.name}({operands})")
        for i, kind in enumerate(kinds):
            self._line(f"{name}.{i}.new = extractvalue {several} {name}.all, {i}")
            self._line(
                f"{name}.{i}.one = select {truth} {when}, {kind} {name}.{i}.new, {kind} {usual[i]}"
            )
        self._line(f"br label %join.{place}")
        self.lines.append(f"join.{place}:")
        for i, kind in enumerate(kinds):
            self._line(
                f"{name}.{i} = phi {kind} [ {usual[i]}, %{before} ], "
                f"[ {name}.{i}.one, %rare.{place} ]"
            )
        self.label = f"join.{place}"

    def _if_any(self, name: str, when: str, form: Format, place: str) -> None:
        """Begin the block `rare`, if the condition holds in a lane; then comes `join`."""
        reduce, truth = f"@llvm.vector.reduce.or.v{form.lanes}i1", form.vector(TRUTH)
        self.module.intrinsics.add(f"declare i1 {reduce}({truth})")
        self._line(f"{name}.any = call i1 {reduce}({truth} {when})")
        self._line(f"br i1 {name}.any, label %rare.{place}, label %join.{place}")
        self.lines.append(f"rare.{place}:")

    def _only_where(self, number: int, step: Step, form: Format) -> None:
        """What only the unusual value needs is in a block that is skipped if no lane needs it."""
        when, usual, value = step.arguments
        name, place, before = f"%v{number}", f"v{number}", self.label
        as_usual = self.name(usual, form.real)
        self._if_any(name, self.names[when], form, place)
        self.label, converted = f"rare.{place}", dict(self._converted)
        needed = self.steps.needed([value], {**self.read, **self.names}, always=True)
        self._print_all(k for k in needed if k not in self.names)
        unusual = self.name(value, form.real)
        self._line(f"br label %join.{place}")
        self.lines.append(f"join.{place}:")
        self._line(
            f"{name} = phi {form.vector(step.kind)} [ {as_usual}, %{before} ], "
            f"[ {unusual}, %{self.label} ]"
        )
        self.label, self._converted = f"join.{place}", converted

    def _function(self, function: Function) -> None:
        """Define a function of rare cases in the module."""
        if function.name in self.module.functions:
            return
        steps, results = function.traced(expanded=True)
        body, double = Body(self.module, steps, results), self.module.double
        several = f"{{ {', '.join(double.vector(k) for k in function.kinds)} }}"
        inputs = ", ".join(
            f"{double.vector(FLOAT)} %v{body.inputs[p]}" for p in function.parameters
        )
        lines = [
            f"define internal {several} @{function.name}({inputs}) noinline nounwind {{",
            "loop:",
            *body.lines,
        ]
        whole = "poison"
        for i, value in enumerate(results):
            kind = double.vector(function.kinds[i])
            lines.append(
                f"  %r{i} = insertvalue {several} {whole}, {kind} {body.names[value.number]}, {i}"
            )
            whole = f"%r{i}"
        self.module.functions[function.name] = "\n".join([*lines, f"  ret {several} {whole}", "}"])


def leaves_text(leaves: Mapping[str, Leaf], lanes: int = LANES) -> str:
    """The text of a module with these functions, of so many values of a step at a time."""
    module = Module(Format(lanes))
    return module.text([_LeafText(module, leaf).text(name) for name, leaf in leaves.items()])


@dataclass(frozen=True)
class Places:
    """Where a leaf finds its arrays: it has one argument, with an address of each.

    names: of the arrays, in the order of their addresses. pitch: from a row of an array to the
    next. into: the array that each result fills: with values, with a bit for each truth value, or,
    if it is `largest`, with the largest value of each lane, so far. rest: the array of the lanes
    beyond the last column, since what follows there in the first array is not the leaf's.
    """

    names: Sequence[str]
    pitch: int
    into: Sequence[str]
    largest: str = ""
    rest: str = ""


@dataclass(frozen=True)
class Leaf:
    """A function of columns: row i of an argument is its column `i * stride`, and so of the result.

    All rows of `LANES` values are read before one is written, so that the result may be in place of
    an argument.

    arguments: the names of the arrays, with the inputs of the steps in their rows. results: the
    rows of the array that is filled. uniform: arguments, of doubles, whose rows are one number
    each. single: other arrays are in single precision. algebraic: the steps are arithmetic alone,
    so that they have the precision of the arrays; else only those that may be fused have it. read:
    steps whose values are inputs, by their numbers. places: where arrays and results are, if these
    are not its arguments.
    """

    steps: Steps
    arguments: Mapping[str, Sequence[str]]
    results: Sequence[Value]
    uniform: frozenset[str] = frozenset()
    single: bool = False
    algebraic: bool = False
    read: Mapping[int, str] = field(default_factory=dict)
    places: Places | None = None


def lanes_of(leaf: Leaf, lanes: int = LANES) -> int:
    """The values of a step that a leaf computes together, where others compute so many."""
    return 2 * lanes if leaf.single and leaf.algebraic else lanes


class _LeafText:
    """The text of a leaf: before the loop over columns, and in it."""

    def __init__(self, module: Module, leaf: Leaf) -> None:
        self.module, self.leaf, self.places = module, leaf, leaf.places
        self.stored = "float" if leaf.single else "double"
        lanes = lanes_of(leaf, module.double.lanes)
        self.values = Format(lanes, self.stored)
        self.form = Format(lanes, self.stored if leaf.algebraic else "double")
        self.rows = {n: (a, i) for a, names in leaf.arguments.items() for i, n in enumerate(names)}
        self.entry: list[str] = []
        self.lines: list[str] = []

    def text(self, name: str) -> str:
        heading = self._at_places() if self.places else self._in_rows()
        return "\n".join(
            [
                f"define void @{name}({heading}, i64 %count) nounwind {{",
                "entry:",
                *self.entry,
                "  br label %loop",
                "loop:",
                f"  %lane = phi i64 [ 0, %entry ], [ %next, %{self.label} ]",
                *self.lines,
                f"  %next = add nuw nsw i64 %lane, {self.values.lanes}",
                "  %more = icmp ult i64 %next, %count",
                "  br i1 %more, label %loop, label %done",
                "done:",
                "  ret void",
                "}",
            ]
        )

    def _body(self, load: Callable[[str, str, Format], Sequence[str]] | None = None) -> Body:
        leaf = self.leaf
        body = Body(
            self.module, leaf.steps, leaf.results, self.form, self.values, leaf.read, load=load
        )
        self.label = body.label
        return body

    # -- arguments and results are rows that are `stride` apart

    def _in_rows(self) -> str:
        body = self._body()
        for name, (array, row) in self.rows.items():
            number = body.inputs.get(name)
            if number is None:
                continue
            form = body.form(number)
            if array in self.leaf.uniform:
                self.lines += _uniform(form, f"%{array}", row, f"%v{number}")
            else:
                self.lines += self._row(f"%{array}", row, f"i{number}")
                self.lines += self._loaded(form, f"%i{number}.at", f"%v{number}")
        self.lines += body.lines
        for row, value in enumerate(self.leaf.results):
            self.lines += self._row("%out", row, f"o{row}")
            register, of = body.names[value.number], body.form(value.number)
            if self.stored != of.real:
                short = self.values.vector(FLOAT)
                self.lines.append(f"  %o{row}.v = fptrunc {of.vector(FLOAT)} {register} to {short}")
                register = f"%o{row}.v"
            self._store(register, f"%o{row}.at")
        arrays = "".join(f"ptr %{array}, " for array in self.leaf.arguments)
        return f"{arrays}ptr %out, i64 %stride"

    def _row(self, array: str, row: int, name: str) -> list[str]:
        return [
            f"  %{name}.row = mul i64 %stride, {row}",
            f"  %{name}.lane = add i64 %{name}.row, %lane",
            f"  %{name}.at = getelementptr {self.stored}, ptr {array}, i64 %{name}.lane",
        ]

    def _loaded(self, form: Format, place: str, name: str) -> list[str]:
        load = f"load {self.values.vector(FLOAT)}, ptr {place}, align {_SIZE[self.stored]}"
        if self.stored == form.real:
            return [f"  {name} = {load}"]
        wide = f"fpext {self.values.vector(FLOAT)} {name}.s to {form.vector(FLOAT)}"
        return [f"  {name}.s = {load}", f"  {name} = {wide}"]

    def _store(self, name: str, place: str) -> None:
        self.lines.append(
            f"  store {self.values.vector(FLOAT)} {name}, ptr {place}, align {_SIZE[self.stored]}"
        )

    # -- arguments and results are at places

    def _at_places(self) -> str:
        assert self.places is not None
        for k, name in enumerate(self.places.names):
            self.entry += [
                f"  %{name}.p = getelementptr i64, ptr %places, i64 {k}",
                f"  %{name}.a = load ptr, ptr %{name}.p, align 8",
            ]
        body = self._body(self._read)
        self.lines += body.lines
        self.lines.append("  %left = sub i64 %count, %lane")
        for value, array in zip(self.leaf.results, self.places.into, strict=True):
            if value.kind == TRUTH:
                self._store_truths(array, body.names[value.number])
            elif array == self.places.largest:
                self._keep_largest(array, body.name(value.number, self.stored))
            else:
                self._store_whole(array, body.name(value.number, self.stored))
        return "ptr %places"

    def _read(self, name: str, input_name: str, form: Format) -> list[str]:
        """The lines that load an input; what is the same for all columns is loaded before them."""
        assert self.places is not None
        array, row = self.rows[input_name]
        if array in self.leaf.uniform:
            self.entry += _uniform(form, f"%{array}.a", row, name)
            return []
        at = row * self.places.pitch
        return [
            f"  {name}.l = getelementptr {self.stored}, ptr %{array}.a, i64 %lane",
            f"  {name}.r = getelementptr {self.stored}, ptr {name}.l, i64 {at}",
            *self._loaded(form, f"{name}.r", name),
        ]

    def _store_whole(self, array: str, name: str) -> None:
        """Whole lanes where they belong, the rest apart. All lanes have been read before."""
        assert self.places is not None
        self.lines += [
            f"  %{array}.l = getelementptr {self.stored}, ptr %{array}.a, i64 %lane",
            f"  %{array}.w = icmp uge i64 %left, {self.values.lanes}",
            f"  %{array}.t = select i1 %{array}.w, ptr %{array}.l, ptr %{self.places.rest}.a",
        ]
        self._store(name, f"%{array}.t")

    def _store_truths(self, array: str, name: str) -> None:
        whole = f"i{self.values.lanes}"
        self.lines += [
            f"  %{array}.b = bitcast {self.values.vector(TRUTH)} {name} to {whole}",
            f"  %{array}.k = lshr i64 %lane, 3",
            f"  %{array}.l = getelementptr i8, ptr %{array}.a, i64 %{array}.k",
            f"  store {whole} %{array}.b, ptr %{array}.l, align 1",
        ]

    def _keep_largest(self, array: str, name: str) -> None:
        """Of the columns, and not of the lanes beyond."""
        lanes = self.values.lanes
        of, truth, whole = (self.values.vector(k) for k in (FLOAT, TRUTH, WHOLE))
        places = ", ".join(f"i64 {k}" for k in range(lanes))
        self.lines += [
            f"  %{array}.i = insertelement {whole} poison, i64 %left, i32 0",
            f"  %{array}.s = shufflevector {whole} %{array}.i, {whole} poison, "
            f"<{lanes} x i32> zeroinitializer",
            f"  %{array}.in = icmp ult {whole} <{places}>, %{array}.s",
            f"  %{array}.v = select {truth} %{array}.in, {of} {name}, {of} zeroinitializer",
            f"  %{array}.o = load {of}, ptr %{array}.a, align {_SIZE[self.stored]}",
            f"  %{array}.m = fcmp ogt {of} %{array}.v, %{array}.o",
            f"  %{array}.n = select {truth} %{array}.m, {of} %{array}.v, {of} %{array}.o",
        ]
        self._store(f"%{array}.n", f"%{array}.a")


_SIZE = {"float": 4, "double": 8}


def _uniform(form: Format, array: str, row: int, name: str) -> list[str]:
    """A number of double precision in every lane."""
    scalar = f"{name}.d"
    lines = [
        f"  {name}.p = getelementptr double, ptr {array}, i64 {row}",
        f"  {scalar} = load double, ptr {name}.p, align 8",
    ]
    if form.real == "float":
        lines.append(f"  {scalar}f = fptrunc double {scalar} to float")
        scalar += "f"
    return [*lines, *repeated(form, name, scalar)]
