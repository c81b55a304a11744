"""Switching laws (hybrid automata): several laws and the guarded transitions between them.

A controller may have a memory: a state in discrete time, from one sample to the next, as in an
observer.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace

from holdfast.arguments import Written, checked, written_by_user
from holdfast.errors import DefinitionError, check_name
from holdfast.maths.definitions.law import GainCondition, Law, Lookup
from holdfast.maths.definitions.quantity import (
    SAMPLE_TIME,
    TIME,
    TIME_IN_MODE,
    Parameter,
    Quantity,
    check_symbols,
    check_unique,
    expression_of,
    frozen,
    merge_parameters,
)
from holdfast.maths.definitions.units import Empirical, Units, are_not_checked
from holdfast.maths.definitions.value import InOrder, Printed, Value, short_text


@checked
@dataclass(frozen=True)
class Memory(Value):
    """z(0) = initial(q), z(k+1) = following(q(k), z(k), u(k)) for the quantities z.

    quantities: z, with names and units. initial, following: name -> its expression. reads: q,
    measured quantities. parameters: what the expressions use besides. inputs: those of the system,
    the command to the actuators at sample k, saturated at the limits that the controller knows;
    `following` may also use `SAMPLE_TIME`.

    Raises `DefinitionError` for a value of a name that is not remembered, or none of one that is.

    >>> travelled = hf.Quantity("travelled", "m")
    >>> after = {"travelled": hf.symbol("travelled") + abs(v) * hf.SAMPLE_TIME}
    >>> hf.Memory((travelled,), {"travelled": 0}, after, reads=cart.states).following
    {'travelled': sample_time*magnitude(v) + travelled}
    """

    quantities: tuple[Quantity, ...]
    initial: Mapping[str, Written]
    following: Mapping[str, Written]
    reads: tuple[Quantity, ...]
    inputs: tuple[Quantity, ...] = ()
    parameters: tuple[Parameter, ...] = ()

    def __post_init__(self) -> None:
        object.__setattr__(self, "parameters", merge_parameters(self.parameters))
        object.__setattr__(self, "initial", frozen(self.initial))
        object.__setattr__(self, "following", frozen(self.following))
        names = {q.name for q in self.quantities}
        everything = (*self.quantities, *self.reads, *self.inputs, *self.parameters)
        check_unique((q.name for q in everything), "the memory")
        for what, table in (("first", self.initial), ("following", self.following)):
            if set(table) != names:
                odd = min(names ^ set(table))
                raise DefinitionError(
                    f"'{odd}' " + (f"has no {what} value" if odd in names else "is not remembered")
                )
        at_start = [q.symbol for q in (*self.reads, *self.parameters)]
        check_symbols(
            {f"first value of '{n}'": e for n, e in self.initial.items()}, at_start, "the memory"
        )
        later = [q.symbol for q in (*self.quantities, *self.inputs)]
        check_symbols(
            {f"following value of '{n}'": e for n, e in self.following.items()},
            [*at_start, *later, TIME, SAMPLE_TIME],
            "the memory",
        )


def joined(one: Memory | None, other: Memory) -> Memory:
    """Both memories of a controller; `DefinitionError` where they remember the same name."""
    if one is None:
        return other
    reads = {q.name: q for q in (*one.reads, *other.reads)}
    inputs = {q.name: q for q in (*one.inputs, *other.inputs)}
    return Memory(
        quantities=(*one.quantities, *other.quantities),
        initial={**one.initial, **other.initial},
        following={**one.following, **other.following},
        reads=tuple(reads.values()),
        inputs=tuple(inputs.values()),
        parameters=(*one.parameters, *other.parameters),
    )


@checked
@dataclass(frozen=True)
class Transition(Value):
    """source -> target as soon as `when` >= 0.

    source, target: names of modes. when: an expression of what the laws read.

    Hysteresis is a pair of transitions whose expressions are offset against each other; a minimum
    dwell is a guard that contains `TIME_IN_MODE`.

    >>> hf.Transition("coast", "brake", abs(x) - 0.5).when
    magnitude(x) - 0.5
    """

    source: str
    target: str
    when: Written

    def __post_init__(self) -> None:
        object.__setattr__(self, "when", expression_of(self.when))


@checked
@dataclass(frozen=True, repr=False)
class Switching(Printed):
    """Modes (each a `Law` with the same outputs), guarded transitions and the first mode.

    At every control sample the transitions out of the current mode are tried in the order written.
    The first whose guard holds is taken, at most one per sample, before the law is evaluated.

    modes: name -> its law; in this order they have their numbers, so that another order is another
    switching. transitions: each a `Transition`. initial: the name of the first mode.
    signals: named expressions that are recorded in every mode. extra_parameters: what transitions
    and signals use besides those of the laws. memory: the discrete-time state of the controller;
    every mode may read it. empirical: why units do not count in its guards, signals and memory;
    without it they are checked where a user makes the switching.

    Raises `DefinitionError` without modes, for modes with different outputs, and for a transition
    from or to no mode.

    >>> coast = hf.Law("coast", cart.states, {"a": 0})
    >>> near_end = hf.Transition("coast", "brake", abs(x) - 0.5)
    >>> print(hf.Switching("late", {"coast": coast, "brake": brake}, (near_end,), "coast"))
    Switching 'late', from 'coast': coast, brake
      coast -> brake as soon as abs(x) - 0.5 >= 0
    """

    name: str
    modes: Mapping[str, Law]
    transitions: tuple[Transition, ...] = ()
    initial: str = ""
    signals: Mapping[str, Written] = field(default_factory=dict)
    extra_parameters: tuple[Parameter, ...] = ()
    memory: Memory | None = None
    description: str = ""
    source: str = ""
    empirical: Empirical = field(default="", kw_only=True, compare=False)

    def _lines(self) -> tuple[str, list[str], list[str]]:
        turns = [f"{t.source} -> {t.target} as soon as {short_text(t.when)} >= 0"
                 for t in self.transitions]  # fmt: skip
        modes = ", ".join(self.modes)
        last = []
        if self.memory is not None:
            last = [f"remembers {', '.join(q.name for q in self.memory.quantities)}"]
        return f"Switching '{self.name}', from '{self.initial}': {modes}", turns, last

    def __post_init__(self) -> None:
        owner = f"switching '{self.name}'"
        if not self.modes:
            raise DefinitionError(f"{owner} has no modes")
        object.__setattr__(self, "initial", self.initial or next(iter(self.modes)))
        object.__setattr__(self, "signals", frozen(self.signals))
        object.__setattr__(self, "modes", InOrder(self.modes))
        outputs = next(iter(self.modes.values())).output_names
        for name, law in self.modes.items():
            if set(law.output_names) != set(outputs):
                raise DefinitionError(
                    f"mode '{name}' of {owner} gives {', '.join(law.output_names)}",
                    expected="the same outputs in every mode: " + ", ".join(outputs),
                )
        ends = [self.initial]
        for transition in self.transitions:
            ends += [transition.source, transition.target]
        for end in ends:
            check_name(end, self.modes, DefinitionError, f"{owner} names the unknown mode '{end}'")
        allowed = [q.symbol for q in self.reads + self.handed + self.parameters] + [TIME]
        check_symbols(
            {f"guard {t.source} -> {t.target}": t.when for t in self.transitions},
            [*allowed, TIME_IN_MODE],
            owner,
        )
        allowed += self.lookup.symbols if self.lookup else ()  # not for guards
        check_symbols({f"signal '{k}'": e for k, e in self.signals.items()}, allowed, owner)
        if written_by_user():
            self.check_units()

    def check_units(self) -> None:
        """Refuse guards, signals and a memory whose units do not fit, unless they are `empirical`.

        The laws of its modes are checked by themselves.
        """
        if are_not_checked(self.empirical, f"switching '{self.name}'"):
            return
        owner = f"switching '{self.name}'"
        units = Units(owner, self.reads + self.handed + self.parameters)
        for t in self.transitions:
            units.check_level(t.when, f"guard {t.source} -> {t.target}")
        for name, e in self.signals.items():
            units.of(e, f"signal '{name}'")
        if (memory := self.memory) is not None:
            held = memory.quantities + memory.reads + memory.inputs + memory.parameters
            units = Units(f"the memory of {owner}", held)
            for q in memory.quantities:
                for when, of in (("first", memory.initial), ("following", memory.following)):
                    what = f"{when} value of '{q.name}'"
                    units.check(of[q.name], what, units.kinds[q.symbol], "its unit")

    @property
    def output_names(self) -> tuple[str, ...]:
        return next(iter(self.modes.values())).output_names

    @property
    def reads(self) -> tuple[Quantity, ...]:
        merged = {q.name: q for law in self.modes.values() for q in law.reads}
        return tuple(merged.values())

    @property
    def handed(self) -> tuple[Quantity, ...]:
        merged = {q.name: q for law in self.modes.values() for q in law.handed}
        return tuple(merged.values())

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        groups = [law.parameters for law in self.modes.values()]
        remembering = self.memory.parameters if self.memory else ()
        return merge_parameters(*groups, self.extra_parameters, remembering)

    @property
    def lookup(self) -> Lookup | None:
        """The lookup table that its laws use, the same for all of them."""
        lookups = [law.lookup for law in self.modes.values() if law.lookup is not None]
        if any(other != lookups[0] or other.table is not lookups[0].table for other in lookups):
            raise DefinitionError(f"the modes of '{self.name}' look up different functions")
        return lookups[0] if lookups else None

    @property
    def conditions(self) -> tuple[GainCondition, ...]:
        distinct = {c: None for law in self.modes.values() for c in law.conditions}
        return tuple(distinct)

    def map_laws(self, change: Callable[[Law], Law], name: str) -> Switching:
        """The same modes and guards with every law replaced by change(law)."""
        modes = {mode: change(law) for mode, law in self.modes.items()}
        return replace(self, name=name, modes=modes)


def as_switching(law: Law | Switching) -> Switching:
    """A single law as a switching that never switches."""
    if isinstance(law, Switching):
        return law
    return Switching(
        name=law.name,
        modes={law.name: law},
        signals=law.signals,
        description=law.description,
        source=law.source,
    )
