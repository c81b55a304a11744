"""Runs advance together in blocks of lanes, and no bit of a run depends on the others."""

import numpy as np
import pytest

import holdfast as hf
from tests.carts import BOX, WALLS, cart, swinging

GENERATOR = np.random.default_rng(16)
COUNT = 37
"""Two whole blocks, and one of five runs."""


def of_scenario(name, **changes):
    loaded = hf.load_scenario(name)
    low, high = np.array([loaded.starts.box.get(s.name, (0, 0)) for s in loaded.system.states]).T
    starts = GENERATOR.uniform(low, high, (COUNT, len(low)))
    rest = {"region": loaded.region, "goal": loaded.goal, "horizon": 12.0, "record_every": 1.0}
    rest["start_outside"] = True
    return loaded.system, loaded.law, starts, rest | changes


def wild():
    """Some runs diverge, some leave at once, some stay: with steps of their own length."""
    x, u = hf.symbol("x"), hf.symbol("u")
    system = hf.System("wild", (hf.Quantity("x"),), (hf.Quantity("u"),), {"x": x**3 + u})
    law = hf.Law("nothing", system.states, {"u": -x * 0.01})
    room = hf.Region("room", system.states, (hf.Inequality("wall", x - 1.5),))
    starts = np.linspace(-1.2, 1.8, COUNT)[:, np.newaxis]
    rest = {"horizon": 3.0, "stepper": "dormand-prince", "start_outside": True}
    return system, law, starts, {"region": room} | rest


def from_a_table():
    """A law that the value of a kernel keeps; some runs leave the grid."""
    system = cart(push=0.2)
    found = hf.discriminating_kernel(system, WALLS, hf.grid(system, BOX, 21), horizon=2)
    law = hf.safety_law(system, found, swinging())
    starts = GENERATOR.uniform(-1.4, 1.4, (COUNT, 2))
    return system, law, starts, {"horizon": 6.0, "region": WALLS, "start_outside": True}


CASES = {
    "safeguarded, two modes": lambda: of_scenario("inspection"),
    "blended, three modes, exits": lambda: of_scenario("ch5-viable-goal-set", horizon=40.0),
    "adaptive, diverging": wild,
    "continuous": lambda: of_scenario("ch5-nominal", continuous=True),
    "late": lambda: of_scenario("ch5-nominal", delay=0.1),
    "with a memory": lambda: of_scenario("ch3-unknown-current"),
    "from a table": from_a_table,
}
NOT_OF_A_RUN = ("time",)


def test_every_run_draws_noise_of_its_own():
    system, law, starts, rest = CASES["late"]()
    rest |= {"noise_normal": {"x": 0.01}, "horizon": 1.0}
    same = np.repeat(starts[:1], 5 * COUNT, axis=0)  # runs of several blocks and threads
    one, two = (hf.simulate(system, law, starts=same, threads=k, **rest) for k in (1, 2))
    ends = one.dataset["state"].values[:, -1, 0]
    assert len(set(ends)) == len(ends)
    assert np.array_equal(one.dataset["state"], two.dataset["state"])


@pytest.mark.few("continuous", "with a memory")
@pytest.mark.parametrize("name", CASES)
def test_no_bit_of_a_run_depends_on_the_runs_beside_it(name):
    system, law, starts, rest = CASES[name]()
    with np.errstate(all="ignore"):
        whole = hf.simulate(system, law, starts=starts, threads=1, **rest).dataset
        turned = hf.simulate(system, law, starts=np.roll(starts, 5, axis=0), threads=2, **rest)
        alone = [hf.simulate(system, law, starts=starts[[k]], **rest).dataset for k in (0, 20, 36)]
    outcomes = len(set(whole["outcome"].values.tolist()))
    assert outcomes >= (2 if name == "adaptive, diverging" else 1)
    for variable, values in whole.items():
        if "run" not in values.dims or variable in NOT_OF_A_RUN:
            continue
        same = np.roll(turned.dataset[variable].values, -5, axis=0)
        assert np.array_equal(values.values, same, equal_nan=values.dtype.kind == "f"), variable
        for k, own in zip((0, 20, 36), alone, strict=True):
            one, other = values.values[k], own[variable].values[0]
            assert np.array_equal(one, other, equal_nan=values.dtype.kind == "f"), (variable, k)
