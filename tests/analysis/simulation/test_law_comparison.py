"""Laws side by side: the same starts, honest rates, a table that can be read."""

import json
import math

import matplotlib.pyplot as plt
import numpy as np
import pytest

import holdfast as hf
from holdfast.analysis.simulation.law_comparison import Rate
from holdfast.errors import HoldfastError
from holdfast.presentation.studies.comparison import comparison_text
from tests.command_line import called

CART = """
[scenario]
title = "A cart before a wall"

[system]
states = { x = { unit = "m" }, v = { unit = "m/s" } }
inputs = { a = { unit = "m/s^2", bounds = ["-a_max", "a_max"] } }
parameters = { a_max = { value = 1.0, unit = "m/s^2" } }
rates = { x = "v", v = "a" }

[region]
constraints = { wall = { expression = "x - 1", unit = "m" } }

[law]
empirical = "numbers"
outputs = { a = "-4*(x - 0.95) - 1*v" }

[safeguard]
gains = [1.0, 4.0]

[goal]
empirical = "numbers"
constraints = { there = "max(abs(x - 0.95), abs(v)) - 0.02" }

[starts]
random = 40
box = { x = [-1, 0.9] }

[run]
horizon = 30
seed = 3

[compare]
title = "guarded"
laws = { unguarded = { without = ["safeguard"] } }
cases = { strong = { title = "strong motor", system = { parameters = { a_max = 3.0 } } }, weak = {} }
"""


@pytest.fixture(scope="module")
def cart(tmp_path_factory):
    path = tmp_path_factory.mktemp("cart") / "cart.toml"
    path.write_text(CART)
    return str(path)


@pytest.fixture(scope="module")
def found(cart):
    return hf.compare(cart)


def test_every_law_meets_every_case(found):
    assert list(found.laws) == ["cart", "unguarded"]
    assert found.laws["cart"] == "guarded"
    assert list(found.cases.values()) == ["strong motor", "weak"]
    assert {(t.law, t.case) for t in found.trials} == {
        (law, case) for law in found.laws for case in found.cases
    }


def test_rates_are_those_of_running_each_law_on_its_own(found, cart):
    alone = hf.load_scenario(cart).run()
    assert found.viable("cart", "weak").count == alone.viable == 40
    assert found.rescued("cart", "weak").count == alone.outcomes["reached goal"]
    loose = hf.load_scenario(cart, ["safeguard="]).run()
    assert found.viable("unguarded", "weak").count == loose.viable < 40


def test_laws_of_a_case_start_from_the_same_states(cart):
    a, b = (
        hf.load_scenario(cart, c).run().dataset["state"].values[:, 0] for c in ([], ["safeguard="])
    )
    assert np.array_equal(a, b)


@pytest.mark.parametrize(("count", "total"), [(0, 50), (50, 50), (198, 203), (1, 3)])
def test_interval_is_wilsons(count, total):
    p, z = count / total, 1.959963984540054
    assert math.erf(z / math.sqrt(2)) == pytest.approx(0.95)
    centre = (p + z * z / (2 * total)) / (1 + z * z / total)
    half = z / (1 + z * z / total) * math.sqrt(p * (1 - p) / total + z * z / (4 * total**2))
    assert Rate(count, total).interval == pytest.approx((centre - half, centre + half), abs=1e-9)


def test_law_of_another_scenario_can_be_named(cart, tmp_path):
    other = tmp_path / "other.toml"
    other.write_text(CART.replace("-4*(x - 0.95) - 1*v", "-(x - 0.95) - 2*v"))
    found = hf.compare(cart, ["cart", str(other)], ["weak"], runs=5)
    assert found.laws[str(other)] == "law of other"
    assert found.of(str(other), "weak").viable.all()


