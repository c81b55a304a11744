"""Flowpipes: all trajectories are in their boxes, and the file is what the checker follows."""

import hashlib
import json
import re
import zlib
from pathlib import Path

import numpy as np
import pytest
import sympy as sp
from click.testing import CliRunner
from scipy.integrate import solve_ivp

import holdfast as hf
from holdfast.commands.certify import command
from holdfast.errors import HoldfastError, OutputError, SimulationError
from holdfast.maths.expressions.functions import angle, greatest, least, length, wrap
from holdfast.studies.law_certification import check_of_scenario, flowpipe_of
from holdfast_check.checker import checked
from holdfast_check.reading import NotValidError
from tests.certified_systems import changed

x, y, v, a, w, k = (hf.symbol(n) for n in ("x", "y", "v", "a", "w", "k"))


def system(rates, disturbances=None, parameters=(), inputs=(), bounds=None):
    names = [hf.Quantity(str(s)) for s in rates]
    ends = disturbances or {}
    return hf.System(
        "moving", tuple(names), tuple(hf.Quantity(n) for n in inputs),
        {str(s): r for s, r in rates.items()}, parameters=parameters,
        disturbances=tuple(hf.Quantity(n) for n in ends),
        input_bounds=bounds,
        disturbance_bounds=hf.Box(*zip(*ends.values(), strict=True)) if ends else None,
    )  # fmt: skip


def region(of, **limits):
    return hf.Region("bounds", of.states, tuple(hf.Inequality(n, e) for n, e in limits.items()))


def contained(pipe, times, states, slack=1e-6):
    """Whether each state is in a box of its time."""
    for t, q in zip(times, states, strict=True):
        now = (pipe.times[:, 0] <= t + 1e-12) & (t - 1e-12 <= pipe.times[:, 1])
        inside = (pipe.low[now] - slack <= q) & (q <= pipe.high[now] + slack)
        assert inside.all(axis=1).any(), (t, q)


FAIRWAY = """
[scenario]
title = "A vessel in a fairway, and a cross current"

[system]
states = { y = { unit = "m" }, psi = { unit = "rad" } }
inputs = { r = { unit = "rad/s", bounds = [-0.3, 0.3] } }
disturbances = { w = { unit = "m/s", bounds = [-0.2, 0.2] } }
rates = { y = "1.5*sin(psi) + w", psi = "r" }

[region]
constraints = { port = { expression = "y - 5", unit = "m" }, starboard = { expression = "-y - 5", unit = "m" } }

[law]
outputs = { r = "-0.05*y - 0.6*psi" }

[starts]
states = [{ y = 3, psi = 0 }]

[run]
horizon = 60
sample_time = 0.5
"""

SMOOTH = {
    "sine": ({x: sp.sin(y) + sp.cos(2 * x), y: -sp.sin(x * y)}, 1.5),
    "exponential": ({x: sp.exp(-x) - 2 * x + y / 2, y: -sp.log(1 + y**2) + x / 4}, 2.0),
    "quotient": ({x: y / (1 + x**2), y: -x / sp.sqrt(2 + sp.sin(x))}, 1.5),
    "tangent": ({x: sp.tanh(y) - sp.tan(x / 3), y: -sp.atan(x + y)}, 1.5),
    "polar": ({x: -length(x + 3, y, 0) / 4 + 1, y: -angle(y, x + 4, 0)}, 2.0),
    "kinked": ({x: sp.Abs(y) - x, y: greatest(-x, -y / 2) - least(y, 1)}, 2.0),
    "turning": ({x: wrap(y) / 2 - x, y: 1 - y + 0 * x}, 2.0),
}


