"""Certificates are checked by a program that shares no code: true ones hold, wrong ones do not."""

import ast
import hashlib
import math
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import sympy as sp

import holdfast as hf
from holdfast.analysis.certificates.certify import certify
from holdfast.errors import DefinitionError, SimulationError
from holdfast_check import checker
from holdfast_check.checker import NotValidError, check
from tests.certified_systems import (
    AHEAD,
    BOX,
    CART,
    LEFT,
    A,
    R,
    U,
    V,
    X,
    camera,
    cart,
    changed,
    view,
)


@pytest.fixture(scope="module")
def seen():
    return certify(camera(), view(camera()), box=BOX, cells=41, sample_time=0.1)


@pytest.fixture(scope="module")
def braked():
    return certify(*cart(), box=CART, cells=41, sample_time=0.2)


def test_view_is_certified_for_ever_and_the_checker_agrees(seen, tmp_path):
    assert seen.kept.share > 0.9
    path = seen.write(tmp_path / "view.certificate")
    count = len(seen.kept.members)
    assert check(str(path)) == f"{count} cells for ever: {count} of {count} entries hold"


def test_cart_with_an_uncertain_drag_is_certified(tmp_path):
    found = certify(*cart(), box=CART, cells=41, sample_time=0.2, uncertain={"drag": (0.1, 0.3)})
    assert found.kept.share > 0.35
    assert "entries hold" in check(str(found.write(tmp_path / "cart.certificate")))


def test_number_of_a_constraint_may_be_uncertain(tmp_path):
    """Walls anywhere within 10 cm: those that are nearest count."""
    system, _ = cart()
    wall = hf.Parameter("wall", "m", value=1.0)
    rows = (hf.Inequality("left", -wall.symbol - X), hf.Inequality("right", X - wall.symbol))
    walls = hf.Region("walls", system.states, rows, (wall,))
    found, near = (
        certify(system, replace(walls, parameters=(replace(wall, value=at),)), box=CART, cells=41,
                sample_time=0.2, uncertain=ends)
        for at, ends in ((1.0, {"wall": (0.9, 1.1)}), (0.9, None))
    )  # fmt: skip
    assert found.kept.members.tolist() == near.kept.members.tolist()
    assert len(found.kept.members)
    assert "entries hold" in check(str(found.write(tmp_path / "walls.certificate")))


def test_state_that_does_not_change_stays_in_the_grid(tmp_path):
    """A cart pushed by a bias that is a state: balls around its first and last cell stick out."""
    x, v, a, w = (hf.symbol(n) for n in "xvaw")
    states = (hf.Quantity("x", "m"), hf.Quantity("v", "m/s"), hf.Quantity("w", "m/s^2"))
    pushed = hf.System(
        "cart", states, (hf.Quantity("a", "m/s^2"),), {"x": v, "v": a + w, "w": sp.S.Zero},
        input_bounds=hf.Box((-1.0,), (1.0,)),
    )  # fmt: skip
    walls = hf.Region("walls", states, (hf.Inequality("l", -1 - x), hf.Inequality("r", x - 1)))
    found = certify(pushed, walls, box={**CART, "w": (-0.3, 0.3)},
                    cells={"x": 27, "v": 27, "w": 5}, sample_time=0.25, inputs=3)  # fmt: skip
    assert {0, 4} <= set((found.kept.members % 5).tolist())
    assert "entries hold" in check(str(found.write(tmp_path / "cart.certificate")))


def test_finite_horizon_has_levels_and_is_checked(tmp_path):
    found = certify(camera(0.6), view(camera()), box=BOX, cells=41, horizon=0.5)
    assert len(found.kept.members)
    assert len(certify(camera(0.6), view(camera()), box=BOX, cells=41).kept.members) == 0
    assert set(found.kept.entries[:, 2]) == {1, 2, 3, 4, 5}
    path = found.write(tmp_path / "some.certificate")
    assert "entries hold" in check(str(path))

    def longer(raw):
        rows = np.frombuffer(raw, dtype=[("c", "<u4"), ("i", "<u2"), ("l", "<u4")]).copy()
        rows["l"] = 6
        return rows.tobytes()

    claimed = {"holds": 6, "cells_kept": len(set(found.kept.entries[:, 0].tolist()))}
    with pytest.raises(NotValidError, match="which is not kept"):
        check(str(changed(path, lambda h: h.update(claimed), entries=longer)))
    with pytest.raises(NotValidError, match="no cell of it lasts for the horizon"):
        check(str(changed(path, lambda h: h.update(holds=100))))


