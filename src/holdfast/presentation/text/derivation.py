"""The steps of a derivation as sentences and equations.

Expressions are readable mathematics: for the terminal and as LaTeX.
"""

from __future__ import annotations

import re
import textwrap
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import sympy as sp
from sympy.printing.latex import LatexPrinter, translate
from sympy.printing.pretty.pretty import PrettyPrinter
from sympy.printing.pretty.pretty_symbology import greek_unicode
from sympy.printing.pretty.stringpict import prettyForm

from holdfast.maths.catalogue import laws
from holdfast.maths.catalogue.signature import is_made_for
from holdfast.maths.definitions.quantity import Quantity, symbol
from holdfast.maths.definitions.system import System
from holdfast.maths.nonholonomic.chained_feedback import (
    POLE,
    can_stop,
    chained_feedback,
    closed_loop_matrix,
    gains_for_poles,
)
from holdfast.maths.nonholonomic.chained_search import ChainedForm, Growth, Search
from holdfast.maths.nonholonomic.structure import (
    Alignment,
    Structure,
    inputs_at_rest,
    own_inputs,
    relative_degrees,
)

WIDTH = 100


def equations(
    pairs: Iterable[tuple[str, sp.Expr]], relation: str = "=", taken: Iterable[str] = ()
) -> list[str]:
    """Equations set in two dimensions; long ones are split by naming their parts.

    taken: names that mean something else beside these equations.
    """
    by_name = dict(pairs)
    used = {str(s) for e in by_name.values() for s in e.free_symbols} | {*by_name, *taken}
    free = (s for s in sp.numbered_symbols("s", start=1) if s.name not in used)
    if max(width(e) for e in by_name.values()) > WIDTH:
        shared, reduced = sp.cse(list(by_name.values()), symbols=free, order="none")
        by_name = {str(s): e for s, e in shared} | dict(zip(by_name, reduced, strict=True))
    lines = []
    for left, expression in by_name.items():
        rows = pretty(expression)
        middle = len(rows) // 2
        if max(len(row) for row in rows) > WIDTH:
            rows = textwrap.wrap(sp.sstr(expression), WIDTH, break_long_words=False)
            middle = 0
        head = f"    {left} {relation} "
        lines += [
            (head if i == middle else " " * len(head)) + row.rstrip() for i, row in enumerate(rows)
        ]
    return lines


class _Printer(PrettyPrinter):
    """Names and functions as in a scenario file, except for Greek letters."""

    def _print_Symbol(self, e: sp.Symbol) -> prettyForm:  # noqa: N802
        return prettyForm(greek_unicode.get(e.name, e.name))

    def _print_angle(self, e: sp.Expr) -> prettyForm:
        return self._call("atan2", *e.args[:2])

    def _print_length(self, e: sp.Expr) -> prettyForm:
        return self._call("hypot", *e.args[:2])

    def _print_magnitude(self, e: sp.Expr) -> prettyForm:
        return self._call("abs", *e.args)

    def _print_least(self, e: sp.Expr) -> prettyForm:
        return self._call("min", *e.args)

    def _print_greatest(self, e: sp.Expr) -> prettyForm:
        return self._call("max", *e.args)

    def _call(self, name: str, *arguments: sp.Expr) -> prettyForm:
        return self._print_Function(sp.Function(name)(*arguments))


def pretty(expression: sp.Expr) -> list[str]:
    text: str = _Printer({"use_unicode": True, "wrap_line": False}).doprint(expression)
    return text.splitlines()


def width(expression: sp.Expr) -> int:
    return max(len(row) for row in pretty(expression))


class _Latex(LatexPrinter):
    """Greek letters, subscripts, and whole words upright."""

    def _print_Symbol(self, e: sp.Symbol, style: str = "plain") -> str:  # noqa: N802
        return latex_name(e.name)


def latex(expression: sp.Basic) -> str:
    """The expression as LaTeX."""
    text: str = _Latex({"mat_delim": "(", "fold_short_frac": False, "mul_symbol": r" \, "}).doprint(
        expression
    )
    return text


def latex_name(name: str) -> str:
    """A name as LaTeX: psi0 -> \\psi_{0}, tau_u -> \\tau_{u}, threshold upright."""
    head, _, tail = name.partition("_")
    if not tail and (numbered := re.fullmatch(r"([A-Za-z]+?)(\d+)", name)):
        head, tail = numbered.groups()
    shown = "\\lambda" if head == "lam" else translate(head)
    if len(head) > 1 and not shown.startswith("\\"):
        shown = f"\\mathrm{{{head}}}"
    if not tail:
        return shown
    if len(tail) > 1 and not tail.isdigit():
        words = tail.replace("_", "\\ ")
        tail = f"\\mathrm{{{words}}}"
    return f"{shown}_{{{tail}}}"


