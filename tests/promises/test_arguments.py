"""Every public function, given nonsense in the place of each of its arguments, says what is wrong."""

import contextlib
import inspect
import math
import signal
import tempfile
import warnings
from functools import cache, partial
from pathlib import Path

import numpy as np
import pytest

import holdfast as hf
from holdfast.errors import HoldfastError
from tests.boats import boat, boat_log
from tests.scenario_files import LINE

NAN, INF = math.nan, math.inf
NONSENSE = {
    "nan": NAN,
    "inf": INF,
    "-inf": -INF,
    "none": None,
    "empty text": "",
    "text": "nonsense",
    "empty list": [],
    "empty table": {},
    "list of nan": [NAN, NAN, NAN],
    "list of text": ["a", "b"],
    "table of nan": {"x": NAN},
    "table of text": {"x": "nonsense"},
    "array of nothing": np.zeros((0, 3)),
    "array of three axes": np.zeros((2, 2, 2)),
    "array of nan": np.full((2, 3), NAN),
    "array of text": np.array(["a", "b"]),
    "array of objects": np.array([object(), None], dtype=object),
    "complex": 1j,
    "minus one": -1,
    "huge": 10**400,
    "object": object(),
    "class": int,
}
PATIENCE = 20
x, y, v, k = (hf.symbol(n) for n in ("x", "y", "v", "k"))


@cache
def line_file():
    """A scenario of one state, on disk."""
    file = Path(tempfile.mkdtemp()) / "line.toml"
    file.write_text(LINE)
    return str(file)


def line():
    """x' = x + u + d, |u| <= 0.6, |d| <= push."""
    u, d, push = (hf.symbol(n) for n in ("u", "d", "push"))
    return hf.System(
        name="line",
        states=(hf.Quantity("x", "m"),),
        inputs=(hf.Quantity("u", "m/s"),),
        disturbances=(hf.Quantity("d", "m/s"),),
        parameters=(hf.Parameter("push", "m/s", value=0.2),),
        rates={"x": 1.0 * x + u + d},
        input_bounds=hf.Box((-0.6,), (0.6,)),
        disturbance_bounds=hf.Box((-push,), (push,)),
    )


def slider():
    """x' = u."""
    return hf.System(
        name="slider",
        states=(hf.Quantity("x", "m"),),
        inputs=(hf.Quantity("u", "m/s"),),
        rates={"x": hf.symbol("u")},
        input_bounds=hf.Box((-0.6,), (0.6,)),
    )


def end():
    return hf.Region("ends", (hf.Quantity("x", "m"),), (hf.Inequality("end", x**2 - 1, "m^2"),))


@cache
def value():
    return hf.discriminating_kernel(line(), end(), over(), 1.0)


@cache
def reached():
    over_it = hf.grid(slider(), {"x": (-1.2, 1.2)}, 21)
    return hf.capture_basin(slider(), end(), None, over_it, 1.0)


@cache
def certificate():
    still = {"ahead": (0.3, 2.1), "left": (-1.2, 1.2)}
    scenario = hf.load_scenario("seen-target")
    return hf.certify(scenario.system, scenario.region, box=still, cells=9, inputs=2, horizon=0.1)


@cache
def certificate_file():
    return str(certificate().write(Path(tempfile.mkdtemp()) / "target.holdfast"))


def over():
    return hf.grid(line(), {"x": (-1.2, 1.2)}, 21)


def push_law(of=None):
    return hf.Law("push", (hf.Quantity("x", "m"),), {"u": -2 * x})


@cache
def apart():
    found = hf.decompose(line(), end(), kind="discriminating-kernel")
    return hf.solve_parts(found, {"x": (-1.2, 1.2)}, 21, 0.2)


@cache
def result():
    return hf.simulate(
        line(), push_law(), starts=[[0.1], [0.2]], region=end(), goal=end(), horizon=1.0
    )


def marched(**more):
    return {"system": line(), "grid": over(), "horizon": 0.2, **more}


@cache
def station():
    robot = hf.systems.drifting_unicycle()
    law = hf.laws.hold_station(robot)
    return hf.simulate(robot, law, starts=[[1.0, 0, 0]], horizon=1.0)


def robots():
    robot = hf.systems.unicycle()
    names = [q.name for q in (*robot.states, *robot.inputs, *robot.parameters)]
    return hf.renamed(robot, {n: f"{n}L" for n in names}), robot


@cache
def tuning():
    return hf.tune("ch4-integrator", gains=["k2=0.5:1"], candidates=10, runs=1)


@cache
def short_log():
    return boat_log(seconds=25.0)


@cache
def identified():
    return hf.identify(boat(), short_log())


