"""Laws with modes, jumps, a safeguard, a table: what is proved of them holds in closed loop."""

from base64 import b64decode, b64encode
from dataclasses import replace
from functools import cache
from zlib import compress, decompress

import numpy as np
import pytest

import holdfast as hf
from holdfast.analysis.certificates.law_cells import law_of_cases
from holdfast.analysis.certificates.law_keeps import judge_law
from holdfast.analysis.safety.safety_filter import safety_law
from holdfast.errors import DefinitionError, SimulationError
from holdfast.execution.intervals.law_ranges import LawRanges
from holdfast.maths.expressions.functions import least, select, sgn
from holdfast_check.checker import NotValidError, check
from tests.certified_systems import changed
from tests.laws_to_judge import (
    VIEW,
    V,
    W,
    X,
    boat,
    camera,
    forward,
    guarded,
    slider,
    thermostat,
    view,
)

LINE = {"box": {"x": (-1, 1)}, "cells": 64}
CORNERS = ({"w": -0.3}, {"w": 0.3})


def judged(law, **more):
    return judge_law(*slider(), law, **{**LINE, **more})


@cache
def seen():
    """The view that a guarded law keeps."""
    system = camera()
    law = guarded(system, forward(system))
    return law, hf.certify(system, view(system), law=law, box=VIEW, cells=101, sample_time=0.1)


@cache
def berthed():
    """A berth that the filter of its kernel keeps, whatever is commanded."""
    system, berth = boat()
    value = hf.discriminating_kernel(
        system, berth, hf.grid(system, {"x": (-1.2, 1.2), "y": (-1.2, 1.2)}, 121), 10.0
    )
    law = safety_law(
        system, value, hf.commanded(system), rate=4.0, margin=0.15, sample_time=0.1, ahead=False
    )
    found = hf.certify(
        system, berth, law=law, box={"x": (-1, 1), "y": (-1, 1)}, cells=80, sample_time=0.1,
        inputs=10,
    )  # fmt: skip
    return system, berth, law, found


def starts_in(found, count, seed):
    rng = np.random.default_rng(seed)
    low, high = found.cells.corners(rng.choice(found.kept.members, count))
    return low + (high - low) * rng.random(low.shape)


def all_stay(system, region, law, found, currents, count=500, **options):
    """Runs from certified cells never leave the region, under each of these disturbances."""
    starts = starts_in(found, count, 8)
    for current in currents:
        runs = hf.simulate(
            system, law, starts=starts, region=region, sample_time=0.1, disturbance=current,
            **{"horizon": 10, **options},
        )  # fmt: skip
        assert runs.outcomes["stayed"] == count


# -- modes and jumps --------------------------------------------------------------------------


def test_modes_with_hysteresis_are_proved_and_checked(tmp_path):
    found = judged(thermostat())
    assert found.verdict == "proved"
    kept = found.certificate.kept
    assert len(kept.entries) == 2 * len(kept.members)  # in both modes
    path = found.certificate.write(tmp_path / "modes.certificate")
    assert "128 of 128 entries hold" in check(str(path))
    again = hf.read_certificate(path).write(tmp_path / "again.certificate")
    assert again.read_bytes() == path.read_bytes()
    all_stay(*slider(), thermostat(), found.certificate, CORNERS)


def test_modes_that_turn_too_late_are_refuted_by_a_trajectory_that_is_true():
    found = judged(thermostat(on=1.5, off=-1.5))
    assert found.verdict == "refuted"
    path = found.leaving
    assert abs(path.start["x"]) < 1
    x, w = path.start["x"], path.held["w"]
    for low, high in zip(path.low[:, 0], path.high[:, 0], strict=True):
        assert low - 1e-12 <= x <= high + 1e-12
        x += 0.1 * (-0.6 + w)  # it begins to the left, and does not turn
    assert np.abs(path.low[-1, 0]) > 1


def test_modes_of_which_it_is_not_certain_when_they_turn_are_undecided():
    """From 0.909 on it turns, and moves by 0.09 before: that ends at 0.999, but the cell is wide."""
    found = judged(thermostat(on=0.909, off=-0.909))
    assert found.verdict == "undecided"
    assert judged(thermostat(on=0.9, off=-0.9)).verdict == "proved"


