"""Shared fixtures. Floating-point faults raise in NumPy code; compiled code has its outcomes."""

import gc
import os
import signal

os.environ.setdefault("SYMPY_CACHE_SIZE", "50000")  # many systems in one process
os.environ.setdefault("MPLBACKEND", "Agg")


import numpy as np
import pytest
import sympy as sp
from hypothesis import settings

import holdfast as hf

np.seterr(all="raise", under="ignore")
settings.register_profile("here", deadline=None)  # the machine may do other things as well
settings.load_profile("here")
if signal.getsignal(signal.SIGINT) == signal.SIG_IGN:  # in the background of a script
    signal.signal(signal.SIGINT, signal.default_int_handler)  # else no child could be interrupted
gc.set_threshold(50_000)  # expressions and the compiler keep most of what they make

LEFT_OUT = pytest.StashKey[set[str]]()
"""The ids of the tests that the fast run leaves out, of the files that were collected."""
NO_CASE = pytest.StashKey[set[str]]()
"""Cases that `few` or `slow` names and that no test has, where all cases were collected."""


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(config, items):
    missing = {}
    for item in items:
        for mark in [m for m in item.iter_markers() if m.name in ("few", "slow")]:
            test, case = item.nodeid.removesuffix("]").split("[", 1)
            missing.setdefault(test, set(mark.args)).discard(case)
            if (case in mark.args) == (mark.name == "slow"):
                item.add_marker("heavy")
    config.stash[NO_CASE] = {f"{test}[{case}]" for test, cases in missing.items() for case in cases}
    config.stash[LEFT_OUT] = {
        item.nodeid
        for item in items
        if any(item.get_closest_marker(name) for name in ("heavy", "thesis"))
    }


@pytest.fixture(scope="session")
def vehicle():
    return hf.systems.marine_vehicle()


@pytest.fixture(scope="session")
def double_integrator():
    """xdot = v, vdot = a with |a| <= 1: motions known in closed form."""
    v, a = hf.symbol("v"), hf.symbol("a")
    return hf.System(
        name="double_integrator",
        states=(hf.Quantity("x", "m"), hf.Quantity("v", "m/s")),
        inputs=(hf.Quantity("a", "m/s^2"),),
        rates={"x": v, "v": a},
        input_bounds=hf.Box((-1,), (1,)),
    )


@pytest.fixture(scope="session")
def wall():
    """x <= 1."""
    x = hf.symbol("x")
    return hf.Region("wall", (hf.Quantity("x", "m"),), (hf.Inequality("wall", x - 1, "m"),))


def constant_law(system, value):
    """A law that commands the same input for ever: one program for all values."""
    parameters = (hf.Parameter("wanted", system.inputs[0].unit, value=value),)
    outputs = {system.input_names[0]: hf.symbol("wanted")}
    return hf.Law("constant", system.states, outputs, parameters=parameters)


def number_at(expression, at):
    """Its value where every symbol has one: `subs`, but in one pass over the expression."""
    return float(expression.xreplace({symbol: sp.N(value) for symbol, value in at.items()}))
