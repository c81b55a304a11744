"""A control system, defined once: qdot = f(t, q, u, d; p), with A(q) qdot = b.

Declared with it are measurements (output equations), with laws that know the states only through
them, and a flat output where the chained coordinates are no states.
"""

from __future__ import annotations

import math
import random
import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cache
from typing import Any

import sympy as sp
from sympy.integrals.quadrature import gauss_legendre

from holdfast.arguments import Written, checked, written_by_user
from holdfast.errors import DefinitionError, RenamedWarning
from holdfast.maths.definitions.bounds import Ball, Bounds, Box, LinearImage, Product, section
from holdfast.maths.definitions.law import Law
from holdfast.maths.definitions.quantity import (
    TIME,
    Parameter,
    Quantity,
    alike,
    check_symbols,
    check_unique,
    dimension,
    expression_of,
    frozen,
    has_unit,
    merge_parameters,
    numbers_text,
    symbol,
)
from holdfast.maths.definitions.switching import Switching, Transition
from holdfast.maths.definitions.units import Empirical, Units, are_not_checked, of_another_unit
from holdfast.maths.definitions.value import Printed, Value, short_text
from holdfast.maths.expressions.traversal import derivatives

NODES = 16

FORMER_CURRENT = ("Vx", "Vy")
"""The names by which disturbances were the current before they had roles."""


@checked
@dataclass(frozen=True)
class Antiderivative(Value):
    """A quantity int_0^upper integrand d(variable), which no elementary function is.

    upper: an expression of the states. integrand: of `variable` and parameters. variable: a symbol
    that nothing else is called.

    Its derivative is exact, by the fundamental theorem; its value is by Gauss-Legendre quadrature
    with 16 nodes.

    >>> turned = hf.symbol("turned")
    >>> hf.Antiderivative("arc", 1 / sp.cos(turned), turned, x).slope
    1/cos(x)
    """

    name: str
    integrand: sp.Expr
    variable: sp.Symbol
    upper: sp.Expr

    @property
    def symbol(self) -> sp.Symbol:
        return symbol(self.name)

    @property
    def slope(self) -> sp.Expr:
        """The derivative by the upper limit."""
        return self.integrand.xreplace({self.variable: self.upper})

    @property
    def value(self) -> sp.Expr:
        """The quadrature, as an expression."""
        half = self.upper / 2
        return sp.Mul(
            half,
            sp.Add(
                *(
                    weight * self.integrand.xreplace({self.variable: half * (1 + node)})
                    for node, weight in _nodes()
                )
            ),
        )


@checked
@dataclass(frozen=True)
class FlatOutput(Value):
    """The flat output (z1, zn) of a system, from which its chained coordinates follow.

    first: z1. last: (zk, ..., zn), at least zn; those before it spare the search their
    differentiation, and it refuses them unless they are what differentiation gives. All are zero at
    the origin. antiderivatives: quantities that these expressions name.

    Raises `DefinitionError` without a last coordinate.

    >>> hf.FlatOutput(first=x, last=(hf.symbol("y"),))
    FlatOutput(first=x, last=(y,), antiderivatives=())
    """

    first: Written
    last: tuple[Written, ...]
    antiderivatives: tuple[Antiderivative, ...] = ()

    def __post_init__(self) -> None:
        object.__setattr__(self, "first", expression_of(self.first))
        object.__setattr__(self, "last", tuple(map(expression_of, self.last)))
        if not self.last:
            raise DefinitionError("a flat output has no last coordinate", expected="z1 and zn")


@cache
def _nodes() -> tuple[tuple[sp.Float, sp.Float], ...]:
    nodes, weights = gauss_legendre(NODES, 17)
    return tuple(zip(nodes, weights, strict=True))