def test_only_cells_in_the_first_mode_count_and_the_other_mode_may_lose_them():
    """In the mode that stands still nothing is kept; it is never in it."""
    states = slider()[0].states
    modes = {"back": hf.Law("back", states, {"v": -X}), "off": hf.Law("off", states, {"v": 0 * X})}
    law = hf.Switching("one", modes, (hf.Transition("back", "off", X - 5),))
    found = judged(law)
    assert found.verdict == "proved"
    assert set(found.certificate.kept.entries[:, 1]) == {0}
    assert judged(replace(law, initial="off")).verdict == "refuted"


def test_dwell_in_a_mode_may_be_over_or_not():
    """The guard waits 0.3 s: a proof may not count with its turn, nor without it."""
    turns = thermostat().transitions
    dwell = hf.TIME_IN_MODE - 0.3
    slow = replace(
        thermostat(), transitions=tuple(replace(t, when=least(t.when, dwell)) for t in turns)
    )
    assert judged(thermostat()).verdict == "proved"
    assert judged(slow).verdict == "undecided"
    brief = replace(  # the turn back has a dwell that nothing depends on
        thermostat(speed=0.2),
        modes={
            "left": hf.Law("left", slider()[0].states, {"v": -X}),
            "right": hf.Law("right", slider()[0].states, {"v": -0.9 * X}),
        },
        transitions=(hf.Transition("left", "right", dwell), hf.Transition("right", "left", X)),
    )
    assert judged(brief).verdict == "proved"


@pytest.mark.parametrize("law", [-0.6 * sgn(X), select(X, -0.6 + 0 * X, 0.6 + 0 * X)])
def test_law_that_jumps_is_split_at_its_jump_and_checked(tmp_path, law):
    found = judged(hf.Law("bang", slider()[0].states, {"v": law}))
    assert found.verdict == "proved"
    assert len(found.certificate.sampling.law.options[0]) == 2
    check(str(found.certificate.write(tmp_path / "bang.certificate")))


def test_state_on_the_edge_of_a_cell_at_a_jump_has_both_inputs():
    """At x = 1/2, an edge of cells, a law turns to pushing outward: it does so from there on."""
    back = select(X - 0.5, 0.9 + 0 * X, -X)
    states = slider()[0].states
    modes = {"in": hf.Law("in", states, {"v": -X}),
             "out": hf.Law("out", states, {"v": 0.9 + 0 * X})}  # fmt: skip
    turns = (hf.Transition("in", "out", X - 0.5), hf.Transition("out", "in", 0.5 - X - 1e-9))
    for law in (hf.Law("jump", states, {"v": back}), hf.Switching("turns", modes, turns)):
        kept = judged(law).certificate.kept
        _, high = kept.cells.corners(kept.members)
        assert high.max() == 0.46875  # the cell below that of which x = 1/2 is the edge


def test_law_with_a_delay_may_have_given_any_of_its_inputs_before(tmp_path):
    law = hf.Law("back", slider()[0].states, {"v": -2 * X})
    found = judged(law, delay=0.02, errors={"x": 0.005}).certificate
    assert found.sampling.under_way == ((-1.0, 1.0),)
    assert found.kept.share > 0.9
    path = found.write(tmp_path / "late.certificate")
    assert "entries hold" in check(str(path))

    def narrower(header):
        header["law"]["under_way"] = [[(-0.1).hex(), (0.1).hex()]]

    with pytest.raises(NotValidError, match="none that may be under way"):
        check(str(changed(path, narrower)))


def test_law_reaches_a_target_in_the_periods_that_are_promised(tmp_path):
    system, line = slider()
    middle = hf.Region(
        "middle", system.states, (hf.Inequality("a", X - 0.5), hf.Inequality("b", -0.5 - X))
    )
    law = hf.Law("back", system.states, {"v": -0.8 * sgn(X)})
    found = hf.certify(system, line, target=middle, law=law, horizon=2.0, **LINE)
    assert found.kept.share == 1
    assert found.kept.holds == round(found.kept.entries[:, 2].max())
    assert "reach the target" in check(str(found.write(tmp_path / "to.certificate")))
    gap = 0.5 / (0.8 - 0.3)  # seconds that the worst current takes from the end of the line
    assert gap <= found.kept.holds * 0.1 <= 2 * gap


# -- forged files -----------------------------------------------------------------------------


