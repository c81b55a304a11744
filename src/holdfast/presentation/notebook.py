"""What a notebook shows of a definition, of runs and of a set: equations, sets and small figures.

Equations are MathML, which browsers show without a script.
"""

from __future__ import annotations

import base64
import html
import io
from collections.abc import Iterable, Sequence
from functools import singledispatch

import matplotlib.pyplot as plt
import sympy as sp
from matplotlib.figure import Figure
from sympy.printing.mathml import MathMLPresentationPrinter

from holdfast.analysis.reachability.value_function import ValueFunction
from holdfast.analysis.simulation.result import Result
from holdfast.errors import HoldfastError
from holdfast.maths.definitions.law import Law
from holdfast.maths.definitions.quantity import Parameter, Quantity
from holdfast.maths.definitions.region import Region
from holdfast.maths.definitions.switching import Switching
from holdfast.maths.definitions.system import System, bounds_text
from holdfast.maths.definitions.value import Printed, short_text
from holdfast.presentation.figures.paths import paths_figure
from holdfast.presentation.figures.value_function import value_function_figure
from holdfast.presentation.text.runs import summary_text
from holdfast.presentation.text.values import value_text

DOTS_PER_INCH = 90
MOST_OPERATIONS = 50
"""Of what is shown as a formula."""


@singledispatch
def html_of(value: object) -> str:
    """The page of what is shown. Nothing but text where it has no page of its own."""
    return _text(repr(value))


@html_of.register
def _of_printed(value: Printed) -> str:
    """Its first line and then its parts, or its lines where it has none."""
    parts = [p for p in vars(value).values() if isinstance(p, Printed)]
    pages = [_closed(repr(part).splitlines()[0], html_of(part)) for part in dict.fromkeys(parts)]
    return _text(repr(value).splitlines()[0] if pages else repr(value)) + "".join(pages)


@html_of.register
def _of_system(system: System) -> str:
    rates = [
        (_named(q), html.escape(q.unit), _equation(q.name, system.rates[q.name], "\u2032"))
        for q in system.states
    ]
    page = _title(f"System {system.name}", system.description)
    page += _table(("state", "in", "rate"), rates)
    for what, of, bounds in (
        ("inputs", system.inputs, system.input_bounds),
        ("disturbances", system.disturbances, system.disturbance_bounds),
    ):
        if of:
            page += f"<p>{what}: {html.escape(bounds_text(of, bounds))}</p>"
    return page + _parameters(system.parameters)


@html_of.register
def _of_law(law: Law) -> str:
    outputs = [_equation(n, e) for n, e in law.outputs.items()]
    page = _title(f"Law {law.name}", law.description) + "".join(f"<p>{e}</p>" for e in outputs)
    if law.safeguard is not None:
        page += f"<p>kept by {len(law.safeguard.offsets)} conditions (a safety filter)</p>"
    return page + _parameters(law.parameters)


@html_of.register
def _of_switching(law: Switching) -> str:
    page = _title(f"Switching {law.name}", law.description)
    page += f"<p>begins in mode {html.escape(law.initial)}</p>"
    if law.transitions:
        rows = [(html.escape(t.source), html.escape(t.target), _sign(t.when, "\u2265"))
                for t in law.transitions]  # fmt: skip
        page += _table(("from", "to", "as soon as"), rows)
    return page + "".join(_closed(f"mode {n}", html_of(mode)) for n, mode in law.modes.items())


@html_of.register
def _of_region(region: Region) -> str:
    rows = [
        (
            html.escape(c.name),
            _sign(c.expression, "\u2264"),
            html.escape(c.unit),
            html.escape(c.description),
        )
        for c in region.inequalities
    ]
    page = _title(f"Region {region.name}", region.description)
    return (
        page + _table(("inequality", "safe where", "in", ""), rows) + _parameters(region.parameters)
    )


@html_of.register
def _of_result(result: Result) -> str:
    try:
        page = _picture(paths_figure(result), "paths of the runs, by their outcome")
    except HoldfastError:  # it has no plane of x and y
        page = ""
    return page + _text(summary_text(result))


@html_of.register
def _of_value(value: ValueFunction) -> str:
    try:
        page = _picture(value_function_figure(value), "slices of the set")
    except HoldfastError:  # of more states than a figure has
        page = ""
    return page + _text(value_text(value))


def _title(name: str, about: str) -> str:
    return f"<p><b>{html.escape(name)}</b>{': ' * bool(about)}{html.escape(about)}</p>"


def _text(text: str) -> str:
    return f"<pre>{html.escape(text)}</pre>"


def _closed(title: str, page: str) -> str:
    """A part that is opened by a click."""
    return f"<details><summary>{html.escape(title)}</summary>{page}</details>"


def _table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    cell = '<td style="text-align: left; padding-right: 1em">'
    lines = "".join(f"<tr>{''.join(f'{cell}{c}</td>' for c in row)}</tr>" for row in rows)
    titles = "".join(
        f'<th style="text-align: left; padding-right: 1em">{title}</th>' for title in head
    )
    return f"<table><thead><tr>{titles}</tr></thead><tbody>{lines}</tbody></table>"


def _parameters(parameters: Sequence[Parameter]) -> str:
    if not parameters:
        return ""
    rows = [
        (_named(q), f"{q.value:.6g}", html.escape(q.unit), html.escape(q.description))
        for q in parameters
    ]
    title = "1 parameter" if len(rows) == 1 else f"{len(rows)} parameters"
    return _closed(title, _table(("name", "value", "in", ""), rows))


def _picture(figure: Figure, about: str) -> str:
    data = io.BytesIO()
    figure.savefig(data, format="png", dpi=DOTS_PER_INCH)
    plt.close(figure)
    text = base64.b64encode(data.getvalue()).decode()
    return f'<img alt="{about}" src="data:image/png;base64,{text}">'


def _mathml(e: sp.Basic) -> str:
    named = {s: sp.Symbol(html.escape(s.name)) for s in e.free_symbols}
    return str(MathMLPresentationPrinter({"mul_symbol": "dot"}).doprint(e.xreplace(named)))


def _math(inner: str) -> str:
    return f'<math xmlns="http://www.w3.org/1998/Math/MathML">{inner}</math>'


def _named(q: Quantity) -> str:
    return _math(_mathml(q.symbol))


def _formula(left: str, link: str, right: sp.Basic, text: str) -> str:
    """left link right; as its text where it has more operations than are read as a formula."""
    if sp.count_ops(right) > MOST_OPERATIONS:
        return f'<code style="white-space: normal">{html.escape(text)}</code>'
    return _math(f"<mrow>{left}<mo>{link}</mo>{_mathml(right)}</mrow>")


def _equation(name: str, right: sp.Basic, mark: str = "") -> str:
    left = f"{_mathml(sp.Symbol(name))}<mo>{mark}</mo>"
    return _formula(left, "=", right, f"{name}{mark} = {short_text(right)}")


def _sign(e: sp.Basic, link: str) -> str:
    """Where an expression is at most, or at least, 0."""
    if sp.count_ops(e) > MOST_OPERATIONS:
        return _formula("", "", e, f"{short_text(e)} {link} 0")
    return _math(f"<mrow>{_mathml(e)}<mo>{html.escape(link)}</mo><mn>0</mn></mrow>")
