"""The verdict says what is proved: no two files that prove different things have the same one."""

import json
import math
import sys
from fractions import Fraction

import pytest
import sympy as sp

import holdfast as hf
from holdfast.studies.law_certification import judged_law
from holdfast_check.checker import NotValidError, checked, main, verdict
from holdfast_check.intervals import Expression
from holdfast_check.statement import _readable, lines
from tests.certified_systems import changed

H = float.hex


X, V, A, W = (hf.symbol(n) for n in "xvaw")
STATES = (hf.Quantity("x", "m"), hf.Quantity("v", "m/s"))
WALLS = hf.Region(
    "walls", STATES, (hf.Inequality("l", -1 - X, "m"), hf.Inequality("r", X - 1, "m"))
)


def cart(push):
    """On a floor, pushed either way by so much, between two walls."""
    return hf.System(
        "cart", STATES, (hf.Quantity("a", "m/s^2"),), {"x": V, "v": A + W},
        disturbances=(hf.Quantity("w", "m/s^2"),), input_bounds=hf.Box((-1.0,), (1.0,)),
        disturbance_bounds=hf.Box((-push,), (push,)),
    )  # fmt: skip


@pytest.fixture(scope="module")
def path(tmp_path_factory):
    found = hf.certify(
        cart(0.3), WALLS, box={"x": (-1, 1), "v": (-2, 2)}, cells=31, sample_time=0.2, inputs=3
    )
    return found.write(tmp_path_factory.mktemp("cart") / "cart.holdfast")


def said(path, **options):
    return "\n".join(lines(checked(str(path), **options)))


def test_verdict_of_a_cart_says_all_that_is_proved(path):
    told = said(path)
    for part in (
        "from each of 405 cells the constraints are kept for ever", "x' = v", "v' = a + w",
        "x [m] from -1 to 1 in 31 cells, measured exactly", "x - 1 <= 0 [m]", "-x - 1 <= 0 [m]",
        "w [m/s^2] is, from -0.3 to 0.3, another at every instant",
        "a [m/s^2]: one of 3 that were tried, from -1 to 1", "every 0.2 s exactly",
        "an input acts from its sample on, as it is",
    ):  # fmt: skip
        assert part in told, part


def test_verdict_of_a_target_says_late_inputs_errors_and_the_horizon(tmp_path):
    near = hf.Region("near", STATES, tuple(
        hf.Inequality(str(2 * k + j), s * q.symbol - 0.5, q.unit)
        for k, q in enumerate(STATES) for j, s in enumerate((-1, 1))
    ))  # fmt: skip
    found = hf.certify(
        cart(0.1), WALLS, box={"x": (-1, 1), "v": (-1.6, 1.6)}, cells=61, sample_time=0.2, inputs=5,
        target=near, horizon=3.0, delay=0.05, errors={"x": 0.01},
    )  # fmt: skip
    told = said(found.write(tmp_path / "near.holdfast"), share=0.1)
    assert "the target is reached within 15 holds, 3 s, and the constraints are kept until" in told
    assert "x [m] from -1 to 1 in 61 cells, measured within 0.01" in told
    assert "0.05 s late at most, before which any input between these may act" in told
    assert "target       -x - 0.5 <= 0 [m]" in told


def leaves(value, place=()):
    """The places of all texts, numbers and truths of a header."""
    if isinstance(value, dict | list):
        for key, inner in value.items() if isinstance(value, dict) else enumerate(value):
            yield from leaves(inner, (*place, key))
    else:
        yield place


def other(value):
    """A value that is a little another, of the same kind."""
    if isinstance(value, bool):
        return not value
    if isinstance(value, int):
        return value + 1
    if value is None:
        return 3
    if "0x" in value:
        return H(math.nextafter(float.fromhex(value), math.inf))
    return f"({value})*2"


HEADER_SAYS_ONLY = {"cells_in_region"}
"""What a header tells and no verdict says."""


@pytest.mark.heavy
def test_header_with_one_other_leaf_is_refused_or_has_another_verdict(path):
    header = json.loads(path.read_bytes().split(b"\n")[1])
    own, refused, others = said(path), 0, set()
    for place in leaves(header):

        def change(h, place=place):
            *way, last = place
            for key in way:
                h = h[key]
            h[last] = other(h[last])

        forged = changed(path, change)
        try:
            told = said(forged)
        except NotValidError:
            refused += 1
            continue
        assert place[0] in HEADER_SAYS_ONLY or told != own, place
        others.add(told)
    assert refused > 10
    assert len(others) > 60