@pytest.fixture(scope="module")
def modes(tmp_path_factory):
    """The file of a law with two modes."""
    folder = tmp_path_factory.mktemp("modes")
    return judged(thermostat()).certificate.write(folder / "modes.certificate")


def alter(path, change):
    def changes(header):
        change(header["law"])

    return str(changed(path, changes))


@pytest.mark.parametrize(
    "change",
    [
        lambda law: law["modes"][0].pop(),  # no option is left where it does not turn
        lambda law: law["modes"][0].pop(0),
        lambda law: law["modes"][0][0].__setitem__(0, ["x+1"]),  # it turns at -1, not at -1/2
        lambda law: law["modes"][0][0].__setitem__(2, 7),  # to a mode that is none
        lambda law: law["modes"][0][1].__setitem__(1, ["-6"]),
        lambda law: law.update(initial=2),
        lambda law: law.update(initial=False),
        lambda law: law["modes"][0][0].__setitem__(0, "x"),  # a text, not a list of one
        lambda law: law.update(wind=0),
    ],
    ids=["option", "turn", "guard", "target", "input", "first", "flag", "text", "key"],
)
def test_forged_modes_are_found(modes, change):
    with pytest.raises(NotValidError):
        check(alter(modes, change))


@pytest.mark.parametrize("gap", ["33/64", "65/128", "129/256"])
def test_law_that_does_nothing_in_a_part_of_a_cell_is_found(modes, gap):
    """It turns from -1/2 - a gap on, and moves on above -1/2: it is told nothing between."""
    with pytest.raises(NotValidError, match=r"cell 15 .*: the law does nothing in a part of it"):
        check(alter(modes, lambda law: law["modes"][0][0].__setitem__(0, [f"x + {gap}"])))


def test_inputs_that_were_tried_beside_those_of_a_law_are_refused(modes):
    with pytest.raises(NotValidError, match="the inputs are none"):
        check(str(changed(modes, lambda h: h.update(candidates=[["0x0.0p+0"]]))))


def test_entry_of_a_mode_that_is_not_kept_is_found(tmp_path):
    """The mode that stands still keeps no cell: an entry of it is forged."""
    states = slider()[0].states
    modes = {"back": hf.Law("back", states, {"v": -X}), "off": hf.Law("off", states, {"v": 0 * X})}
    law = hf.Switching("one", modes, (hf.Transition("back", "off", X - 5),))
    path = judged(law).certificate.write(tmp_path / "one.certificate")
    forged = changed(
        path, lambda h: None, entries=lambda raw: raw + raw[-10:-6] + b"\1\0" + raw[-4:]
    )
    with pytest.raises(NotValidError, match="cell 63"):
        check(str(forged))


def test_law_of_a_certificate_that_is_read_is_checked_for_its_form(modes):
    for change, says in (
        (lambda law: law["modes"][0][0].__setitem__(2, 7), "a mode that there is none of"),
        (lambda law: law.update(where=[["x", "1"]]), "other parts: where"),
        (lambda law: law["modes"][0][0].__setitem__(1, ["y"]), "y"),
    ):
        with pytest.raises(hf.HoldfastError, match=says):
            hf.read_certificate(alter(modes, change))


# -- safeguards, tables, and what others command ------------------------------------------------


def kept_in_line(law):
    margins = {"left": 0.1, "right": 0.1}
    return hf.safeguard(
        *(slider()[0], law, slider()[1]), worst=("w",), gains=(2.0, 4.0), margins=margins
    )


def filtered(law, rate=4.0):
    """The filter of the kernel of the line."""
    system, line = slider()
    grid = hf.grid(system, {"x": (-1.2, 1.2)}, 241)
    value = hf.discriminating_kernel(system, line, grid, 5.0)
    return safety_law(system, value, law, rate=rate, margin=0.15, sample_time=0.1, ahead=False)


def outward(t, states):
    """Half of the runs are pushed out by their commands, the others by chance."""
    wild = np.random.default_rng(round(10 * t)).uniform(-2, 2, states.shape)
    return np.where(np.arange(len(states))[:, None] % 2, wild, 3 * states)


