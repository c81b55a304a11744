"""[law] certificate: a scenario runs the inputs of the file of a certificate."""

import pytest

import holdfast as hf
from holdfast.errors import ModelWarning, ScenarioError
from tests.certified_systems import BOX, changed

KEPT = """
[scenario]
title = "A target kept in view by its certificate"

[system]
states = {{ ahead = {{ unit = "m" }}, left = {{ unit = "m" }} }}
inputs = {{ u = {{ unit = "m/s", bounds = [-0.5, 0.5] }}, r = {{ unit = "rad/s", bounds = [-0.8, 0.8] }} }}
disturbances = {{ wa = {{ unit = "m/s", bounds = [-0.1, 0.1] }}, wb = {{ unit = "m/s", bounds = [-{sway}, 0.15] }} }}
rates = {{ ahead = "-u + r*left - wa", left = "-r*ahead - wb" }}

[law]
certificate = "{certificate}"
check = {check}

[region]
constraints = {{ {first}, far = {{ expression = "ahead - 2", unit = "m" }} }}

[starts]
random = 50
box = {{ ahead = [0.8, 1.6], left = [-0.3, 0.3] }}

[run]
horizon = 4
sample_time = {sample_time}

[disturbance]
wa = "0.1*sgn(sin(3*t))"
wb = "0.15*sgn(left)"
"""
NEAR = 'near = { expression = "0.35 - ahead", unit = "m" }'


@pytest.fixture(scope="module")
def certificate(tmp_path_factory):
    target = hf.load_scenario("seen-target")
    found = hf.certify(target.system, target.region, box=BOX, cells=41)
    return found.write(tmp_path_factory.mktemp("certificate") / "target.holdfast")


def loaded(folder, certificate, *, sway=0.15, first=NEAR, sample_time=0.1, check=1):
    path = folder / "kept.toml"
    path.write_text(
        KEPT.format(
            certificate=certificate, sway=sway, first=first, sample_time=sample_time, check=check
        )
    )
    return hf.load_scenario(str(path))


def test_scenario_runs_the_law_of_its_certificate(certificate, tmp_path):
    scenario = loaded(tmp_path, certificate)
    result = scenario.run()
    assert result.outcomes["stayed"] == 50
    law = hf.certified_law(hf.read_certificate(certificate), scenario.system)
    assert hf.export_c(scenario.system, scenario.law) == hf.export_c(scenario.system, law)


def test_other_files_vehicles_regions_and_samples_are_refused(certificate, tmp_path):
    with pytest.raises(ScenarioError, match="cannot be read"):
        loaded(tmp_path, tmp_path / "none.holdfast")
    with pytest.raises(ScenarioError, match=r"'wb' of system 'system' is -0\.2"):
        loaded(tmp_path, certificate, sway=0.2)
    nearer = 'near = { expression = "0.34 - ahead", unit = "m" }'
    with pytest.raises(ScenarioError, match="'near' of region 'region' is not certified"):
        loaded(tmp_path, certificate, first=nearer)
    with pytest.raises(ScenarioError, match=r"the sample time is 0\.05 s; expected 0\.1 s"):
        loaded(tmp_path, certificate, sample_time=0.05).run()


def test_scenario_asks_the_checker_of_its_certificate(certificate, tmp_path):
    """A file that says of the current what is not proved."""

    def wider(header):
        header["disturbances"][1]["range"] = [(-0.2).hex(), (0.2).hex()]

    spoiled = tmp_path / "spoiled.holdfast"
    spoiled.write_bytes(certificate.read_bytes())
    forged = changed(spoiled, wider)
    with pytest.raises(ScenarioError, match="is not valid: cell"):
        loaded(tmp_path, forged, sway=0.2)
    with pytest.warns(ModelWarning, match="was not checked"):
        loaded(tmp_path, forged, sway=0.2, check=0)
    with pytest.raises(ScenarioError, match=r"check.*less than or equal to 1"):
        loaded(tmp_path, certificate, check=2)