WEAKER = {
    "a smaller push": lambda h: h["disturbances"][0].update(range=[H(-0.01), H(0.01)]),
    "a push that is known": lambda h: h["disturbances"][0].update(range=[H(0.2), H(0.2)]),
    "one wall": lambda h: h.update(constraints=h["constraints"][:1]),
    "no wall": lambda h: h.update(constraints=[{"name": "r", "unit": "m", "expression": "-1"}]),
    "a wall written otherwise": lambda h: h["constraints"][1].update(expression="-log(2 - x)"),
    "a far wall": lambda h: h["constraints"][1].update(expression="x - 1000"),
    "a wall or nothing": lambda h: h["constraints"][1].update(expression="least(x - 1, -1)"),
    "another unit": lambda h: h["disturbances"][0].update(unit="cm/s^2"),
    "another title": lambda h: h.update(title="ferry, any current up to 5 m/s, certified by X"),
}  # fmt: skip


def test_weaker_statements_under_one_title_have_verdicts_of_their_own(path):
    told = {said(path)}
    for change in WEAKER.values():
        told.add(said(changed(path, change)))
    assert len(told) == 1 + len(WEAKER)


HOSTILE = {
    "a comment": lambda h: h["constraints"][1].update(expression="x - 1000 # x - 1\n"),
    "another alphabet": lambda h: h.update(rates=["\uff56", "a + w"]),
    "a call": lambda h: h.update(rates=["v + __import__('os').getpid()", "a + w"]),
    "a name twice": lambda h: h["states"][0].update(name="v"),
    "no number": lambda h: h.update(errors=["nan", "nan"]),
    "no hold": lambda h: h.update(hold=H(0.0)),
    "no errors": lambda h: h.update(errors=[]),
    "negative errors": lambda h: h.update(errors=[H(-0.1), H(-0.1)]),
    "too many steps": lambda h: h.update(steps=65),
    "no step": lambda h: h.update(steps=0),
    "a level above the horizon": lambda h: h.update(holds=-1),
    "a state that is no number": lambda h: h.update(rates=["v + 0*(1/(x - x))", "a + w"]),
}  # fmt: skip


@pytest.mark.parametrize("how", HOSTILE)
def test_text_that_misleads_is_refused(path, how):
    with pytest.raises(NotValidError):
        said(changed(path, HOSTILE[how]))


def test_title_and_units_cannot_write_on_a_terminal(path):
    def escapes(header):
        header["title"] = "\x1b[2J\u202e valid\nproves everything " + 10_000 * "x"
        header["states"][0]["unit"] = "m]\n  proves       all"

    told = said(changed(path, escapes))
    assert told.isascii()
    assert all(32 <= ord(c) < 127 or c == "\n" for c in told)
    assert max(map(len, told.split("\n"))) < 400
    assert len(told.split("\n")) == len(said(path).split("\n"))


def run(monkeypatch, capsys, *arguments):
    monkeypatch.setattr(sys, "argv", ["holdfast-check", *map(str, arguments)])
    with pytest.raises(SystemExit) as end:
        main()
    return end.value.code, capsys.readouterr().out


def test_verdict_as_json_has_the_same_facts(path, monkeypatch, capsys):
    code, out = run(monkeypatch, capsys, path, "--json")
    told = json.loads(out)
    assert code == 0
    assert told["valid"] is True
    assert told["rates"] == {"x": "v", "v": "a + w"}
    assert told["whatever"]["w"] == {
        "unit": "m/s^2",
        "least": -0.3,
        "greatest": 0.3,
        "varies": True,
    }
    assert told["held_for"] == 0.2
    assert told["holds"] is None
    wrong = changed(path, lambda h: h.update(hold=H(0.5)))
    code, out = run(monkeypatch, capsys, wrong, "--json")
    assert code == 1
    assert json.loads(out)["valid"] is False


SCENARIO = """
[scenario]
title = "cart"
kind = "discriminating-kernel"

[system]
states = {{ x = {{ unit = "m" }}, v = {{ unit = "m/s" }} }}
inputs = {{ a = {{ unit = "m/s^2", bounds = [-1, 1] }} }}
disturbances = {{ w = {{ unit = "m/s^2", bounds = [-{push}, {push}] }} }}
rates = {{ x = "v", v = "{force}" }}

[region.constraints]
left = {{ expression = "-1 - x", unit = "m" }}
right = {{ expression = "x - {wall}", unit = "m" }}

[grid]
nodes = 31
box = {{ x = [-1, 1], v = [-2, 2] }}

[march]
horizon = 1
"""


def test_certificate_is_of_its_scenario_and_of_no_other(path, tmp_path, monkeypatch, capsys):
    file = tmp_path / "cart.toml"
    for push, wall, force, code in (
        (0.3, 1, "a + w", 0), (0.2, 1, "w + a", 0), (0.4, 1, "a + w", 3), (0.3, 0.9, "a + w", 3),
        (0.3, 1, "a + w - v", 3),
    ):  # fmt: skip
        file.write_text(SCENARIO.format(push=push, wall=wall, force=force))
        ended, out = run(monkeypatch, capsys, path, "--expect", file)
        assert ended == code, (push, wall, out)
        assert out.startswith("valid, of" if code == 0 else "NOT as expected: "), out
    ended, out = run(monkeypatch, capsys, path, "--expect", "seen-target")
    assert ended == 3
    assert "has the states ahead [m], left [m]" in out


