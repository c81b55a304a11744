"""Shared fixtures. Floating-point faults raise in NumPy code; compiled code has its outcomes."""

import gc
import os
import signal
from pathlib import Path

os.environ.setdefault("SYMPY_CACHE_SIZE", "50000")  # many systems in one process
os.environ.setdefault("MPLBACKEND", "Agg")


import numpy as np
import pytest
import sympy as sp
from hypothesis import settings

import holdfast as hf
from holdfast import arguments

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


TESTS = Path(__file__).parent
WITH_UNITS = (
    "known_solutions/test_ridges_that_fall.py",
    "known_solutions/test_sampled_inputs.py",
    "known_solutions/test_units.py",
    "known_solutions/test_units_of_values.py",
    "known_solutions/test_upwind_around_a_hole.py",
    "known_solutions/test_what_depends_on_time.py",
    "maths/catalogue/laws/test_inspect_target.py",
    "maths/catalogue/laws/test_rest_in_current.py",
    "maths/catalogue/laws/test_rest_in_varying_current.py",
    "maths/catalogue/regions/test_camera_and_lasers.py",
    "maths/catalogue/regions/test_hitch_angles.py",
    "maths/catalogue/regions/test_steering_angle.py",
    "maths/catalogue/test_car.py",
    "maths/catalogue/test_marine_craft.py",
    "maths/catalogue/test_slipping_unicycle.py",
    "maths/catalogue/test_tractor_trailer.py",
    "maths/catalogue/test_vehicles.py",
    "maths/control/test_blended_redesign.py",
    "maths/control/test_held_conditions.py",
    "maths/control/test_held_gain.py",
    "maths/control/test_later_inputs.py",
    "maths/control/test_observer.py",
    "maths/control/test_parameter_box.py",
    "maths/control/test_prediction.py",
    "maths/control/test_priority.py",
    "maths/control/test_rate_limits.py",
    "maths/control/test_safety_filter.py",
    "maths/control/test_set_observer.py",
    "maths/control/test_slow_down.py",
    "maths/control/test_surge_and_turn.py",
    "maths/control/test_unmodelled.py",
    "maths/decomposition/test_factor.py",
    "maths/decomposition/test_prediction.py",
    "maths/definitions/test_bounds.py",
    "maths/definitions/test_current.py",
    "maths/definitions/test_definitions.py",
    "maths/definitions/test_extension.py",
    "maths/definitions/test_lag.py",
    "maths/definitions/test_steady.py",
    "maths/definitions/test_units_and_vehicles.py",
    "maths/definitions/test_units_of_expressions.py",
    "maths/definitions/test_values.py",
    "maths/definitions/test_variation.py",
    "maths/definitions/test_written.py",
    "maths/expressions/test_canonical.py",
    "maths/expressions/test_functions.py",
    "maths/expressions/test_parser.py",
    "maths/expressions/test_random_points.py",
    "maths/expressions/test_syntax.py",
    "maths/expressions/test_traversal.py",
    "maths/formations/test_walls.py",
    "maths/games/test_hamiltonian.py",
    "maths/games/test_monotone_flux.py",
    "maths/games/test_sampled_inputs.py",
    "maths/nonholonomic/test_bodies.py",
    "maths/nonholonomic/test_chained_feedback.py",
    "maths/nonholonomic/test_flat_output.py",
    "maths/nonholonomic/test_integrability.py",
    "maths/nonholonomic/test_uniform_logic.py",
    "maths/reference_fields/test_fields.py",
    "maths/test_fields_and_gains.py",
    "maths/test_measured_motion.py",
    "planning/test_corners.py",
    "planning/test_environment.py",
    "planning/test_fields.py",
    "planning/test_obstacles.py",
    "planning/test_polylines.py",
    "presentation/figures/test_flow_lines.py",
    "presentation/figures/test_frame.py",
    "presentation/figures/test_optimal_input.py",
    "presentation/figures/test_regulation_map.py",
    "presentation/figures/test_surface.py",
    "presentation/figures/test_value_function.py",
    "presentation/studies/test_margin.py",
    "presentation/test_figures.py",
    "presentation/test_notebook.py",
    "presentation/test_own_figures.py",
    "promises/test_arguments.py",
    "promises/test_catalogue.py",
    "promises/test_craft.py",
    "scenario/test_certificate.py",
    "scenario/test_external.py",
    "scenario/test_files.py",
    "scenario/test_flat_output.py",
    "scenario/test_formation.py",
    "scenario/test_glossary.py",
    "scenario/test_kernel.py",
    "scenario/test_messages.py",
    "scenario/test_online_filter.py",
    "scenario/test_overrides.py",
    "scenario/test_parts.py",
    "scenario/test_resting.py",
    "studies/test_certification.py",
    "studies/test_certification_advice.py",
    "studies/test_derivation.py",
    "studies/test_disturbance_margin.py",
    "studies/test_exploration.py",
    "studies/test_explored_levels.py",
    "studies/test_explored_sweep.py",
    "studies/test_gains_page.py",
    "studies/test_identification.py",
    "studies/test_kernel_reference.py",
    "studies/test_largest_certified.py",
    "studies/test_law_certification.py",
    "studies/test_packed_slices.py",
    "studies/test_proofs.py",
    "studies/test_sweep.py",
    "studies/test_tune.py",
    "studies/thesis/test_explorers.py",
    "studies/thesis/test_report_page.py",
    "studies/thesis/test_reproduce.py",
    "test_architecture.py",
    "test_attack.py",
    "test_checks.py",
    "test_cli.py",
    "test_coming_from.py",
    "test_documentation.py",
    "test_documented_numbers.py",
    "test_examples.py",
    "test_extending.py",
    "test_filter_and_monitor.py",
    "test_first_hour.py",
    "test_hostile_input.py",
    "test_odd_files.py",
    "test_readme.py",
    "test_reference.py",
    "test_remedies.py",
    "test_scenarios.py",
    "test_versions.py",
    "test_vocabulary.py",
    "test_walk_of_a_limit.py",
    "thesis/test_chapter_2.py",
    "thesis/test_chapter_3.py",
    "thesis/test_chapter_3_directions.py",
    "thesis/test_chapter_3_noise_and_limits.py",
    "thesis/test_chapter_3_vehicle.py",
    "thesis/test_chapter_4.py",
    "thesis/test_chapter_5.py",
    "thesis/test_chapter_5_current.py",
    "thesis/test_chapter_5_inspection.py",
    "thesis/test_chapter_5_redesign.py",
    "thesis/test_chapter_5_tables.py",
    "thesis/test_chapter_6.py",
    "thesis/test_chapter_7.py",
    "thesis/test_fields_of_chapters_2_and_4.py",
    "thesis/test_marine_of_chapter_4.py",
)
"""Files in which units of definitions are checked as a user has it, beside all files of scenarios.

The models of other tests are numbers, in which a gain of 1 with a unit is not written.
"""


def _check_units_in(path):
    arguments._AT_WORK.depth = int(path not in [TESTS / name for name in WITH_UNITS])


@pytest.hookimpl(wrapper=True)
def pytest_make_collect_report(collector):
    _check_units_in(collector.path)
    return (yield)


@pytest.hookimpl(tryfirst=True)
def pytest_runtest_setup(item):
    _check_units_in(item.path)


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
