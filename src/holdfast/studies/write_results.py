"""Files of studies: margins, campaigns, comparisons, tunings."""

from __future__ import annotations

from pathlib import Path

from holdfast.analysis.reachability.solve import Margin
from holdfast.analysis.simulation.law_comparison import Comparison
from holdfast.analysis.simulation.sweep_table import Campaign, Tuning
from holdfast.host.files import make_folder, saved, write_summary, write_text


def write_margin(found: Margin, folder: Path, *, figures: bool) -> list[Path]:
    """margin.json and the figure."""
    make_folder(folder)
    files = [write_summary(folder / "margin.json", found.summary())]
    if figures:
        from holdfast.presentation.figures import style
        from holdfast.presentation.studies.margin import margin_figure

        drawn = margin_figure(
            [t.value for t in found.trials],
            [t.fraction for t in found.trials],
            found.name,
            found.unit,
            answers=[t.answer for t in found.trials],
            keeps=found.keeps,
        )
        files += style.write(drawn, folder, "margin")
    return files


def write_campaign(
    found: Campaign, folder: Path, variable: str | None, *, figures: bool
) -> list[Path]:
    """sweep.nc, sweep.json and the figure of a variable."""
    make_folder(folder)
    files = [saved(found, folder / "sweep.nc")]
    if figures:
        from holdfast.presentation.figures import style
        from holdfast.presentation.studies.sweep import campaign_figure

        files += style.write(campaign_figure(found, variable), folder, "sweep")
    return [*files, write_summary(folder / "sweep.json", found.summary(variable))]


def write_comparison(found: Comparison, folder: Path, *, figures: bool) -> list[Path]:
    """comparison.json, comparison.txt and the figure."""
    from holdfast.presentation.studies.comparison import comparison_figure, comparison_text

    make_folder(folder)
    files = [
        write_text(folder / "comparison.txt", comparison_text(found) + "\n"),
        write_summary(folder / "comparison.json", found.summary()),
    ]
    if figures:
        from holdfast.presentation.figures import style

        files += style.write(comparison_figure(found), folder, "comparison")
    return files


def write_tuning(found: Tuning, folder: Path, *, figures: bool) -> list[Path]:
    """The scenario with the gains, the candidates as a table, the summary and the figure."""
    from holdfast.presentation.studies.tuning import tuning_figure, tuning_table

    make_folder(folder)
    files = [
        write_text(folder / "tuned.toml", found.text),
        write_text(folder / "tuning.csv", tuning_table(found)),
        write_summary(folder / "tuning.json", found.summary()),
    ]
    if figures:
        from holdfast.presentation.figures import style

        files += style.write(tuning_figure(found), folder, "tuning")
    return files