@checked
@dataclass(frozen=True)
class Measurement(Quantity):
    """A quantity that is measured: an expression of states and parameters.

    expression: what it is, in `unit`. angle, role: as of a `Quantity`.

    >>> hf.Measurement("range", "m", expression=abs(x)).expression
    magnitude(x)
    """

    expression: Written = sp.S.Zero

    def __post_init__(self) -> None:
        super().__post_init__()
        object.__setattr__(self, "expression", expression_of(self.expression))


def by_measurements(system: System, law: Law | Switching) -> Law | Switching:
    """`law` as a function of the states of `system`: measurements are replaced by expressions.

    A law reads only its `reads`. If these are measurements, the law knows nothing else of the
    states. A law that reads only states is returned unchanged.
    """
    by_name = {m.name: m for m in system.measurements}
    if not any(q.name in by_name for q in law.reads):
        return law
    check_output_units(system, law)
    expressions = {m.symbol: m.expression for m in system.measurements}

    def written_out(mode: Law) -> Law:
        read = [q for q in mode.reads if q.name in by_name]
        used = set().union(*(by_name[q.name].expression.free_symbols for q in read))
        others = [q for q in mode.reads if q.name not in by_name]
        states = [q for q in system.states if q.symbol in used and q not in others]
        return replace(
            mode,
            reads=(*others, *states),
            outputs={n: e.xreplace(expressions) for n, e in mode.outputs.items()},
            signals={n: e.xreplace(expressions) for n, e in mode.signals.items()},
            believed={n: e.xreplace(expressions) for n, e in mode.believed.items()},
            safeguard=mode.safeguard.subs(expressions) if mode.safeguard else None,
            lookup=mode.lookup.subs(expressions) if mode.lookup else None,
            parameters=(*mode.parameters, *(p for p in system.parameters if p.symbol in used)),
        )

    if isinstance(law, Law):
        return written_out(law)
    return replace(
        law.map_laws(written_out, law.name),
        transitions=tuple(
            Transition(t.source, t.target, t.when.xreplace(expressions)) for t in law.transitions
        ),
        signals={n: e.xreplace(expressions) for n, e in law.signals.items()},
    )


@checked
@dataclass(frozen=True)
class PfaffianRow(Value):
    """One constraint on the velocities: sum_i coefficients[i] * qdot_i = rhs.

    coefficients: state -> the factor of its rate; 0 where it is left out. rhs: an expression of
    states, disturbances and parameters.

    Catastatic when rhs is zero (thesis (5.2)); a current or a sway velocity makes it acatastatic
    (5.15).

    >>> robot.pfaffian[0].coefficients["x"]
    -sin(psi)
    """

    coefficients: Mapping[str, Written]
    rhs: Written = sp.S.Zero

    def __post_init__(self) -> None:
        object.__setattr__(self, "coefficients", frozen(self.coefficients))
        object.__setattr__(self, "rhs", expression_of(self.rhs))


def bounds_text(of: Sequence[Quantity], bounds: Bounds | None) -> str:
    """What quantities may be, as text."""
    named = ", ".join(f"{q.name} [{q.unit}]" if q.unit else q.name for q in of)
    match bounds:
        case None:
            return f"{named}, without bounds"
        case Box(lower=lower, upper=upper):
            ends = zip(of, lower, upper, strict=True)
            return ", ".join(
                f"{q.name} in [{short_text(a)}, {short_text(b)}] {q.unit}".rstrip()
                for q, a, b in ends
            )
        case Ball(radius=radius):
            names = ", ".join(q.name for q in of)
            return f"|({names})| <= {short_text(radius)} {of[0].unit}"
        case Product():
            return ", ".join(bounds_text(some, part) for part, some in bounds.split(of))
        case LinearImage(of=inner, actuators=actuators):
            made_by = [Quantity(name, "") for name in actuators]
            return f"{named}, made by {bounds_text(made_by, inner)}"
    return f"{named} in a {type(bounds).__name__}"


