"""The derivation for a system, from the constraint A(q) to the law: `holdfast explain`.

The content is a list of steps, each of sentences and equations; three ways to set it: for the
terminal, as LaTeX, as a Markdown page with formulas.
"""

from __future__ import annotations

import textwrap
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import groupby

from holdfast.arguments import checked
from holdfast.errors import DefinitionError
from holdfast.maths.definitions.system import System
from holdfast.maths.nonholonomic.chained_search import Growth, Search, find_chained_form, growth
from holdfast.maths.nonholonomic.structure import Alignment, Structure, alignment, structure
from holdfast.presentation.text.derivation import (
    Equation,
    Step,
    equations,
    latex,
    latex_name,
    steps,
)


@dataclass(frozen=True)
class Derivation:
    """The derivation from the constraint of one system.

    structure, growth, alignment (or the reason for its absence), search: the results as values;
    steps: the same as readable mathematics.
    """

    title: str
    structure: Structure
    growth: Growth
    alignment: Alignment | str
    search: Search
    steps: tuple[Step, ...]

    def text(self) -> str:
        """The derivation as text for a terminal."""
        lines = [self.title]
        for number, step in enumerate(self.steps, start=1):
            lines += ["", f"{number}. {step.title}", ""]
            for formulas, parts in groupby(step.body, lambda part: isinstance(part, Equation)):
                if formulas:
                    lines += equations((e.left, e.right) for e in parts if isinstance(e, Equation))
                else:
                    lines += [line for part in parts for line in _wrapped(str(part))]
        return "\n".join(lines)

    def latex(self) -> str:
        """A LaTeX document (needs amsmath)."""
        lines = [
            "\\documentclass{article}",
            "\\usepackage[T1]{fontenc}",
            "\\usepackage{amsmath}",
            "\\begin{document}",
            f"\\section*{{{_escaped(self.title)}}}",
        ]
        for step in self.steps:
            lines.append(f"\\subsection*{{{_escaped(step.title)}}}")
            for part in step.body:
                if isinstance(part, str):
                    lines += [_escaped(part), ""]
                else:
                    lines += ["\\begin{equation*}", _formula(part), "\\end{equation*}"]
        return "\n".join([*lines, "\\end{document}"])

    def markdown(self) -> str:
        """A Markdown page whose formulas are set by any viewer that knows $$ (GitHub, mkdocs)."""
        lines = [f"# {self.title}"]
        for number, step in enumerate(self.steps, start=1):
            lines += ["", f"## {number}. {step.title}"]
            for part in step.body:
                shown = (
                    part.replace("*", "\\*") if isinstance(part, str) else f"$$ {_formula(part)} $$"
                )
                lines += ["", shown]
        return "\n".join(lines) + "\n"


def _formula(part: Equation) -> str:
    return f"{_latex_left(part.left)} = {latex(part.right)}"


def _latex_left(name: str) -> str:
    if name.startswith("∂"):
        above, below = name.replace("∂", "").split("/")
        return f"\\frac{{\\partial {latex_name(above)}}}{{\\partial {latex_name(below)}}}"
    return name if not name[0].isalpha() or "(" in name else latex_name(name)


_TEX = {c: f"\\{c}" for c in "_&%#${}"} | {
    "\\": "\\textbackslash{}",
    "^": "\\textasciicircum{}",
    "~": "\\textasciitilde{}",
    "∂": "$\\partial$",
}


def _escaped(text: str) -> str:
    """Escaped text for TeX: a description may come from an untrusted file."""
    return "".join(_TEX.get(c, c) for c in text)


def _wrapped(text: str) -> list[str]:
    return textwrap.wrap(text, 96, initial_indent="  ", subsequent_indent="  ")


@checked
def explain(
    system: System,
    moment: Sequence[float] | None = None,
    *,
    limit: float = 60.0,
    progress: Callable[[float], None] | None = None,
) -> Derivation:
    """Derive the structure of the constraint of `system`, up to its steering law if it has one.

    moment: p, if A leaves a choice. limit [s]: of the search for chained coordinates.

    Raises `DefinitionError` for a system without a constraint, an integrable (holonomic) one, and
    every error of `structure`.

    >>> [step.title for step in hf.explain(robot).steps[:3]]
    ['The constraint', 'Leafwise and transverse states', 'Is it nonholonomic']
    """
    derived = structure(system, moment)
    grown = growth(derived)
    if grown.integrable:
        _refuse_holonomic(system, derived, grown)
    aligned = alignment(derived)
    search = find_chained_form(derived, limit=limit, progress=progress)
    all_steps = steps(system, derived, grown, aligned, search, chosen=moment is not None)
    title = f"{system.name}: {system.description}" if system.description else system.name
    return Derivation(title, derived, grown, aligned, search, all_steps)


def _refuse_holonomic(system: System, derived: Structure, grown: Growth) -> None:
    n, kappa = len(derived.coordinates), derived.matrix.rows
    which = ", ".join(str(i) for i in grown.integrable_rows)
    rows = f" (row {which} on its own)" if which else ""
    raise DefinitionError(
        f"system '{system.name}': {grown.integrable} of its {kappa} constraints can be integrated"
        f"{rows}: brackets of the allowed motions span {grown.vector[-1]} of {n} dimensions",
        expected="nonholonomic constraints",
        remedy="a holonomic constraint keeps the motion on a surface: eliminate a coordinate",
    )
