"""Words of the field find a page and a name: in the table, on the pages, and from the command line."""

import re
from functools import reduce
from pathlib import Path

import pytest

import holdfast as hf
from holdfast.commands.main import cli
from holdfast.errors import ScenarioError
from holdfast.maths.definitions.vehicle_file import vehicle_names
from holdfast.scenario.files import load_system, scenario_names
from holdfast.scenario.glossary import looked_up, rows
from holdfast.scenario.kinds import kinds
from holdfast.scenario.load import load_scenario
from holdfast.studies.catalogue import catalogue_lines, describe

ROOT = Path(__file__).parents[2]
TABLE = (ROOT / "src/holdfast/scenario/glossary.md").read_text("utf-8")

SEARCHED = {
    "Dubins": "systems.unicycle",
    "bicycle": "systems.car",
    "trailer": "systems.tractor_trailer",
    "avoid set": "viability_kernel",
    "viability kernel": "viability_kernel",
    "control invariant set": "viability_kernel",
    "discriminating kernel": "discriminating_kernel",
    "BRT": "backward_reachable_tube",
    "backward reachable tube": "backward_reachable_tube",
    "BRS": "backward_reachable_at",
    "backward reachable set": "backward_reachable_at",
    "reach-avoid": "capture_basin",
    "level set": "ValueFunction",
    "HJI": "hamiltonian",
    "CBF-QP": "SafetyFilter",
    "HOCBF": "SafetyFilter",
    "safety filter": "SafetyFilter",
    "MPC": "viability_kernel",
    "STL": "capture_basin",
    "dwell time": "Switching",
    "notebook": "",
    "quickstart": "",
    "conda": "",
}  # fmt: skip
"""What is searched for, and the public name that is found."""


@pytest.mark.parametrize("word", SEARCHED)
def test_word_of_the_field_finds_a_page_and_a_name(word):
    entries = looked_up(word)
    assert entries
    assert entries == looked_up(word.upper()) == looked_up(word.replace(" ", "_"))
    assert any(f"hf.{SEARCHED[word]}" in row.here for row in entries) or not SEARCHED[word]
    for row in entries:
        page = re.search(r"docs/([\w/]+\.md)", row.here)[1]
        assert (ROOT / "docs" / page).is_file()
    assert word.lower() in TABLE.lower(), "what the search of the site reads"


def test_page_of_a_word_has_the_word():
    """So that a search among the pages leads there as well."""
    for row in rows():
        page = re.search(r"docs/([\w/]+)\.md", row.here)[1]
        text = (ROOT / f"docs/{page}.md").read_text("utf-8").lower()
        names = [name.lower() for name in (*row.words, *row.names)]
        assert any(name in text for name in names), (row.words, page)


def test_names_of_the_glossary_exist():
    for code in re.findall(r"`([^`]*)`", TABLE):
        if code.startswith("hf."):
            assert reduce(getattr, code.split(".")[1:], hf), code
        elif code.startswith("kind = "):
            assert code.split('"')[1] in {kind.name for kind in kinds()}, code
        elif code.startswith("examples/"):
            assert (ROOT / code).is_file(), code
        elif code.startswith("holdfast "):
            assert code.split()[1] in cli.list_commands(None), code
        elif not code.startswith(("gains=", "holdfast.", "holdfast-check", "sample_time", "delay")):
            assert code in {*scenario_names(), *vehicle_names()}, code


def test_no_word_is_in_two_rows():
    words = [word.lower() for row in rows() for word in row.words]
    assert len(words) == len(set(words))


def test_show_says_what_a_word_of_the_field_is_here():
    assert describe("bicycle").startswith("bicycle model, kinematic bicycle, ")
    assert "hf.systems.car" in describe("Bicycle")
    assert "states" in describe("unicycle"), "a name of the catalogue is that entry"
    assert describe("reach_avoid").count("docs/") == 2


def test_list_names_the_entries_of_a_word():
    lines = list(catalogue_lines("bicycle"))
    assert [line.split()[:2] for line in lines] == [
        ["system", "car"], ["system", "front_axle_car"],
        ["scenario", "car-limits"], ["scenario", "ch4-car"], ["word", "bicycle"],
    ]  # fmt: skip
    assert all(
        "trailer" in line.lower() for line in catalogue_lines("trailer") if "word" not in line
    )
    with pytest.raises(ScenarioError, match="no entry has the words 'zeppelin'"):
        catalogue_lines("zeppelin")


@pytest.mark.parametrize(
    ("name", "said"),
    [
        (
            "dubins",
            "unknown scenario 'dubins'; Dubins car: .* the nearest scenario is ch4-unicycle",
        ),
        ("bicycle", "unknown scenario 'bicycle'; bicycle model: .* scenarios ch4-car, car-limits"),
        (
            "brt",
            "unknown scenario 'brt'; backward reachable tube: .* scenario is ch7-capture-basin",
        ),
        ("inspektion", "did you mean 'inspection'"),
    ],
)
def test_unknown_scenario_is_answered_by_what_the_word_is_here(name, said):
    with pytest.raises(ScenarioError, match=said):
        load_scenario(name)


def test_unknown_system_is_answered_by_what_the_word_is_here(tmp_path):
    with pytest.raises(ScenarioError, match=r"bicycle model: hf\.systems\.car by"):
        load_system("bicycle")
    mine = tmp_path / "mine.toml"
    mine.write_text('[scenario]\ntitle = "mine"\n[system]\nname = "bicycle"\n')
    with pytest.raises(ScenarioError, match=r"system\.name: .*'bicycle'; bicycle model: hf\.syst"):
        load_system(str(mine))