@pytest.mark.few("False-turning")
@pytest.mark.parametrize("name", SMOOTH)
@pytest.mark.parametrize("disturbed", [False, True])
def test_trajectories_are_in_the_boxes(name, disturbed, tmp_path):
    rates, horizon = SMOOTH[name]
    rates = {**rates, x: rates[x] + k * y / 10 + (w if disturbed else 0)}
    of = system(
        rates, {"w": (-0.02, 0.03)} if disturbed else None, (hf.Parameter("k", "", value=1.0),)
    )
    start = {"x": (0.3, 0.4), "y": (0.5, 0.7)}
    pipe = hf.flowpipe(
        of, region(of, far=x**2 + y**2 - 100), start=start, horizon=horizon, degrees=(2, 5),
        uncertain={"k": (0.8, 1.3)},
    )  # fmt: skip
    assert pipe.proved, pipe.why
    generator = np.random.default_rng(1)
    f = sp.lambdify([x, y, w, k], [rates[x], rates[y]], _numpy_functions())
    for _ in range(12):
        corner = generator.random(2) < 0.5
        q = np.array([start[n][int(generator.random() * 2)] if c else np.mean(start[n])
                      for n, c in zip("xy", corner, strict=True)])  # fmt: skip
        kk = generator.choice([0.8, 1.3, 1.0])
        edges = np.sort(generator.random(3)) * horizon
        values = generator.choice([-0.02, 0.03], 4) if disturbed else np.zeros(4)

        def along(t, q, edges=edges, values=values, kk=kk):
            return f(*q, values[np.searchsorted(edges, t)], kk)

        run = solve_ivp(along, (0, horizon), q, rtol=1e-9, atol=1e-11, max_step=0.05)
        contained(pipe, run.t, run.y.T)
    path = pipe.write(tmp_path / "a.flowpipe")
    said = checked(str(path))
    assert said["valid"]
    assert said["parts"] == pipe.parts


def _numpy_functions():
    return [{
        "wrap": lambda q: (q + np.pi) % (2 * np.pi) - np.pi, "least": np.minimum,
        "greatest": np.maximum, "magnitude": np.abs, "length": lambda *q: np.hypot(*q[:2]),
        "angle": lambda *q: np.arctan2(*q[:2]),
    }, "numpy"]  # fmt: skip


def test_ends_of_a_decay_are_known():
    of = system({x: -x + w}, {"w": (-0.1, 0.1)})
    pipe = hf.flowpipe(of, region(of, far=x - 3), start={"x": (1.0, 2.0)}, horizon=2.0)
    low, high = pipe.ends["x"]
    gone = np.exp(-2)
    assert 2 * gone + 0.1 * (1 - gone) < high < 2 * gone + 0.1 * (1 - gone) + 0.03
    assert gone - 0.1 * (1 - gone) - 0.03 < low < gone - 0.1 * (1 - gone)


@pytest.mark.heavy
def test_a_turn_does_not_wrap():
    of = system({x: y, y: -x})
    start, far = {"x": (0.9, 1.1), "y": (-0.1, 0.1)}, x**2 + y**2
    most = 1.1**2 + 0.1**2
    pipe = hf.flowpipe(of, region(of, far=far - most - 1e-3), start=start, horizon=30.0)
    assert pipe.proved, pipe.why
    assert pipe.parts == 1
    less = hf.flowpipe(of, region(of, far=far - most + 1e-3), start=start, horizon=30.0, parts=8)
    assert not less.proved
    assert "constraint 0 may fail after" in less.why


@pytest.fixture(scope="module")
def cart():
    of = hf.System(
        "cart", (hf.Quantity("x"), hf.Quantity("v")), (hf.Quantity("a"),),
        {"x": v, "v": a + w}, disturbances=(hf.Quantity("w"),),
        input_bounds=hf.Box((-1.0,), (1.0,)), disturbance_bounds=hf.Box((-0.1,), (0.1,)),
    )  # fmt: skip
    return of, region(of, left=-1 - x, right=x - 1)


BACK = {"a": -x - 1.5 * v}
BOX = {"x": (0.4, 0.8), "v": (-0.2, 0.2)}


@pytest.mark.parametrize("errors", [{}, {"x": 0.02, "v": 0.01}])
def test_runs_of_a_sampled_law_are_in_the_boxes(cart, errors):
    of, walls = cart
    rest = region(of, left=-0.25 - x, right=x - 0.25)
    pipe = hf.flowpipe(
        of, walls, start=BOX, horizon=8, law=hf.Law("back", of.states, BACK), sample_time=0.2,
        target=rest, errors=errors,
    )  # fmt: skip
    assert pipe.proved, pipe.why
    generator = np.random.default_rng(2)
    for run in range(40):
        q = np.array([generator.choice(BOX[n]) for n in "xv"])
        times, states = [0.0], [q]
        for n in range(40):
            seen = q + generator.choice([-1, 1], 2) * [errors.get("x", 0), errors.get("v", 0)]
            u = np.clip(-seen[0] - 1.5 * seen[1], -1, 1)
            push = [0.1, -0.1, -0.1 * np.sign(q[1])][run % 3]
            for part in (0.1, 0.2):
                moved = q + np.array([part * q[1] + part**2 / 2 * (u + push), part * (u + push)])
                times.append(0.2 * n + part)
                states.append(moved)
            q = moved
        contained(pipe, times, states)


