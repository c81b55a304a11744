"""Certificates of harder cases, stated for easier ones."""

import pytest
import sympy as sp

import holdfast as hf
from holdfast.analysis.certificates.certify import certify
from holdfast.analysis.certificates.narrowed import narrowed
from holdfast.errors import SimulationError
from holdfast_check.checker import check

X, V, A, W, DRAG, GAP = (hf.symbol(n) for n in ("x", "v", "a", "w", "drag", "gap"))


def cart(push, gap, drag=0.1):
    """x'' = a - drag v + w between walls at 1 m less a gap."""
    system = hf.System(
        "cart", (hf.Quantity("x", "m"), hf.Quantity("v", "m/s")), (hf.Quantity("a", "m/s^2"),),
        {"x": V, "v": A - DRAG * V + W}, disturbances=(hf.Quantity("w", "m/s^2"),),
        parameters=(hf.Parameter("drag", "1/s", value=drag),),
        input_bounds=hf.Box((-1.0,), (1.0,)), disturbance_bounds=hf.Box((-push,), (push,)),
    )  # fmt: skip
    rows = (hf.Inequality("l", -1 - X + GAP, "m"), hf.Inequality("r", X - 1 + 2 * GAP, "m"))
    region = hf.Region("walls", system.states, rows, (hf.Parameter("gap", "m", value=gap),))
    box = {"x": (-1.0, 1.0), "v": (-2.0, 2.0)}
    return certify(system, region, box=box, cells=51, sample_time=0.2)


def test_certificate_of_a_harder_push_and_tighter_walls_is_one_of_easier_ones(tmp_path):
    hard, easy = cart(0.3, 0.05), cart(0.2, 0.0)
    stated = narrowed(hard, easy.ranges)
    assert stated.ranges == easy.ranges
    assert 0 < len(stated.kept.members) < len(easy.kept.members)
    assert set(stated.kept.members) <= set(easy.kept.members)
    told = check(str(stated.write(tmp_path / "cart.holdfast")))
    assert told.startswith(f"{len(stated.kept.members)} cells for ever")


@pytest.mark.parametrize(
    ("ranges", "message"),
    [
        ({"w": (-0.4, 0.2)}, "w from -0.4 to 0.2 is not implied by -0.3 to 0.3"),
        ({"gap": (0.1, 0.1)}, "gap from 0.1 to 0.1 is not implied"),
        ({"drag": (0.05, 0.05)}, "drag from 0.05 to 0.05 is not implied"),
        ({"mass": (1.0, 1.0)}, "'mass' is no number of the certificate"),
    ],
)
def test_ranges_that_do_not_follow_are_refused(ranges, message):
    with pytest.raises(SimulationError, match=message):
        narrowed(cart(0.3, 0.05), ranges)


def test_parameter_that_may_loosen_a_constraint_is_no_clearance():
    found = cart(0.3, 0.05)
    bent = [(n, u, c.subs(GAP, sp.sin(GAP))) for n, u, c in found.constraints]
    changed = type(found)(**{**found.__dict__, "constraints": tuple(bent)})
    with pytest.raises(SimulationError, match="gap"):
        narrowed(changed, {"gap": (0.0, 0.0)})