def test_detour_is_the_path_over_the_shortest_of_any_law(tmp_path):
    """In the plane: one law goes straight, the other around a corner."""
    path = tmp_path / "plane.toml"
    path.write_text(
        '[scenario]\ntitle = "plane"\n'
        '[system]\nstates = { x = { unit = "m" }, y = { unit = "m" } }\n'
        'inputs = { a = { unit = "m/s" }, b = { unit = "m/s" } }\nrates = { x = "a", y = "b" }\n'
        '[region]\nconstraints = { room = "hypot(x, y) - 9" }\n'
        '[law]\nempirical = "numbers"\noutputs = { a = "-x", b = "-y" }\n[goal]\nname = "near_origin"\n'
        "[starts]\nstates = [{ x = 3, y = 4 }]\n[run]\nhorizon = 30\nrecord_every = 0.02\n"
        '[compare.laws.corner]\nwithout = ["law"]\n'
        'law = { empirical = "numbers", outputs = { a = "-x*clip((y - 4)*(0 - 1) - 3.9, 0, 1)*10", b = "-y" } }\n'
    )
    found = hf.compare(str(path))
    assert list(found.cases) == ["as it is"]
    assert found.of("plane", "as it is").length == pytest.approx([5.0], abs=0.01)
    assert found.detours("corner", "as it is") == pytest.approx([7 / 5], abs=0.05)


def test_table_and_figure_name_laws_cases_and_what_was_counted(found):
    text = comparison_text(found)
    for word in (
        "guarded",
        "unguarded",
        "strong motor",
        "viable",
        "rescued",
        "Wilson",
        "40 starts",
    ):
        assert word in text
    assert max(map(len, text.splitlines())) < 130
    figure = hf.comparison_figure(found)
    figure.canvas.draw()
    labels = [t.get_text() for t in figure.legends[0].get_texts()]
    assert labels[:2] == ["guarded", "unguarded"]
    assert [t.get_text() for t in figure.axes[0].get_yticklabels()] == ["strong motor", "weak"]
    plt.close(figure)


@pytest.mark.parametrize(
    ("laws", "cases", "complaint"),
    [
        (["cort"], None, "did you mean 'cart'"),
        (None, ["week"], "did you mean 'weak'"),
        (["cart", "cart"], None, "named twice"),
        (["inspection"], None, "needs 'y', which system 'system' does not have"),
    ],
)
def test_what_cannot_be_compared_is_refused(cart, laws, cases, complaint):
    with pytest.raises(HoldfastError, match=complaint):
        hf.compare(cart, laws, cases)


def test_a_comparison_needs_a_region():
    with pytest.raises(HoldfastError, match=r"needs a \[region\]"):
        hf.compare("ch3-known-current")


def test_command_writes_the_table_and_the_numbers(cart, tmp_path):
    laws = ("--laws", "unguarded,cart")
    answer = called("compare", cart, "--runs", "6", *laws, "--out", tmp_path / "out")
    assert answer.returncode == 0, answer.stderr
    assert "of 6 starts" in answer.stdout
    names = sorted(p.name for p in (tmp_path / "out").iterdir())
    assert names == ["comparison.json", "comparison.png", "comparison.svg", "comparison.txt"]
    numbers = json.loads((tmp_path / "out" / "comparison.json").read_text())
    assert list(numbers["laws"]) == ["unguarded", "cart"]
    assert len(numbers["trials"]) == 4
    assert numbers["trials"][0]["viable"]["interval"][0] >= 0


@pytest.mark.heavy
def test_starts_can_be_put_where_two_constraints_are_active():
    scenario = hf.load_scenario(
        "inspection",
        ["run.horizon=2", 'starts.active=[["edge_low", "too_far"], ["edge_high", "too_near"]]'],
        runs=23,
    )
    data = scenario.run().dataset
    c = data["constraint"].values[:, 0]
    drawn = c[3:]
    assert np.abs(drawn[0::2][:, [0, 3]]).max() < 1e-8
    assert np.abs(drawn[1::2][:, [1, 2]]).max() < 1e-8
    assert drawn.max() <= 0
    assert len(np.unique(data["state"].values[3:, 0, 0].round(6))) == 20


@pytest.mark.few("[[]]-group of active inequalities is empty")
@pytest.mark.parametrize(
    ("active", "complaint"),
    [
        ('[["edge_lo"]]', "did you mean 'edge_low'"),
        ("[[]]", "group of active inequalities is empty"),
        ('[["too_near", "too_far"]]', "too_near and too_far are active together"),
    ],
)
def test_edges_that_do_not_meet_are_refused(active, complaint):
    with pytest.raises(HoldfastError, match=complaint):
        hf.load_scenario("inspection", [f"starts.active={active}"], runs=8).run()