@pytest.mark.heavy
def test_law_with_modes_is_followed_in_each_that_may_be(cart, tmp_path):
    """Where the guard may hold or not, both what it does are: until all have turned."""
    of, walls = cart
    modes = {
        "far": hf.Law("far", of.states, {"a": -0.5 - v}),
        "near": hf.Law("near", of.states, BACK),
    }
    law = hf.Switching("both", modes, (hf.Transition("far", "near", 0.5 - x),))
    rest = region(of, left=-0.3 - x, right=x - 0.3)
    pipe = hf.flowpipe(
        of, walls, start={"x": (0.55, 0.8), "v": (-0.1, 0.1)}, horizon=8, law=law,
        sample_time=0.2, target=rest,
    )  # fmt: skip
    assert pipe.proved, pipe.why
    turned, generator = set(), np.random.default_rng(3)
    for run in range(60):
        q, near = np.array([generator.uniform(0.55, 0.8), generator.choice([-0.1, 0.1])]), False
        times, states = [0.0], [q]
        for n in range(40):
            turned |= {n} if not near and q[0] <= 0.5 else set()
            near = near or q[0] <= 0.5
            u = np.clip(-q[0] - 1.5 * q[1] if near else -0.5 - q[1], -1, 1) + 0.1 * (run % 3 - 1)
            q = q + np.array([0.2 * q[1] + 0.02 * u, 0.2 * u])
            times.append(0.2 * (n + 1))
            states.append(q)
        contained(pipe, times, states)
    assert len(turned) > 1
    path = pipe.write(tmp_path / "modes.flowpipe")
    said = checked(str(path))
    assert said["valid"]
    assert len(said["options"]) == 2 * 2 - 1  # from one mode either, from the last itself
    assert said["options"][0].startswith("in far: a = ")
    assert said["options"][0].endswith(" where x - 0.5 <= 0, then near")

    def never(header):
        header["law"]["modes"][0] = header["law"]["modes"][0][1:]

    with pytest.raises(NotValidError):
        checked(str(changed(path, never)))


def test_at_every_instant_it_is_the_rates_that_have_the_law(cart, tmp_path):
    of, walls = cart
    pipe = hf.flowpipe(of, walls, start=BOX, horizon=5, law=hf.Law("back", of.states, BACK))
    assert pipe.proved, pipe.why
    assert pipe.header["inputs"] == []
    said = checked(str(pipe.write(tmp_path / "cart.flowpipe")))
    assert said["valid"]
    assert "least" in said["rates"]["v"]


def wider(header):
    header["start"][0][1] = (1.5).hex()


def shorter_steps(header):
    header["splits"] = [split + 1 if split < 0 else split for split in header["splits"]]


