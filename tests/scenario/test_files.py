"""Files that are named in files: found from the folder of the file that names them."""

from importlib import resources

import pytest

from holdfast.errors import ScenarioError
from holdfast.scenario.files import load_system, read_text
from holdfast.scenario.kernel_reference import named_kernel
from holdfast.scenario.load import load_scenario
from holdfast.studies.comparison import compare
from tests.scenario_files import CART

LOOP = f"""
[scenario]
title = "pushed cart"
{CART[CART.index("[system]") : CART.index("[grid]")]}
[law]
outputs = {{ a = "1" }}
[goal]
constraints = {{ right = {{ expression = "0.5 - x", unit = "m" }} }}
[safety]
kernel = "kernels/cart.toml"
[starts]
states = [{{ x = 0 }}]
[run]
horizon = 8
"""


@pytest.fixture
def jobs(tmp_path, monkeypatch):
    """jobs/loop.toml and jobs/kernels/cart.toml, seen from the folder `elsewhere` beside them."""
    (tmp_path / "jobs" / "kernels").mkdir(parents=True)
    (tmp_path / "jobs" / "loop.toml").write_text(LOOP)
    small = CART.replace("nodes = 61", "nodes = 31").replace("forever = true", "")
    (tmp_path / "jobs" / "kernels" / "cart.toml").write_text(small)
    (tmp_path / "elsewhere").mkdir()
    monkeypatch.chdir(tmp_path / "elsewhere")
    return tmp_path / "jobs"


@pytest.mark.few("{jobs}/loop.toml")
@pytest.mark.parametrize("name", ["../jobs/loop.toml", "{jobs}/loop.toml"])
def test_kernel_is_found_beside_the_file_that_names_it(jobs, name):
    assert load_scenario(name.format(jobs=jobs)).run().viable == 1


def test_value_function_is_found_beside_the_file_that_names_it(jobs):
    named_kernel("../jobs/kernels/cart.toml").value().save(jobs / "kernels" / "cart.nc")
    (jobs / "loop.toml").write_text(LOOP.replace("cart.toml", "cart.nc"))
    assert load_scenario("../jobs/loop.toml").run().viable == 1


def test_kernel_on_the_command_line_is_one_from_the_working_folder(jobs):
    change = ["safety.kernel=../jobs/kernels/cart.toml"]
    assert load_scenario("../jobs/loop.toml", change).run().viable == 1
    with pytest.raises(ScenarioError, match=r"kernels/cart.toml: cannot be read"):
        load_scenario("../jobs/loop.toml", ["safety.kernel=kernels/cart.toml"]).run()


def test_laws_that_are_compared_bring_their_own_kernels(jobs):
    """One of [compare.laws], and one of another file in another folder."""
    free = LOOP.replace('[safety]\nkernel = "kernels/cart.toml"', "")
    free += '[compare.laws.kept]\nsafety = { kernel = "kernels/cart.toml" }\n'
    (jobs / "free.toml").write_text(free)
    (jobs / "other").mkdir()
    other = LOOP.replace("kernels/", "../kernels/")
    (jobs / "other" / "law.toml").write_text(other)
    found = compare("../jobs/free.toml", ["free", "kept", "../jobs/other/law.toml"])
    stayed = {t.law: bool(t.viable.all()) for t in found.trials}
    assert stayed == {"free": False, "kept": True, "../jobs/other/law.toml": True}


VEHICLE = (
    read_text("ch5-viable-goal-set")[1]
    .replace('vehicle = "videoray_pro_iii"', 'vehicle = "vehicles/mine.toml"')
)  # fmt: skip


def test_vehicle_is_found_beside_the_file_that_names_it(jobs):
    own = (resources.files("holdfast.vehicles") / "bluerov2.toml").read_text("utf-8")
    (jobs / "vehicles").mkdir()
    (jobs / "vehicles" / "mine.toml").write_text(own)
    (jobs / "dock.toml").write_text(VEHICLE)
    for system in (load_scenario("../jobs/dock.toml").system, load_system("../jobs/dock.toml")):
        assert {p.name: p.value for p in system.parameters}["mass"] == 11.4
    with pytest.raises(ScenarioError, match=r"vehicle file vehicles/mine.toml: cannot be read"):
        load_scenario("../jobs/dock.toml", ["system.vehicle=vehicles/mine.toml"])


def test_checkpoint_is_written_beside_the_file_that_names_it(jobs):
    cart = jobs / "kernels" / "cart.toml"
    cart.write_text(cart.read_text().replace("[march]", '[march]\ncheckpoint = "cart.checkpoint"'))
    load_scenario("../jobs/kernels/cart.toml", ["march.horizon=0.1"]).solve()
    assert [p.name for p in jobs.rglob("*.checkpoint")] == ["cart.checkpoint"]
    assert (jobs / "kernels" / "cart.checkpoint").exists()