FUNCTIONS = {
    "backward_reachable_at": lambda: marched(target=end(), disturbances="min"),
    "backward_reachable_tube": lambda: marched(target=end(), disturbances="min"),
    "forward_reachable_set": lambda: marched(start=end(), disturbances="max"),
    "capture_basin": lambda: marched(goal=end(), region=None, arrival_steps=4),
    "discriminating_kernel": lambda: marched(region=end()),
    "invariance_kernel": lambda: marched(region=end()),
    "viability_kernel": lambda: {
        "system": slider(), "region": end(), "grid": hf.grid(slider(), {"x": (-1.2, 1.2)}, 21), "horizon": 0.2,
    },
    "check_promise": lambda: {
        "system": line(), "value": value(), "region": end(), "goal": None, "law": push_law(), "runs": 4,
        "margin": 0.1, "horizon": 0.2, "sample_time": 0.02, "rate": 2.0, "seed": 0,
    },
    "check_viability": lambda: {
        "boundary": hf.Boundary(line(), end()), "box": {"x": (-1.2, 1.2)}, "count": 5, "seed": 0, "disturbance": "none",
    },
    "classify": lambda: {"field": hf.fields.dipolar(), "point": [0, 0]},
    "compare": lambda: {
        "name": "wheeled_camera", "laws": ["wheeled_camera"], "cases": None, "overrides": ["run.horizon=0.5"], "runs": 1, "seed": 1,
    },
    "comparison_figure": lambda: {"found": comparison()},
    "campaign_figure": lambda: {"found": campaign(), "variable": "refused"},
    "contingent_cone": lambda: {
        "system": line(), "region": end(), "state": [1.0], "parameters": {"push": 0.1}, "tolerance": 1e-6,
    },
    "critical_points": lambda: {"field": hf.fields.dipole_in_current(), "box": ((-2.0, 2.0), (-2.0, 2.0))},
    "certify": lambda: {
        "system": line(), "region": end(), "box": {"x": (-1.0, 1.0)}, "cells": 5, "sample_time": 0.1, "horizon": 0.2, "inputs": 2,
        "uncertain": {"push": (0.1, 0.2)}, "disturbance": {"d": 0.1}, "errors": {"x": 0.01}, "delay": 0.02,
        "halvings": 1, "enclosure": "zonotope", "store": tempfile.mkdtemp(), "candidate": None, "margin": 0.0,
    },
    "flowpipe": lambda: {
        "system": line(), "region": end(), "start": {"x": (-0.1, 0.1)}, "horizon": 0.2, "law": push_law(), "sample_time": 0.1,
        "target": end(), "uncertain": {"push": (0.1, 0.2)}, "disturbance": {"d": 0.1}, "errors": {"x": 0.01}, "degrees": (1, 2),
        "tolerance": 1e-3, "parts": 2,
    },
    "outer_set": lambda: {
        "value": value(), "system": line(), "region": end(), "target": None, "cells": 5, "sample_time": 0.1, "inputs": 2, "halvings": 0,
    },
    "judge_law": lambda: {
        "system": line(), "region": end(), "law": push_law(), "box": {"x": (-1.0, 1.0)}, "cells": 5, "sample_time": 0.1,
        "horizon": 0.2, "uncertain": {"push": (0.1, 0.2)}, "disturbance": {"d": 0.1}, "errors": {"x": 0.01}, "delay": 0.02, "inputs": 2,
    },
    "certificate_figure": lambda: {"found": certificate()},
    "certified_law": lambda: {
        "certificate": certificate(), "system": hf.load_scenario("seen-target").system, "disturbance": {"wa": 0.1},
    },
    "certified_system": lambda: {"certificate": certificate()},
    "read_certificate": lambda: {"path": certificate_file()},
    "disturbance_margin": lambda: {
        "scenario": line_file(), "of": "push", "between": (0.1, 0.2), "tolerance": 0.09, "keep": [],
        "overrides": ["grid.nodes=7", "march.forever=false", "march.horizon=0.1"],
    },
    "decompose": lambda: {
        "system": line(), "region": end(), "kind": "discriminating-kernel", "goal": None, "disturbances": "min",
        "disturbance": {"d": 0.1}, "cut": {}, "lag_share": None, "box": None,
    },
    "parts_law": lambda: {"value": apart(), "law": push_law()},
    "solve_parts": lambda: {
        "decomposition": apart().decomposition, "box": {"x": (-1.2, 1.2)}, "nodes": 21, "horizon": 0.2, "ends": {"x": "extrapolated"},
    },
    "exact_flow": lambda: {"field": hf.fields.dipolar(lam=2.0), "start": [1.0, 0.5], "time": 0.2},
    "explain": lambda: {"system": hf.systems.unicycle(), "moment": [1.0, 0.0], "limit": 60.0},
    "export_c": lambda: {"system": line(), "law": push_law(), "name": "push", "table": "text"},
    "export_c_header": lambda: {"system": line(), "law": push_law(), "name": "push", "table": "text"},
    "export_c_table": lambda: {
        "law": hf.safety_law(line(), value(), push_law(), margin=0.1), "path": str(Path(tempfile.mkdtemp()) / "push.bin"),
    },
    "field_facts": lambda: {"field": hf.fields.dipolar()},
    "flow_line": lambda: {"field": hf.fields.dipolar(lam=2.0), "start": [1.0, 0.5]},
    "explore": lambda: {"scenario": "ch2-unicycle", "overrides": ["run.horizon=1"]},
    "flow_lines_figure": lambda: {"field": hf.fields.dipolar(), "reach": 1.0, "planes": 2},
    "grid": lambda: {"system": line(), "box": {"x": (-1.0, 1.0)}, "nodes": 11, "ends": {"x": "extrapolated"}},
    "hamiltonian": lambda: {"system": line(), "inputs": "max", "disturbances": "min", "samples": None},
    "histories_figure": lambda: {"result": result(), "run": 0},
    "load": lambda: {"path": "nowhere.nc", "lazy": True, "cache": 1.0},
    "load_scenario": lambda: {"name": "inspection", "overrides": ["law.k1=0.1"], "runs": 2, "seed": 3},
    "march_memory": lambda: {"grid": over(), "capture": True, "moving": False, "opposed": True, "times": 1, "least_times": True},
    "largest_certified": lambda: {
        "scenario": "loaded-cart", "of": "slope", "between": (0.1, 0.2), "tolerance": 0.09, "share": 0.1, "cells": 5,
        "sample_time": 0.2, "horizon": 0.2, "inputs": 2, "uncertain": {"mass": (19.0, 21.0)}, "errors": {"x": 0.01}, "delay": 0.02, "overrides": ["grid.nodes=7"],
    },
    "margin_figure": lambda: {
        "values": [0.1, 0.2], "fractions": [0.5, 0.0], "name": "current", "unit": "m/s", "threshold": 0.0, "answers": None,
        "keeps": False,
    },
    "obstacles": lambda: {
        "system": hf.systems.unicycle(), "polygons": {"pier": [[0, 0], [1, 0], [0, 1]]}, "room": None, "clearance": 0.1,
        "position": ("x", "y"),
    },
    "targets_in_view": lambda: {
        "system": hf.panning(hf.systems.unicycle(), 1.0), "targets": {"lamp": (2.0, 2.0)},
        "polygons": {"pier": [[0, 0], [1, 0], [0, 1]]}, "room": None, "at_least": 1, "clearance": 0.1, "half_angle": 0.5,
        "range_min": 0.1, "range_max": 5.0, "heading": "psi", "pan": "pan", "pan_limit": 2.0, "position": ("x", "y"),
    },
    "panning": lambda: {"system": hf.systems.unicycle(), "rate": 1.0, "name": "pan"},
    "observe_set": lambda: {
        "system": line(), "law": push_law(), "measured": ["x"], "bandwidth": 2.0,
        "error_bounds": {"x": 0.1}, "rate_bounds": {"d": 0.1},
    },
    "observe": lambda: {"system": line(), "law": push_law(), "measured": ["x"], "bandwidth": 2.0},
    "optimal_input_figure": lambda: plane_figure(),
    "outward_rates": lambda: {"system": line(), "region": end(), "law": push_law()},
    "parse_condition": lambda: {"text": "x < 1", "names": {"x": x}},
    "parse_expression": lambda: {"text": "x + 1", "names": {"x": x}},
    "paths_figure": lambda: {"result": station(), "plane": ("x", "y"), "highlight": 1, "cones": 1, "cone_run": 0},
    "plane_by_plane": lambda: {"field": hf.fields.electric_dipole(), "count": 1, "seed": 0},
    "add_unmodelled": lambda: {"system": line(), "names": ["u", "x"], "bounds": hf.Box((-1, -1), (1, 1))},
    "cancel_unmodelled": lambda: {"system": hf.add_unmodelled(line(), ["u"], hf.Box((-1,), (1,))), "law": push_law()},
    "lagged": lambda: {"system": line(), "lag": {"u": 0.1}, "slew": {"u": 1.0}},
    "limit_rates": lambda: {"system": line(), "law": push_law(), "rates": {"u": 1.0}},
    "load_vehicle": lambda: {"name": "bluerov2", "thrust_limit": 1.0},
    "both": lambda: {"first": near(), "second": hf.input_limits(hf.systems.unicycle())},
    "commanded": lambda: {"system": line(), "outputs": ["u"]},
    "dynamic_extension": lambda: {
        "system": hf.systems.unicycle(), "inputs": ("v",), "rates": hf.Box((-1,), (1,)),
    },
    "in_order": lambda: {"filters": [hf.safeguard(line(), push_law(), end())]},
    "input_limits": lambda: {"system": hf.systems.unicycle(), "inputs": ("v",)},
    "promote": lambda: {
        "system": hf.systems.marine_vehicle(), "states": ("u", "r"), "bounds": hf.Box((-1, -1), (1, 1)), "disturbances": ("v",),
        "disturbance_bounds": hf.Box((-0.1,), (0.1,)),
    },
    "redesign": lambda: redesigned(),
    "steady_bounds": lambda: {"system": hf.systems.marine_vehicle(), "states": ("u", "r")},
    "regulation_map": lambda: {
        "system": line(), "region": end(), "state": [1.0], "parameters": {"push": 0.1}, "tolerance": 1e-6,
        "disturbance": "none", "gains": (1.0, 2.0),
    },
    "regulation_map_figure": lambda: {
        "found": hf.regulation_map(hf.systems.unicycle(), near(), [1.0, 0.0, 0.0]),
    },
    "renamed": lambda: {"system": line(), "names": {"x": "z"}, "name": "other"},
    "resting_directions": lambda: {
        "system": hf.systems.drifting_unicycle(), "region": end(), "speed": 0.1, "count": 2, "box": {"x": (-1, 1)}, "searches": 1,
        "seed": 0,
    },
    "resting_state": lambda: {
        "system": line(), "region": end(), "disturbance": {"d": 0.1}, "box": {"x": (-1, 1)}, "searches": 1, "seed": 0,
    },
    "safeguard": lambda: {
        "system": line(), "law": push_law(), "region": end(), "gains": (1.0, 4.0), "margins": {"end": 0.1},
        "scales": {"u": 1.0}, "disturbance_measured": False,
    },
    "least_time_law": lambda: {"system": slider(), "value": reached(), "sample_time": 0.02},
    "relative_system": lambda: {
        "ours": hf.systems.unicycle(), "theirs": hf.systems.unicycle(), "position": ("x", "y"), "heading": "psi", "common": (),
    },
    "safety_law": lambda: {
        "system": line(), "value": value(), "law": push_law(), "rate": 2.0, "margin": 0.1, "sample_time": 0.02, "delay": 0.0,
        "scales": {"u": 1.0},
    },
    "sampled_margin": lambda: {"system": line(), "value": value(), "sample_time": 0.02, "delay": 0.0},
    "seen_from": lambda: {
        "leader": robots()[0], "leader_pose": ("xL", "yL", "psiL"), "follower": robots()[1],
        "follower_pose": ("x", "y", "psi"), "pose": ("x", "y", "psi"),
    },
    "simulate": lambda: {
        "system": line(), "law": push_law(), "starts": [[0.1]], "part": range(1), "region": end(), "goal": end(), "horizon": 0.2,
        "stepper": "rk4", "disturbance": {"d": 0.1}, "plant": {"push": 0.3}, "varied": hf.Varied(), "reference": {"x": 0.0},
        "start_outside": False, "sample_time": 0.02, "substeps": 2, "record_every": 0.1, "tolerance": 0.0, "seed": 1,
        "delay": 0.0, "until_goal": True, "switch_limit": 5, "noise_normal": {"x": 0.01}, "noise_uniform": {"x": 0.01},
    },
    "station_keeping_limits": lambda: {"speed_bound": 0.3, "lam": 3.0, "k1": 1.5, "r0": 0.1, "k2": 5.0},
    "station_statistics": lambda: {"result": station(), "radius": 0.1, "settled": 0.5, "heading": 0.1},
    "subsystem": lambda: {"system": hf.systems.marine_vehicle(), "states": ("u", "v", "r")},
    "surface_figure": lambda: {"value": solid(), "at": None, "others": None, "label": "set", "view": (25.0, -60.0)},
    "sweep": lambda: {
        "scenario": "ch2-unicycle", "over": ["k=1:2:2"], "latin": None, "runs": 1, "seed": 1, "overrides": ["run.horizon=0.2"],
        "executor": here(),
    },
    "symbol": lambda: {"name": "x"},
    "wiener_process": lambda: {"intensity": 0.1},
    "identify": lambda: {
        "system": boat(), "log": short_log(), "held_out": None, "estimate": ["drag"], "hold": ["mass"], "outputs": None,
        "unexplained_rates": ["u"], "level": 0.95, "window": None, "widen": 1.5,
    },
    "identification_figure": lambda: {"found": identified()},
    "tune": lambda: {
        "scenario": "ch4-integrator", "cost": "time", "gains": ["k2=0.5:1"], "margin": 0.1, "candidates": 10, "runs": 1,
        "seed": 1, "case": None, "overrides": ["run.horizon=4"],
    },
    "tuning_figure": lambda: {"found": tuning()},
    "track_velocity": lambda: {
        "system": hf.systems.marine_vehicle(), "law": hf.laws.steer_marine(hf.systems.marine_vehicle()), "gains": {"u": 5.0, "r": 9.0},
    },
    "ultimate_bound": lambda: {"k1": 0.16, "mu": 1.5, "current": 0.05},
    "value_function_figure": lambda: {
        "value": solid(), "plane": ("x", "y"), "at": {"psi": 0.0}, "others": None, "label": "set", "scene": (), "parameters": {},
    },
    "viability_conditions": lambda: {"system": line(), "region": end()},
    "visibility_gains": lambda: {
        "k1": 0.6, "distance": 1.0, "range_max": 2.5, "half_angle": 0.6, "leader_speed": 0.2, "softness": 0.05, "turn": "bearing",
        "robot_radius": 0.2,
    },
    "winding_number": lambda: {"field": hf.fields.dipolar(), "radius": 1.0, "centre": (0.0, 0.0), "samples": 64},
}  # fmt: skip

