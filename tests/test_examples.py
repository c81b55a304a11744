"""The scripts of `examples/` run, and each notebook there is what its script says."""

import ast
import inspect
import runpy
from pathlib import Path

import jupytext
import matplotlib.pyplot as plt
import nbformat
import pytest

import holdfast as hf

FOLDER = Path(__file__).parent.parent / "examples"
SCRIPTS = sorted(FOLDER.glob("*.py"))


@pytest.mark.slow("dubins_car", "boat_in_a_current", "log_to_guarantee", "trailer", "bicycle")
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


def of_holdfast(node):
    """The public name of `hf.name`."""
    if isinstance(node, ast.Attribute) and getattr(node.value, "id", "") == "hf":
        return node.attr
    return None


@pytest.mark.parametrize("script", SCRIPTS, ids=lambda p: p.stem)
def test_example_calls_what_is_public_by_the_names_of_its_arguments(script):
    """Also of an example that runs for long."""
    tree = ast.parse(script.read_text("utf-8"))
    names = {of_holdfast(node) for node in ast.walk(tree)} - {None}
    assert names
    assert names <= set(hf.__all__)
    for call in (n for n in ast.walk(tree) if isinstance(n, ast.Call) and of_holdfast(n.func)):
        parameters = inspect.signature(getattr(hf, call.func.attr)).parameters.values()
        if not any(p.kind is p.VAR_KEYWORD for p in parameters):
            words = {k.arg for k in call.keywords} - {None}
            assert words <= {p.name for p in parameters}, f"line {call.lineno}"


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
