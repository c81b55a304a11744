"""`holdfast run` of a scenario whose nominal law is a program of the user's own."""

import re
import sys

import numpy as np
import pytest

import holdfast as hf
from holdfast.errors import ScenarioError
from tests.command_line import PD, holdfast
from tests.scenario_files import EXTERNAL


@pytest.fixture
def mine(tmp_path):
    (tmp_path / "pd.py").write_text(PD)
    (tmp_path / "mine.toml").write_text(EXTERNAL)
    return tmp_path


def test_filter_keeps_what_the_program_loses(mine):
    line = f"{sys.executable} pd.py"
    answer = holdfast(
        "run", "mine.toml", "--controller", line, "--no-figures", "--out", "kept", cwd=mine
    )
    assert answer.returncode == 0, answer.stderr
    assert "viable         3 of 3 runs" in answer.stdout
    assert "overruled the law at" in answer.stdout
    answer = holdfast(
        "run", "mine.toml", "--controller", line, "--no-figures", "--set", "safeguard=", cwd=mine
    )
    assert answer.returncode == 0, answer.stderr
    assert "viable         3 of 3 runs" not in answer.stdout


def test_run_of_the_program_is_that_of_the_same_function(mine, monkeypatch):
    monkeypatch.chdir(mine)
    loaded = hf.load_scenario("mine.toml")
    found = loaded.with_controller(f"{sys.executable} pd.py").run().dataset

    def pd(t, q):
        x, y, psi, u, _, r = q.T
        return np.stack([4 * (-0.5 - x) - 6 * u, -0.6 * psi - 1.2 * y - 0.4 * r], axis=1)

    same = hf.simulate(
        loaded.system, loaded.law, starts=loaded.starts, region=loaded.region, command=pd,
        **loaded.settings,
    ).dataset  # fmt: skip
    assert found["state"].values == pytest.approx(same["state"].values, abs=1e-9)
    assert np.array_equal(found["outcome"].values, same["outcome"].values)


def test_scenario_that_lacks_its_program_and_program_that_lacks_a_scenario_are_refused(mine):
    answer = holdfast("run", "mine.toml", cwd=mine)
    assert answer.returncode == 2
    assert (
        "another controller commands tau_u, tau_r; give holdfast run --controller 'COMMAND'"
        in answer.stderr
    )
    answer = holdfast("run", "inspection", "--controller", "true", cwd=mine)
    assert answer.returncode == 2
    assert "no other controller commands this scenario" in answer.stderr
    answer = holdfast("run", "ch7-any-current", "--controller", "true", cwd=mine)
    assert answer.returncode == 2
    assert "no other controller commands this scenario" in answer.stderr
    answer = holdfast("run", "mine.toml", "--controller", "false", cwd=mine)
    assert answer.returncode == 2
    assert re.search(r"the controller 'false' of run \d", answer.stderr)  # the first that ended
    assert "Traceback" not in answer.stderr
    assert not (mine / "runs").exists()


def test_velocities_that_the_inputs_track_may_be_commanded(mine, monkeypatch):
    monkeypatch.chdir(mine)
    sets = ["law.external=['u', 'r']", "tracking={u=5.0, r=10.0}"]
    loaded = hf.load_scenario("mine.toml", sets)
    assert [q.name for q in loaded.law.handed] == ["command_u", "command_r"]
    with pytest.raises(ScenarioError, match="'w' is neither an input nor a state"):
        hf.load_scenario("mine.toml", ["law.external=['w']"])
    with pytest.raises(ScenarioError, match=r"law\.external"):
        hf.load_scenario("mine.toml", ["law.external=false"])


def test_filter_of_the_file_is_exported_with_the_command_as_an_argument(mine):
    answer = holdfast("export-c", "mine.toml", "--out", "keep.c", cwd=mine)
    assert answer.returncode == 0, answer.stderr
    assert "const double *handed" in (mine / "keep.c").read_text()


def test_rates_of_the_safeguard_limit_the_inputs(mine):
    sets = [
        "law={ outputs = { tau_u = '5', tau_r = '0' } }",
        "safeguard.rates={ tau_u = 4, u = '20 cm/s^2' }",
    ]
    loaded = hf.load_scenario(str(mine / "mine.toml"), sets)
    data = loaded.run().dataset
    changes = np.diff(data["input"].sel(input_name="tau_u").values, axis=1)
    assert np.abs(changes).max() == pytest.approx(4 * 0.02, rel=1e-9)
    with pytest.raises(ScenarioError, match=r"rates\.w: unknown name; allowed: psi"):
        hf.load_scenario(str(mine / "mine.toml"), ["safeguard.rates={ w = 4 }"])


def test_program_is_told_the_states_of_the_model_and_not_the_lag_of_actuators(mine):
    seen = mine / "seen.py"
    seen.write_text(
        "import json, sys\n"
        "for line in sys.stdin:\n"
        f"    open({str(mine / 'keys')!r}, 'w').write(' '.join(json.loads(line)))\n"
        "    print(json.dumps({'tau_u': 0.0, 'tau_r': 0.0}), flush=True)\n"
    )
    sets = ["system.lag={ tau_u = 0.1, tau_r = 0.1 }", "run.horizon=0.1"]
    scenario = hf.load_scenario(str(mine / "mine.toml"), sets, runs=1)
    scenario.with_controller(f"{sys.executable} {seen}").run()
    assert (mine / "keys").read_text() == "t run x y psi u v r"


def test_estimate_that_the_filter_does_not_use_is_refused(mine):
    sets = ["system.unmodelled={ tau_u = [-3, 3] }", "observer={}"]
    with pytest.raises(ScenarioError, match="disturbance_measured = true"):
        hf.load_scenario(str(mine / "mine.toml"), sets)
    counted = hf.load_scenario(
        str(mine / "mine.toml"), [*sets, "safeguard.disturbance_measured=true"]
    )
    assert counted.safety_filter().measured_states == counted.model.state_names