@pytest.mark.heavy
@pytest.mark.parametrize("keep", [kept_in_line, filtered], ids=["safeguard", "filter"])
def test_line_is_kept_whatever_is_commanded(tmp_path, keep):
    system, line = slider()
    law = keep(hf.commanded(system))
    found = judged(law, inputs=20)
    assert found.verdict == "proved"
    path = found.certificate.write(tmp_path / "any.certificate")
    assert "64 of 64 entries hold" in check(str(path))
    again = hf.read_certificate(path).write(tmp_path / "again.certificate")
    assert again.read_bytes() == path.read_bytes()
    all_stay(system, line, law, found.certificate, CORNERS, command=outward)
    push = hf.Law("push", system.states, {"v": 0.5 + 0 * X})
    assert judged(push).verdict == "refuted"
    assert judged(keep(push)).verdict == "proved"


def test_forged_safeguard_is_found(tmp_path):
    """Without what pushes back, without its conditions, and with these reversed."""
    push = hf.Law("push", slider()[0].states, {"v": 0.5 + 0 * X})
    path = judged(kept_in_line(push)).certificate.write(tmp_path / "guard.certificate")

    def program(law):
        return law["modes"][0][0][1]

    changes = (
        lambda law: program(law).update(rows=program(law)["rows"][: program(law)["hard"]]),
        lambda law: law["modes"].__setitem__(0, [[[], program(law)["wanted"], 0]]),
        lambda law: program(law).update(
            rows=[[f"-({e})" for e in r] for r in program(law)["rows"]]
        ),
        lambda law: program(law).update(hard=99),
        lambda law: program(law).update(wanted=["v"]),
        lambda law: program(law).update(scales=[]),
    )
    for change in changes:
        with pytest.raises(NotValidError):
            check(alter(path, change))


def test_forged_table_is_found(tmp_path):
    """A kernel in which every place is deep inside lets every command pass."""
    path = judged(filtered(hf.commanded(slider()[0])), inputs=20).certificate.write(
        tmp_path / "filter.certificate"
    )

    def deeper(law):
        ends = law["table"]["nodes"]["_V"]
        values = np.frombuffer(decompress(b64decode(ends[0]))) + 5.0
        ends[:] = 2 * [b64encode(compress(values.tobytes())).decode()]

    def holed(law):
        """NaN at every second node, and deep places at the others."""
        ends = law["table"]["nodes"]["_V"]
        values = np.frombuffer(decompress(b64decode(ends[0]))).copy() + 5.0
        values[1::2] = np.nan
        ends[:] = 2 * [b64encode(compress(values.tobytes())).decode()]

    def flat(law):
        nodes = law["table"]["nodes"]
        nodes["_V0"] = nodes["_V"]

    def axis(place, value):
        return lambda law: law["table"]["axes"][0].__setitem__(place, value)

    for forged in (
        deeper, holed, axis(0, "log(x - 9)"), axis(0, "0"), axis(1, ["0x0p+0"] * 2),
        axis(2, 240), axis(2, 0), axis(3, 0), lambda law: law.update(parts=[]),
        lambda law: law.update(parts=[[]]), lambda law: law["parts"][0].reverse(),
    ):  # fmt: skip
        with pytest.raises(NotValidError):
            check(alter(path, forged))
    with pytest.raises(hf.HoldfastError, match="not those of its values"):
        hf.read_certificate(alter(path, flat))


@pytest.mark.heavy
def test_safeguard_keeps_the_view_that_its_law_would_lose(tmp_path):
    system, (law, found) = camera(), seen()
    assert judge_law(system, view(system), forward(system), box=VIEW, cells=31).verdict == "refuted"
    assert found.kept.share > 0.99
    assert "no proof" in check(str(found.write(tmp_path / "guard.certificate")), 0.02)
    corners = [{"wa": wa, "wb": wb} for wa in (-0.05, 0.05) for wb in (-0.1, 0.1)]
    finely = {"horizon": 15, "substeps": 5, "record_every": 0.1}
    all_stay(system, view(system), law, found, corners, 1000, **finely)


@pytest.mark.heavy
def test_filter_of_a_kernel_keeps_the_berth_whatever_is_commanded(tmp_path):
    system, berth, law, found = berthed()
    assert found.kept.share > 0.99
    assert "no proof" in check(str(found.write(tmp_path / "filter.certificate")), 0.02)
    corners = [{"a": a, "b": b} for a in (-0.1, 0.1) for b in (-0.1, 0.1)]
    finely = {"substeps": 2, "record_every": 0.1, "command": outward}
    all_stay(system, berth, law, found, corners, 1000, **finely)


