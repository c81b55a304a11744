"""Steps of arithmetic as C99: the same operations in the same order as the leaves of a closed loop.

Each operation is exactly rounded in C too, so that an exported law has every bit of the simulated
one, where the compiler keeps to IEEE 754: without -ffast-math, and without fused operations, which
the file itself turns off.

Scalar functions are printed with the same operations in the same order as the compiled ones.
"""

from __future__ import annotations

import ast
import math
import re
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from types import MappingProxyType

import sympy as sp

from holdfast.execution.arithmetic.steps import (
    FLOAT,
    WHERE,
    WHOLE,
    Function,
    Step,
    Steps,
    Value,
    in_single,
)
from holdfast.execution.codegen.lowering import WALLS, OverWalls, lowered
from holdfast.execution.codegen.scalar_reader import (
    ARRAYS,
    BOOL,
    FLAGS,
    FLOATS,
    INT,
    NONE,
    TABLE,
    VALUE,
    VALUES,
    WHOLES,
    ScalarFunction,
    Scalars,
    common,
)
from holdfast.execution.codegen.scalar_reader import FLOAT as FLOAT_KIND
from holdfast.maths.definitions.quantity import SAMPLE_TIME, TIME, TIME_IN_MODE
from holdfast.maths.expressions.traversal import symbols_of

_TYPES = {INT: "long", FLOAT_KIND: "double", BOOL: "int", NONE: "void", VALUE: "hf_real"}
_ELEMENTS = {
    FLOATS: "double", WHOLES: "long", TABLE: "hf_table", VALUES: "hf_real", FLAGS: "uint8_t",
}  # fmt: skip
_OPERATORS = {
    ast.Add: ("+", 5), ast.Sub: ("-", 5), ast.Mult: ("*", 6), ast.Div: ("/", 6), ast.Mod: ("%", 6),
    ast.FloorDiv: ("/", 6), ast.RShift: (">>", 0), ast.LShift: ("<<", 0), ast.BitAnd: ("&", 0),
    ast.BitOr: ("|", 0), ast.Lt: ("<", 3),
    ast.LtE: ("<=", 3), ast.Gt: (">", 3), ast.GtE: (">=", 3), ast.Eq: ("==", 3),
    ast.NotEq: ("!=", 3), ast.And: ("&&", 2), ast.Or: ("||", 1),
}  # fmt: skip
"""The operator and how strongly it binds; 0: always in parentheses."""
_CALLED_BY_SCALARS = {
    "abs": "fabs", "int": "(long)", "float": "(double)", "math.sqrt": "sqrt",
    "math.floor": "floor", "math.isnan": "isnan", "math.isfinite": "isfinite",
}  # fmt: skip
_ATOM, _PREFIX = 9, 7


def scalars_c(
    library: Scalars,
    roots: Sequence[str],
    *,
    scope: str = "static",
    kernels: Sequence[str] = (),
    fused: bool = False,
) -> str:
    """The text of these functions and of those that they call, named hf_ and their name.

    An entry of a `Table` has the type hf_table, a `Value` the type hf_real, which the text before
    it has to define. scope: of the functions, kernels: those of them that are kernels of a device
    (`device/blocks.h`). fused: whether a product and a sum are fused, as LLVM may in a sweep.
    """
    text = "\n".join(
        _Printer(library, f, "HF_KERNEL" if f.name in kernels else scope, fused).text()
        for f in library.needed(roots)
        if f.body
    )
    return c_helpers(_HELPERS, text, scope) + text


def heading_c(library: Scalars, name: str, scope: str) -> str:
    """That of a function which a program defines."""
    return _Printer(library, library.functions[name], scope, fused=False).heading()


def c_helpers(helpers: Mapping[str, str], text: str, scope: str = "static") -> str:
    """Those of the functions that a text calls: compilers warn of unused ones."""
    called = (body for name, body in helpers.items() if f"hf_{name}(" in text)
    return "".join(f"{scope} {body}\n\n" for body in called)