@pytest.mark.few("<lambda>-none1")
@pytest.mark.parametrize(
    ("alter", "why"),
    [
        (wider, "from x = "),
        (shorter_steps, "not as many steps"),
        (lambda h: h.update(hold=(1e6).hex()), "from x = "),
        (lambda h: h["constraints"][0].update(expression="x + 1/10"), "constraint 0 may fail"),
        (lambda h: h["target"].append({"name": "t", "unit": "m", "expression": "x"}), "target"),
        (lambda h: h.update(rates=["v", "a"]), "undeclared name a"),
        (lambda h: h["disturbances"][0].update(range=[(-1.0).hex(), (1.0).hex()]), "from x = "),
        (lambda h: h["disturbances"][0].update(range=[(1.0).hex(), (-1.0).hex()]), "reversed"),
        (lambda h: h.update(splits=[]), "parts"),
        (lambda h: h.update(splits=[5, *h["splits"]]), "not as it says"),
        (lambda h: h.update(splits=[*h["splits"], 0]), "not as it says"),
        (lambda h: h.update(splits=[0, *h["splits"]]), "not as it says"),
        (lambda h: h.update(holds=2), "make up the holds"),
        (lambda h: h.update(holds=0), "none"),
        (lambda h: h.update(degrees=[0, 6]), "degrees"),
        (lambda h: h.update(degrees=[3, 31]), "degrees"),
        (lambda h: h.update(errors=[(-1.0).hex(), (0.0).hex()]), "errors"),
        (lambda h: h.update(constraints=[]), "constraints"),
        (lambda h: h["inputs"].append({"name": "a", "unit": ""}), "inputs"),
        (lambda h: h["states"][0].update(name="w"), "stands twice"),
        (lambda h: h.update(errors=[(9.0).hex(), (0.0).hex()]), "none"),
        (lambda h: h.update(splits=[0] * 10_000), "not as many steps"),
        (lambda h: h.update(degrees=[12, 12]), "degrees"),
    ],
)
def test_forged_flowpipe_is_refused(cart, tmp_path, alter, why):
    of, walls = cart
    pipe = hf.flowpipe(of, walls, start=BOX, horizon=2, law=hf.Law("back", of.states, BACK))
    path = pipe.write(tmp_path / "cart.flowpipe")
    with pytest.raises(NotValidError, match=why):
        checked(str(changed(path, alter)))


def test_levels_that_are_not_the_steps_are_refused(cart, tmp_path):
    of, walls = cart
    pipe = hf.flowpipe(of, walls, start=BOX, horizon=2, law=hf.Law("back", of.states, BACK))
    path = pipe.write(tmp_path / "cart.flowpipe")
    for alter, why in (
        (lambda raw: b"\x00" + raw[1:], "may fail|was found|make up"),
        (lambda raw: raw[:-1] + b"\x29", "make up"),
        (lambda raw: bytes(len(raw)), "may fail|was found|more steps"),
    ):
        with pytest.raises(NotValidError, match=why):
            checked(str(changed(path, dict, entries=alter)))


def test_what_is_not_proved_is_not_written(cart, tmp_path):
    of, walls = cart
    pipe = hf.flowpipe(
        of, walls, start={"x": (0.4, 1.2), "v": (0, 0)}, horizon=2, parts=2,
        law=hf.Law("back", of.states, BACK),
    )  # fmt: skip
    assert not pipe.proved
    with pytest.raises(OutputError, match="nothing is proved: from x = "):
        pipe.write(tmp_path / "cart.flowpipe")


@pytest.mark.parametrize(
    ("options", "why"),
    [
        ({"start": {"x": (0, 1)}}, "start lacks the state 'v'"),
        ({"start": {**BOX, "q": (0, 1)}}, "start names 'q'"),
        ({"start": {**BOX, "v": (1, 0)}}, "start: v is 1 to 0"),
        ({"horizon": 0}, "horizon is 0"),
        ({"sample_time": float("nan")}, "sample_time is nan"),
        ({"degrees": (0, 3)}, "degrees"),
        ({"degrees": (12, 12)}, "degrees"),
        ({"law": None, "errors": {"x": 0.1}}, "errors of measurement without samples"),
        ({"law": None}, "the inputs of 'cart' are unknown"),
    ],
)
def test_what_cannot_be_asked_is_refused(cart, options, why):
    of, walls = cart
    asked = {"start": BOX, "horizon": 2, "law": hf.Law("back", of.states, BACK)}
    with pytest.raises(SimulationError, match=why):
        hf.flowpipe(of, walls, **{**asked, **options})


def forged(path, **header):
    """A flowpipe of one step from one sample to the next."""
    named = [{"name": n, "unit": ""} for n in header.pop("states")]
    whole = {
        "title": "", "states": named, "inputs": [], "disturbances": [], "parameters": [],
        "target": [], "law": [], "hold": (0.1).hex(), "holds": 1, "degrees": [1, 1],
        "errors": [(0.0).hex()] * len(named), **header,
    }  # fmt: skip
    whole |= {"splits": [-whole["holds"]], "entries": whole["holds"]}
    content = json.dumps(whole).encode() + b"\n" + zlib.compress(bytes(whole["holds"]))
    digest = hashlib.sha256(content).hexdigest().encode()
    path.write_bytes(b"holdfast-flowpipe 1 " + digest + b"\n" + content)
    return path