FINE = {
    ("disc", "radius", "nan"),  # `step` then answers NOT_A_NUMBER
    ("capsule", "radius", "nan"),
    ("compare", "laws", "none"),  # all of them: minutes
    ("compare", "cases", "none"),
    ("sweep", "executor", "none"),  # processes of its own
    ("export_c_table", "path", "text"),  # the name of a file, which would be written
    ("Ball", "radius", "text"),  # the name of a parameter
    ("PfaffianRow", "rhs", "text"),
}
"""What is no nonsense, and takes long."""

SIDE_BY_SIDE = "side_by_side"  # takes as many systems as one likes

CLASSES = {
    "Ball": lambda: {"radius": 1, "dimension": 2},
    "Box": lambda: {"lower": (-1,), "upper": (1,)},
    "Boundary": lambda: {"system": line(), "region": end(), "parameters": {"push": 0.1}, "tolerance": 1e-6},
    "Field": lambda: {
        "name": "f", "coordinates": (hf.Quantity("x"), hf.Quantity("y")), "components": (x, y), "moment": (1, 0),
        "parameters": (), "factor": 1, "unit": "1", "description": "", "source": "",
    },
    "GainCondition": lambda: {"value": k, "limit": 2, "consequence": "it ends", "source": "us", "closed": False},
    "CertifiedFilter": lambda: {
        "certificate": certificate(), "system": hf.load_scenario("seen-target").system, "scales": {"u": 1.0}, "fallback": [0.0, 0.0],
    },
    "Controller": lambda: {"of": line(), "law": push_law(), "sample_time": 0.02},
    "Plant": lambda: {"system": line(), "start": [0.1], "sample_time": 0.02, "substeps": 2},
    "Relay": lambda: {"keep": keeper(), "patience": 0.25},
    "SafetyFilter": lambda: {
        "system": line(), "keep": end(), "sample_time": 0.02, "delay": 0.0, "rate": None, "margin": None, "gains": (1.0, 4.0),
        "margins": {"end": 0.1}, "constraints": None, "disturbance_measured": False, "states": None, "bandwidth": 2.0, "scales": {"u": 1.0}, "rates": {"x": 1.0},
        "fallback": [0.0], "around": line(),
    },
    "Inequality": lambda: {"name": "c", "expression": x - 1, "unit": "m", "description": ""},
    "Law": lambda: {
        "name": "law", "reads": (hf.Quantity("x"),), "outputs": {"u": x}, "parameters": (), "signals": {"s": x},
        "conditions": (),
    },
    "Antiderivative": lambda: {"name": "arc", "integrand": k, "variable": k, "upper": x},
    "FlatOutput": lambda: {"first": x, "last": (y,), "antiderivatives": ()},
    "LinearImage": lambda: {"matrix": hf.systems.marine_vehicle().input_bounds.matrix, "of": hf.Box((-1, -1), (1, 1)), "actuators": ("a", "b")},
    "Measurement": lambda: {"name": "range", "unit": "m", "description": "", "angle": False, "expression": x},
    "Memory": lambda: {
        "quantities": (hf.Quantity("z"),), "initial": {"z": x}, "following": {"z": x}, "reads": (hf.Quantity("x"),),
        "inputs": (), "parameters": (),
    },
    "OccupancyMap": lambda: {
        "cells": [[0, 100]], "resolution": 0.5, "origin": (0.0, 0.0, 0.0), "unknown": "free", "occupied_thresh": 0.65, "free_thresh": 0.2,
    },
    "Obstacle": lambda: {
        "bodies": ((((1.0, 2.0),), 0.4),), "velocity": (0.1, 0.0), "acceleration": 0.1, "velocity_error": 0.1,
        "age": 0.1, "share": 0.5, "name": "buoy",
    },
    "Obstacles": lambda: {
        "most": 2, "hull": 0.2, "lead": 0.3, "speed": 0.2, "clearance": 0.1, "position": ("x", "y"), "heading": "psi",
    },
    "Parameter": lambda: {"name": "k", "unit": "1", "description": "", "angle": False, "value": 1.0, "source": "", "assumed": False, "above": 0.0},
    "PfaffianRow": lambda: {"coefficients": {"x": x}, "rhs": 0},
    "Product": lambda: {"parts": (hf.Box((-1,), (1,)), hf.Ball(1, 2))},
    "Quantity": lambda: {"name": "x", "unit": "rad", "description": "", "angle": True, "role": ""},
    "Region": lambda: {"name": "r", "reads": (hf.Quantity("x"),), "inequalities": (hf.Inequality("c", x),), "parameters": (), "scene": ()},
    "Starts": lambda: {"states": [{"x": 0.1}], "random": 1, "box": {"x": (-1.0, 1.0)}, "active": ()},
    "Switching": lambda: {
        "name": "s", "modes": {"a": push_law(), "b": push_law()}, "transitions": (hf.Transition("a", "b", x),), "initial": "a",
        "signals": {"s": x}, "extra_parameters": (), "description": "", "source": "",
    },
    "System": lambda: {
        "name": "s", "states": (hf.Quantity("x"),), "inputs": (hf.Quantity("u"),), "rates": {"x": hf.symbol("u")}, "parameters": (),
        "disturbances": (), "input_bounds": hf.Box((-1,), (1,)), "disturbance_bounds": None, "pfaffian": (),
    },
    "Transition": lambda: {"source": "a", "target": "b", "when": x},
    "Varied": lambda: {"draws": {"d": (0.0, 1.0)}, "values": {"k": hf.symbol("d")}, "plant": {"push": hf.symbol("d")}, "units": {"d": "m"}},
}  # fmt: skip


