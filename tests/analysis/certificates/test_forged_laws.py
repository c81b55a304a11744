"""Files of laws that exist nowhere, or on next to nothing, or without a branch, are refused."""

import base64
import os
import random
import tracemalloc
import zlib
from dataclasses import replace

import numpy as np
import pytest
import sympy as sp

import holdfast as hf
from holdfast.errors import OutputError
from holdfast_check.checker import NotValidError, check, checked
from tests.carts import STATES, WALLS, D, U, V, X, cart
from tests.certified_systems import changed

BOX = {"x": (-1, 1), "v": (-1, 1)}
GAINS = "gains are numbers"


@pytest.fixture(scope="module")
def braked(tmp_path_factory):
    """u = -3 x - 3 v keeps a cart between its walls: one option, whatever is measured."""
    system = replace(cart(0.1), input_bounds=hf.Box((-2,), (2,)))
    law = hf.Law("braked", system.states, {system.input_names[0]: -3 * X - 3 * V}, empirical=GAINS)
    found = hf.certify(system, WALLS, law=law, box=BOX, cells=41, sample_time=0.1)
    return found.write(tmp_path_factory.mktemp("law") / "braked.holdfast")


def with_options(path, of):
    """The file whose law has other options, from those of an honest one: conditions, inputs."""

    def other(header):
        ((_, inputs, mode),) = header["law"]["modes"][0]
        header["law"]["modes"][0] = [[when, inputs, mode] for when in of]

    return str(changed(path, other))


@pytest.mark.heavy
def test_honest_law_is_valid_with_one_option_and_with_two(braked):
    assert "entries hold" in check(str(braked))
    assert "entries hold" in check(with_options(braked, [["x - 1/2"], ["1/2 - x"]]))
    assert "entries hold" in check(
        with_options(braked, [["time_in_mode - 1"], ["1 - time_in_mode"]])
    )


@pytest.mark.few("options5", "options6", "options7")
@pytest.mark.parametrize(
    "options",
    [
        [["x - 1/2"]],
        [["x - 1/2"], ["log(-1 - x*x)"]],
        [["x - 1/2"], ["sqrt(-1 - x*x)"]],
        [["x - 1/2"], ["1/(x - x)"]],
        [["x - 1/2"], ["time_in_mode"]],
        [["time_in_mode - 1"]],
        [["1 - time_in_mode"]],
        [["log(-1 - x*x)"]],
    ],
)
def test_law_without_a_branch_is_refused(braked, options):
    with pytest.raises(NotValidError, match="the law does nothing in a part of it"):
        check(with_options(braked, options))


@pytest.mark.heavy
def test_law_at_places_that_a_seed_foretells_is_refused(tmp_path):
    """It is defined within 1e-12 m of 32 places of each cell alone."""
    system = hf.System(
        "line", STATES[:1], (hf.Quantity("u", "m/s"),), {"x": U + D},
        disturbances=(hf.Quantity("d", "m/s"),), input_bounds=hf.Box((-1,), (1,)),
        disturbance_bounds=hf.Box((-0.1,), (0.1,)),
    )  # fmt: skip
    law = hf.Law("to the middle", system.states, {"u": -X}, empirical=GAINS)
    path = hf.certify(system, WALLS, law=law, box={"x": (-1, 1)}, cells=20, sample_time=0.5).write(
        tmp_path / "line.holdfast"
    )
    assert "entries hold" in check(str(path))
    edges, options = np.linspace(-1, 1, 21), []
    for cell in range(20):
        chance = random.Random(cell)
        for _ in range(32):
            chance.uniform(-0.1, 0.1)  # the disturbance
            at = sp.Rational(chance.uniform(edges[cell], edges[cell + 1]))
            chance.choice((0, chance.uniform(-3, 5)))  # the time in the mode
            options.append([f"x - ({at}) - 1/10**12", f"({at}) - x - 1/10**12"])
    with pytest.raises(NotValidError, match="the law does nothing in a part of it"):
        check(with_options(path, options))


def test_share_is_drawn_anew_each_time_and_the_seed_is_printed(braked):
    told = {check(str(braked), share=0.1) for _ in range(3)}
    assert len(told) == 3
    seed = int(told.pop().split("drawn with seed ")[1].split(":")[0])
    assert f"seed {seed}" in check(str(braked), share=0.1, seed=seed)


def test_one_entry_at_least_is_checked(braked):
    checks = [checked(str(braked), share) for share in (1e-9, 0.5)]
    assert checks[0]["checked"] == 1
    assert checks[1]["checked"] == round(checks[1]["entries"] / 2)
    assert not checks[0]["valid"]
    assert not checks[1]["valid"]


@pytest.mark.parametrize("what", ["entries", "nodes"])
def test_small_file_that_unpacks_to_much_is_refused_in_little_memory(braked, what):
    def much(header):
        packed = base64.b64encode(zlib.compress(bytes(50_000_000), 9)).decode()
        header["law"]["table"] = {
            "axes": [["x", [(0.0).hex(), (1.0).hex()], 6_250_000, False]],
            "nodes": {"_V": [packed, packed]},
        }

    def many(content):
        return content[:10] * 5_000_000

    forged = (
        changed(braked, much) if what == "nodes" else changed(braked, lambda h: None, entries=many)
    )
    tracemalloc.start()
    try:
        with pytest.raises(NotValidError, match="unpacks to more than"):
            check(str(forged))
        with pytest.raises(OutputError, match="unpacks to more than"):
            hf.read_certificate(forged)
        assert tracemalloc.get_traced_memory()[1] < 30_000_000
    finally:
        tracemalloc.stop()


