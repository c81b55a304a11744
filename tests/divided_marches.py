"""Small problems whose marches are divided, also in this process, and how answers are compared."""

import math
from contextlib import contextmanager

import numpy as np
import sympy as sp

import holdfast as hf
from holdfast.analysis.reachability.divided_march import MarchPart, cut, layers_of

X, Y, U, W, PSI = (hf.symbol(n) for n in ("x", "y", "u", "w", "psi"))
PLACE = (hf.Quantity("x", "m"), hf.Quantity("y", "m"))
HEADING = (hf.Quantity("psi", "rad", angle=True),)
RATES = {"x": sp.cos(PSI), "y": sp.sin(PSI) + W, "psi": U}


class Here:
    """A workplace in this process: so many parts at most, one after another.

    by_step: whether halos are exchanged once in a step, and not in every stage.
    """

    def __init__(self, count=1, by_step=True):
        self.count, self.by_step = count, by_step

    @contextmanager
    def parts(self, posed, h):
        stages = posed.method.stages if self.by_step else 1
        parts = layers_of(posed).parts(cut(posed, self.count), stages)
        of = [MarchPart(posed, part, stages=stages, threads=1, h=h) for part in parts]
        here = PartsHere(of, parts, stages)
        try:
            yield here
        finally:
            here.ask(MarchPart.close, False)


class PartsHere:
    """Parts in this process."""

    def __init__(self, of, parts, stages):
        self.of, self.parts, self.stages = of, parts, stages
        self.begun = False

    def ask(self, method, *arguments):
        return [method(part, *arguments) for part in self.of]

    def ask_one(self, place, method, *arguments):
        return method(self.of[place], *arguments)

    def carry_out(self, orders):
        if self.begun and len(self.of) > 1:
            for part, mine in zip(self.of, self.parts, strict=True):
                part.take([self.of[k].edges(which) for k, which in mine.wanted(self.parts)])
        self.begun = True
        return self.ask(MarchPart.carry_out, orders)


def robot(states):
    """A robot on a plane in a side wind, with its states in this order."""
    return hf.System(
        "robot", states, (hf.Quantity("u", "rad/s"),), {q.name: RATES[q.name] for q in states},
        disturbances=(hf.Quantity("w", "m/s"),),
        input_bounds=hf.Box((-1,), (1,)), disturbance_bounds=hf.Box((-0.3,), (0.3,)),
    )  # fmt: skip


ROBOT, TURNED = robot((*PLACE, *HEADING)), robot((*HEADING, *PLACE))
SIDES = (hf.Inequality("left", Y - 1, "m"), hf.Inequality("right", -1 - Y, "m"))


def post(x=0.0):
    """The lane with a post in it."""
    far = sp.sqrt((X - x) ** 2 + Y**2 + 1e-12)
    return hf.Region("lane", PLACE, (*SIDES, hf.Inequality("post", 0.4 - far, "m")))


EMPTY = hf.Region("empty", PLACE, SIDES)
GOAL = hf.Region("goal", PLACE, (hf.Inequality("disk", X**2 + Y**2 - 0.3, "m^2"),))
BOX = {"x": (-2, 1), "y": (-1.3, 1.3), "psi": (-math.pi, math.pi)}


def grid(system=ROBOT, ends="extrapolated", **nodes):
    return hf.grid(system, BOX, {"x": 21, "y": 24, "psi": 20} | nodes, {"x": ends})


def kernel(**options):
    """Settled nodes are skipped, as the band is narrow."""
    fine = grid(y=40, psi=40)
    return hf.discriminating_kernel(ROBOT, post(), fine, 0.6, band=0.08, **options)


def turned_kernel(**options):
    return hf.discriminating_kernel(TURNED, post(), grid(TURNED, psi=17), 0.4, **options)


def limited_kernel(**options):
    return hf.discriminating_kernel(ROBOT, post(), grid(ends="limited"), 0.4, **options)


SIGNS = {"y": -1, "psi": -1}


def mirrored_kernel(system=ROBOT, horizon=0.4, **options):
    over = grid(system)
    return hf.discriminating_kernel(system, post(), over, horizon, **{"symmetry": SIGNS} | options)


def mirrored_angle(**options):
    """The angle is the first state that is reflected, or the first of all."""
    return mirrored_kernel(robot((PLACE[0], *HEADING, PLACE[1])), **options)


def mirrored_first(**options):
    return mirrored_kernel(TURNED, **options)