@pytest.mark.parametrize(
    "text",
    ["- 3/2 ** 2", "4/-1/2", "2 **-1/2", "4/ 1/2", "2**1/2", "x**(3/2)", "(2 + x)**-1/2", "x/3/4",
     "(2 + x)**-2/4", "-3*x/4", "3/4*x - 5/8/2", "7205759403792794/72057594037927936*x", "x - (v - 1/2)",
     "2*(3*x/4)**2/8", "-(x/2)**2"],
)  # fmt: skip
def test_formula_that_is_printed_is_the_one_that_is_evaluated(text):
    e = Expression(text)
    printed = _readable(e)
    assert printed.isascii()
    for x, v in ((0.7, -0.3), (1.9, 2.5)):
        names = {"x": Fraction(x), "v": Fraction(v)}
        exact = eval(text, {}, names)
        shown = eval(printed, {}, names)
        assert float(shown) == pytest.approx(float(exact), rel=1e-12), printed


UNTRUE = {
    "an input's range that is told": lambda h: h.update(
        law={"modes": [], "under_way": [[H(-0.001), H(0.001)]], "names": [], "initial": 0,
             "parts": [], "table": None}
    ),
    "a hold that is endless": lambda h: h.update(hold=H(1e308), holds=1000),
}  # fmt: skip


@pytest.mark.parametrize("how", UNTRUE)
def test_what_is_told_beside_what_is_proved_is_refused(path, how):
    with pytest.raises(NotValidError, match="are none"):
        said(changed(path, UNTRUE[how]))


def test_angle_that_turns_too_fast_to_be_counted_is_refused(tmp_path):
    """727 of 20,000 such cells were led to a part of the circle alone."""
    th, d = hf.symbol("th"), hf.symbol("d")
    wheel = hf.System(
        "wheel", (hf.Quantity("th", "rad"),), (), {"th": 1 + d},
        disturbances=(hf.Quantity("d", "rad/s"),), disturbance_bounds=hf.Box((0.0,), (1.0,)),
    )  # fmt: skip
    any_th = hf.Region("any", wheel.states, (hf.Inequality("c", sp.sin(th) - 2),))
    found = hf.certify(wheel, any_th, box={"th": (-math.pi, math.pi)}, cells=8, sample_time=1.0)
    path = found.write(tmp_path / "wheel.holdfast")
    assert "8 of 8" in verdict(checked(str(path)))
    for rate in (10**13, 248057398711992672):
        fast = changed(path, lambda h, rate=rate: h.update(rates=[f"{rate} + d"]))
        with pytest.raises(NotValidError, match="may lead to None"):
            checked(str(fast))


LOOP = """
[scenario]
title = "cart"
kind = "closed-loop"

[system]
states = {{ x = {{ unit = "m" }}, v = {{ unit = "m/s" }} }}
inputs = {{ a = {{ unit = "m/s^2", bounds = [-2, 2] }} }}
disturbances = {{ w = {{ unit = "m/s^2", bounds = [-0.1, 0.1] }} }}
rates = {{ x = "v", v = "a + w" }}

[law]
outputs = {{ a = "{law}" }}

[region.constraints]
left = {{ expression = "-1 - x", unit = "m" }}
right = {{ expression = "x - 1", unit = "m" }}

[starts]
states = [{{ x = 0, v = 0 }}]

[run]
horizon = {horizon}
sample_time = {sample_time}
{more}
"""


def test_certificate_of_a_law_is_of_its_closed_loop_and_of_no_other(tmp_path, monkeypatch, capsys):
    file, own = (
        tmp_path / "loop.toml",
        {"law": "-3*x - 3*v", "horizon": 5, "sample_time": 0.1, "more": ""},
    )
    file.write_text(LOOP.format(**own))
    box = {"x": (-1.0, 1.0), "v": (-1.0, 1.0)}
    proved = judged_law(str(file), box=box, cells=41).certificate
    path = proved.write(tmp_path / "law.holdfast")
    brief = judged_law(str(file), box=box, cells=41, horizon=0.5).certificate
    short = brief.write(tmp_path / "brief.holdfast")
    noise = "\n[noise]\nuniform = { x = 0.5 }\n"
    for certificate, change, code in (
        (path, {}, 0), (path, {"horizon": 500}, 0), (path, {"law": "-2*x - 3*v"}, 3),
        (path, {"sample_time": 0.05}, 3), (path, {"more": "delay = 0.1"}, 3),
        (path, {"more": noise}, 3), (short, {}, 3), (short, {"horizon": 0.4}, 0),
    ):  # fmt: skip
        file.write_text(LOOP.format(**{**own, **change}))
        ended, out = run(monkeypatch, capsys, certificate, "--expect", file, "--share", "0.01")
        assert ended == code, (change, out)