METHODS = {
    "OccupancyMap.from_file": lambda: (hf.OccupancyMap, {"path": str(Path(__file__).parents[2] / "examples" / "rooms.yaml"), "unknown": "free"}),
    "OccupancyMap.from_distances": lambda: (
        hf.OccupancyMap, {"distances": [[0.0, 2.0]], "resolution": 0.5, "origin": (0.0, 0.0, 0.0), "unknown": "free"},
    ),
    "OccupancyMap.update": lambda: (some_map(), {"patch": [[100]], "row": 0, "column": 1}),
    "OccupancyMap.occupied": lambda: (some_map(), {"points": [[0.1, 0.2]]}),
    "OccupancyMap.distance": lambda: (some_map(), {"points": [[0.1, 0.2]]}),
    "OccupancyMap.near": lambda: (some_map(), {"points": [0.1, 0.2], "within": 1.0}),
    "OccupancyMap.polygons": lambda: (some_map(), {"box": ((0.0, 1.0), (0.0, 1.0))}),
    "CertifiedFilter.step": lambda: (hf.CertifiedFilter(certificate()), {"state": [1.2, 0.1], "command": [0.1, 0.2], "t": None, "disturbance": None}),
    "CertifiedFilter.step_many": lambda: (
        hf.CertifiedFilter(certificate()), {"states": [[1.2, 0.1]], "commands": [[0.1, 0.2]]},
    ),
    "CertifiedFilter.around": lambda: (
        hf.CertifiedFilter(certificate()), {"controller": hf.certified_law(certificate())},
    ),
    "SafetyFilter.step": lambda: (keeper(), {"state": [0.1], "command": [0.2], "t": None, "disturbance": None}),
    "SafetyFilter.step_many": lambda: (
        keeper(), {"states": [[0.1]], "commands": [[0.2]], "disturbances": None},
    ),
    "Controller.step": lambda: (
        hf.Controller(line(), push_law()), {"measurement": [0.1], "t": None, "disturbance": None},
    ),
    "Relay.measured": lambda: (hf.Relay(keeper()), {"state": [0.1], "now": 0.0, "disturbance": None}),
    "Relay.commanded": lambda: (hf.Relay(keeper()), {"command": [0.1], "now": 0.0}),
    "Relay.surrounded": lambda: (hf.Relay(clear()), {"obstacles": [buoy()], "now": 0.0}),
    "SafetyFilter.among": lambda: (
        clear(), {"command": lambda t, q: [[0.1, 0.0]], "obstacles": lambda t, q: [[buoy()]]},
    ),
    "Obstacle.aged": lambda: (buoy(), {"seconds": 0.1}),
    "Obstacle.of_table": lambda: (buoy(), {"table": {"disc": [1, 2, 0.5], "velocity": [0.1, 0]}}),
    "Obstacle.disc": lambda: (buoy(), {"centre": (1, 2), "radius": 0.4}),
    "Obstacle.capsule": lambda: (buoy(), {"start": (1, 2), "end": (2, 2), "radius": 0.4}),
    "Obstacle.ellipse": lambda: (buoy(), {"centre": (1, 2), "axes": (0.4, 0.2), "heading": 0.1}),
    "Obstacle.polygon": lambda: (buoy(), {"corners": [(1, 2), (2, 2), (2, 3)], "radius": 0.1}),
    "Relay.decide": lambda: (hf.Relay(keeper()), {"now": 0.0}),
    "Plant.step": lambda: (hf.Plant(line(), [0.1]), {"input": [0.2], "disturbance": [0.1]}),
    "ValueFunction.values": lambda: (value(), {"time": None}),
    "ValueFunction.at": lambda: (value(), {"states": [[0.1]], "time": None}),
    "ValueFunction.gradient": lambda: (value(), {"states": [[0.1]], "time": None}),
    "ValueFunction.contains": lambda: (value(), {"states": [[0.1]], "margin": 0.0}),
    "ValueFunction.fraction": lambda: (value(), {"time": None}),
    "ValueFunction.volume": lambda: (value(), {"time": None}),
    "ValueFunction.extent": lambda: (value(), {"time": None}),
    "ValueFunction.slice": lambda: (solid(), {"psi": 0.1}),
    "PartsValue.at": lambda: (apart(), {"states": [[0.1]], "time": None}),
    "PartsValue.gradient": lambda: (apart(), {"states": [[0.1]], "time": None}),
    "PartsValue.contains": lambda: (apart(), {"states": [[0.1]], "margin": 0.0}),
    "PartsValue.inputs": lambda: (apart(), {"states": [[0.1]], "time": None}),
    "PartsValue.share": lambda: (apart(), {"box": {"x": (-1.0, 1.0)}, "runs": 10, "seed": 1}),
    "Campaign.variable": lambda: (campaign(), {"name": "refused"}),
    "Campaign.summary": lambda: (campaign(), {"variable": "refused"}),
    "Campaign.values_of": lambda: (campaign(), {"cell": 0}),
    "Campaign.command": lambda: (campaign(), {"cell": 0}),
    "Comparison.of": lambda: (comparison(), {"law": "inspection", "case": "5 N"}),
    "Boundary.worst": lambda: (hf.Boundary(line(), end()), {"states": [[0.1]]}),
    "Boundary.active_set": lambda: (hf.Boundary(line(), end()), {"state": [1.0]}),
    "Boundary.outside": lambda: (hf.Boundary(line(), end()), {"state": [1.0]}),
    "Boundary.contingent_cone": lambda: (hf.Boundary(line(), end()), {"state": [1.0]}),
    "Boundary.regulation_map": lambda: (
        hf.Boundary(line(), end()), {"state": [1.0], "disturbance": "none", "gains": (1.0, 2.0)},
    ),
    "Region.inequality": lambda: (end(), {"name": "end"}),
    "System.derivative": lambda: (line(), {"expression": x}),
    "Ball.contains": lambda: (hf.Ball(1, 2), {"values": [0.1, 0.2], "slack": 0.0}),
    "Box.contains": lambda: (hf.Box((-1,), (1,)), {"values": [0.1], "slack": 0.0}),
    "Box.saturate": lambda: (hf.Box((-1,), (1,)), {"values": [x]}),
}  # fmt: skip