def with_level(level, place):
    """The entries of a file, one of which has another level."""

    def alter(packed):
        begin = 10 * place + 6
        return packed[:begin] + level.to_bytes(4, "little") + packed[begin + 4 :]

    return alter


@pytest.mark.parametrize("level", [0, 4])
def test_level_of_no_hold_of_the_horizon_is_refused(level, tmp_path):
    """x' = 1 + u/2 is driven out of |x| <= 1: three holds have the levels 1 to 3."""
    line = hf.System(
        "line", (hf.Quantity("x", "m"),), (hf.Quantity("u", "m/s"),), {"x": 1 + U / 2},
        input_bounds=hf.Box((-1,), (1,)),
    )  # fmt: skip
    ends = hf.Region("ends", line.states, (hf.Inequality("c", sp.Abs(X) - 1, "m"),))
    found = certify(line, ends, box={"x": (-1, 1)}, cells=20, horizon=0.6, sample_time=0.2)
    levels = found.kept.entries[:, 2].tolist()
    assert {*levels} == {1, 2, 3}
    path = found.write(tmp_path / "line.certificate")
    assert "entries hold" in check(str(path))
    place = levels.index(min(levels, key=lambda k: abs(k - level)))
    with pytest.raises(NotValidError, match="no such cell, input or level"):
        check(str(changed(path, lambda h: None, entries=with_level(level, place))))


def test_entry_that_lasts_for_ever_has_no_level(braked, tmp_path):
    path = braked.write(tmp_path / "cart.certificate")
    with pytest.raises(NotValidError, match="no such cell, input or level"):
        check(str(changed(path, lambda h: None, entries=with_level(1, 0))))


@pytest.mark.heavy
def test_angle_that_turns_around_is_certified_and_checked(tmp_path):
    """A vehicle between two walls that must turn away in time, its heading over a whole turn."""
    y, psi, r = (hf.symbol(n) for n in ("y", "psi", "r"))
    car = hf.System(
        "lane", (hf.Quantity("y", "m"), hf.Quantity("psi", "rad")), (hf.Quantity("r", "rad/s"),),
        {"y": sp.sin(psi), "psi": r}, input_bounds=hf.Box((-2.0,), (2.0,)),
    )  # fmt: skip
    lane = hf.Region(
        "lane", car.states, (hf.Inequality("a", y - 1, "m"), hf.Inequality("b", -y - 1, "m"))
    )
    found = certify(
        car, lane, box={"y": (-1, 1), "psi": (-math.pi, math.pi)}, cells=51, sample_time=0.2
    )
    assert 0.5 < found.kept.share < 1
    assert found.cells.periodic == (False, True)
    path = found.write(tmp_path / "lane.certificate")
    assert "entries hold" in check(str(path))

    def apart(header):
        header["rates"] = ["sin(psi)", "r + psi/1000"]

    with pytest.raises(NotValidError, match="psi comes back after a turn"):
        check(str(changed(path, apart)))


def test_angle_that_does_not_come_back_is_no_turn():
    """A limit on the heading itself: states beyond a half turn are none of the other side."""
    y, psi, r = (hf.symbol(n) for n in ("y", "psi", "r"))
    car = hf.System(
        "lane", (hf.Quantity("y", "m"), hf.Quantity("psi", "rad")), (hf.Quantity("r", "rad/s"),),
        {"y": sp.sin(psi), "psi": r}, input_bounds=hf.Box((-2.0,), (2.0,)),
    )  # fmt: skip
    tilted = hf.Inequality("a", y - 1 + 0 * psi + psi / 100, "m")
    lane = hf.Region("lane", car.states, (tilted,), empirical="a tilted edge")
    box = {"y": (-1, 1), "psi": (-math.pi, math.pi)}
    assert certify(car, lane, box=box, cells=9).cells.periodic == (False, False)
    twice = replace(car, rates={"y": sp.sin(psi / 2), "psi": r})
    walls = hf.Region("walls", car.states, (hf.Inequality("a", y - 1, "m"),))
    assert certify(twice, walls, box=box, cells=9).cells.periodic == (False, False)
    assert certify(car, walls, box=box, cells=9).cells.periodic == (False, True)


def test_rates_that_depend_on_time_are_refused():
    driven = replace(camera(), rates={"ahead": -U + sp.sin(hf.TIME), "left": -R * AHEAD})
    with pytest.raises(DefinitionError, match="depends on time"):
        certify(driven, view(driven), box=BOX, cells=11)


