"""Files of studies: margins, campaigns, comparisons, tunings."""

from __future__ import annotations

from pathlib import Path

from holdfast.analysis.reachability.solve import Margin
from holdfast.analysis.simulation.law_comparison import Comparison
from holdfast.analysis.simulation.sweep_table import Campaign, Tuning
from holdfast.host.files import make_folder, saved, write_summary, write_text


def write_margin(margin: Margin, folder: Path, *, figures: bool) -> list[Path]:
    """margin.json and the figure."""
    make_folder(folder)
    files = [write_summary(folder / "margin.json", margin.summary())]
    if figures:
        from holdfast.presentation.figures import style
        from holdfast.presentation.studies.margin import margin_figure

        drawn = margin_figure(
            [t.value for t in margin.trials],
            [t.fraction for t in margin.trials],
            margin.name,
            margin.unit,
            answers=[t.answer for t in margin.trials],
            keeps=margin.keeps,
        )
        files += style.write(drawn, folder, "margin")
    return files


def write_campaign(
    campaign: Campaign, folder: Path, variable: str | None, *, figures: bool
) -> list[Path]:
    """sweep.nc, sweep.json and the figure of a variable."""
    make_folder(folder)
    files = [saved(campaign, folder / "sweep.nc")]
    if figures:
        from holdfast.presentation.figures import style
        from holdfast.presentation.studies.sweep import campaign_figure

        files += style.write(campaign_figure(campaign, variable), folder, "sweep")
    return [*files, write_summary(folder / "sweep.json", campaign.summary(variable))]


def write_comparison(comparison: Comparison, folder: Path, *, figures: bool) -> list[Path]:
    """comparison.json, comparison.txt and the figure."""
    from holdfast.presentation.studies.comparison import comparison_figure, comparison_text

    make_folder(folder)
    files = [
        write_text(folder / "comparison.txt", comparison_text(comparison) + "\n"),
        write_summary(folder / "comparison.json", comparison.summary()),
    ]
    if figures:
        from holdfast.presentation.figures import style

        files += style.write(comparison_figure(comparison), folder, "comparison")
    return files


def write_tuning(tuning: Tuning, folder: Path, *, figures: bool) -> list[Path]:
    """The scenario with the gains, the candidates as a table, the summary and the figure."""
    from holdfast.presentation.studies.tuning import tuning_figure, tuning_table

    make_folder(folder)
    files = [
        write_text(folder / "tuned.toml", tuning.text),
        write_text(folder / "tuning.csv", tuning_table(tuning)),
        write_summary(folder / "tuning.json", tuning.summary()),
    ]
    if figures:
        from holdfast.presentation.figures import style

        files += style.write(tuning_figure(tuning), folder, "tuning")
    return files