# -- the options of the simulated law ----------------------------------------------------------


def applied(system, law, states, **more):
    """What the simulator applies at states in the first mode, from its records."""
    runs = hf.simulate(
        system, law, starts=states, horizon=0.1, sample_time=0.1, record_every=0.1,
        start_outside=True, **more,
    )  # fmt: skip
    return runs.dataset["input"].values[:, 0]


def is_among(system, law, states, given):
    """Whether an option of boxes as narrow as rounding has the inputs, at each of the states."""
    bounds = system.input_bounds
    parts = tuple(tuple(np.linspace(float(a), float(b), 11)) for a, b in bounds.ranges())
    cases = law_of_cases(system, law, {}, 0.1, parts)
    symbols = [[q.symbol for q in group] for group in (system.states, system.inputs)]
    found = LawRanges(cases, *symbols, {}).given(cases.initial, states - 1e-12, states + 1e-12)
    inside = (found.low - 1e-8 <= given[found.row]) & (given[found.row] <= found.high + 1e-8)
    return np.bincount(found.row[inside.all(axis=1)], minlength=len(states)) > 0


def drawn(count, low, high):
    low, high = np.array(low), np.array(high)
    return low + (high - low) * np.random.default_rng(7).random((count, len(low)))


PUSH = {"v": select(X - 0.3, -X, 0.7 * sgn(X))}


@pytest.mark.few("jumps")
@pytest.mark.parametrize(
    "law",
    [
        thermostat(),
        hf.Law("jumps", slider()[0].states, PUSH),
        kept_in_line(hf.Law("jumps", slider()[0].states, PUSH)),
        hf.safeguard(  # of which the conditions exclude each other nearly everywhere
            *(slider()[0], hf.Law("jumps", slider()[0].states, PUSH), slider()[1]), gains=(0.5, 1.0),
            margins={"left": 1.2, "right": 1.2},
        ),
    ],
    ids=["modes", "jumps", "guarded", "relaxed"],
)  # fmt: skip
def test_inputs_of_the_simulator_are_among_the_options(law):
    states = drawn(100_000, [-1.2], [1.2])
    assert is_among(slider()[0], law, states, applied(slider()[0], law, states)).all()


def test_inputs_of_a_filter_are_among_the_options():
    push = hf.Law("push", slider()[0].states, {"v": 0.8 - 0.1 * X})
    law, states = filtered(push), drawn(20_000, [-1.19], [1.19])
    assert is_among(slider()[0], law, states, applied(slider()[0], law, states)).all()


@pytest.mark.heavy
def test_inputs_of_the_guarded_camera_are_among_the_options():
    """Beyond the view too, where the safeguard is relaxed."""
    system, law = camera(), guarded(camera(), forward(camera()))
    states = drawn(100_000, [0.2, -0.7], [2.2, 0.7])
    assert is_among(system, law, states, applied(system, law, states)).all()


# -- what is refused ---------------------------------------------------------------------------


def test_input_that_nothing_limits_and_others_command_is_refused():
    system, line = slider()
    free = replace(system, input_bounds=None)
    with pytest.raises(SimulationError, match="may be anything"):
        hf.certify(free, line, law=hf.commanded(free), **LINE)


@pytest.mark.parametrize(
    ("law", "says"),
    [
        (hf.Law("timed", slider()[0].states, {"v": X * hf.TIME}), "uses the time"),
        (hf.limit_rates(slider()[0], hf.Law("slow", slider()[0].states, {"v": -X}), {"v": 0.1}),
         "remembers"),
    ],
)  # fmt: skip
def test_law_that_no_cell_decides_is_refused(law, says):
    with pytest.raises((SimulationError, DefinitionError), match=says):
        judged(law)


def test_disturbance_that_a_law_measures_is_any_within_its_bounds():
    """Cancelled where it is measured now; it may be another the moment after."""
    system = slider()[0]
    law = hf.Law("cancels", (*system.states, *system.disturbances), {"v": -0.2 * X - W})
    found = judged(law)
    assert found.verdict != "proved"
    assert judged(replace(law, outputs={"v": -0.9 * X - 0.3 * W})).verdict == "proved"
    assert V not in law.outputs["v"].free_symbols