@dataclass(frozen=True)
class Equation:
    """left = right."""

    left: str
    right: sp.Basic


@dataclass(frozen=True)
class Step:
    """One step of a derivation: a title, then sentences and equations in order."""

    title: str
    body: tuple[str | Equation, ...]


def steps(
    system: System,
    structure: Structure,
    grown: Growth,
    aligned: Alignment | str,
    search: Search,
    *,
    chosen: bool,
) -> tuple[Step, ...]:
    """The whole derivation; `chosen` says whether the moment p was given."""
    return (
        _constraint(system, structure),
        _states(structure),
        _nonholonomy(structure, grown),
        _equilibria(structure),
        _field(structure, chosen=chosen),
        _output(structure),
        _following(system, structure, aligned),
        _chain(structure, search),
        _verdict(system, structure, aligned, search),
    )


def _names(quantities: Sequence[Quantity]) -> str:
    return ", ".join(q.name for q in quantities) or "none"


def _constraint(system: System, structure: Structure) -> Step:
    kappa, n = structure.matrix.shape
    origin = "as declared" if system.pfaffian else "derived, annihilates the input directions"
    body: list[str | Equation] = [
        f"Coordinates q: {_names(structure.coordinates)}; {kappa} constraint{'s' * (kappa > 1)} "
        f"A(q) q' = b(q), {origin}.",
        Equation("A", structure.matrix),
    ]
    if not structure.catastatic:
        body.append(Equation("b", sp.Matrix(structure.rhs)))
    whose = (
        "The inputs move the system along" if structure.kinematic else "The motions it allows are"
    )
    body.append(f"{whose} {n - kappa} directions:")
    named = zip(structure.direction_names, structure.directions, strict=True)
    body += [Equation(f"g_{n}", _row(g)) for n, g in named]
    return Step("The constraint", tuple(body))


def _row(vector: sp.ImmutableMatrix) -> sp.Basic:
    """A vector in one line if it is short enough."""
    return sp.Tuple(*vector) if sp.count_ops(vector) < 20 else vector


def _states(structure: Structure) -> Step:
    zero = _names(structure.transverse)
    return Step(
        "Leafwise and transverse states",
        (
            f"Zero columns of A belong to the transverse states: {zero}. The others are the "
            f"leafwise states x: {_names(structure.leaf)}. The reference field has dimension "
            f"N = {len(structure.leaf)}.",
        ),
    )


def _nonholonomy(structure: Structure, grown: Growth) -> Step:
    n = len(structure.coordinates)
    least = "" if grown.origin == n else "at least "
    body: list[str | Equation] = [
        "Brackets of the allowed motions, order by order, span "
        + ", ".join(map(str, grown.vector))
        + f" of {n} dimensions (at the origin {least}{grown.origin})."
    ]
    for number, (name, g) in enumerate(grown.brackets, start=1):
        if number > 3 or sp.count_ops(g) > 60:
            rest = ", ".join(b for b, _ in grown.brackets[number - 1 :])
            body.append(f"Further directions: {rest}.")
            break
        body += [
            f"{name}, direction {len(structure.directions) + number}:",
            Equation(f"b_{number}", _row(g)),
        ]
    body.append(
        "They span everything: the distribution ker A is not involutive, no combination of the "
        "constraints can be integrated, and every state can be reached from every other."
        if not any(structure.drift) and structure.catastatic
        else "They span everything: ker A is not involutive and no combination of the "
        "constraints can be integrated."
    )
    return Step("Is it nonholonomic", tuple(body))


def _equilibria(structure: Structure) -> Step:
    if structure.catastatic and not any(structure.drift):
        return Step(
            "Catastatic or acatastatic",
            ("Catastatic: b = 0. With its inputs at zero the system rests in every state.",),
        )
    body: list[str | Equation] = []
    if structure.catastatic:
        body.append("Catastatic: b = 0; but the system drifts with its inputs at zero.")
    else:
        body.append("Acatastatic: q' = 0 asks for b(q) = 0, that is, rest is possible only where")
        body += [Equation("0", b) for b in structure.rhs if b != 0]
    if structure.kinematic:
        held = inputs_at_rest(structure)
        body.append("and it rests there under the inputs")
        body += [Equation(u.name, e) for u, e in zip(structure.inputs, held, strict=True)]
    return Step("Catastatic or acatastatic; equilibria", tuple(body))