_HELPERS = {
    "min": "double hf_min(double a, double b) {\n    return b < a ? b : a;\n}",
    "max": "double hf_max(double a, double b) {\n    return b > a ? b : a;\n}",
    "min_whole": "long hf_min_whole(long a, long b) {\n    return b < a ? b : a;\n}",
    "max_whole": "long hf_max_whole(long a, long b) {\n    return b > a ? b : a;\n}",
    "min_value": "hf_real hf_min_value(hf_real a, hf_real b) {\n    return b < a ? b : a;\n}",
    "max_value": "hf_real hf_max_value(hf_real a, hf_real b) {\n    return b > a ? b : a;\n}",
    "abs_whole": "long hf_abs_whole(long a) {\n    return a < 0 ? -a : a;\n}",
    "copy": (
        "void hf_copy(const double *a, long i, long count, double *b, long j) {\n"
        "    for (long k = 0; k < count; k++) b[j + k] = a[i + k];\n}"
    ),
    "any_lane": (
        "int hf_any_lane(const double *a, long i, long count) {\n"
        "    for (long k = 0; k < count; k++)\n"
        "        if (a[i + k] != 0.0) return 1;\n"
        "    return 0;\n}"
    ),
    "address": "long hf_address(const double *a, long k) {\n    return (long)(a + k);\n}",
    "floats_at": "double *hf_floats_at(long address) {\n    return (double *)address;\n}",
}
"""As Python has them: `min` and `max` give the first, unless the second is beyond it."""

BITS = {
    "bits": "inline uint64_t hf_bits(double x) {\n    uint64_t bits;\n"
    "    memcpy(&bits, &x, sizeof bits);\n    return bits;\n}",
    "from_bits": "inline double hf_from_bits(uint64_t bits) {\n    double x;\n"
    "    memcpy(&x, &bits, sizeof x);\n    return x;\n}",
}
"""The bits of a number, and the number of some bits."""


