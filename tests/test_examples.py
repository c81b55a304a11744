"""The scripts of `examples/` run, and each notebook there is what its script says."""

import runpy
from pathlib import Path

import jupytext
import matplotlib.pyplot as plt
import nbformat
import pytest

FOLDER = Path(__file__).parent.parent / "examples"
SCRIPTS = sorted(FOLDER.glob("*.py"))


@pytest.mark.parametrize("script", SCRIPTS, ids=lambda p: p.stem)
def test_example_runs_and_shows_a_figure(script, tmp_path, monkeypatch, capsys):
    """What it promises it asserts itself; a warning is an error."""
    shown = []

    def show():
        shown.extend(plt.get_fignums())
        for number in plt.get_fignums():
            plt.figure(number).savefig(tmp_path / f"{number}.png")
        plt.close("all")

    plt.close("all")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(plt, "show", show)
    runpy.run_path(str(script), run_name="__main__")
    assert len(shown) == 1
    assert not plt.get_fignums(), "a figure is drawn that is not shown"
    assert capsys.readouterr().out.count("\n") >= 3, "numbers are printed"


def test_every_notebook_is_of_a_script():
    assert {p.stem for p in FOLDER.glob("*.ipynb")} == {p.stem for p in SCRIPTS}
    assert len(SCRIPTS) == 10


@pytest.mark.parametrize("script", SCRIPTS, ids=lambda p: p.stem)
def test_notebook_is_its_script_without_outputs(script):
    """Else: the command of CONTRIBUTING.md makes it anew."""
    written = nbformat.read(script.with_suffix(".ipynb"), as_version=4)
    made = jupytext.read(script, fmt="py:percent")
    nbformat.validate(written)
    cells, others = ([(c.cell_type, c.source) for c in nb.cells] for nb in (written, made))
    assert cells == others
    for cell in written.cells:
        assert cell.cell_type == "markdown" or (cell.outputs, cell.execution_count) == ([], None)
    assert written.metadata.kernelspec.name == "python3"
    assert cells[0][0] == "markdown"
    assert "\n*" in cells[0][1], "it begins with a question"
