"""Finite-difference schemes: one file each, with its `SCHEME`; every file here is found by itself.

Sources: S. Osher, C.-W. Shu, SIAM J. Numer. Anal. 28, 1991 (essentially non-oscillatory, ENO);
G.-S. Jiang, D. Peng, SIAM J. Sci. Comput. 21, 2000 (fifth-order weighted, WENO5).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cache
from importlib import import_module
from itertools import pairwise
from pathlib import Path
from pkgutil import iter_modules

from holdfast.execution.arithmetic.steps import Steps, Value, bits, choose, from_bits
from holdfast.execution.codegen.llvm_text import Leaf

MOST_NODES = 6
"""Nodes that a scheme may read."""


@dataclass(frozen=True)
class Scheme:
    """One-sided derivatives along an axis.

    ghosts: nodes that they reach on either side. order: of the Runge-Kutta method that goes with
    them. slopes: of the differences of 2 `ghosts` nodes in a row, the slopes of the middle
    interval, in cells: at its upper end, the left derivative there, and at its lower end, the right
    derivative there. None: both are the plain difference, as at first order.
    """

    name: str
    ghosts: int
    order: int
    slopes: Callable[..., tuple[Value, Value]] | None = None

    @property
    def one_slope(self) -> bool:
        """Whether both ends of an interval have the same slope."""
        return self.slopes is None

    def leaf(self, precision: str, *, plain: bool) -> Leaf:
        """Of rows of nodes n0, n1, ... the slopes at the upper and the lower end of intervals, and
        the plain difference if it is wanted."""
        assert self.slopes is not None
        single = precision == "float32"
        steps = Steps(expanded=True, single=single, fused=True)
        nodes = [steps.input(f"n{i}") for i in range(2 * self.ghosts)]
        differences = [b - a for a, b in pairwise(nodes)]
        results = [*self.slopes(*differences), *differences[self.ghosts - 1 :][: int(plain)]]
        arguments = {f"n{i}": [f"n{i}"] for i in range(MOST_NODES)}
        return Leaf(steps, arguments, results, single=single, algebraic=True)


EXPONENT, OF_INVERSE = 0x7FF << 52, 0x7FE << 52
"""The bits of the exponent of a number in double precision; and the sum of those of 2^k, 2^-k."""


def about_inverse(size: Value) -> Value:
    """Of a positive number: times it, the result is from 1 to 2. It is a power of two in double
    precision, where a division takes as long as ten other operations."""
    if size.steps.single:
        return 1.0 / size
    return from_bits(OF_INVERSE - (bits(size) & EXPONENT))


ALIKE = 1.0 + 1e-6
"""The ratio of two magnitudes up to which they are equal: where they are, and the signs are not, it
is not for rounding to say which of the two is taken."""


def no_larger(a: Value, b: Value) -> Value:
    """Whether the magnitude of the first is that of the second, or smaller."""
    return abs(a) <= ALIKE * abs(b)


def smaller(a: Value, b: Value) -> Value:
    """The one of smaller magnitude."""
    return choose(no_larger(a, b), a, b)


def same_way(slope: Value, plain: Value) -> Value:
    """A slope of higher order, between zero and twice the plain difference.

    Else the nodes on either side of a ridge that lies between them would both rise to a summit
    that no node is at, and so would never learn that it falls.
    """
    twice = 2.0 * plain
    low, high = choose(twice < 0.0, twice, 0.0), choose(twice > 0.0, twice, 0.0)
    above = choose(slope < low, low, slope)
    return choose(above > high, high, above)


@cache
def schemes() -> Mapping[str, Scheme]:
    """Every scheme by its name, the one with the fewest ghosts first."""
    names = [m.name for m in iter_modules([str(Path(__file__).parent)])]
    all_schemes: list[Scheme] = [import_module(f"{__name__}.{name}").SCHEME for name in names]
    return {s.name: s for s in sorted(all_schemes, key=lambda s: (s.ghosts, s.name))}
