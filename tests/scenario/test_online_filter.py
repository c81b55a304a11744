"""The filter of a scenario, sample by sample: the one that its runs have."""

import sys

import numpy as np
import pytest

import holdfast as hf
from holdfast.errors import ScenarioError
from tests.command_line import PD
from tests.scenario_files import CART, EXTERNAL


def pd(t, q):
    x, y, psi, u, _, r = q.T
    return np.stack([4 * (-0.5 - x) - 6 * u, -0.6 * psi - 1.2 * y - 0.4 * r], axis=1)


def decided(keep, data, run):
    """The decisions of the filter on the states and commands of a run, all but the last sample."""
    keep.reset()
    commands = data["nominal"].values[run]
    states = data["state"].sel(state_name=list(keep.measured_states)).values[run]
    samples = zip(data["time"].values[:-1], states[:-1], commands[:-1], strict=True)
    return [keep.step(q, command, t=t) for t, q, command in samples]


def same_bits(keep, data):
    """Whether every decision is that of the run; the kinds of decisions that there were."""
    kinds = set()
    for run in range(data.sizes["run"]):
        decisions = decided(keep, data, run)
        kinds |= {d.status for d in decisions}
        found = np.array([d.actuators for d in decisions])
        if not np.array_equal(found, data["actuator"].values[run, :-1]):
            return False, kinds
    return True, kinds


def test_filter_decides_as_the_runs_of_the_program_do(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "pd.py").write_text(PD)
    (tmp_path / "mine.toml").write_text(EXTERNAL)
    loaded = hf.load_scenario("mine.toml")
    data = loaded.with_controller(f"{sys.executable} pd.py").run().dataset
    same, kinds = same_bits(loaded.safety_filter(), data)
    assert same
    assert kinds == {hf.Status.PASSED, hf.Status.CHANGED}


SETTINGS = {
    "rates": ["safeguard.rates={ tau_u = 4, u = '20 cm/s^2' }"],
    "margins": [
        "safeguard.margins={ too_far = '3 cm' }",
        "safeguard.scales={ tau_r = 0.2 }",
        "safeguard.constraints={ bow = 'abs(psi) - 0.5' }",
        "run.sample_time=0.05",
        "run.record_every=0.05",
    ],
    "observer": ["observer={ measured = ['x', 'y', 'psi'], bandwidth = 3.0 }"],
}


@pytest.mark.few("rates")
@pytest.mark.parametrize("sets", SETTINGS.values(), ids=SETTINGS)
def test_rates_margins_and_observer_of_the_file_are_those_of_the_filter(sets, tmp_path):
    (tmp_path / "mine.toml").write_text(EXTERNAL)
    loaded = hf.load_scenario(str(tmp_path / "mine.toml"), sets)
    data = hf.simulate(
        loaded.system, loaded.law, starts=loaded.starts, region=loaded.region, command=pd,
        **loaded.settings,
    ).dataset  # fmt: skip
    keep = loaded.safety_filter()
    same, kinds = same_bits(keep, data)
    assert same
    assert hf.Status.CHANGED in kinds
    usual = hf.load_scenario(str(tmp_path / "mine.toml")).safety_filter()
    assert keep.law != usual.law


KEPT = """
[scenario]
title = "pushed cart"
{plant}
[law]
external = true
[safety]
kernel = "{kernel}"
rate = 3.0
[starts]
states = [{{ x = 0 }}, {{ x = 0.8, v = 0.2 }}]
[run]
horizon = 5
record_every = 0.02
delay = 0.02
"""


@pytest.mark.heavy
def test_filter_over_the_kernel_of_another_scenario_has_the_law_of_its_runs(tmp_path, monkeypatch):
    monkeypatch.setenv("HOLDFAST_CACHE_DIR", str(tmp_path / "cache"))
    kernel = tmp_path / "cart.toml"
    kernel.write_text(CART)
    plant = CART[CART.index("[system]") : CART.index("[grid]")]
    (tmp_path / "loop.toml").write_text(KEPT.format(plant=plant, kernel=kernel))
    loaded = hf.load_scenario(str(tmp_path / "loop.toml"))
    keep = loaded.safety_filter()
    assert keep.law == loaded.kept().law
    late = hf.load_scenario(str(tmp_path / "loop.toml"), ["system.lag={ a = 0.05 }"])
    assert late.kept().law == keep.law  # the kernel is that of the model
    assert late.system.state_names != late.model.state_names
    alone = hf.load_scenario(str(tmp_path / "loop.toml"), ["safety.alone=true"])
    with pytest.raises(ScenarioError, match=r"safety\.alone: the kernel replaces the command"):
        alone.safety_filter()
    other = hf.load_scenario(str(tmp_path / "loop.toml"), ["law.external=['x']"])
    with pytest.raises(ScenarioError, match="the other controller does not command a"):
        other.safety_filter()


@pytest.mark.parametrize(
    ("sets", "said"),
    [
        (["safeguard="], "nothing keeps the command of the other controller"),
        (["law.external=['u', 'r']", "tracking={u=5.0, r=10.0}"], "it has no filter around"),
        (["law={ outputs = { tau_u = '5', tau_r = '0' } }"], "it has no filter around"),
        (["varied.draws={ kappa1 = [1, 2] }"], "'kappa1' of the filter differs"),
    ],
)
def test_scenario_without_a_filter_around_another_controller_is_refused(sets, said, tmp_path):
    (tmp_path / "mine.toml").write_text(EXTERNAL)
    with pytest.raises(ScenarioError, match=said):
        hf.load_scenario(str(tmp_path / "mine.toml"), sets).safety_filter()


@pytest.mark.few("ch7-any-current")
@pytest.mark.parametrize("name", ["inspection", "ch7-any-current", "ch6-chain"])
def test_kernels_formations_and_laws_of_holdfast_have_no_filter_around_another_controller(name):
    with pytest.raises(ScenarioError, match="external = true, and a"):
        hf.load_scenario(name).safety_filter()