@checked
@dataclass(frozen=True, repr=False)
class System(Printed):
    """States q, inputs u, disturbances d, parameters p, rates f and Pfaffian rows.

    states, inputs, disturbances: each a `Quantity`, in the order of all arrays. rates: state -> its
    rate, an expression or text, in the unit of the state per second. parameters: what expressions
    use besides. input_bounds, disturbance_bounds: `Box`, `Ball`, `LinearImage` or `Product`, in the
    order of the inputs and of the disturbances; None for no bounds. pfaffian: constraints on the
    velocities, which the rates keep. samples: the number of points per coordinate that replace the
    bounds in a Hamiltonian without a closed form (0: such a Hamiltonian is refused). measurements:
    output equations, which a law may read in place of the states. promoted: of a reduced model, the
    states of the whole one that are its inputs or disturbances (`promote`). flat_output: from which
    chained coordinates follow, where no pair of states is one. empirical: why units do not count in
    it, such as "a fit to data"; without it they are checked where a user makes the system.

    Raises `DefinitionError` when shapes disagree, a rate uses an undeclared name, the rates leave a
    Pfaffian constraint, or units do not fit.

    >>> slider = hf.System(
    ...     "slider",
    ...     states=(hf.Quantity("x", "m"),),
    ...     inputs=(hf.Quantity("v", "m/s"),),
    ...     rates={"x": hf.symbol("v")},
    ...     input_bounds=hf.Box((-0.5,), (0.5,)),
    ... )
    >>> print(slider)
    System 'slider': 1 state, 1 input
      x' = v
      inputs: v in [-0.5, 0.5] m/s
    """

    name: str
    states: tuple[Quantity, ...]
    inputs: tuple[Quantity, ...]
    rates: Mapping[str, Written]
    parameters: tuple[Parameter, ...] = ()
    disturbances: tuple[Quantity, ...] = ()
    input_bounds: Bounds | None = None
    disturbance_bounds: Bounds | None = None
    pfaffian: tuple[PfaffianRow, ...] = ()
    description: str = ""
    source: str = ""
    samples: int = 0
    measurements: tuple[Measurement, ...] = ()
    promoted: tuple[str, ...] = ()
    flat_output: FlatOutput | None = None
    empirical: Empirical = field(default="", kw_only=True, compare=False)

    def _lines(self) -> tuple[str, list[str], list[str]]:
        counts = [
            f"{len(of)} {what}{'s' * (len(of) != 1)}"
            for of, what in ((self.states, "state"), (self.inputs, "input"),
                             (self.disturbances, "disturbance")) if of
        ]  # fmt: skip
        rates = [f"{n}' = {short_text(e)}" for n, e in self.rates.items()]
        last = [
            f"{what}: {bounds_text(of, bounds)}"
            for what, of, bounds in (("inputs", self.inputs, self.input_bounds),
                                     ("disturbances", self.disturbances, self.disturbance_bounds))
            if of
        ]  # fmt: skip
        last += numbers_text(self.parameters)
        return f"System '{self.name}': {', '.join(counts)}", rates, last

    def __post_init__(self) -> None:
        owner = f"system '{self.name}'"
        object.__setattr__(self, "parameters", merge_parameters(self.parameters))
        quantities = self.states + self.inputs + self.disturbances + self.parameters
        check_unique((q.name for q in quantities + self.measurements), owner)
        if not self.states:
            raise DefinitionError(f"{owner} has no states")
        names = [q.name for q in self.states]
        if set(self.rates) != set(names):
            odd = sorted(set(self.rates) ^ set(names))
            raise DefinitionError(
                f"{owner}: '{odd[0]}' has "
                + ("no rate" if odd[0] in names else "a rate but is not a state"),
                expected="one rate for every state: " + ", ".join(names),
            )
        object.__setattr__(self, "rates", frozen({n: self.rates[n] for n in names}))
        symbols = [q.symbol for q in quantities] + [TIME]
        check_symbols({f"the rate of '{n}'": e for n, e in self.rates.items()}, symbols, owner)
        for what, bounds, members in (
            ("input", self.input_bounds, self.inputs),
            ("disturbance", self.disturbance_bounds, self.disturbances),
        ):
            if bounds is None:
                continue
            if bounds.dimension != len(members):
                raise DefinitionError(
                    f"{owner}: the {what} bounds have dimension {bounds.dimension}",
                    expected=f"{len(members)}, one for each {what}",
                )
            parameter_symbols = {p.symbol for p in self.parameters}
            unknown = sorted(str(s) for s in bounds.free_symbols - parameter_symbols)
            if unknown:
                raise DefinitionError(
                    f"the {what} bounds of {owner} use the undeclared name '{unknown[0]}'",
                    expected="numbers or declared parameters",
                )
        few = isinstance(self.samples, int) and (self.samples < 0 or self.samples == 1)
        if few or isinstance(self.samples, bool) or not isinstance(self.samples, int):
            raise DefinitionError(
                f"samples: {self.samples!r}", expected="a whole number of at least 2, or 0 for none"
            )
        seen = [q.symbol for q in self.states + self.parameters]
        check_symbols({f"'{m.name}'": m.expression for m in self.measurements}, seen, owner)
        if (flat := self.flat_output) is not None:
            integrals = flat.antiderivatives
            check_unique([q.name for q in quantities] + [a.name for a in integrals], owner)
            for e in (flat.first, *flat.last):
                allowed = [*seen, *(a.symbol for a in integrals)]
                check_symbols({"the flat output": e}, allowed, owner)
            for a in integrals:
                check_symbols({f"'{a.name}'": a.slope}, seen, owner)
        for number, row in enumerate(self.pfaffian, start=1):
            self._check_row(number, row, symbols, owner)
        if written_by_user():
            self.check_units()

    def check_units(self) -> None:
        """Refuse expressions whose units do not fit, unless they are `empirical`."""
        if are_not_checked(self.empirical, f"system '{self.name}'"):
            return
        quantities = self.states + self.inputs + self.disturbances + self.parameters
        units = Units(f"system '{self.name}'", quantities)
        for q in self.states:
            wanted = units.per_second(units.kinds[q.symbol])
            units.check(
                self.rates[q.name], f"the rate of '{q.name}'", wanted, "the unit of it per second"
            )
        units.check_set(self.input_bounds, self.inputs, "the input bounds")
        units.check_set(self.disturbance_bounds, self.disturbances, "the disturbance bounds")
        for m in self.measurements:
            what = f"'{m.name}'"
            units.check(m.expression, what, units.written(m.unit, what), "its unit")
        for number, row in enumerate(self.pfaffian, start=1):
            entries = {symbol(n): c for n, c in row.coefficients.items()}
            units.check_row(entries, row.rhs, f"Pfaffian row {number}")
        if self.flat_output is not None:
            for e in (self.flat_output.first, *self.flat_output.last):
                units.of(e, "the flat output")

    def _check_row(
        self, number: int, row: PfaffianRow, symbols: list[sp.Symbol], owner: str
    ) -> None:
        what = f"Pfaffian row {number}"
        unknown = sorted(set(row.coefficients) - set(self.rates))
        if unknown:
            raise DefinitionError(f"{what} of {owner} names '{unknown[0]}', which is not a state")
        check_symbols({what: sp.Add(row.rhs, *row.coefficients.values())}, symbols, owner)
        residual = sum((c * self.rates[n] for n, c in row.coefficients.items()), start=-row.rhs)
        if not vanishes(residual, {p.symbol: sp.Float(p.value) for p in self.parameters}):
            shown = sp.sstr(residual)
            raise DefinitionError(
                f"the rates of {owner} leave {what}: A qdot - b = "
                f"{shown if len(shown) < 200 else shown[:197] + '...'}",
                expected="A qdot = b for every state, input and disturbance",
                remedy="correct the row or the rates",
            )

    @property
    def state_names(self) -> tuple[str, ...]:
        return tuple(q.name for q in self.states)

    @property
    def input_names(self) -> tuple[str, ...]:
        return tuple(q.name for q in self.inputs)

    @property
    def disturbance_names(self) -> tuple[str, ...]:
        return tuple(q.name for q in self.disturbances)

    @property
    def current(self) -> tuple[Quantity, ...]:
        """The disturbances whose role it is to be the current."""
        felt = tuple(q for q in self.disturbances if q.role == "current")
        if felt or not all(n in self.disturbance_names for n in FORMER_CURRENT):
            return felt
        warnings.warn(
            f"{' and '.join(FORMER_CURRENT)} of system '{self.name}' are its current "
            'by their names alone, which goes with the next release: say role="current" of them',
            RenamedWarning,
            stacklevel=2,
        )
        return tuple(q for q in self.disturbances if q.name in FORMER_CURRENT)

    @property
    def largest_current(self) -> sp.Expr | None:
        """The largest speed of the current, of parameters; None without bounds of it alone."""
        current = self.current
        try:
            bounds = section(self.disturbance_bounds, [q in current for q in self.disturbances])
        except DefinitionError:
            return None
        return None if bounds is None else bounds.largest_size()

    def current_along(self, *position: str) -> tuple[Quantity, ...] | None:
        """The component of the current along each of these states.

        It is the one that is added to the rate of the state and to no other of theirs. None where
        a state has no such component.
        """
        along, current = {}, self.current
        for state in position:
            for q in current:
                slopes = {
                    n: sp.expand(self.rates[n].diff(q.symbol)) for n in position if n in self.rates
                }
                if slopes == {n: sp.Integer(n == state) for n in position}:
                    along[state] = q
        return tuple(along[n] for n in position) if len(along) == len(position) else None

    @property
    def actuators(self) -> tuple[str, ...]:
        """Names of the actuators that produce the inputs; empty if the inputs have none."""
        return self.input_bounds.actuators if self.input_bounds else ()

    @property
    def actuator_bounds(self) -> Bounds | None:
        """The limits of the actuators, or of the inputs if there are no actuators."""
        return self.input_bounds.limited if self.input_bounds else None

    def allocated(self, inputs: Sequence[sp.Expr]) -> list[sp.Expr]:
        """The actuator values that produce the inputs, before they are limited."""
        return list(self.input_bounds.allocate(inputs) if self.input_bounds else inputs)

    def limited(self, actuators: Sequence[sp.Expr]) -> list[sp.Expr]:
        """The actuator values after saturation of the requested ones."""
        bounds = self.actuator_bounds
        return list(bounds.saturate(actuators) if bounds else actuators)

    def produced(self, actuators: Sequence[sp.Expr]) -> list[sp.Expr]:
        """The inputs that the actuators produce."""
        return list(self.input_bounds.produce(actuators) if self.input_bounds else actuators)

    def quantities(self, names: tuple[str, ...], owner: str) -> tuple[Quantity, ...]:
        """The states and parameters of these names; `DefinitionError` if one is missing."""
        by_name = {q.name: q for q in self.states + self.parameters}
        for name in names:
            if name not in by_name:
                raise DefinitionError(
                    f"{owner} needs '{name}', which system '{self.name}' does not have"
                )
        return tuple(by_name[name] for name in names)

    @checked
    def derivative(self, expression: sp.Expr) -> sp.Expr:
        """d/dt of an expression of the states along the rates (its Lie derivative)."""
        slopes = derivatives(sp.sympify(expression), [*(q.symbol for q in self.states), TIME])
        moving = ((slopes[q.symbol], self.rates[q.name]) for q in self.states)
        # SymPy asks of 0 * rate whether the rate may be infinite, which takes long
        return sp.Add(slopes[TIME], *(slope * rate for slope, rate in moving if slope != 0))

    @property
    def undisturbed_rates(self) -> dict[str, sp.Expr]:
        """The rates with every disturbance zero: the model of a law that does not know them."""
        still = {d.symbol: 0 for d in self.disturbances}
        return {name: rate.subs(still) for name, rate in self.rates.items()}