@pytest.mark.parametrize("place", [0, 10, 24, 60, 200, 4000, -1])
def test_one_flipped_bit_is_refused(seen, tmp_path, place):
    path = seen.write(tmp_path / "view.certificate")
    content = bytearray(path.read_bytes())
    content[place] ^= 1
    path.write_bytes(content)
    with pytest.raises(NotValidError, match=r"is not a certificate|was changed"):
        check(str(path))


def test_wrong_rate_is_found(braked, tmp_path):
    path = braked.write(tmp_path / "cart.certificate")
    assert "entries hold" in check(str(path))

    def wrong(header):
        header["rates"][1] = "9*a/10 - drag*v + w"

    with pytest.raises(NotValidError, match="which is not kept"):
        check(str(changed(path, wrong)))


def test_doubled_sample_time_is_found(braked, tmp_path):
    path = braked.write(tmp_path / "cart.certificate")

    def doubled(header):
        header["hold"] = (0.4).hex()

    with pytest.raises(NotValidError, match=r"which is not kept|may fail on the way"):
        check(str(changed(path, doubled)))


def test_cell_too_many_is_found(braked, tmp_path):
    path = braked.write(tmp_path / "cart.certificate")
    inside = set(braked.kept.members.tolist())
    counts = braked.cells.counts
    fast = int(np.ravel_multi_index((counts[0] // 2, counts[1] - 1), counts))
    assert fast not in inside

    def more(raw):
        return raw + np.array([(fast, 0, 0)], dtype="<u4,<u2,<u4").tobytes()

    claimed = {"cells_kept": len(inside) + 1}
    with pytest.raises(NotValidError, match=f"cell {fast} "):
        check(str(changed(path, lambda h: h.update(claimed), entries=more)))
    with pytest.raises(NotValidError, match="not as many as it says"):
        check(str(changed(path, lambda h: None, entries=more)))


def test_cell_outside_the_region_is_found(seen, tmp_path):
    path = seen.write(tmp_path / "view.certificate")

    def closer(header):
        header["constraints"][0]["expression"] = "2/5 - ahead"

    with pytest.raises(NotValidError, match="is not inside constraint 0"):
        check(str(changed(path, closer)))


def test_wider_bounds_of_a_disturbance_are_found(braked, tmp_path):
    path = braked.write(tmp_path / "cart.certificate")

    def stronger(header):
        header["disturbances"][0]["range"] = [(-0.4).hex(), (0.4).hex()]

    with pytest.raises(NotValidError, match="which is not kept"):
        check(str(changed(path, stronger)))


def test_random_share_says_its_confidence(seen, tmp_path):
    path = seen.write(tmp_path / "view.certificate")
    told = check(str(path), share=0.2, seed=3)
    assert "99.9 % confidence" in told
    assert "this is no proof" in told


@pytest.mark.parametrize(
    ("options", "error", "message"),
    [
        ({"box": {"ahead": (0.3, 2.1)}}, SimulationError, "box lacks the state 'left'"),
        ({"box": {**BOX, "lefd": (0, 1)}}, SimulationError, "box names 'lefd'"),
        ({"sample_time": 0.0}, SimulationError, "sample_time is 0"),
        ({"horizon": -1.0}, SimulationError, "horizon is -1"),
        ({"cells": 0}, SimulationError, "0 cells"),
        ({"inputs": 1}, SimulationError, "1 values"),
        ({"uncertain": {"mass": (1, 2)}}, SimulationError, "'mass', which is no parameter"),
    ],
)
def test_what_cannot_be_certified_is_named(options, error, message):
    with pytest.raises(error, match=message):
        certify(camera(), view(camera()), **{"box": BOX, "cells": 11, **options})


def test_system_without_bounds_or_with_an_unknown_function_is_refused():
    free = replace(camera(), input_bounds=None)
    with pytest.raises(SimulationError, match="no bounds of its inputs"):
        certify(free, view(free), box=BOX, cells=11)
    open_ended = replace(camera(), disturbance_bounds=None)
    with pytest.raises(SimulationError, match="no bounds of its disturbances"):
        certify(open_ended, view(open_ended), box=BOX, cells=11)
    bent = {"ahead": -U, "left": sp.asin(LEFT / 9)}
    odd = replace(camera(), rates=bent, empirical="no enclosure is known of it")
    with pytest.raises(DefinitionError, match="'asin' has no proved enclosure in a certificate"):
        certify(odd, view(odd), box=BOX, cells=11)


# -- what a review found -----------------------------------------------------------------


def one_state(rate, limits, *, parameters=(), pushes=(), bounds=None):
    """xdot of one state without inputs."""
    system = hf.System(
        "line", (hf.Quantity("x"),), (), {"x": rate}, parameters=parameters,
        disturbances=pushes, disturbance_bounds=bounds,
    )  # fmt: skip
    rows = tuple(hf.Inequality(f"c{k}", e) for k, e in enumerate(limits))
    return system, hf.Region("line", system.states, rows)


@pytest.mark.heavy
def test_more_cells_than_small_numbers_count_certify_nothing_that_leaves():
    """From x > 0.3 every trajectory leaves; numbers of cells go beyond 32767."""
    found = certify(
        *one_state((X + 0.45) * (X - 0.3), [X - 2]), box={"x": (-1, 1)}, cells=40000,
        sample_time=0.002,
    )  # fmt: skip
    high = found.cells.corners(found.kept.members)[1]
    assert len(found.kept.members) > 1000
    assert high.max() < 0.31


def test_bound_that_is_largest_inside_a_range_is_counted():
    p, w = hf.symbol("p"), hf.symbol("w")
    system, region = one_state(
        -X + w, [X - 1, -1 - X], parameters=(hf.Parameter("p", value=0.5),),
        pushes=(hf.Quantity("w"),), bounds=hf.Box((-8 * p * (1 - p),), (8 * p * (1 - p),)),
    )  # fmt: skip
    found = certify(system, region, box={"x": (-1, 1)}, cells=20, uncertain={"p": (0.0, 1.0)})
    low, high = found.ranges["w"]
    assert low <= -2
    assert high >= 2
    assert len(found.kept.members) == 0


def test_one_name_with_two_values_is_refused():
    p = hf.Parameter("p", value=5.0)
    system, _ = one_state(-X + p.symbol, [X - 1], parameters=(p,))
    limit = hf.Inequality("limit", X - 1 - p.symbol)
    region = hf.Region("line", system.states, (limit,), (replace(p, value=0.0),))
    with pytest.raises(SimulationError, match="'p' is 5 in system 'line' and 0 in region"):
        certify(system, region, box={"x": (-1, 1)}, cells=20)


@pytest.mark.parametrize(
    ("rate", "message"),
    [
        (-X * 2**X, "no power"),
        (-(X ** sp.Rational(1, 3)), "no power"),
        (-X * (1 + sp.E), "has no E"),
    ],
)
def test_what_the_checker_does_not_read_is_not_certified(rate, message):
    with pytest.raises(DefinitionError, match=message):
        certify(*one_state(rate, [X - 1]), box={"x": (0, 1)}, cells=5)


def test_squares_of_states_around_zero_are_checked(tmp_path):
    """Powers stand in the file as they are."""
    found = certify(*one_state(-(X**3), [X**2 - 1]), box={"x": (-1.1, 1.1)}, cells=21)
    assert "x**2" in found.header()["constraints"][0]["expression"]
    assert found.header()["rates"] == ["-x**3"]
    assert len(found.kept.members) == 19
    assert "19 of 19 entries hold" in check(str(found.write(tmp_path / "square.holdfast")))


def test_root_of_squares_is_checked_where_a_cell_touches_zero(tmp_path):
    """A ball around [0, 1] reaches a little below 0, where a root is no number."""
    pushed, _ = cart()
    inside = hf.Inequality("c", sp.sqrt(X**2 + V**2 / 4) - 1, "m")
    disc = hf.Region("disc", pushed.states, (inside,), empirical="an ellipse of numbers")
    proved = certify(pushed, disc, box=CART, cells=20, sample_time=0.1, horizon=0.4)
    assert len(proved.kept.members) > 50
    assert "entries hold" in check(str(proved.write(tmp_path / "disc.holdfast")))


def test_certificate_of_rates_with_kinks_is_agreed_with(tmp_path):
    """No cell meets the kinks: the checker's slopes are those of the search."""
    system = hf.System(
        "bent", (hf.Quantity("x"), hf.Quantity("v")), (hf.Quantity("a"),),
        {"x": sp.Max(V, -0.666) - 0.474 * X, "v": sp.Min(-0.923 * X, 0.498) + 0.51 * A},
        input_bounds=hf.Box((-0.9,), (0.9,)),
    )  # fmt: skip
    limits = (sp.Max(sp.Abs(X) - 0.775, sp.Abs(V) - 0.769), X - 0.529)
    rows = tuple(hf.Inequality(f"c{k}", e) for k, e in enumerate(limits))
    box = {"x": (-1.2, 1.2), "v": (-1.21, 1.21)}
    room = hf.Region("room", system.states, rows)
    proved = certify(system, room, box=box, cells=20, sample_time=0.068, horizon=0.272)
    assert len(proved.kept.members) > 20
    assert "entries hold" in check(str(proved.write(tmp_path / "bent.holdfast")))


def test_names_of_functions_and_numbers_are_refused():
    number = hf.Parameter("E", value=2.5)
    with pytest.raises(DefinitionError, match="'E' is the name of a function or number"):
        certify(*one_state(-X, [X - 1], parameters=(number,)), box={"x": (0, 1)}, cells=5)


def test_constraint_of_a_value_that_does_not_exist_certifies_nothing():
    for limit in (sp.sqrt(X + 1.5) - 2, sp.sin(sp.log(X + 1.5)) - 2):
        found = certify(*one_state(-X - 1.5, [limit]), box={"x": (-2, -1)}, cells=20)
        low, _ = found.cells.corners(found.kept.region)
        assert (low >= -1.5).all()


@pytest.mark.parametrize(
    ("alter", "message"),
    [
        (lambda h: h.update(rates=["wrap(log(x-5))", "0"]), None),
        (lambda h: h.update(cells_kept=1000), "not as many"),
        (lambda h: h["inputs"][0].update(name="w"), "stands twice"),
        (lambda h: h["disturbances"][0].update(name="pi"), "function or number"),
        (lambda h: h["disturbances"][0].update(range=[(0.2).hex(), (-0.2).hex()]), "reversed"),
        (lambda h: h["disturbances"][0].update(range=["nan", "nan"]), "not finite"),
        (lambda h: h.update(constraints=[]), "are none"),
        (lambda h: h.update(hold="nan"), "hold is 'nan': it is not finite"),
        (lambda h: h.update(hold=0.2), "hold is 0.2"),
        (lambda h: h.update(hold=(-0.2).hex()), "are none"),
        (lambda h: h.update(holds=True), "holds has another form: True"),
        (lambda h: h.update(holds=0), "are none"),
        (lambda h: h.update(rates=["v", "a - drag*v + w + sin(1, **x)"]), "rates is"),
        (lambda h: h.update(rates=["v", "a - drag*v + w + sin(x, v)"]), "rates is"),
        (lambda h: h.update(rates=["v + 0*length(x, v)", "a - drag*v + w"]), "rates is"),
        (lambda h: h.update(rates=["v + sin", "a - drag*v + w"]), "rates is"),
        (lambda h: h.update(rates=["v + 0*x**999", "a - drag*v + w"]), "the exponent 999"),
        (lambda h: h.update(rates=["v + 0*time_in_mode", "a"]), "undeclared name time_in_mode"),
        (lambda h: h.update(rates=["v + 0*(1/(x - x))", "a"]), "no box of the states"),
        (lambda h: h["constraints"][0].update(expression="least(-1 - x, f(x))"), "expression is"),
        (lambda h: h["constraints"][0].update(expression="-1 - x + 0*a"), "undeclared name a"),
        (lambda h: h.update(wind=1), r"the header has another form: \['wind'\]"),
        (lambda h: h["states"][0].update(offset="1"), r"states has another form: \['offset'\]"),
        (lambda h: h.pop("delay"), r"another form: \['delay'\]"),
        (lambda h: h.update(depth=True), "depth has another form: True"),
        (lambda h: h.update(edges=[h["edges"][0][::-1], h["edges"][1]]), "do not grow"),
        (lambda h: h["edges"][0].__setitem__(0, "-inf"), "not finite"),
        (lambda h: h.update(errors=h["errors"][:1]), "do not go together"),
        (lambda h: h.update(errors=[h["errors"][0], (-1e-9).hex()]), "the errors are none"),
        (lambda h: h.update(cells_kept=float(h["cells_kept"])), "cells_kept has another form"),
        (lambda h: h.update(candidates=[]), "are none"),
        (lambda h: h.update(law={}), "law has another form"),
    ],
)
def test_malformed_headers_are_not_valid(braked, tmp_path, alter, message):
    path = changed(braked.write(tmp_path / "cart.certificate"), alter)
    with pytest.raises(NotValidError, match=message):
        check(str(path))


def test_key_that_stands_twice_and_a_file_without_entries_are_not_valid(braked, tmp_path):
    path = braked.write(tmp_path / "cart.certificate")
    text, _, packed = path.read_bytes().partition(b"\n")[2].partition(b"\n")
    twice = text.replace(b'{"candidates"', b'{"rates":["0","0"],"candidates"', 1)
    content = twice + b"\n" + packed
    first = f"holdfast-certificate 1 {hashlib.sha256(content).hexdigest()}\n".encode()
    path.write_bytes(first + content)
    with pytest.raises(NotValidError, match="stands twice"):
        check(str(path))
    path = braked.write(tmp_path / "other.certificate")
    empty = changed(path, lambda h: h.update(cells_kept=0), entries=lambda raw: b"")
    with pytest.raises(NotValidError, match="has not the 0 entries"):
        check(str(empty))


def test_checker_is_short_enough_to_be_read():
    """Lines of code, those with more than a comment or a text that explains, are those of the page."""
    count = {}
    for file in Path(checker.__file__).parent.glob("*.py"):
        source, explained = file.read_text(encoding="utf-8"), set()
        for node in ast.walk(ast.parse(source)):
            if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant):
                explained |= set(range(node.lineno, node.end_lineno + 1))
        lines = {k for k, line in enumerate(source.splitlines(), 1) if line.strip()}
        count[file.stem] = len(lines - explained)
    page = (Path(__file__).parents[3] / "docs/certificates.md").read_text("utf-8")
    said = re.search(r"the checker: some ([\d,]+) lines of code, (\d+) of them for flowpipes", page)
    every, of_flowpipes = (int(n.replace(",", "")) for n in said.groups())
    assert every == pytest.approx(sum(count.values()), rel=0.05)
    assert of_flowpipes == pytest.approx(count["flowpipe"] + count["taylor"], rel=0.05)


def test_angle_that_turns_faster_than_doubles_count_leaves_no_cell_unchecked(tmp_path):
    """x leaves in one hold; the turns of an angle at 1e19 rad/s are not the doubles' to count."""
    x = hf.symbol("x")
    system = hf.System(
        "top", (hf.Quantity("th", "rad"), hf.Quantity("x", "m")), (),
        {"th": sp.Integer(2), "x": sp.Rational(-1, 4) * x},
    )  # fmt: skip
    end = hf.Region("end", system.states, (hf.Inequality("c", x - sp.Rational(3, 2), "m"),))
    found = certify(system, end, box={"th": (-math.pi, math.pi), "x": (-3, 3)},
                    cells={"th": 2, "x": 6}, sample_time=0.25)  # fmt: skip
    assert found.cells.periodic == (True, False)
    path = found.write(tmp_path / "top.certificate")
    assert "entries hold" in check(str(path))
    with pytest.raises(NotValidError):
        check(str(changed(path, lambda h: h.update(rates=["10**19", "1"]))))


@pytest.mark.parametrize(
    "alter",
    [
        lambda h: h.update(errors=[(-0.1).hex(), (0.0).hex()]),
        lambda h: h["states"][0].update(name="True"),
        lambda h: h["states"][0].update(name="\ufb01"),
        lambda h: h.update(periodic=["false", False]),
        lambda h: h.update(rates=dict.fromkeys(h["rates"])),
        lambda h: h["constraints"][0].update(expression="greatest()"),
        lambda h: h["constraints"][0].update(expression="True"),
    ],
)
def test_header_of_another_form_is_refused(seen, tmp_path, alter):
    path = changed(seen.write(tmp_path / "view.certificate"), alter)
    with pytest.raises(NotValidError):
        check(str(path), share=0.01)


def test_wrong_claim_is_not_valid_and_a_file_that_is_none_cannot_be_read(
    braked, tmp_path, monkeypatch, capsys
):
    """Whatever stands in a header whose digest is right is a claim, and a wrong one."""
    forged = changed(
        braked.write(tmp_path / "cart.certificate"), lambda h: h.update(rates=[None, 1])
    )
    for path, status, said in (
        (forged, 1, "NOT valid: rates is None"),
        (tmp_path / "none", 2, "cannot be read"),
    ):
        monkeypatch.setattr("sys.argv", ["holdfast-check", str(path)])
        with pytest.raises(SystemExit) as stopped:
            checker.main()
        assert stopped.value.code == status
        assert said in "".join(capsys.readouterr())