def limit(text):
    return [{"name": "c", "unit": "", "expression": text}]


def law(*options, initial=0, names=("",)):
    return {"names": list(names), "initial": initial, "modes": [list(options)], "parts": [],
            "under_way": [], "table": None}  # fmt: skip


def test_law_that_jumps_between_the_polynomial_and_the_states(tmp_path):
    """Its slopes are those on the way from the one to the others: what is left out is beside 0."""
    hump = "greatest(9/10 + x + 4*t, 0) + greatest(9/10 - x + 4*t, 0)"
    path = forged(
        tmp_path / "jump.flowpipe", states=["t", "x", "z", "y"], rates=["1", "0", hump, "u"],
        start=[[(a).hex(), (b).hex()] for a, b in ((0.0, 0.0), (-1.0, 1.0), (0.0, 0.0), (0.0, 0.0))],
        inputs=[{"name": "u", "unit": ""}], constraints=limit("y - 10"), holds=2,
        target=limit("3/100 - y"),
        law=law([[], ["t*wrap(z - 171782/1000000 + pi)"], 0]),
    )  # fmt: skip
    with pytest.raises(NotValidError, match="no box of the states"):
        checked(str(path))  # y is -0.03 from everywhere


@pytest.mark.parametrize("given", [law([[], ["0"], 0], initial=-1), law([[], ["0"], 0], names=())])
def test_law_with_no_such_mode_is_refused(tmp_path, given):
    path = forged(
        tmp_path / "mode.flowpipe", states=["x"], rates=["u"], start=[[(0.0).hex()] * 2],
        inputs=[{"name": "u", "unit": ""}], constraints=limit("x - 1"), law=given,
    )  # fmt: skip
    with pytest.raises(NotValidError, match="a mode that there is none of"):
        checked(str(path))


def test_other_order_of_steps_has_another_digest(tmp_path):
    still = {"states": ["x"], "rates": ["0"], "start": [[(0.0).hex()] * 2],
             "constraints": limit("x - 1")}  # fmt: skip
    path = forged(tmp_path / "a.flowpipe", **still)
    digests = set()
    for levels in (b"\x01\x02\x02", b"\x02\x02\x01"):
        other = changed(path, lambda h: h.update(splits=[-3]), entries=lambda raw, e=levels: e)
        digests.add(checked(str(other))["digest"])
    assert len(digests) == 2


def test_start_on_a_constraint_that_falls(tmp_path):
    of = system({x: 1 + y**2, y: -y})
    pipe = hf.flowpipe(
        of, region(of, left=2 - x), start={"x": (2, 3), "y": (-0.1, 0.1)}, horizon=1.0
    )
    assert pipe.proved, pipe.why
    of = system({x: y, y: -x})
    pipe = hf.flowpipe(
        of, region(of, left=2 - x), start={"x": (2, 3), "y": (-0.1, 0.1)}, horizon=1.0, parts=4
    )
    assert not pipe.proved