def check_outputs(system: System, law: Law | Switching) -> None:
    """Refuse a law whose outputs are not the inputs of the system."""
    outputs, wanted = law.output_names, system.input_names
    if len(outputs) != len(wanted) or set(outputs) != set(wanted):
        raise DefinitionError(
            f"law '{law.name}' gives {', '.join(outputs)}",
            expected=f"the inputs of system '{system.name}': " + ", ".join(wanted),
            remedy="its outputs are velocities: let the inputs track them (track_velocity, or "
            "[tracking] in a scenario)"
            if set(outputs) <= set(system.state_names)
            else "",
        )
    check_output_units(system, law)


def check_output_units(system: System, law: Law | Switching) -> None:
    """Refuse a law whose outputs, or what it reads, have other units than in the system.

    Those of a law whose units were checked; its outputs are inputs, or velocities to track.
    """
    groups = (*system.states, *system.inputs, *system.disturbances, *system.measurements)
    moving = {q.name: q for q in groups}
    for mode in law.modes.values() if isinstance(law, Switching) else (law,):
        if mode.units is None or system.empirical:
            continue
        said = [(q.name, dimension(q.unit), "reads it") for q in mode.reads if has_unit(q)]
        said += [
            (n, unit, f"gives '{short_text(mode.outputs[n])}'") for n, unit in mode.units.items()
        ]
        for name, unit, does in said:
            q = moving.get(name)
            if q is not None and has_unit(q) and not alike(unit, dimension(q.unit)):
                does = f"'{name}' of law '{mode.name}': the law {does}"
                raise of_another_unit(does, unit, q, f"system '{system.name}'")


