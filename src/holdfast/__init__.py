"""holdfast: viability control of nonholonomic systems.

One symbolic definition, every answer. A vehicle, its law, its constraints and its
disturbances are written once as expressions; simulation, viable redesign and what follows
are derived from them. The inequality that everything here is about:

    c_j(q) <= 0   for all j, for all time
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

from holdfast._version import __version__

if TYPE_CHECKING:
    from holdfast.analysis.boundary import Boundary, contingent_cone, regulation_map
    from holdfast.analysis.campaign import Campaign
    from holdfast.analysis.comparison import Comparison
    from holdfast.analysis.grid import Grid, grid
    from holdfast.analysis.margin import Margin
    from holdfast.analysis.memory import march_memory
    from holdfast.analysis.promise import check_promise
    from holdfast.analysis.result import Result, load
    from holdfast.analysis.safety_law import safety_law, sampled_margin
    from holdfast.analysis.simulate import simulate
    from holdfast.analysis.starts import Starts
    from holdfast.analysis.station_statistics import station_statistics
    from holdfast.analysis.value_function import ValueFunction
    from holdfast.analysis.verdict import Promise
    from holdfast.analysis.viability_domain import check_viability
    from holdfast.analysis.viability_kernel import (
        backward_reachable_set,
        capture_basin,
        discriminating_kernel,
        forward_reachable_set,
        invariance_kernel,
        viability_kernel,
    )
    from holdfast.analysis.visibility_gains import GainWindow, visibility_gains
    from holdfast.campaign.sweep import sweep
    from holdfast.comparing import compare
    from holdfast.derivation import Derivation, explain
    from holdfast.errors import GainWarning, HoldfastError
    from holdfast.execution.c_source import export_c, export_c_header
    from holdfast.execution.closed_loop import Outcome
    from holdfast.margin import disturbance_margin
    from holdfast.maths import fields, laws, regions, systems
    from holdfast.maths.bounds import Ball, Box, LinearImage, Product
    from holdfast.maths.critical_points import classify, winding_number
    from holdfast.maths.expression import parse_condition, parse_expression
    from holdfast.maths.field import Field
    from holdfast.maths.field_facts import field_facts
    from holdfast.maths.flow_lines import exact_flow, flow_line
    from holdfast.maths.formation import renamed, seen_from, side_by_side
    from holdfast.maths.hamiltonian import Hamiltonian, hamiltonian
    from holdfast.maths.law import GainCondition, Law, Safeguard
    from holdfast.maths.lyapunov import ultimate_bound
    from holdfast.maths.measurement import Measurement
    from holdfast.maths.memory import Memory
    from holdfast.maths.observer import observe
    from holdfast.maths.planes import plane_by_plane
    from holdfast.maths.quantity import SAMPLE_TIME, TIME, TIME_IN_MODE, Parameter, Quantity, symbol
    from holdfast.maths.redesign import redesign
    from holdfast.maths.reduction import promote, subsystem
    from holdfast.maths.region import Inequality, Region
    from holdfast.maths.safeguard import safeguard
    from holdfast.maths.station_keeping import StationKeepingLimits, station_keeping_limits
    from holdfast.maths.switching import Switching, Transition
    from holdfast.maths.system import PfaffianRow, System
    from holdfast.maths.tangency import outward_rates
    from holdfast.maths.varied import Varied
    from holdfast.maths.velocity_tracking import track_velocity
    from holdfast.maths.viability import viability_conditions
    from holdfast.maths.zeros import critical_points
    from holdfast.presentation.campaign import campaign_figure
    from holdfast.presentation.comparison import comparison_figure
    from holdfast.presentation.flow_lines import flow_lines_figure
    from holdfast.presentation.histories import histories_figure
    from holdfast.presentation.margin import margin_figure
    from holdfast.presentation.optimal_input import optimal_input_figure
    from holdfast.presentation.paths import paths_figure
    from holdfast.presentation.regulation_map import regulation_map_figure
    from holdfast.presentation.surface import surface_figure
    from holdfast.presentation.value_function import value_function_figure
    from holdfast.scenario import Scenario, load_scenario

_HOME = {
    "analysis.boundary": ("Boundary", "contingent_cone", "regulation_map"),
    "analysis.comparison": ("Comparison",),
    "analysis.grid": ("Grid", "grid"),
    "analysis.campaign": ("Campaign",),
    "analysis.margin": ("Margin",),
    "analysis.memory": ("march_memory",),
    "analysis.promise": ("check_promise",),
    "analysis.verdict": ("Promise",),
    "analysis.result": ("Result", "load"),
    "analysis.safety_law": ("safety_law", "sampled_margin"),
    "analysis.simulate": ("simulate",),
    "analysis.starts": ("Starts",),
    "analysis.station_statistics": ("station_statistics",),
    "analysis.value_function": ("ValueFunction",),
    "analysis.viability_domain": ("check_viability",),
    "analysis.viability_kernel": (
        "backward_reachable_set",
        "capture_basin",
        "discriminating_kernel",
        "forward_reachable_set",
        "invariance_kernel",
        "viability_kernel",
    ),
    "analysis.visibility_gains": ("GainWindow", "visibility_gains"),
    "comparing": ("compare",),
    "derivation": ("Derivation", "explain"),
    "errors": ("GainWarning", "HoldfastError"),
    "execution.c_source": ("export_c", "export_c_header"),
    "execution.closed_loop": ("Outcome",),
    "campaign.sweep": ("sweep",),
    "margin": ("disturbance_margin",),
    "maths": ("fields", "laws", "regions", "systems"),
    "maths.bounds": ("Ball", "Box", "LinearImage", "Product"),
    "maths.critical_points": ("classify", "winding_number"),
    "maths.expression": ("parse_condition", "parse_expression"),
    "maths.field": ("Field",),
    "maths.field_facts": ("field_facts",),
    "maths.flow_lines": ("exact_flow", "flow_line"),
    "maths.formation": ("renamed", "seen_from", "side_by_side"),
    "maths.law": ("GainCondition", "Law", "Safeguard"),
    "maths.hamiltonian": ("Hamiltonian", "hamiltonian"),
    "maths.lyapunov": ("ultimate_bound",),
    "maths.measurement": ("Measurement",),
    "maths.memory": ("Memory",),
    "maths.observer": ("observe",),
    "maths.planes": ("plane_by_plane",),
    "maths.quantity": ("SAMPLE_TIME", "TIME", "TIME_IN_MODE", "Parameter", "Quantity", "symbol"),
    "maths.redesign": ("redesign",),
    "maths.reduction": ("promote", "subsystem"),
    "maths.region": ("Inequality", "Region"),
    "maths.safeguard": ("safeguard",),
    "maths.station_keeping": ("StationKeepingLimits", "station_keeping_limits"),
    "maths.switching": ("Switching", "Transition"),
    "maths.system": ("PfaffianRow", "System"),
    "maths.tangency": ("outward_rates",),
    "maths.varied": ("Varied",),
    "maths.velocity_tracking": ("track_velocity",),
    "maths.viability": ("viability_conditions",),
    "maths.zeros": ("critical_points",),
    "presentation.comparison": ("comparison_figure",),
    "presentation.flow_lines": ("flow_lines_figure",),
    "presentation.histories": ("histories_figure",),
    "presentation.campaign": ("campaign_figure",),
    "presentation.margin": ("margin_figure",),
    "presentation.optimal_input": ("optimal_input_figure",),
    "presentation.paths": ("paths_figure",),
    "presentation.regulation_map": ("regulation_map_figure",),
    "presentation.surface": ("surface_figure",),
    "presentation.value_function": ("value_function_figure",),
    "scenario": ("Scenario", "load_scenario"),
}
_WHERE = {name: home for home, names in _HOME.items() for name in names}

__all__ = [
    "SAMPLE_TIME",
    "TIME",
    "TIME_IN_MODE",
    "Ball",
    "Boundary",
    "Box",
    "Campaign",
    "Comparison",
    "Derivation",
    "Field",
    "GainCondition",
    "GainWarning",
    "GainWindow",
    "Grid",
    "Hamiltonian",
    "HoldfastError",
    "Inequality",
    "Law",
    "LinearImage",
    "Margin",
    "Measurement",
    "Memory",
    "Outcome",
    "Parameter",
    "PfaffianRow",
    "Product",
    "Promise",
    "Quantity",
    "Region",
    "Result",
    "Safeguard",
    "Scenario",
    "Starts",
    "StationKeepingLimits",
    "Switching",
    "System",
    "Transition",
    "ValueFunction",
    "Varied",
    "__version__",
    "backward_reachable_set",
    "campaign_figure",
    "capture_basin",
    "check_promise",
    "check_viability",
    "classify",
    "compare",
    "comparison_figure",
    "contingent_cone",
    "critical_points",
    "discriminating_kernel",
    "disturbance_margin",
    "exact_flow",
    "explain",
    "export_c",
    "export_c_header",
    "field_facts",
    "fields",
    "flow_line",
    "flow_lines_figure",
    "forward_reachable_set",
    "grid",
    "hamiltonian",
    "histories_figure",
    "invariance_kernel",
    "laws",
    "load",
    "load_scenario",
    "march_memory",
    "margin_figure",
    "observe",
    "optimal_input_figure",
    "outward_rates",
    "parse_condition",
    "parse_expression",
    "paths_figure",
    "plane_by_plane",
    "promote",
    "redesign",
    "regions",
    "regulation_map",
    "regulation_map_figure",
    "renamed",
    "safeguard",
    "safety_law",
    "sampled_margin",
    "seen_from",
    "side_by_side",
    "simulate",
    "station_keeping_limits",
    "station_statistics",
    "subsystem",
    "surface_figure",
    "sweep",
    "symbol",
    "systems",
    "track_velocity",
    "ultimate_bound",
    "value_function_figure",
    "viability_conditions",
    "viability_kernel",
    "visibility_gains",
    "winding_number",
]


def __getattr__(name: str) -> Any:
    """Names are imported when first used, so that `import holdfast` stays light."""
    if name not in _WHERE:
        raise AttributeError(f"module 'holdfast' has no attribute '{name}'")
    home = importlib.import_module(f"holdfast.{_WHERE[name]}")
    value = (
        importlib.import_module(f"holdfast.maths.{name}")
        if (_WHERE[name] == "maths")
        else getattr(home, name)
    )
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted(__all__)
