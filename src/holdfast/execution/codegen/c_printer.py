"""Steps of arithmetic as C99: the same operations in the same order as the leaves of a closed loop.

Each operation is exactly rounded in C too, so that an exported law has every bit of the simulated
one, where the compiler keeps to IEEE 754: without -ffast-math, and without fused operations, which
the file itself turns off.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from types import MappingProxyType

import sympy as sp

from holdfast.execution.arithmetic.steps import (
    FLOAT,
    WHOLE,
    Function,
    Step,
    Steps,
    Value,
    in_single,
)
from holdfast.execution.codegen.lowering import WALLS, lowered
from holdfast.maths.definitions.quantity import SAMPLE_TIME, TIME, TIME_IN_MODE
from holdfast.maths.expressions.traversal import symbols_of

_KINDS = {FLOAT: "double", WHOLE: "uint64_t"}
_BINARY = {
    "add": ("+", 5), "sub": ("-", 5), "mul": ("*", 6), "div": ("/", 6), "lt": ("<", 3),
    "le": ("<=", 3), "eq": ("==", 3), "ne": ("!=", 3), "both": ("&&", 2), "either": ("||", 1),
    "iadd": ("+", 5), "isub": ("-", 5), "imul": ("*", 6), "iand": ("&", 0), "ior": ("|", 0),
    "ixor": ("^", 0), "shl": ("<<", 0), "shr": (">>", 0), "ieq": ("==", 3),
}  # fmt: skip
"""The operator and how strongly it binds; 0: always in parentheses."""
_CALLED = {
    "abs": "fabs", "sqrt": "sqrt", "floor": "floor", "ceil": "ceil", "rint": "rint",
    "bits": "hf_bits", "from_bits": "hf_from_bits",
}  # fmt: skip
ATOM = 9


def c_body(
    unpack: Mapping[str, Sequence[sp.Symbol]],
    results: Sequence[sp.Expr],
    into: str,
    indent: str = "    ",
) -> str:
    """Lines that unpack the used symbols, share subexpressions, and fill the array `into`."""
    used = symbols_of(results)
    lines = [
        f"{indent}const double {_name(s)} = {argument}[{i}];"
        for argument, symbols in unpack.items()
        for i, s in enumerate(symbols)
        if s in used
    ]
    steps = Steps(expanded=False)
    values = lowered(steps, results, {s: steps.input(_name(s)) for s in used})
    body = Body(steps, values, indent)
    lines += body.lines
    lines += [f"{indent}{into}[{i}] = {body.text(v.number)};" for i, v in enumerate(values)]
    return "\n".join(lines)


def c_functions(text: str, known: Iterable[Function]) -> str:
    """The functions of those known that a text calls, each before those that call it."""
    found: dict[str, str] = {}
    by_name = {f"hf_{function.name}(": function for function in known}

    def add(text: str) -> None:
        for call, function in by_name.items():
            if call in text and function.name not in found:
                whole = _definition(function)
                add(whole.partition("{\n")[2])
                found[function.name] = whole

    add(text)
    return "".join(f"{body}\n\n" for body in found.values())


def _definition(function: Function) -> str:
    """A function of one result returns it; of several it writes them behind pointers."""
    steps, results = function.traced(expanded=False)
    body = Body(steps, results, "    ")
    parameters = ", ".join(f"double {p}" for p in function.parameters)
    comment = function.text.partition("\n")[0]
    texts = [body.text(v.number) for v in results]
    if len(results) == 1:
        heading = f"static inline double hf_{function.name}({parameters}) {{"
        end = [f"    return {texts[0]};"]
    else:
        outputs = "".join(f", {_KINDS[k]} *r{i}" for i, k in enumerate(function.kinds))
        heading = f"static inline void hf_{function.name}({parameters}{outputs}) {{"
        end = [f"    *r{i} = {text};" for i, text in enumerate(texts)]
    return "\n".join([f"/* {comment} */", heading, *body.lines, *end, "}"])


class Body:
    """The lines of some steps; what is used once stands where it is used.

    real: the type of numbers that are not whole; of steps in float all functions are C++'s, which
    have several types. read: the texts of steps whose values are known; inputs: those of inputs, by
    default their names. fused: whether a product that is used once is fused with the sum it is in,
    by a call of fma, which is exactly rounded on every target.
    """

    def __init__(
        self,
        steps: Steps,
        results: Sequence[Value],
        indent: str,
        real: str = "double",
        *,
        read: Mapping[int, str] = MappingProxyType({}),
        inputs: Mapping[str, str] = MappingProxyType({}),
        fused: bool = False,
    ) -> None:
        self.steps, self.indent, self.real, self.fused = steps, indent, real, fused
        self.inputs = inputs
        self.lines: list[str] = []
        self.tables: dict[tuple[int, ...], str] = {}
        self.texts: dict[int, tuple[str, int]] = {}
        numbers = steps.needed([v.number for v in results], read)
        own = [n for n in numbers if n not in read]
        self.uses = Counter(k for n in own for k in steps.list[n].arguments)
        self.uses.update({v.number for v in results})
        self.texts |= {n: (read[n], ATOM) for n in numbers if n in read}
        for number in own:
            step = steps.list[number]
            text, binding = self._one(number, step)
            simple = step.operation in ("input", "constant", "result") or step.kind == "several"
            if not simple and (self.uses[number] > 1 or len(text) > MOST):
                kind = self.real if step.kind == FLOAT else _KINDS.get(step.kind, "int")
                self._line(f"const {kind} c_{number} = {text};")
                text, binding = f"c_{number}", ATOM
            self.texts[number] = text, binding

    def text(self, number: int, least: int = 0) -> str:
        """The text of a step, in parentheses if it binds less than that."""
        text, binding = self.texts[number]
        return text if binding >= least else f"({text})"

    def _line(self, text: str) -> None:
        self.lines.append(self.indent + text)

    def _one(self, number: int, step: Step) -> tuple[str, int]:
        operation, a = step.operation, step.arguments
        if operation == "input":
            return self.inputs.get(step.given, str(step.given)), ATOM
        if operation == "constant":
            return _constant(step, single=self.real == "float")
        if self.fused and (found := self._in_one(step)):
            return found, ATOM
        if operation in _BINARY:
            sign, binding = _BINARY[operation]
            if not binding:
                return f"({self.text(a[0], ATOM)} {sign} {self.text(a[1], ATOM)})", ATOM
            return f"{self.text(a[0], binding)} {sign} {self.text(a[1], binding + 1)}", binding
        if operation in _CALLED:
            return f"{_CALLED[operation]}({self.text(a[0])})", ATOM
        if operation == "neg":
            return f"-{self.text(a[0], ATOM)}", 7
        if operation == "not":
            return f"!{self.text(a[0], ATOM)}", 7
        if operation == "choose":
            when, one, other = (self.text(k, 4) for k in a)
            return f"({when} ? {one} : {other})", ATOM
        if operation == "entry":
            return f"{self._table(step.given)}[{self.text(a[0])}]", ATOM
        if operation == "result":
            return f"c_{a[0]}_{step.given}", ATOM
        if operation == WALLS:
            return self._walls(step), ATOM
        return self._several(number, step)

    def _in_one(self, step: Step) -> str:
        """A sum or a difference of which one side is a product that nothing else needs."""
        if step.operation not in ("add", "sub"):
            return ""
        for own, other in (step.arguments, step.arguments[::-1]):
            product = self.steps.list[own]
            if product.operation == "mul" and self.uses[own] == 1:
                first, second = (self.text(k) for k in product.arguments)
                rest = self.text(other, ATOM)
                if step.operation == "sub" and own == step.arguments[0]:
                    rest = f"-{rest}"
                elif step.operation == "sub":
                    first = f"-({first})"
                return f"fma({first}, {second}, {rest})"
        return ""

    def _table(self, words: tuple[int, ...]) -> str:
        """The name of a table, which is declared where it is first used."""
        if words not in self.tables:
            name = self.tables[words] = f"table_{len(self.tables)}"
            self._line(f"static const uint64_t {name}[] = {{")
            for k in range(0, len(words), 6):
                some = ", ".join(f"0x{w:08x}" for w in words[k : k + 6])
                self._line(f"    {some},")
            self._line("};")
        return self.tables[words]

    def _several(self, number: int, step: Step) -> tuple[str, int]:
        """A call, or a rare case, whose results are variables of their own."""
        function: Function = step.given
        own = [f"c_{number}_{i}" for i in range(len(function.kinds))]
        a = list(step.arguments)
        outputs = "".join(f", &{name}" for name in own)
        if step.operation == "call":
            arguments = ", ".join(map(self.text, a))
            if len(own) == 1:
                self._line(f"const double {own[0]} = hf_{function.name}({arguments});")
                return own[0], ATOM
            for name, kind in zip(own, function.kinds, strict=True):
                self._line(f"{_KINDS[kind]} {name};")
            self._line(f"hf_{function.name}({arguments}{outputs});")
            return own[0], ATOM
        for name, kind, usual in zip(own, function.kinds, a[1:], strict=False):
            self._line(f"{_KINDS[kind]} {name} = {self.text(usual)};")
        arguments = ", ".join(map(self.text, a[1 + len(own) :]))
        self._line(f"if ({self.text(a[0])}) hf_{function.name}({arguments}{outputs});")
        return own[0], ATOM

    def _walls(self, step: Step) -> str:
        """One of the results of a function of coordinates and of all walls."""
        name, points, which = step.given
        texts = [self.text(k) for k in step.arguments]
        at, ends = ", ".join(texts[:points]), texts[points:]
        walls = f"(const double[]){{{', '.join(ends)}}}"
        return f"hf_{name}({which}, {at}, {walls}, {len(ends) // 4})"


MOST = 300
"""Characters of an expression, beyond which it has a line of its own."""


def _constant(step: Step, *, single: bool = False) -> tuple[str, int]:
    if step.kind == WHOLE:
        return f"UINT64_C({step.given})", ATOM
    value: float = step.given
    if single:
        value = in_single(value)
    if math.isnan(value):
        return "NAN", ATOM
    text = repr(abs(value)) + "f" * single if math.isfinite(value) else "INFINITY"
    return (f"-{text}", 7) if math.copysign(1.0, value) < 0 else (text, ATOM)


def _name(s: sp.Symbol) -> str:
    """The name in C, where names that begin with an underscore are reserved."""
    name = source_name(s)
    return f"hf{name}" if name.startswith("_") else name


def source_name(s: sp.Symbol) -> str:
    """The name in the source. It ends in '_', unlike arguments and generated names."""
    return s.name if s in (TIME, TIME_IN_MODE, SAMPLE_TIME) else f"{s.name}_"