def check_disturbance_units(
    system: System, disturbance: Mapping[str, sp.Expr], more: Sequence[Quantity] = ()
) -> None:
    """Refuse a disturbance in another unit than its own; `more` may stand in it too."""
    if system.empirical or not disturbance:
        return
    groups = (*more, *system.parameters, *system.states, *system.disturbances)
    by_name = {q.name: q for q in groups}
    units = Units(f"system '{system.name}'", by_name.values())
    for name, e in disturbance.items():
        if name in system.disturbance_names:
            units.check(e, f"the disturbance '{name}'", units.kinds[symbol(name)], "its unit")


def check_rates(law: str, system: System, wanted: Callable[..., System], *arguments: Any) -> None:
    """Refuse a system whose undisturbed rates are not those of `wanted`(*arguments).

    Names must agree too: a law uses the names of the states and inputs it was made for.
    """
    try:
        model = wanted(*arguments)
    except DefinitionError:
        model = wanted()
    same = system.state_names == model.state_names and system.input_names == model.input_names
    if same:
        rates = system.undisturbed_rates
        same = all(sp.expand(rates[n] - r) == 0 for n, r in model.undisturbed_rates.items())
    if not same:
        raise DefinitionError(
            f"law '{law}' is not made for system '{system.name}'",
            expected=f"the states, inputs and rates of '{wanted.__name__}'",
        )


def vanishes(expression: sp.Expr, parameters: Mapping[sp.Symbol, float]) -> bool:
    """Whether an expression is zero, at random points of its symbols and the parameters' values.

    Points where it is not a number are skipped; with too few others it counts as not zero.
    """
    generator = random.Random(0)
    terms = sp.Add.make_args(expression.xreplace(parameters))
    free = sorted(set().union(*(t.free_symbols for t in terms)), key=str)
    tested = 0
    for _ in range(40):
        values = {s: sp.Float(generator.uniform(-1.7, 1.7)) for s in free}
        numbers = [complex(sp.N(term.xreplace(values))) for term in terms]
        if not all(math.isfinite(n.real) and n.imag == 0 for n in numbers):
            continue
        if abs(sum(numbers)) > max(1e-14, 1e-9 * max(abs(n) for n in numbers)):
            return False
        tested += 1
        if tested == 8:
            return True
    return False
