"""A law that is simulated again: its program is lowered once."""

import cProfile
import pstats
from dataclasses import replace

import numpy as np
import pytest

import holdfast as hf
import holdfast.analysis.simulation.simulate as simulating


@pytest.mark.slow("inspection-20000")
@pytest.mark.parametrize(("name", "most"), [("ch2-unicycle", 5_000), ("inspection", 20_000)])
def test_what_was_simulated_before_is_not_lowered_again(name, most, monkeypatch):
    """A second simulation of the same definitions from one start: calls of Python are counted."""
    loaded = hf.load_scenario(name)
    law, held = loaded.kept().law, float(loaded.settings["sample_time"])
    problem = {
        "region": loaded.region, "goal": loaded.goal, "disturbance": loaded.disturbance,
        "horizon": 10 * held, "sample_time": held, "record_every": held,
    }  # fmt: skip
    drawn = hf.simulate(loaded.system, law, starts=loaded.starts, part=range(1), **problem)
    start = drawn.dataset["state"].values[0, 0]
    first = hf.simulate(loaded.system, law, starts=[start], **problem)

    def lowered(*_, **__):
        raise AssertionError("it is lowered again")

    monkeypatch.setattr(simulating, "closed_loop_program", lowered)
    counted = cProfile.Profile()
    second = counted.runcall(hf.simulate, loaded.system, law, starts=[start], **problem)
    assert pstats.Stats(counted).total_calls < most
    assert np.array_equal(first.dataset["state"], second.dataset["state"])
    with pytest.raises(AssertionError):  # another definition is another program
        hf.simulate(replace(loaded.system), law, starts=[start], **problem)