def _field(structure: Structure, *, chosen: bool) -> Step:
    names = _names(structure.leaf)
    dimension = len(structure.admissible)
    body: list[str | Equation] = ["The moment p has to satisfy A(0) p = 0, with"]
    body.append(
        Equation("A(0)", structure.leaf_matrix.subs({q.symbol: 0 for q in structure.coordinates}))
    )
    p = sp.Tuple(*structure.moment)
    if dimension == 1:
        body.append(f"which leaves one direction in ({names}):")
    elif chosen:
        body.append(f"which leaves {dimension} dimensions in ({names}); p is the one given:")
    else:
        body.append(
            f"which leaves {dimension} dimensions in ({names}). The designer chooses p; "
            "here it is the first basis vector (choose with --moment):"
        )
    body += [
        Equation("p", p),
        "The reference field F = lam (p . x) x - p |x|^2 is then",
        Equation("F", sp.Matrix(structure.field)),
        f"Its only zero, for lam > 1, is x = 0: the law is singular on ({names}) = 0, for every "
        f"value of the transverse states ({_names(structure.transverse)}), "
        "and has to treat it apart. "
        + (
            "It is a rose: two elliptic sectors, index 2; every flow line but the two on the p "
            "axis leaves and enters along p."
            if len(structure.leaf) == 2
            else "In every plane through p it is a rose (two elliptic sectors, index 2); the "
            f"index on the sphere around it says nothing in {len(structure.leaf)} dimensions."
        ),
    ]
    return Step("The reference field", tuple(body))


def _output(structure: Structure) -> Step:
    body: list[str | Equation] = ["The output to bring to zero is h = A F:"]
    body += [Equation(f"h_{i}", h) for i, h in enumerate(structure.output, start=1)]
    sampler = structure.sampler()
    at = sampler.generic_point(structure.symbols, [*structure.output_rate], "dh/dt")
    rank_found = sampler.rank(structure.output_rate.tolist(), at)
    body.append(
        f"dh/dt per unit of the {len(structure.directions)} motions has rank {rank_found} for "
        f"{len(structure.output)} output{'s' * (len(structure.output) > 1)}."
    )
    for t in structure.transverse:
        degrees = ", ".join(
            f"h_{i}: {d if d else 'none'}"
            for i, d in enumerate(relative_degrees(structure, t), start=1)
        )
        body.append(f"Relative degree with respect to the rate of {t.name}: {degrees}.")
    return Step("The output", tuple(body))


def _following(system: System, structure: Structure, aligned: Alignment | str) -> Step:
    title = "Steering along the field"
    if isinstance(aligned, str):
        return Step(title, (f"Not derived: {aligned}.",))
    t = structure.transverse[0]
    body: list[str | Equation] = [
        "Derived. The motion on the leaf is along g, the kernel of A by its signed minors, with "
        "p . g(0) > 0:",
        Equation("g", _row(aligned.direction)),
        "The misalignment s = atan2(g x F, g . F) is turned by the transverse state at",
        Equation(f"∂s/∂{t.name}", aligned.slope),
        "so that, with",
        Equation("s", aligned.error),
        "the law is: along g at the speed motion_along = -k1 sgn(g . x) |x| / |g|, and "
        f"{t.name} at the rate motion_across = (-k s - (ds/dx . g) motion_along) / (ds/d{t.name}), "
        "hence s' = -k s. In the inputs of the system:",
    ]
    body += [Equation(n, e) for n, e in own_inputs(system, structure, aligned).items()]
    body.append(
        "g can point every way, so the law is global but for x = 0."
        if aligned.everywhere
        else "g cannot turn round: s is known up to half a turn only, and the law is local."
        if aligned.regular
        else f"The law is local: it divides by ∂s/∂{t.name}, which does not keep its sign."
    )
    return Step(title, tuple(body))