class _Printer:
    def __init__(self, library: Scalars, function: ScalarFunction, scope: str, fused: bool) -> None:
        self.known, self.function, self.scope, self.fused = library, function, scope, fused
        self.lines: list[str] = []
        self.depth = 1

    def text(self) -> str:
        f, heading = self.function, f"{self.heading()} {{"
        self._head()
        self._all(f.body)
        comment = " ".join(f.text.partition("\n\n")[0].split())
        return "\n".join([*_wrapped(comment), *_folded(heading), *self.lines, "}", ""])

    def heading(self) -> str:
        f = self.function
        parameters = ", ".join(self._declared(n) for n in f.parameters)
        of = "" if self.scope == "HF_KERNEL" else f" {_TYPES[f.result]}"
        return f"{self.scope}{of} hf_{f.name}({parameters})"

    def _declared(self, name: str) -> str:
        kind = self.function.kind(name)
        if kind not in ARRAYS:
            return f"{_TYPES[kind]} {name}"
        const = "" if name in self.function.written else "const "
        return f"{const}{_ELEMENTS[kind]} *{name}"

    def _head(self) -> None:
        """The variables, a line for each kind."""
        by_type: dict[str, list[str]] = {}
        rooms = dict(filter(None, map(self._room, ast.walk(self.function.node))))
        for name, kind in self.function.variables.items():
            if name in rooms:
                shared, count = rooms[name]
                self._line(f"{shared}{_ELEMENTS[kind]} {name}[{count}];")
                continue
            of = self._declared(name)[: -len(name)]
            zero = "NULL" if kind in ARRAYS else "0" if kind in (INT, BOOL) else "0.0"
            star = "*" if kind in ARRAYS else ""
            by_type.setdefault(of.rstrip("*"), []).append(f"{star}{name} = {zero}")
        for of, names in by_type.items():
            self._line(f"{of}{', '.join(names)};")

    def _room(self, node: ast.AST) -> tuple[str, tuple[str, int]] | None:
        """The name of a new array that a statement makes, whether it is shared, its length."""
        match node:
            case ast.Assign(
                targets=[ast.Name(id=name)], value=ast.Call(func=ast.Name(id=called), args=[count])
            ) if called.startswith(("private_", "shared_")):
                shared = "HF_SHARED " if called.startswith("shared_") else ""
                return name, (shared, int(self.function.number(count) or 0))
        return None

    # -- statements

    def _all(self, statements: Iterable[ast.stmt]) -> None:
        for one in statements:
            if self._room(one) is None:
                self._statement(one)

    def _statement(self, node: ast.stmt) -> None:
        match node:
            case ast.Assign(targets=[ast.Tuple(elts=names)], value=ast.Tuple(elts=values)):
                for name, one in zip(names, values, strict=True):
                    self._assign(name, self._text(one))
            case ast.Assign(targets=targets, value=value):
                self._assign(targets[0], self._text(value))
                for target in targets[1:]:
                    self._assign(target, self._text(targets[0]))
            case ast.AugAssign(target=target, op=op, value=value):
                symbol = _OPERATORS[type(op)][0]
                self._line(f"{self._text(target)} {symbol}= {self._text(value)};")
            case ast.If(test=test, body=body, orelse=other):
                self._line(f"if ({self._text(test)}) {{")
                self._inside(body)
                while len(other) == 1 and isinstance(other[0], ast.If):
                    self._line(f"}} else if ({self._text(other[0].test)}) {{")
                    self._inside(other[0].body)
                    other = other[0].orelse
                if other:
                    self._line("} else {")
                    self._inside(other)
                self._line("}")
            case ast.While(test=test, body=body):
                self._line(f"while ({self._text(test)}) {{")
                self._inside(body)
                self._line("}")
            case ast.For(
                target=ast.Name(id=name), iter=ast.Call(func=ranged, args=bounds), body=body
            ):
                first, last = (bounds[0], bounds[1]) if len(bounds) > 1 else (None, bounds[0])
                start = self._text(first) if first is not None else "0"
                if (among := ast.unparse(ranged)) != "range":
                    self._line(f"HF_{among.upper()}({name}, {start}, {self._text(last)}) {{")
                    self._inside(body)
                    self._line("}")
                    return
                below = f"{name} < {self._text(last, 4)}"
                turn = f"{name}++"
                if len(bounds) > 2 and self.function.number(bounds[2]) == -1:
                    below, turn = f"{name} > {self._text(last, 4)}", f"{name}--"
                self._line(f"for ({name} = {start}; {below}; {turn}) {{")
                self._inside(body)
                self._line("}")
            case ast.Return(value=value):
                self._line("return;" if value is None else f"return {self._text(value)};")
            case ast.Expr(value=value):
                self._line(f"{self._text(value)};")
            case ast.Break():
                self._line("break;")
            case ast.Continue():
                self._line("continue;")

    def _inside(self, body: list[ast.stmt]) -> None:
        self.depth += 1
        self._all(body)
        self.depth -= 1

    def _assign(self, target: ast.expr, value: str) -> None:
        self._line(f"{self._text(target)} = {value};")

    # -- expressions

    def _text(self, node: ast.expr, least: int = 0) -> str:
        text, strength = self._found(node)
        return f"({text})" if strength < least else text

    def _found(self, node: ast.expr) -> tuple[str, int]:
        if isinstance(node, ast.Constant) and isinstance(node.value, bool):
            return str(int(node.value)), _ATOM
        value = self.function.number(node)
        if value is not None:
            return _number(value), _ATOM if value >= 0 else _PREFIX
        match node:
            case ast.Name(id=name):
                return name, _ATOM
            case ast.Subscript(value=ast.Name(id=name), slice=ast.Slice(lower=lower)):
                return (name, _ATOM) if lower is None else (f"{name} + {self._text(lower, 5)}", 5)
            case ast.Subscript(value=ast.Name(id=name), slice=place):
                return f"{name}[{self._text(place)}]", _ATOM
            case ast.BinOp(left=left, op=op, right=right):
                symbol, strength = _OPERATORS[type(op)]
                kind = self.function.kinds[node]
                if self.fused and kind != INT and isinstance(op, ast.Add | ast.Sub):
                    for side, other in ((left, right), (right, left)):
                        if isinstance(side, ast.BinOp) and isinstance(side.op, ast.Mult):
                            return self._in_one(kind, op, side, other, first=side is left), _ATOM
                a, b = self._as(kind, left, strength), self._as(kind, right, strength + 1)
                if isinstance(op, ast.Div) and self.function.kinds[left] == INT:
                    a = f"(double){self._text(left, _PREFIX)}"
                return (
                    (f"{a} {symbol} {b}", strength) if strength else (f"({a} {symbol} {b})", _ATOM)
                )
            case ast.UnaryOp(op=op, operand=inner):
                sign = "!" if isinstance(op, ast.Not) else "-"
                least = _ATOM if sign == "-" else _PREFIX  # two signs would be another operator
                return f"{sign}{self._text(inner, least)}", _PREFIX
            case ast.Compare(left=left, ops=tests, comparators=others):
                pairs = zip((left, *others), tests, others, strict=False)
                kind = common({self.function.kinds[one] for one in (left, *others)})
                texts = [
                    f"{self._as(kind, a, 4)} {_OPERATORS[type(t)][0]} {self._as(kind, b, 4)}"
                    for a, t, b in pairs
                ]
                return (texts[0], 3) if len(texts) == 1 else (f"({' && '.join(texts)})", _ATOM)
            case ast.BoolOp(op=op, values=values):
                symbol, strength = _OPERATORS[type(op)]
                return f" {symbol} ".join(self._text(v, 3) for v in values), strength
            case ast.IfExp(test=test, body=a, orelse=b):
                kind = self.function.kinds[node]
                return f"{self._text(test, 1)} ? {self._as(kind, a, 1)} : {self._as(kind, b, 1)}", 0
            case ast.Call(args=arguments):
                return self._called(self.function.calls[node], arguments)
        raise AssertionError(ast.dump(node))

    def _as(self, kind: str, node: ast.expr, least: int = 0) -> str:
        """The text of an operand of what is of this kind: what is no `Value` becomes one first."""
        if kind == VALUE and self.function.kinds[node] != VALUE:
            return f"(hf_real){self._text(node, _PREFIX)}"
        return self._text(node, least)

    def _in_one(
        self, kind: str, op: ast.operator, product: ast.BinOp, other: ast.expr, *, first: bool
    ) -> str:
        """A product and a sum, or a difference, rounded once."""
        one, two = self._as(kind, product.left), self._as(kind, product.right)
        rest = self._as(kind, other, _ATOM)
        if isinstance(op, ast.Sub):
            one, rest = (one, f"-{rest}") if first else (f"-({one})", rest)
        return f"fma({one}, {two}, {rest})"

    def _called(self, name: str, arguments: Sequence[ast.expr]) -> tuple[str, int]:
        if name == "leaf":
            places = ", ".join(f"w + {self._text(a, 5)}" for a in arguments[1:])
            return f"leaf_{ast.literal_eval(arguments[0])}({places})", _ATOM
        if name == "part":
            passed = ", ".join(self._text(a) for a in arguments[1:])
            return f"hf_{ast.literal_eval(arguments[0])}({passed})", _ATOM
        if name in ("min", "max", "abs"):
            kind = common({self.function.kinds[a] for a in arguments})
            name += "_whole" if kind == INT else ""
            if kind == VALUE and name != "abs":
                texts = ", ".join(self._as(kind, a) for a in arguments)
                return f"hf_{name}_value({texts})", _ATOM
        if name in ("int", "float"):
            return f"{_CALLED_BY_SCALARS[name]}{self._text(arguments[0], _PREFIX)}", _PREFIX
        called = _CALLED_BY_SCALARS.get(name) or f"hf_{name}"
        return f"{called}({', '.join(self._text(a) for a in arguments)})", _ATOM

    def _line(self, text: str) -> None:
        self.lines += _folded("    " * self.depth + text)