def some_map():
    return hf.OccupancyMap([[0, 100], [0, -1]], 0.5)


def buoy():
    return hf.Obstacle.disc((1, 2), 0.4, velocity=(0.1, 0))


@cache
def clear():
    """A filter of a robot among obstacles."""
    return hf.SafetyFilter(hf.systems.unicycle(), obstacles=hf.Obstacles(2, lead=0.3), gains=(1, 4))


@cache
def keeper():
    return hf.SafetyFilter(line(), end())


@cache
def here():
    from concurrent.futures import ThreadPoolExecutor

    return ThreadPoolExecutor(1)


@cache
def campaign():
    return hf.sweep(
        "ch2-unicycle", ["k=1,2"], runs=1, overrides=["run.horizon=0.2"], executor=here()
    )


@cache
def comparison():
    return hf.compare("ch5-rescue", ["inspection"], ["5 N"], overrides=["run.horizon=0.5"], runs=1)


def near():
    quantities = (hf.Quantity("x", "m"), hf.Quantity("y", "m"))
    return hf.Region("near", quantities, (hf.Inequality("far", x**2 + y**2 - 1, "m^2"),))


@cache
def solid():
    robot = hf.systems.unicycle()
    box = {"x": (-1.2, 1.2), "y": (-1.2, 1.2), "psi": (-np.pi, np.pi)}
    return hf.viability_kernel(robot, near(), hf.grid(robot, box, 9), 0.2)