@pytest.mark.heavy
def test_command_from_a_box(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("fairway.toml").write_text(FAIRWAY, encoding="utf-8")
    box = ["--from", "y=2,4", "--from", "psi=-0.2,0.2"]
    told = CliRunner().invoke(command, ["fairway.toml", *box, "--no-figures"])
    assert told.exit_code == 0, told.output
    assert "keeps every constraint for 60 s" in told.output
    assert checked("runs/fairway/flowpipe.holdfast")["valid"]
    with pytest.raises(OutputError, match="is a flowpipe, of one box"):
        hf.read_certificate("runs/fairway/flowpipe.holdfast")
    for more, says in (
        (["--horizon", "0.5", "--from", "y=4.9,5.2"], "constraint 0 may fail after 0 s"),
        (["--cells", "4"], "--cells with --from"),
        (["--inputs", "4"], "--inputs with --from"),
        (["--halvings", "0"], "--halvings with --from"),
        (["--enclosure", "zonotope"], "--enclosure with --from"),
        (["--to-goal"], "has no goal"),
        (["--set", "run.delay=0.5"], "has a delay"),
    ):
        told = CliRunner().invoke(command, ["fairway.toml", *box, *more, "--no-figures"])
        assert told.exit_code == 1
        assert says in told.output + str(told.exception)


def test_flowpipe_is_of_the_closed_loop_that_it_is_of(tmp_path):
    """`holdfast-check --expect`: what is narrower and shorter is proved too, all else is another."""
    file = tmp_path / "fairway.toml"
    file.write_text(FAIRWAY, encoding="utf-8")
    pipe = flowpipe_of(str(file), start={"y": (2, 2.5), "psi": (-0.1, 0.1)}, horizon=5)
    path = pipe.write(tmp_path / "a.holdfast")
    for change, other, says in (
        ("horizon = 60", "horizon = 5", ""),
        ("horizon = 60", "horizon = 4", ""),
        ("horizon = 60", "horizon = 6", "the flowpipe is for 5 s"),
        ("[-0.2, 0.2]", "[-0.1, 0.2]", ""),
        ("[-0.2, 0.2]", "[-0.3, 0.2]", "'w' is from -0.2 to 0.2 in the flowpipe"),
        ("0.6*psi", "0.5*psi", "another law"),
        ("1.5*sin(psi)", "1.4*sin(psi)", "another rate"),
        ("y - 5", "y - 4", "another constraint"),
        ("sample_time = 0.5", "sample_time = 0.25", "inputs are held for 0.5 s in the flowpipe"),
        (
            "sample_time = 0.5",
            "sample_time = 0.5\n[noise]\nuniform = { y = 0.1 }",
            "is measured within 0",
        ),
        ("sample_time = 0.5", "sample_time = 0.5\ndelay = 0.5", "has a delay"),
    ):
        short = FAIRWAY.replace("horizon = 60", "horizon = 5")
        text = (FAIRWAY if "horizon" in change else short).replace(change, other)
        file.write_text(text, encoding="utf-8")
        if not says:
            check_of_scenario(path, str(file))
            continue
        with pytest.raises(HoldfastError, match=re.escape(says)):
            check_of_scenario(path, str(file))
    with pytest.raises(HoldfastError, match="has no law"):
        check_of_scenario(path, "seen-target")


OSCILLATOR = """
[scenario]
title = "An oscillator, pushed"

[system]
states = { x = { unit = "m" }, v = { unit = "m/s" } }
inputs = { u = { unit = "m/s^2", bounds = [-1, 1] } }
WHATEVER
empirical = "numbers"
rates = { x = "v", v = "w - x + u" }

[region]
constraints = { right = { expression = "x - 1", unit = "m" } }

[goal]
constraints = { slow = { expression = "v - 2", unit = "m/s" } }

[law]
outputs = { u = "-0.1*v" }

[starts]
states = [{ x = 0, v = 0 }]

[run]
horizon = 2
sample_time = 0.5
"""


def test_flowpipe_of_a_constant_is_not_of_what_changes(tmp_path):
    """One number all the time is less than another at every instant, in a vehicle too."""
    constant = 'parameters = { w = { value = 0.0, unit = "m/s^2" } }'
    changing = 'disturbances = { w = { unit = "m/s^2", bounds = [-0.2, 0.2] } }'
    file = tmp_path / "oscillator.toml"
    written = {}
    for name, of, more in (
        ("constant", constant, {"uncertain": {"w": (-0.2, 0.2)}}), ("changing", changing, {}),
        ("arriving", changing, {"to_goal": True}),
    ):  # fmt: skip
        file.write_text(OSCILLATOR.replace("WHATEVER", of), encoding="utf-8")
        pipe = flowpipe_of(str(file), start={"x": (0, 0.01), "v": (0, 0.01)}, **more)
        written[name] = pipe.write(tmp_path / f"{name}.holdfast")
    for name, of, more, says in (
        ("constant", constant, "", ""),
        ("constant", constant.replace("0.0", "0.2"), "", ""),
        ("constant", constant.replace("0.0", "0.3"), "", "'w' is from -0.2 to 0.2 in the flowpipe"),
        ("constant", constant, "[plant]\nw = 0.1\n", ""),
        ("constant", constant, "[plant]\nw = 0.3\n", "'w' is from -0.2 to 0.2 in the flowpipe"),
        ("constant", constant, "[varied]\ndraws = { w = [-0.1, 0.1] }\n", "vary from run to run"),
        ("constant", changing, "", "the flowpipe has no 'w' in 'm/s^2'"),
        ("changing", constant, "", ""),
        ("changing", changing, "", ""),
        (
            "changing",
            changing.replace("m/s^2", "km/s^2"),
            "",
            "the flowpipe has no 'w' in 'km/s^2'",
        ),
        ("arriving", changing, "", ""),
    ):
        file.write_text(OSCILLATOR.replace("WHATEVER", of) + more, encoding="utf-8")
        if not says:
            check_of_scenario(written[name], str(file))
            continue
        with pytest.raises(HoldfastError, match=re.escape(says)):
            check_of_scenario(written[name], str(file))
    slow = OSCILLATOR.replace("v - 2", "v - top").replace("WHATEVER", changing)
    slow = slow.replace("[goal]", '[goal]\nparameters = { top = { value = 2.0, unit = "m/s" } }')
    file.write_text(slow, encoding="utf-8")
    pipe = flowpipe_of(str(file), start={"x": (0, 0.01), "v": (0, 0.01)}, to_goal=True)
    check_of_scenario(pipe.write(tmp_path / "slow.holdfast"), str(file))
    for name, says in (("changing", ""), ("arriving", "the flowpipe is for 2 s; expected 1.5 s")):
        shorter = OSCILLATOR.replace("horizon = 2", "horizon = 1.5")
        file.write_text(shorter.replace("WHATEVER", changing), encoding="utf-8")
        if not says:
            check_of_scenario(written[name], str(file))
            continue
        with pytest.raises(HoldfastError, match=re.escape(says)):
            check_of_scenario(written[name], str(file))


def test_cart_of_the_page_keeps_its_walls():
    of = hf.System(
        "cart", (hf.Quantity("x"), hf.Quantity("v")), (hf.Quantity("a"),),
        {"x": v, "v": a + w}, disturbances=(hf.Quantity("w"),),
        input_bounds=hf.Box((-1.0,), (1.0,)), disturbance_bounds=hf.Box((-0.3,), (0.3,)),
    )  # fmt: skip
    pipe = hf.flowpipe(
        of, region(of, left=-1 - x, right=x - 1), start={"x": (0.2, 0.4), "v": (-0.1, 0.1)},
        horizon=10, law=hf.Law("back", of.states, BACK), sample_time=0.2,
    )  # fmt: skip
    assert pipe.proved


@pytest.mark.heavy
def test_van_der_pol_of_the_arch_competition(tmp_path):
    of = system({x: y, y: (1 - x**2) * y - x})
    start = {"x": (1.25, 1.55), "y": (2.35, 2.45)}
    pipe = hf.flowpipe(of, region(of, most=y - 2.75), start=start, horizon=7.0)
    assert pipe.proved
    assert checked(str(pipe.write(tmp_path / "a.flowpipe")))["valid"]
    less = hf.flowpipe(of, region(of, most=y - 2.6), start=start, horizon=7.0)
    assert "constraint 0 may fail after 6." in less.why  # a trajectory has 2.69


def test_law_that_leaves_inputs_free_is_refused(tmp_path):
    path = forged(
        tmp_path / "free.flowpipe", states=["x"], rates=["u"], start=[[(0.0).hex()] * 2],
        inputs=[{"name": "u", "unit": ""}], constraints=limit("x - 1"), law=law([["u"], ["u"], 0]),
    )  # fmt: skip
    with pytest.raises(NotValidError, match="no law with a safeguard"):
        checked(str(path))


def test_header_that_is_nested_without_end_is_refused(tmp_path):
    content = b"[" * 200_000 + b"\n"
    digest = hashlib.sha256(content).hexdigest().encode()
    path = tmp_path / "deep.flowpipe"
    path.write_bytes(b"holdfast-flowpipe 1 " + digest + b"\n" + content)
    with pytest.raises(NotValidError, match="nested too deep"):
        checked(str(path))


def test_more_steps_than_are_read_are_not_proved(monkeypatch):
    monkeypatch.setattr("holdfast_check.reading.LITTLE", 5)
    of = system({x: y, y: -x})
    point = {"x": (1.0, 1.0), "y": (0.0, 0.0)}
    pipe = hf.flowpipe(of, region(of, far=x - 3), start=point, horizon=30.0)
    assert "more than 5 steps are needed" in pipe.why
