"""A tractor with trailers: hitches on, behind and ahead of the axle in front."""

import numpy as np
import pytest
import sympy as sp

import holdfast as hf
from holdfast.errors import DefinitionError
from tests.conftest import number_at

TRAINS = {
    "behind": (1, {"hitch_1": 0.2}),
    "ahead": (1, {"hitch_1": -0.2}),
    "second behind": (2, {"hitch_2": 0.3}),
    "both": (2, {"hitch_1": 0.2, "hitch_2": -0.1}),
    "three": (3, {"hitch_1": 0.1, "hitch_2": 0.2, "hitch_3": 0.3}),
}


def axles(trailers, states, lengths, hitches):
    """Position of each axle and its heading, from the drawing: shape (axles, 3)."""
    x, y, *headings = states
    psi = headings[::-1]  # tractor first
    place = np.array([x, y])
    found = [(*place, psi[trailers])]
    for i in range(trailers, 0, -1):
        ahead = np.array([np.cos(psi[i]), np.sin(psi[i])])
        further = np.array([np.cos(psi[i - 1]), np.sin(psi[i - 1])])
        place = place + lengths[i - 1] * ahead + hitches[i - 1] * further
        found.append((*place, psi[i - 1]))
    return np.array(found)


@pytest.mark.parametrize(("trailers", "hitches"), TRAINS.values(), ids=TRAINS)
def test_no_axle_of_the_drawing_slips_sideways_at_the_rates(trailers, hitches):
    """By central differences of the axles' positions; the tractor moves at v and turns at r."""
    system = hf.systems.tractor_trailer(
        trailers, length_1=0.5, length_2=0.7, length_3=0.6, **hitches
    )
    generator, step = np.random.default_rng(0), 1e-6
    lengths, given = (0.5, 0.7, 0.6), [hitches.get(f"hitch_{i}", 0.0) for i in (1, 2, 3)]
    for _ in range(10):
        q = generator.uniform(-1, 1, len(system.states))
        v, r = generator.uniform(-1, 1, 2)
        at = dict(zip((s.symbol for s in system.states), q, strict=True))
        at |= {hf.symbol("v"): v, hf.symbol("r"): r}
        at |= {p.symbol: p.value for p in system.parameters}
        rates = np.array([number_at(system.rates[n], at) for n in system.state_names])
        before, after = (
            axles(trailers, q + s * step * rates, lengths, given) for s in (-1, 1)
        )  # fmt: skip
        slopes = (after - before) / (2 * step)
        heading = axles(trailers, q, lengths, given)[:, 2]
        sideways = -np.sin(heading) * slopes[:, 0] + np.cos(heading) * slopes[:, 1]
        assert sideways == pytest.approx(0, abs=1e-8)
        along = np.cos(heading[-1]) * slopes[-1, 0] + np.sin(heading[-1]) * slopes[-1, 1]
        assert (along, slopes[-1, 2]) == pytest.approx((v, r), abs=1e-8)


def test_hitch_on_the_axle_leaves_no_trace():
    """The same rates, rows and parameters as without the argument."""
    plain, zero = hf.systems.tractor_trailer(2), hf.systems.tractor_trailer(2, hitch_1=0.0)
    assert zero == plain
    assert zero.parameters == plain.parameters
    assert not any("hitch" in str(s) for e in plain.rates.values() for s in e.free_symbols)
    assert plain.pfaffian[-1].coefficients.keys() == {"x", "y", "psi1", "psi2"}


def test_trailer_behind_a_hitch_swings_out_when_the_tractor_turns_on_the_spot():
    rates = hf.systems.tractor_trailer(1, hitch_1=0.2).rates
    straight = {hf.symbol("psi0"): 0, hf.symbol("psi1"): 0, hf.symbol("v"): 0}
    turn, hitch, length = (hf.symbol(n) for n in ("r", "hitch_1", "length_1"))
    assert sp.expand(rates["psi1"].xreplace(straight) + hitch * turn / length) == 0


@pytest.mark.parametrize(
    ("arguments", "complaint"),
    [
        ({"hitch_1": -0.5}, "hitch_1 is -0.5 m with length_1 0.5 m; expected above -0.5"),
        ({"hitch_2": 0.1}, "hitch_2 is 0.1 with 1 trailer; expected the hitch of a trailer that"),
        ({"trailers": 2, "hitch_2": -1.0, "length_2": 0.9}, "hitch_2 is -1 m with length_2 0.9 m"),
    ],
)
def test_hitch_that_no_trailer_can_have_is_refused(arguments, complaint):
    with pytest.raises(DefinitionError, match=complaint):
        hf.systems.tractor_trailer(**arguments)