def plane_figure():
    from holdfast.analysis.safety.safety_filter import optimal_inputs

    inputs, velocity = optimal_inputs(hf.systems.unicycle(), solid(), ("x", "y"), {"psi": 0.0})
    return {
        "value": solid(), "inputs": {n: inputs[n] for n in list(inputs)[:1]}, "velocity": velocity, "plane": ("x", "y"),
        "at": {"psi": 0.0}, "others": None, "scene": (), "parameters": {},
    }  # fmt: skip


def redesigned():
    vehicle = hf.systems.marine_vehicle()
    law, view = hf.laws.steer_marine(vehicle), hf.regions.camera_view()
    face = hf.laws.face_target(vehicle)
    names = view.inequality_names
    return {
        "law": law, "region": view, "viable": dict.fromkeys(names, face),
        "layers": dict.fromkeys(names, (-0.1, -0.03)), "as_printed": False,
    }  # fmt: skip


def catalogue():
    """Every entry with the arguments it is built on, and those of its own."""
    from holdfast.maths.catalogue.signature import leading_argument

    for kind in (hf.systems, hf.laws, hf.regions, hf.fields):
        for function in kind.ALL:
            yield function, leading_argument(function)


CATALOGUE = {function.__name__: (function, leading) for function, leading in catalogue()}


