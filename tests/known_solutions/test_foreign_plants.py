"""Laws made for our model, on plants that others wrote: benchmarks/foreign.py and its fit."""

from importlib.util import find_spec

import numpy as np
import pytest
from foreign_plants import FITTED, Boat, Otter, Rov, Ship, fitted, numbers_of

import holdfast as hf


class Own(Boat):
    """Our vehicle in the place of a plant of others."""

    scale, arm, ahead, astern = 1.0, 0.1, 5.0, 5.0

    def __init__(self):
        super().__init__()
        self.plant = hf.Plant(hf.systems.marine_vehicle(), [0.0] * 6)

    def start(self, pose):
        self.plant.reset([*pose, 0, 0, 0])

    def state(self):
        return self.plant.state

    def step(self, thrusts, seconds):
        port, starboard = thrusts
        self.plant.step([port + starboard, self.arm * (starboard - port)])


def test_fit_finds_the_numbers_of_a_vehicle_from_its_step_responses():
    p = {q.name: q.value for q in hf.systems.marine_vehicle().parameters}
    found = fitted(Own())
    exact = {
        "m11": p["mass"] - p["Xudot"], "m22": p["mass"] - p["Yvdot"], "m33": p["Iz"] - p["Nrdot"],
        **{n: p[n] for n in FITTED[3:]},
    }  # fmt: skip
    for name, value in exact.items():
        assert found[name] == pytest.approx(value, rel=0.02), name


@pytest.mark.heavy
@pytest.mark.peer
@pytest.mark.parametrize(
    ("plant", "horizon", "without"),
    [(Otter, 150.0, 0), (Rov, 150.0, 8), (Ship, 400.0, 8)],
    ids=["Otter", "ROV", "ship"],
)
def test_law_with_an_estimate_arrives_on_a_foreign_plant_in_still_water(plant, horizon, without):
    """8 of 8 starts in view and within 1 cm and 0.02 rad; without the estimate not on the Otter."""
    if find_spec(plant.package) is None:
        pytest.skip(f"there is no {plant.package}")
    from foreign import LawInC, Row, inspection, judged, pose, starts_of

    boat = plant()
    numbers = numbers_of(boat)
    arrived = []
    for estimate in (False, True):
        scenario = inspection(boat, numbers, estimate)
        law, view = LawInC(scenario), hf.Boundary(scenario.model, scenario.region)
        row = judged(
            Row("", ""), boat, law, starts_of(scenario, 8)[:, :3], horizon,
            lambda q, view=view: float(view.worst(q).max()),
            pose(np.array([-0.5 * boat.scale, 0.0, 0.0])), law.begin,
        )  # fmt: skip
        assert max(row.worst) <= 1e-3
        arrived.append(int(((np.array(row.far) < 0.01) & (np.array(row.turned) < 0.02)).sum()))
    assert arrived == [without, 8]