def _number(value: float) -> str:
    if isinstance(value, int) or math.isfinite(value):
        return repr(value)
    return "NAN" if math.isnan(value) else "INFINITY" if value > 0 else "-INFINITY"


def _folded(line: str, width: int = 100) -> list[str]:
    """The line, or several that end after a comma or before an operator."""
    indent = " " * (len(line) - len(line.lstrip()) + 8)
    lines = []
    while len(line) > width:
        ends = [line.rfind(", ", 0, width) + 1]
        ends += [line.rfind(f" {op} ", 0, width) for op in ("&&", "||", "?", ":", "+", "-", ">")]
        cut = max(ends)
        if cut <= len(indent):
            break
        lines.append(line[:cut].rstrip())
        line = indent + line[cut:].lstrip()
    return [*lines, line]


def _wrapped(text: str) -> list[str]:
    """A comment."""
    lines: list[str] = []
    for word in text.split():
        if lines and len(lines[-1]) + len(word) < 96:
            lines[-1] += f" {word}"
        else:
            lines.append(f"{' * ' if lines else '/* '}{word}")
    return [*lines[:-1], f"{lines[-1]} */"] if lines else []


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


def c_own(text: str, name: str) -> str:
    """The text with the law's name as a prefix of every name of this package: hf_, HF_."""
    return re.sub(r"\bHF_", f"{name.upper()}_HF_", re.sub(r"\bhf_", f"{name}_hf_", text))