def built_on(function):
    """A system that the entry is made for."""
    with_sway = partial(hf.systems.marine_craft, "cybership_ii_full")
    for system in (*hf.systems.ALL, with_sway):
        try:
            function(system())
        except HoldfastError:
            continue
        return system()
    raise AssertionError(function.__name__)


def entry_arguments(function, leading):
    signature = inspect.signature(function).parameters.values()
    found = {
        p.name: p.default for p in signature if p.default is not p.empty and p.kind != p.VAR_KEYWORD
    }
    if leading == "system":
        found["system"] = built_on(function)
    elif leading == "law":
        found["law"] = hf.laws.steer_marine(hf.systems.marine_vehicle())
    return found


@contextlib.contextmanager
def within(seconds):
    """An answer in that time, or `TimeoutError`."""

    def late(number, frame):
        raise TimeoutError(f"no answer in {seconds} s")

    before = signal.signal(signal.SIGALRM, late)
    signal.alarm(seconds)
    try:
        yield
    finally:
        signal.alarm(0)
        signal.signal(signal.SIGALRM, before)


def attempts(function, base, some=None):
    """The calls with one argument replaced; what they gave that is neither an answer nor a refusal.

    some: how many of the nonsense each argument is given, in turn; by default all of it.
    """
    wrong, turn = [], 0
    with warnings.catch_warnings(), np.errstate(all="ignore"):
        warnings.simplefilter("ignore")
        function(**base) if function is not hf.load else None
        for name, given in base.items():
            kinds = list(NONSENSE.items())
            if some is not None:
                kinds = [kinds[(turn + i) % len(kinds)] for i in range(some)]
                turn += some
            for what, nonsense in kinds:
                if (function.__name__, name, what) in FINE:
                    continue
                try:
                    with within(PATIENCE):
                        function(**{**base, name: nonsense})
                except HoldfastError as error:
                    if len(str(error)) < 10:
                        wrong.append(f"{name} = {what}: '{error}'")
                except Exception as error:
                    wrong.append(f"{name} = {what}: {type(error).__name__}: {error}"[:200])
                else:
                    number = isinstance(given, float) or (
                        isinstance(given, int) and not isinstance(given, bool)
                    )
                    if number and what in (
                        "nan",
                        "text",
                        "list of nan",
                        "object",
                        "complex",
                        "array of nan",
                    ):
                        wrong.append(f"{name} = {what}: taken")
    return wrong


