"""Symbolic functions that SymPy lacks or defines differently from what control laws need.

Each has the value, the derivative and the convention at its kink that the laws assume;
`execution/codegen/lowering.py` has the steps of each of them. `FUNCTIONS` are those that a text may
call, of SymPy too. A derivative never differentiates through a jump: the sign and the number of
turns are frozen, as a sampled controller holds them.

| function | value | derivative |
|---|---|---|
| sgn(x) | +1 for x >= 0, else -1 (thesis, after (5.18)) | 0 |
| wrap(x) | x modulo 2 pi in (-pi, pi] | 1 |
| select(x, a, b) | a for x >= 0, else b | the derivative of the branch taken |
| least(a, b), greatest(a, b) | min, max | that of the branch taken |
| magnitude(x) | absolute value | sgn(x) |
| clip(x, lo, hi) | saturation | that of the branch taken |
| angle(y, x, guard) | atan2(y, x), and 0 at the origin | (x dy - y dx) / (x^2 + y^2 + guard) |
| length(x, y, guard) | sqrt(x^2 + y^2) | (x dx + y dy) / sqrt(x^2 + y^2 + guard) |
| wiener(s) | a Wiener process of the intensity s, of a disturbance alone | 0 |
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any

import sympy as sp

from holdfast.arguments import checked


def _number(value: sp.Expr) -> float | None:
    return float(value) if value.is_number and value.is_real else None


class RealFunction(sp.Function):
    """A function that is real wherever its arguments are."""

    def _eval_is_real(self) -> bool:
        return True

    def slope(self, slopes: Sequence[sp.Expr]) -> sp.Expr:
        """The derivative, from those of the arguments."""
        return sp.Add(*(self.fdiff(i + 1) * s for i, s in enumerate(slopes) if s != 0))

    def _eval_derivative(self, s: sp.Symbol) -> sp.Expr:
        return self.slope([a.diff(s) for a in self.args])

    def _latex(self, printer: Any, exp: str | None = None) -> str:
        """The LaTeX of the function; `exp` is an exponent."""
        arguments = [printer._print(a) for a in self.args]
        text = self._formula(*arguments)
        return text if exp is None else f"\\left({text}\\right)^{{{exp}}}"

    def _formula(self, *arguments: str) -> str:
        return f"\\operatorname{{{type(self).__name__}}}\\left({', '.join(arguments)}\\right)"

    @classmethod
    def _numbers(cls, *values: sp.Expr) -> list[float] | None:
        numbers = [_number(v) for v in values]
        return None if any(n is None for n in numbers) else [n for n in numbers if n is not None]


class Frozen(RealFunction):
    """A function that is read where it is computed, such as which corner is nearest: its value is
    that of no formula here, and it is a number when it is differentiated."""

    def fdiff(self, argindex: int = 1) -> sp.Expr:
        return sp.S.Zero


class sgn(RealFunction):
    """Sign with sgn(0) = +1; frozen (derivative 0) when differentiated."""

    nargs = 1

    @classmethod
    def eval(cls, x: sp.Expr) -> Any:
        value = _number(x)
        return None if value is None else sp.Integer(1 if value >= 0 else -1)

    def fdiff(self, argindex: int = 1) -> sp.Expr:
        return sp.S.Zero


_TIME = sp.Symbol("t", real=True)


class Process(RealFunction):
    """A stochastic process as a part of a disturbance, 0 at the start; its arguments are numbers,
    or expressions of parameters.

    A run holds its value for a sample. The processes of each disturbance are its own, and are fixed
    by the seed and the number of the run. What has a process depends on time.
    """

    is_number = False

    @property
    def free_symbols(self) -> set[sp.Basic]:
        return {_TIME}.union(*(a.free_symbols for a in self.args))

    def fdiff(self, argindex: int = 1) -> sp.Expr:
        return sp.S.Zero

    def following(self, value: sp.Expr, h: sp.Expr, normal: sp.Expr) -> sp.Expr:
        """The value a time h [s] later, with a normal number of mean 0 and variance 1."""
        raise NotImplementedError


class wiener(Process):
    """A Wiener process W(t) of the intensity s (Brownian motion, a random walk).

        W(0) = 0,   W(t + h) - W(t) normal with mean 0 and variance s^2 h

    s has the unit of the disturbance per sqrt(s). Source: B. Oksendal, Stochastic Differential
    Equations, 6th ed., 2.2.
    """

    nargs = 1

    def following(self, value: sp.Expr, h: sp.Expr, normal: sp.Expr) -> sp.Expr:
        return value + self.args[0] * sp.sqrt(h) * normal

    @classmethod
    def eval(cls, s: sp.Expr) -> Any:
        return sp.S.Zero if s.is_zero else cls(-s) if s.could_extract_minus_sign() else None


@checked
def wiener_process(intensity: float | sp.Expr) -> sp.Expr:
    """A Wiener process W(t) as a part of a disturbance of `simulate`; "wiener(s)" in a file.

        W(0) = 0,   W(t + h) - W(t) normal with mean 0 and variance intensity^2 h

    intensity: a number, or an expression of parameters, in the unit of the disturbance per sqrt(s).

    A run holds the value for a sample; each disturbance has processes of its own, which the seed
    and the number of the run fix. Source: B. Oksendal, Stochastic Differential Equations, 2.2.

    >>> gust = {"d": hf.wiener_process(0.01)}
    >>> hf.simulate(gusty, brake, starts=starts, disturbance=gust, horizon=2.0)
    <Result of 2 runs: 2 stayed>
    """
    return wiener(sp.sympify(intensity))


class wrap(RealFunction):
    """An angle in radians wrapped to (-pi, pi]; its derivative is 1."""

    nargs = 1

    @classmethod
    def eval(cls, x: sp.Expr) -> Any:
        value = _number(x)
        if value is None:
            return None
        if -math.pi < value <= math.pi:
            return x
        return sp.Float(value - 2 * math.pi * math.ceil((value - math.pi) / (2 * math.pi)))

    def fdiff(self, argindex: int = 1) -> sp.Expr:
        return sp.S.One


class select(RealFunction):
    """select(x, a, b): a where x >= 0, b elsewhere."""

    nargs = 3

    def _formula(self, *arguments: str) -> str:
        x, a, b = arguments
        cases = f"{a} & {x} \\geq 0 \\\\ {b} & \\text{{otherwise}}"
        return f"\\begin{{cases}} {cases} \\end{{cases}}"

    @classmethod
    def eval(cls, x: sp.Expr, a: sp.Expr, b: sp.Expr) -> Any:
        if a == b:
            return a
        value = _number(x)
        return None if value is None else (a if value >= 0 else b)

    def slope(self, slopes: Sequence[sp.Expr]) -> sp.Expr:
        return select(self.args[0], slopes[1], slopes[2])


class least(RealFunction):
    """The smaller of two values."""

    nargs = 2

    def _formula(self, *arguments: str) -> str:
        return f"\\min\\left({', '.join(arguments)}\\right)"

    @classmethod
    def eval(cls, a: sp.Expr, b: sp.Expr) -> Any:
        if a == b:
            return a
        numbers = cls._numbers(a, b)
        return None if numbers is None else (a if numbers[0] <= numbers[1] else b)

    def slope(self, slopes: Sequence[sp.Expr]) -> sp.Expr:
        return select(self.args[1] - self.args[0], *slopes)


class greatest(RealFunction):
    """The larger of two values."""

    nargs = 2

    def _formula(self, *arguments: str) -> str:
        return f"\\max\\left({', '.join(arguments)}\\right)"

    @classmethod
    def eval(cls, a: sp.Expr, b: sp.Expr) -> Any:
        if a == b:
            return a
        numbers = cls._numbers(a, b)
        return None if numbers is None else (a if numbers[0] >= numbers[1] else b)

    def slope(self, slopes: Sequence[sp.Expr]) -> sp.Expr:
        return select(self.args[0] - self.args[1], *slopes)


class angle(RealFunction):
    """atan2(y, x), whose derivative stays bounded at the origin: the removable singularity
    of a direction is guarded here, by `guard` > 0 added to the squared radius, and nowhere
    else (correction E7 of the thesis's 'phi-dot is bounded')."""

    nargs = 3

    def _formula(self, *arguments: str) -> str:
        return f"\\operatorname{{atan2}}\\left({arguments[0]}, {arguments[1]}\\right)"

    @classmethod
    def eval(cls, y: sp.Expr, x: sp.Expr, guard: sp.Expr) -> Any:
        numbers = cls._numbers(y, x, guard)
        return None if numbers is None else sp.Float(math.atan2(numbers[0], numbers[1]))

    def fdiff(self, argindex: int = 1) -> sp.Expr:
        y, x, guard = self.args
        if argindex == 3:
            return sp.S.Zero
        return (x if argindex == 1 else -y) / (x**2 + y**2 + guard)


class length(RealFunction):
    """sqrt(x^2 + y^2), whose derivative is 0 (not 0/0) at the origin."""

    nargs = 3

    def _formula(self, *arguments: str) -> str:
        return f"\\left\\Vert ({arguments[0]}, {arguments[1]}) \\right\\Vert"

    @classmethod
    def eval(cls, x: sp.Expr, y: sp.Expr, guard: sp.Expr) -> Any:
        numbers = cls._numbers(x, y, guard)
        return None if numbers is None else sp.Float(math.hypot(numbers[0], numbers[1]))

    def fdiff(self, argindex: int = 1) -> sp.Expr:
        x, y, guard = self.args
        if argindex == 3:
            return sp.S.Zero
        return (x if argindex == 1 else y) / sp.sqrt(x**2 + y**2 + guard)


class magnitude(RealFunction):
    """|x|, with the derivative sgn(x)."""

    nargs = 1

    def _formula(self, *arguments: str) -> str:
        return f"\\left|{arguments[0]}\\right|"

    @classmethod
    def eval(cls, x: sp.Expr) -> Any:
        value = _number(x)
        if value is not None:
            return x if value >= 0 else -x
        return cls(-x) if x.could_extract_minus_sign() else None

    def fdiff(self, argindex: int = 1) -> sp.Expr:
        return sgn(self.args[0])


def clip(x: sp.Expr, lower: sp.Expr, upper: sp.Expr) -> sp.Expr:
    """Saturation of x to [lower, upper]."""
    return least(greatest(x, lower), upper)


_EPS = sp.Float(1e-12)


def pairwise(function: Callable[..., sp.Expr]) -> Callable[..., sp.Expr]:
    """Extend a function of two arguments to any number of them."""

    def fold(first: sp.Expr, *rest: sp.Expr) -> sp.Expr:
        for value in rest:
            first = function(first, value)
        return first

    return fold


PROCESSES = {p.__name__: p for p in Process.__subclasses__()}
"""Stochastic processes, which a disturbance alone may have."""

FUNCTIONS: dict[str, tuple[int, int, Callable[..., sp.Expr]]] = {
    "sin": (1, 1, sp.sin),
    "cos": (1, 1, sp.cos),
    "tan": (1, 1, sp.tan),
    "asin": (1, 1, sp.asin),
    "acos": (1, 1, sp.acos),
    "atan": (1, 1, sp.atan),
    "sinh": (1, 1, sp.sinh),
    "cosh": (1, 1, sp.cosh),
    "tanh": (1, 1, sp.tanh),
    "exp": (1, 1, sp.exp),
    "log": (1, 1, sp.log),
    "sqrt": (1, 1, sp.sqrt),
    "abs": (1, 1, magnitude),
    "sgn": (1, 1, sgn),
    "wrap": (1, 1, wrap),
    "atan2": (2, 2, lambda y, x: angle(y, x, _EPS)),
    "hypot": (2, 2, lambda x, y: length(x, y, _EPS)),
    "clip": (3, 3, clip),
    "select": (3, 3, select),
    "min": (2, 8, pairwise(least)),
    "max": (2, 8, pairwise(greatest)),
    **{name: (int(max(p.nargs)), int(max(p.nargs)), p) for name, p in PROCESSES.items()},
}
"""Name -> (fewest arguments, most arguments, the function).

`diff(expression, name)`, the partial derivative, is handled apart."""