def c_functions(text: str, functions: Iterable[Function | OverWalls]) -> str:
    """Those of the functions that a text calls, each before those that call it."""
    definitions: dict[str, str] = {}
    by_name = {f"hf_{function.name}(": function for function in functions}

    def add(text: str) -> None:
        for call, function in by_name.items():
            if call in text and function.name not in definitions:
                if isinstance(function, OverWalls):
                    whole = _over_walls(function)
                else:
                    whole = _definition(function)
                add(whole.partition("{\n")[2])
                definitions[function.name] = whole

    add(text)
    return "".join(f"{body}\n\n" for body in definitions.values())


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
    return "\n".join([f"/* {comment} */", *_folded(heading), *body.lines, *end, "}"])


def _over_walls(function: OverWalls) -> str:
    """A function of points and of walls, x0, y0, x1, y1 each, gives its result number k."""
    steps = Steps(expanded=False)
    points = function.one.parameters[: function.points]
    first = function.first(*(steps.input(p) for p in points))
    body = Body(steps, first, "")
    places = range(len(first))
    results = ", ".join(body.text(v.number) for v in first)
    parameters = ", ".join(f"double {p}" for p in points)
    arguments = [*points, *(f"ends[{i}]" for i in range(4)), *(f"r[{i}]" for i in places)]
    arguments += [f"&r[{i}]" for i in places]
    return "\n".join(
        [
            f"/* Result k of the walls together; {function.one.name} is for each. */",
            *_folded(
                f"static inline double hf_{function.name}(int k, {parameters}, "
                "const double *ends, int count) {"
            ),
            f"    double r[] = {{{results}}};",
            "    for (int j = 0; j < count; j++, ends += 4)",
            *_folded(f"        hf_{function.one.name}({', '.join(arguments)});"),
            "    return r[k + 1];",
            "}",
        ]
    )


