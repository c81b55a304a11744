"""A checkpoint that the parts of a march write, each its own."""

import json
import shutil
from pathlib import Path

import numpy as np
import pytest

from holdfast.analysis.reachability import posed_march
from holdfast.analysis.reachability.checkpoint import PartFiles, read_parts, write_part
from holdfast.errors import OutputError, SimulationError
from tests.divided_marches import Here, basin, same

PARTS = "capture-basin.checkpoint.parts"


def ended(folder, monkeypatch, *, count, writes):
    """A march in parts that ends while they write for the last of so many times."""
    told = []

    def write(generation, first, arrays):
        told.append(first)
        if len(told) == writes:
            raise KeyboardInterrupt
        return write_part(generation, first, arrays)

    with monkeypatch.context() as patched:
        patched.setattr(posed_march, "write_part", write)
        options = {"checkpoint": folder, "checkpoint_every": 0}
        with pytest.raises(KeyboardInterrupt):
            basin(**options, cluster=Here(count=count))


def generations(folder):
    return [p.name for p in (folder / PARTS).iterdir() if p.is_dir()]


def test_what_was_written_of_another_cut_is_not_mixed_in(tmp_path, monkeypatch):
    """A worker is lost when others have written; the march goes on in fewer parts, and again."""
    ended(tmp_path, monkeypatch, count=3, writes=9)
    ended(tmp_path, monkeypatch, count=2, writes=4)
    said = json.loads((tmp_path / PARTS / "said.json").read_text())
    assert said["parts"] == [0, 10]
    assert generations(tmp_path) == [said["generation"]]
    found = basin(checkpoint=tmp_path, cluster=Here(count=4))
    same(basin(), found, "computed_share")


def test_who_has_been_given_up_writes_nowhere_else(tmp_path):
    files, values = PartFiles(tmp_path / "a"), {"values": np.arange(6.0)}
    late, new = files.begin(), files.begin()
    files.finish({}, new, [write_part(new, 0, values)])
    with pytest.raises(OutputError, match=r"0-values.npy cannot be written \(No such file"):
        write_part(late, 0, values)
    assert (read_parts(files.path, 2)("values")[0:6] == values["values"]).all()


def test_a_folder_that_a_part_cannot_see_is_refused(tmp_path, monkeypatch):
    """As /tmp of another machine."""
    monkeypatch.setattr(
        posed_march, "write_part", lambda g, *given: write_part(Path("/none") / g.name, *given)
    )
    with pytest.raises(OutputError, match="which all machines of the cluster share") as refused:
        basin(checkpoint=tmp_path, cluster=Here(count=2))
    assert "0-values.npy cannot be written (No such file or directory)" in str(refused.value)
    assert generations(tmp_path) == []


@pytest.mark.few("short")
@pytest.mark.parametrize("harm", ["missing", "short", "unsaid"])
def test_a_part_of_a_checkpoint_that_is_damaged_is_refused(harm, tmp_path):
    basin(checkpoint=tmp_path, cluster=Here(count=3))
    folder = tmp_path / PARTS
    [generation] = generations(tmp_path)
    part = folder / generation / "7-values.npy"
    if harm == "missing":
        part.unlink()
    elif harm == "short":
        part.write_bytes(part.read_bytes()[:1000])
    else:
        said = json.loads((folder / "said.json").read_text())
        said["parts"].remove(7)
        (folder / "said.json").write_text(json.dumps(said))
    with pytest.raises(
        SimulationError, match=r"\.parts cannot be read as a checkpoint; expected a checkpoint that"
    ):
        basin(checkpoint=tmp_path, cluster=Here(count=2))
    shutil.rmtree(folder)
    basin(checkpoint=tmp_path, cluster=Here(count=2))


def test_the_folder_is_the_same_for_whoever_works_elsewhere(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    asked = []
    write = posed_march.write_part
    monkeypatch.setattr(
        posed_march, "write_part", lambda g, *given: asked.append(g) or write(g, *given)
    )
    basin(checkpoint="six", cluster=Here(count=2))
    folders = {tmp_path / "six.parts", tmp_path / "six.rest.parts"}  # of both marches
    assert {g.parent for g in asked} == folders