def close():
    import matplotlib.pyplot as plt

    plt.close("all")


def few_and_all(names):
    """Every name, with how many kinds of nonsense each argument is given; heavy: all of them."""
    few = [pytest.param(n, 3, id=n) for n in names]
    return few + [pytest.param(n, None, marks=pytest.mark.heavy, id=f"{n} all") for n in names]


@pytest.mark.slow(
    "check_promise",
    "comparison_figure",
    "critical_points",
    "certify",
    "outer_set",
    "judge_law",
    "certificate_figure",
    "parts_law",
    "explain",
    "export_c_table",
    "explore",
    "load_scenario",
    "largest_certified",
    "identify",
    "tune",
    "value_function_figure",
)
@pytest.mark.parametrize(("name", "some"), few_and_all(FUNCTIONS))
def test_nonsense_is_refused_by_functions(name, some):
    wrong = attempts(getattr(hf, name), FUNCTIONS[name](), some)
    close()
    assert not wrong, "\n".join(wrong)


@pytest.mark.slow("SafetyFilter")
@pytest.mark.parametrize("name", CLASSES)
def test_nonsense_is_refused_by_definitions(name):
    wrong = attempts(getattr(hf, name), CLASSES[name]())
    assert not wrong, "\n".join(wrong)


@pytest.mark.slow("steer_by_chained_form", "follow_field")
@pytest.mark.parametrize(("name", "some"), few_and_all(CATALOGUE))
def test_nonsense_is_refused_by_the_catalogue(name, some):
    function, leading = CATALOGUE[name]
    wrong = attempts(function, entry_arguments(function, leading), some)
    assert not wrong, "\n".join(wrong)


@pytest.mark.parametrize("name", METHODS)
def test_nonsense_is_refused_by_methods(name):
    of, base = METHODS[name]()
    wrong = attempts(getattr(of, name.split(".")[1]), base)
    assert not wrong, "\n".join(wrong)


FORMER = {"backward_reachable_set"}
"""Former names, which hand everything to the new ones."""


def test_every_public_function_is_asked():
    functions = {n for n in hf.__all__ if inspect.isfunction(getattr(hf, n))}
    assert functions == set(FUNCTIONS) | {SIDE_BY_SIDE, *FORMER}


def test_systems_side_by_side_are_systems():
    for what, nonsense in NONSENSE.items():
        with pytest.raises(HoldfastError):
            hf.side_by_side(line(), nonsense, name="two")
        if what != "text":
            with pytest.raises(HoldfastError):
                hf.side_by_side(line(), slider(), name=nonsense)


def test_true_is_no_number_of_a_run():
    with pytest.raises(HoldfastError, match="run is True; expected a whole number"):
        hf.histories_figure(result(), run=True)
    with pytest.raises(HoldfastError, match=r"runs is 1e\+22; expected a whole number below 2\^63"):
        hf.load_scenario("inspection", runs=1e22)


@pytest.mark.parametrize("function", [hf.laws.back_off, hf.laws.move_ahead])
def test_law_built_on_another_names_the_output_that_it_needs(function):
    with pytest.raises(HoldfastError, match=r"needs a law with the output 'u'; .* which has v"):
        function(hf.laws.steer_unicycle(hf.systems.unicycle()))
