"""A graphics processor: how it is found, and what is said where there is none."""

import importlib
import re

import pytest

import holdfast as hf
from holdfast.commands import run
from holdfast.errors import HoldfastError, SimulationError
from holdfast.execution.device import program
from holdfast.scenario.load import load_scenario
from tests.devices import StandIn, has_gpu, needs_cpp

X, U = hf.symbol("x"), hf.symbol("u")
BOAT = hf.System(
    "boat", (hf.Quantity("x"),), (hf.Quantity("u"),), {"x": X + U},
    input_bounds=hf.Box((-0.5,), (0.5,)),
)  # fmt: skip
PIER = hf.Region("pier", BOAT.states, (hf.Inequality("pier", X**2 - 1),))
LINE = hf.grid(BOAT, {"x": (-1.5, 1.5)}, 61)


@pytest.fixture
def stand_in(monkeypatch):
    """CuPy is this module; what a process knows of its GPU is forgotten before and after."""

    def become(module):
        imported = importlib.import_module

        def import_module(name, package=None):
            if name != "cupy":
                return imported(name, package)
            if module is None:
                raise ImportError("No module named 'cupy'")
            return module

        monkeypatch.setattr(program.importlib, "import_module", import_module)
        return module

    program.cuda_device.cache_clear()
    yield become
    program.cuda_device.cache_clear()


def test_who_has_no_cupy_is_told_how_to_install_it(stand_in):
    stand_in(None)
    with pytest.raises(SimulationError, match=re.escape("pip install")):
        hf.viability_kernel(BOAT, PIER, LINE, 1.0, device="gpu")


def test_who_has_no_gpu_is_told_so_before_anything_is_computed(stand_in, monkeypatch):
    stand_in(StandIn(devices=0))
    monkeypatch.setenv("CUDA_VISIBLE_DEVICES", "7")
    with pytest.raises(SimulationError, match=r"no GPU was found.*CUDA_VISIBLE_DEVICES is '7'"):
        program.device_named("gpu")


@needs_cpp
def test_what_exceeds_the_memory_of_a_gpu_is_refused(stand_in):
    stand_in(StandIn(memory=1000))
    with pytest.raises(SimulationError, match=r"4 arrays of 61 nodes take .* stand-in has"):
        hf.viability_kernel(BOAT, PIER, LINE, 1.0, device="gpu")


def test_unknown_device_is_refused_with_those_there_are():
    with pytest.raises(SimulationError, match="device: 'tpu'"):
        hf.viability_kernel(BOAT, PIER, LINE, 1.0, device="tpu")
    with pytest.raises(HoldfastError, match="device is 'tpu'"):
        load_scenario("ch2-unicycle").with_settings(device="tpu").run()


def test_command_line_knows_every_device():
    assert run.DEVICES == program.DEVICES


@needs_cpp
def test_kernels_reach_the_gpu_through_cupy(stand_in):
    """Launches, transfers and the options of the compiler, with a module in the place of CuPy."""
    module = stand_in(StandIn())
    found = hf.viability_kernel(BOAT, PIER, LINE, 1.0, device="gpu")
    same = hf.viability_kernel(BOAT, PIER, LINE, 1.0, device="c++")
    assert module.launched > 100
    assert "--fmad=false" in module.options
    assert (found.values() == same.values()).all()


@pytest.mark.skipif(not has_gpu(), reason="there is no GPU")
def test_a_gpu_gives_the_bits_of_the_cpp_compiler():
    found = hf.viability_kernel(BOAT, PIER, LINE, 1.0, device="gpu")
    same = hf.viability_kernel(BOAT, PIER, LINE, 1.0, device="c++")
    assert (found.values() == same.values()).all()