def test_device_without_an_end_is_no_file():
    with pytest.raises(OSError, match="no file"):
        check(os.devnull)
    with pytest.raises(OutputError, match="is no file"):
        hf.read_certificate(os.devnull)


def selecting(level):
    """A law that jumps where an expression of x changes its sign."""
    from holdfast.maths.expressions.functions import select
    from tests.laws_to_judge import V as SPEED
    from tests.laws_to_judge import X as PLACE
    from tests.laws_to_judge import slider

    system, line = slider()
    at = level(PLACE)
    law = hf.Law("jumps", system.states, {"v": select(at, -PLACE, -PLACE / 2) + 0 * SPEED * 0})
    return hf.judge_law(system, line, law, box={"x": (-1, 1)}, cells=20, sample_time=0.1)


@pytest.mark.parametrize(
    "level",
    [
        lambda x: (x - 0.01) * (x + 2), lambda x: (x - 0.01) ** 2 * (x + 1.01) - 0.01,
        lambda x: (x - 0.01) / (x + 3), lambda x: (x - 0.01) * sp.exp(x),
        lambda x: (x - 0.31) * (x + 0.41), lambda x: sp.Max(x, 0), lambda x: sp.Max(x - 0.3, 0),
        lambda x: sp.Min(x, -x + 0.3),
    ],
)  # fmt: skip
def test_honest_law_whose_conditions_are_products_is_valid(tmp_path, level):
    judged = selecting(level)
    assert len(judged.certificate.kept.members) > 10
    path = judged.certificate.write(tmp_path / "jumps.holdfast")
    assert "entries hold" in check(str(path))


def test_dwell_time_beside_a_guard_and_free_modes_are_valid(tmp_path):
    from holdfast.maths.definitions.quantity import TIME_IN_MODE
    from holdfast.maths.expressions.functions import least
    from tests.laws_to_judge import X as PLACE
    from tests.laws_to_judge import slider

    system, line = slider()
    back = hf.Law("back", system.states, {"v": -PLACE})
    half = hf.Law("half", system.states, {"v": -PLACE / 2})
    guards = (
        hf.Transition("back", "half", least(0.3 - PLACE, TIME_IN_MODE - 0.3)),
        hf.Transition("half", "back", least(PLACE - 0.2, 0.2 + PLACE)),
    )
    turns = hf.Switching("turns", {"back": back, "half": half}, guards)
    any_inside = hf.Switching(
        "any", {"back": back, "any": hf.commanded(system)},
        (hf.Transition("back", "any", 0.3 - sp.Abs(PLACE)),
         hf.Transition("any", "back", sp.Abs(PLACE) - 0.4)),
    )  # fmt: skip
    for law in (turns, any_inside):
        judged = hf.judge_law(system, line, law, box={"x": (-1, 1)}, cells=40, sample_time=0.1)
        assert len(judged.certificate.kept.members) > 10, law.name
        path = judged.certificate.write(tmp_path / "law.holdfast")
        assert "entries hold" in check(str(path))


@pytest.fixture(scope="module")
def guarded(tmp_path_factory):
    from tests.laws_to_judge import X as PLACE
    from tests.laws_to_judge import slider

    system, line = slider()
    law = hf.safeguard(
        system, hf.Law("push", system.states, {"v": 0.5 + 0 * PLACE}), line, worst=("w",),
        gains=(2.0, 4.0), margins={"left": 0.1, "right": 0.1},
    )  # fmt: skip
    found = hf.judge_law(system, line, law, box={"x": (-1, 1)}, cells=64, sample_time=0.1)
    return found.certificate.write(tmp_path_factory.mktemp("guard") / "guard.holdfast")


FORGED = {
    "a negative scale": (lambda p, law: p.update(scales=["-1"]), "not above 0"),
    "a scale of nothing": (lambda p, law: p.update(scales=["0"]), "not above 0"),
    "limits that are not the bounds": (lambda p, law: p.update(limits=["1"]), "may lead to"),
    "anything wanted": (lambda p, law: p.update(wanted=None), "may (lead|fail)"),
    "anything wanted, of few parts": (
        lambda p, law: (p.update(wanted=None), law.update(parts=[[(0.0).hex(), (0.1).hex()]])),
        "parts of the inputs",
    ),
    "very many conditions": (lambda p, law: p.update(rows=p["rows"] * 500), "too many conditions"),
}


@pytest.mark.parametrize("how", FORGED)
def test_forged_program_is_refused(guarded, how):
    change, says = FORGED[how]
    forged = changed(guarded, lambda h: change(h["law"]["modes"][0][0][1], h["law"]))
    with pytest.raises(NotValidError, match=says):
        check(str(forged))


def test_table_with_axes_alone_is_refused(guarded):
    axis = ["x", [(0.0).hex(), (1.0).hex()], 10**9, False]
    forged = changed(guarded, lambda h: h["law"].update(table={"axes": [axis] * 30, "nodes": {}}))
    with pytest.raises(NotValidError, match="axes without nodes"):
        check(str(forged))


@pytest.mark.heavy
def test_condition_of_a_thousand_terms_is_read(braked):
    long = " + ".join(f"{k}*x/1000000" for k in range(1, 1000))
    options = [[f"{long} - 1/2"], [f"1/2 - ({long})"]]
    assert "entries hold" in check(with_options(braked, options))