def mirrored_on_a_ring(**options):
    """The first state is an angle that is not reflected; settled nodes are skipped."""
    turn, y, v, u = (hf.symbol(n) for n in ("turn", "y", "v", "u"))
    states = (
        hf.Quantity("turn", "rad", angle=True), hf.Quantity("y"), hf.Quantity("v"),
    )  # fmt: skip
    system = hf.System(
        "carousel", states, (hf.Quantity("u"),),
        {"turn": 1 + v**2, "y": v * sp.sin(turn), "v": u}, input_bounds=hf.Box((-1,), (1,)),
    )  # fmt: skip
    wide = 1 + sp.cos(turn) / 4
    walls = hf.Region("walls", states[:2], (hf.Inequality("walls", y**2 - wide),))
    box = {"turn": (-math.pi, math.pi), "y": (-1.3, 1.3), "v": (-1.2, 1.2)}
    over = hf.grid(system, box, {"turn": 19, "y": 40, "v": 15}, {"v": "limited"})
    signs = {"y": -1, "v": -1}
    return hf.viability_kernel(system, walls, over, 0.5, symmetry=signs, band=0.1, **options)


def moving_kernel(**options):
    lane = post(0.5 * hf.TIME)
    return hf.discriminating_kernel(ROBOT, lane, grid(), 0.3, times=[0.1], **options)


def mirrored_moving_kernel(**options):
    return moving_kernel(symmetry=SIGNS, **options)


def moving_set(**options):
    """A goal that moves within a lane that moves, beyond which the set is lost."""
    goal = hf.Region(
        "goal", PLACE, (hf.Inequality("disk", (X + hf.TIME) ** 2 + Y**2 - 0.3, "m^2"),)
    )
    return hf.capture_basin(ROBOT, goal, post(1 + 0.5 * hf.TIME), grid(), 0.3, **options)


def tube(**options):
    return hf.backward_reachable_tube(ROBOT, GOAL, grid(), 0.3, times=[0, 0.1], **options)


def set_at(**options):
    return hf.backward_reachable_at(ROBOT, GOAL, grid(), 0.3, **options)


def basin(**options):
    return hf.capture_basin(
        ROBOT, GOAL, EMPTY, grid(), 0.4, arrival_steps=5, times=[0.15], **options
    )


def two_carts(**options):
    """Four states."""
    x, v, y, w, u, d = (hf.symbol(n) for n in ("x", "v", "y", "w", "u", "d"))
    states = tuple(hf.Quantity(n) for n in ("x", "v", "y", "w"))
    inputs = (hf.Quantity("u"), hf.Quantity("d"))
    system = hf.System(
        "two_carts", states, inputs, {"x": v, "v": u, "y": w, "w": d + x / 4},
        input_bounds=hf.Box((-1, -1), (1, 1)),
    )  # fmt: skip
    apart = hf.Region("apart", states, (hf.Inequality("apart", x**2 + y**2 - 1),))
    box = {"x": (-1.3, 1.3), "v": (-1.8, 1.8), "y": (-1.3, 1.3), "w": (-1.8, 1.8)}
    over = hf.grid(system, box, {"x": 11, "v": 8, "y": 9, "w": 10})
    return hf.viability_kernel(system, apart, over, 0.5, **options)


def cart(**options):
    """A grid of two states, whose parts are cut between rows that are computed together."""
    x, v, u = (hf.symbol(n) for n in ("x", "v", "u"))
    system = hf.System(
        "cart", (hf.Quantity("x", "m"), hf.Quantity("v", "m/s")), (hf.Quantity("u", "m/s^2"),),
        {"x": v, "v": u}, input_bounds=hf.Box((-1,), (1,)),
    )  # fmt: skip
    walls = hf.Region("walls", system.states[:1], (hf.Inequality("walls", x**2 - 1, "m^2"),))
    over = hf.grid(system, {"x": (-1.3, 1.3), "v": (-1.8, 1.8)}, {"x": 75, "v": 20})
    return hf.viability_kernel(system, walls, over, 9.0, **options)


def line(**options):
    x, u = hf.symbol("x"), hf.symbol("u")
    system = hf.System(
        "line", (hf.Quantity("x"),), (hf.Quantity("u"),), {"x": u + x / 2},
        input_bounds=hf.Box((-0.2,), (0.2,)),
    )  # fmt: skip
    walls = hf.Region("walls", system.states, (hf.Inequality("walls", x**2 - 1),))
    return hf.viability_kernel(
        system, walls, hf.grid(system, {"x": (-1.3, 1.3)}, 700), 0.5, **options
    )


def same(one, other, *but):
    """Every value and every entry of the report, but for the wall time and those named."""
    assert set(one.dataset.variables) == set(other.dataset.variables)
    for name in one.dataset.variables:
        a, b = one.dataset[name].values, other.dataset[name].values
        assert a.dtype == b.dtype
        assert np.array_equal(a, b, equal_nan=True), name
    left = {"wall_time_s", *but}
    a, b = ({k: v for k, v in d.dataset.attrs.items() if k not in left} for d in (one, other))
    assert a == b
