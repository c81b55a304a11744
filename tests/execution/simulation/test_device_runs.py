"""Simulations by a graphics processor's kernels, compiled as C++: the bits of the processor."""

import numpy as np
import pytest

from holdfast.execution.device import program
from holdfast.scenario.load import load_scenario
from tests.devices import accepted_by_cuda, needs_cpp, needs_nvcc

pytestmark = needs_cpp


def differing(name, runs, changes=()):
    """The variables of a scenario's result that are not the same on both, and how many there are."""
    scenario = load_scenario(name, changes, runs)
    here, there = (scenario.on_device(d).run().dataset for d in ("cpu", "c++"))
    pairs = {n: (here[n].values, there[n].values) for n in here.variables}
    unlike = [
        n for n, (a, b) in pairs.items() if not np.array_equal(a, b, equal_nan=a.dtype.kind == "f")
    ]
    return unlike, len(pairs)


@pytest.mark.few("ch2-unicycle-5-changes4")
@pytest.mark.parametrize(
    ("name", "runs", "changes"),
    [
        ("inspection", 8, ["run.horizon=10", "run.record_every=0.5"]),
        ("ch3-sample-and-hold", 3, []),
        ("ch7-rescue", 6, []),
        ("seen-guarded", 5, []),
        ("ch2-unicycle", 5, ["run.delay=0.1", "run.horizon=10"]),
        ("inspection", 3, ["run.horizon=4", "disturbance.Vy=wiener(0.05)"]),
    ],
)
def test_runs_have_the_bits_of_the_processor(name, runs, changes):
    """Modes, a safeguard, noise that is held, tables, a delay, a Wiener process."""
    unlike, count = differing(name, runs, changes)
    assert unlike == []
    assert count > 20


def test_runs_are_the_same_in_any_number_of_launches(monkeypatch):
    from holdfast.execution.simulation import device_runs

    monkeypatch.setattr(device_runs, "MOST_RUNS", 7)
    assert differing("ch2-unicycle", 20)[0] == []


@pytest.mark.heavy
@needs_nvcc
def test_cuda_takes_the_same_text(tmp_path, monkeypatch):
    texts = []

    def noted(text, whole=program.whole_text):
        texts.append(whole(text))
        return texts[-1]

    monkeypatch.setattr(program, "whole_text", noted)
    load_scenario("seen-guarded", [], 2).on_device("c++").run()
    accepted_by_cuda(texts[-1], tmp_path)