def _chain(structure: Structure, search: Search) -> Step:
    title = "Steering by chained coordinates"
    if search.found is None:
        tried = f" ({search.tried} of {search.pairs} pairs tried)" if search.pairs else ""
        return Step(title, (f"Not derived: {search.reason}{tried}.",))
    form = search.found
    n = len(form.coordinates)
    zs, vs, ks = (_unused(c, structure) for c in (("z", "zeta"), ("v", "nu"), ("k", "kappa")))
    z = [symbol(f"{zs}{i}") for i in range(1, n + 1)]
    v1, v2 = symbol(f"{vs}1"), symbol(f"{vs}2")
    k1, *gains = (symbol(f"{ks}{i}") for i in range(1, n + 1))
    values = gains_for_poles(1.0, [POLE] * (n - 1))
    placed = ", ".join(f"{k} = {v:g}" for k, v in zip(gains, values, strict=True))
    between = f"{zs}3/{zs}1, ..., " if n > 3 else ""
    ratios = f"({zs}2, {between}{zs}{n}/{zs}1{f'^{n - 2}' if n > 3 else ''})"
    tried = f"{search.tried} of {search.pairs} pairs tried"
    body: list[str | Equation] = [
        f"Derived ({tried}): with {zs}1 and {zs}{n} two of the states and the others by "
        "differentiation,"
        if search.pairs
        else f"Derived from the flat output ({zs}1, {zs}{n}) that the system declares: with",
        *(
            Equation(a.name, sp.Integral(a.integrand, (a.variable, 0, a.upper)))
            for a in form.antiderivatives
        ),
        *(_bounded(str(s), e) for s, e in zip(z, form.coordinates, strict=True)),
        f"the system is the chained form {zs}1' = {vs}1, {zs}2' = {vs}2, {zs}j' = {zs}(j-1) {vs}1. "
        "There the law",
        Equation(str(v1), -k1 * z[0]),
        Equation(str(v2), chained_feedback(z, gains)),
        f"makes y = {ratios} obey y' = M y exactly, with constant",
        Equation("M", closed_loop_matrix(k1, gains)),
        f"whose {n - 1} poles may be placed anywhere in the left half-plane: with {k1} = 1 1/s and "
        f"all of them at {POLE:g} 1/s, {placed}. In the inputs of the system:",
        *(
            _bounded(u.name, a * v1 + b * v2)
            for u, (a, b) in zip(structure.inputs, form.coefficients, strict=True)
        ),
        _domain(form),
        f"From {zs}1 = 0, where it divides by zero, the law escapes first, at a speed and for a "
        "time that are the designer's choice.",
    ]
    return Step(title, tuple(body))


def _unused(choices: tuple[str, str], structure: Structure) -> str:
    """The first letter that, with a number, names no quantity of the system."""
    names = {
        str(s)
        for s in structure.matrix.free_symbols.union(
            *(g.free_symbols for g in structure.directions)
        )
    }
    names |= {q.name for q in (*structure.coordinates, *structure.inputs, *structure.parameters)}
    taken = any(re.fullmatch(choices[0] + r"\d+", name) for name in names)
    return choices[1] if taken else choices[0]


def _domain(form: ChainedForm) -> str:
    if not form.divisors and not form.positive:
        return "The transformation is regular everywhere."
    needs = []
    for what, expressions in (("nonzero", form.divisors), ("positive", form.positive)):
        shown = dict.fromkeys(
            str(e) if len(str(e)) < 60 else "other divisors of the inputs" for e in expressions
        )
        if shown:
            needs.append(f"{what} {', '.join(shown)}")
    return f"The law is local: it needs {'; and '.join(needs)}."


_SHOWN_OPERATIONS = 250


def _bounded(name: str, expression: sp.Expr) -> str | Equation:
    size = sp.count_ops(expression)
    if size > _SHOWN_OPERATIONS:
        return f"{name}: an expression of {size} operations, used by the law and not shown."
    return Equation(name, expression)


def _verdict(
    system: System, structure: Structure, aligned: Alignment | str, search: Search
) -> Step:
    derived = not isinstance(aligned, str)
    body: list[str | Equation] = []
    if isinstance(aligned, Alignment) and aligned.everywhere:
        body.append("Use the law `follow_field`: it is global.")
    elif search.found is not None:
        body.append(
            "Use the law `steer_by_chained_form`."
            if can_stop(system)
            else "No law is made of chained coordinates: the bounds of the inputs leave no rest."
        )
    elif derived:
        body.append("Use the law `follow_field`, from starts near the p axis.")
    else:
        body.append("No law is derived; the reasons are in the two steps before.")
    derivable = (laws.follow_field, laws.steer_by_chained_form)
    others = (f for f in laws.ALL if f not in derivable)
    made = [f.__name__ for f in others if is_made_for(f, system)]
    if made:
        body.append(f"Laws of the catalogue that are made for this system: {', '.join(made)}.")
    left = ["gains, and when to stop near the origin"]
    if len(structure.admissible) > 1:
        left.insert(0, "p")
    body.append(f"Left to the designer: {'; '.join(left)}.")
    return Step("What to use", tuple(body))
