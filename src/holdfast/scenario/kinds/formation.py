"""A leader and its followers among walls: planned, simulated, drawn on a map."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from holdfast.analysis.simulation.result import Result
from holdfast.errors import ScenarioError
from holdfast.maths.definitions.variation import Varied
from holdfast.scenario.build.closed_loop import settings_of
from holdfast.scenario.kinds.base import Bar, Composed, Kind
from holdfast.scenario.kinds.closed_loop import Scenario, about, seeded
from holdfast.scenario.schema.closed_loop import FormationFigures, FormationSpec
from holdfast.scenario.schema.values import validated

if TYPE_CHECKING:
    from holdfast.analysis.simulation.law_comparison import Entry
    from holdfast.planning.corners import Course
    from holdfast.presentation.figures.formation import Ground


@dataclass(frozen=True, eq=False, repr=False)
class FormationScenario(Scenario):
    """A closed loop of robots on a course, which has one start."""

    course: Course = field(kw_only=True)

    @property
    def independent_runs(self) -> int:
        return 0

    def tally(self, part: range | None, threads: int) -> dict[str, Entry]:
        from holdfast.analysis.simulation.law_comparison import tally_of

        return tally_of(self.with_settings(threads=threads).run())

    @property
    def ground(self) -> Ground:
        """The background of its map."""
        from holdfast.presentation.figures.formation import Ground

        cells = [c.corners for c in self.course.environment.cells]
        return Ground(cells, self.course.arrows(), self.course.goal)

    def interactive(self, answer: Result) -> dict[str, Any] | None:
        from holdfast.presentation.html.interactive import robots_data

        return robots_data(answer, self.ground)

    def drawn(self, answer: Result, folder: Path, bar: Bar | None) -> list[Path]:
        """The map, the constraints, and the animation where it is asked for."""
        from holdfast.presentation.figures import style
        from holdfast.presentation.figures.formation import (
            constraints_figure,
            formation_figure,
            write_animation,
        )

        chosen, ground = self.figures, self.ground
        assert isinstance(chosen, FormationFigures)
        files = style.write(formation_figure(answer, ground, chosen.cones), folder, "map")
        files += style.write(constraints_figure(answer), folder, "constraints")
        if not chosen.animate:
            return files
        place, what = folder / "animation.gif", f"{self.name}, animation"
        if bar is None:
            return [*files, write_animation(answer, ground, place, chosen.animate)]
        with bar(what) as tell:
            made = write_animation(
                answer, ground, place, chosen.animate, progress=lambda done: tell(what, done)
            )
        return [*files, made]


def _compose(
    file: str, text: str, data: Mapping[str, Any], runs: int | None, seed: int | None
) -> Composed:
    if runs is not None:
        raise ScenarioError(f"--runs: {file} has one start", remedy="leave it out")
    text, data = seeded(text, dict(data), seed)
    spec = validated(FormationSpec, data, file)
    from holdfast.scenario.build.formation import composed_formation  # with geometry and graphs

    parts = composed_formation(file, spec)
    units = {q.name: q.unit for q in parts.system.states}
    return FormationScenario(
        **about(file, text, spec.scenario),
        system=parts.system,
        model=parts.system,
        law=parts.law,
        region=parts.region,
        goal=parts.goal,
        starts=parts.starts,
        settings=settings_of(spec, units, file),
        disturbance={},
        plant={},
        varied=Varied(),
        reference={},
        plane=("xL", "yL"),
        figures=spec.figures,
        start_outside=False,
        course=parts.course,
    )


KINDS = (Kind("formation", _compose),)