class Body:
    """The lines of some steps; what is used once stands where it is used.

    real: the type of numbers that are not whole, of_fused: of steps that may be fused; of steps in
    float all functions are C++'s, which have several types. read: the texts of steps whose values
    are known; inputs: those of inputs, by default their names. Of steps that may be fused, a
    product that is used once is fused with the sum it is in, by a call of fma, which is exactly
    rounded on every target.
    """

    def __init__(
        self,
        steps: Steps,
        results: Sequence[Value],
        indent: str,
        real: str = "double",
        of_fused: str = "double",
        *,
        read: Mapping[int, str] = MappingProxyType({}),
        inputs: Mapping[str, str] = MappingProxyType({}),
    ) -> None:
        self.steps, self.indent, self.inputs, self.read = steps, indent, inputs, read
        self.reals = {False: real, True: of_fused}
        self.lines: list[str] = []
        self.tables: dict[tuple[int, ...], str] = {}
        self.texts: dict[int, tuple[str, int]] = {}
        asked = [v.number for v in results]
        computed = [n for n in steps.needed(asked, read) if n not in read]
        self.uses = Counter(k for n in computed for k in steps.list[n].arguments)
        self.uses.update(set(asked))
        self._print_all(steps.needed(asked, read, always=True))

    def _print_all(self, numbers: Iterable[int]) -> None:
        for number in numbers:
            if number in self.read:
                self.texts[number] = self.read[number], ATOM
                continue
            step = self.steps.list[number]
            text, binding = self._one(number, step)
            simple = step.operation in ("input", "constant", "result", WHERE)
            if (
                step.kind != "several"
                and not simple
                and (self.uses[number] > 1 or len(text) > MOST)
            ):
                self._line(f"const {self._type(step)} c_{number} = {text};")
                text, binding = f"c_{number}", ATOM
            self.texts[number] = text, binding

    def _type(self, step: Step) -> str:
        return self.reals[step.fused] if step.kind == FLOAT else _KINDS.get(step.kind, "int")

    def text(self, number: int, least: int = 0, real: str = "") -> str:
        """The text of a step, in parentheses if it binds less than that; as this type."""
        text, binding = self.texts[number]
        step = self.steps.list[number]
        if real and step.kind == FLOAT and self._type(step) != real:
            text, binding = f"({real}){text if binding >= 7 else f'({text})'}", 7
        return text if binding >= least else f"({text})"

    def _line(self, text: str) -> None:
        self.lines.append(self.indent + text)

    def _one(self, number: int, step: Step) -> tuple[str, int]:
        operation, a = step.operation, step.arguments
        real = self.reals[step.fused]
        if operation == "input":
            return self.inputs.get(step.given, str(step.given)), ATOM
        if operation == "constant":
            return _constant(step, single=real == "float")
        if fused := self._in_one(step, real):
            return fused, ATOM
        if operation in _BINARY:
            sign, binding = _BINARY[operation]
            if not binding:
                return f"({self.text(a[0], ATOM)} {sign} {self.text(a[1], ATOM)})", ATOM
            least = 3 if operation == "either" else binding  # compilers ask for (a && b) || c
            one, two = self.text(a[0], least, real), self.text(a[1], max(least, binding + 1), real)
            return f"{one} {sign} {two}", binding
        if operation in _CALLED:
            return f"{_CALLED[operation]}({self.text(a[0], 0, real)})", ATOM
        if operation == "neg":
            return f"-{self.text(a[0], ATOM, real)}", 7
        if operation == "not":
            return f"!{self.text(a[0], ATOM)}", 7
        if operation == "choose":
            when, one, other = (self.text(k, 4, real) for k in a)
            return f"({when} ? {one} : {other})", ATOM
        if operation == "entry":
            return f"{self._table(step.given)}[{self.text(a[0])}]", ATOM
        if operation == "result":
            return f"c_{a[0]}_{step.given}", ATOM
        if operation == WALLS:
            return self._walls(step), ATOM
        if operation == WHERE:
            return self._only_where(number, step, real), ATOM
        return self._several(number, step)

    def _in_one(self, step: Step, real: str) -> str:
        """A sum or a difference of which one side is a product that nothing else needs."""
        if not step.fused or step.operation not in ("add", "sub"):
            return ""
        for side, other in (step.arguments, step.arguments[::-1]):
            product = self.steps.list[side]
            if product.operation == "mul" and product.fused and self.uses[side] == 1:
                first, second = (self.text(k, 0, real) for k in product.arguments)
                rest = self.text(other, ATOM, real)
                if step.operation == "sub" and side == step.arguments[0]:
                    rest = f"-{rest}"
                elif step.operation == "sub":
                    first = f"-({first})"
                return f"fma({first}, {second}, {rest})"
        return ""

    def _only_where(self, number: int, step: Step, real: str) -> str:
        """A variable, and the steps that only its unusual value needs."""
        when, usual, value = step.arguments
        self._line(f"{self._type(step)} c_{number} = {self.text(usual, 0, real)};")
        self._line(f"if ({self.text(when)}) {{")
        indent, self.indent = self.indent, f"{self.indent}    "
        needed = self.steps.needed([value], self.texts, always=True)
        self._print_all(k for k in needed if k not in self.texts)
        self._line(f"c_{number} = {self.text(value, 0, real)};")
        self.indent = indent
        self._line("}")
        return f"c_{number}"

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
        names = [f"c_{number}_{i}" for i in range(len(function.kinds))]
        a = list(step.arguments)
        outputs = "".join(f", &{name}" for name in names)
        if step.operation == "call":
            arguments = ", ".join(map(self.text, a))
            if len(names) == 1:
                self._line(f"const double {names[0]} = hf_{function.name}({arguments});")
                return names[0], ATOM
            for name, kind in zip(names, function.kinds, strict=True):
                self._line(f"{_KINDS[kind]} {name};")
            self._line(f"hf_{function.name}({arguments}{outputs});")
            return names[0], ATOM
        for name, kind, usual in zip(names, function.kinds, a[1:], strict=False):
            self._line(f"{_KINDS[kind]} {name} = {self.text(usual)};")
        arguments = ", ".join(map(self.text, a[1 + len(names) :]))
        self._line(f"if ({self.text(a[0])}) hf_{function.name}({arguments}{outputs});")
        return names[0], ATOM

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
