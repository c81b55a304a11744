"""`holdfast certify --box`: the law of a closed loop is judged, and the answer is a sentence."""

import json

import pytest

from holdfast.errors import ScenarioError
from holdfast.studies.law_certification import judged_law
from tests.command_line import called

TACKS = ("--box", "y=-3,3", "--box", "psi=-0.8,0.8", "--cells", "41", "--no-figures")


def test_command_judges_the_law_of_a_closed_loop(tmp_path):
    answer = called("certify", "ferry-tacks", *TACKS, "--out", tmp_path)
    assert answer.returncode == 1, answer.stderr
    assert answer.stdout.startswith("refuted: a trajectory under the law surely leaves the region")
    assert "bank is violated by at least" in answer.stdout
    said = json.loads((tmp_path / "certificate.json").read_text())
    assert said["law"]
    assert said["sample_time"] == 0.5  # that of its run
    assert 0.5 < said["share"] < 1


def test_law_of_a_kernel_or_of_no_scenario_is_refused():
    with pytest.raises(ScenarioError, match="has no law to certify"):
        judged_law("seen-target", box={"ahead": (0.3, 2.1), "left": (-1, 1)})


def test_range_that_is_none_names_its_option(tmp_path):
    answer = called("certify", "ferry-tacks", "--box", "y=3", "--out", tmp_path)
    assert answer.returncode != 0
    assert "--box y=3, expected NAME=LOW,HIGH" in answer.stderr.replace(";", ",")
