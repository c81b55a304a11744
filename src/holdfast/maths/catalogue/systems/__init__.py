"""The catalogue of systems: a noun each; membership in `ALL` enrols it in the tests."""

from typing import TYPE_CHECKING

from holdfast.errors import refused_attribute
from holdfast.maths.catalogue.systems.car import car, front_axle_car
from holdfast.maths.catalogue.systems.chain import chain
from holdfast.maths.catalogue.systems.drifting_unicycle import drifting_unicycle
from holdfast.maths.catalogue.systems.driftless import (
    chained_form,
    nonholonomic_integrator,
    unicycle,
)
from holdfast.maths.catalogue.systems.leader_follower import leader_follower
from holdfast.maths.catalogue.systems.marine_craft import marine_craft
from holdfast.maths.catalogue.systems.marine_vehicle import marine_vehicle
from holdfast.maths.catalogue.systems.slipping_unicycle import slipping_unicycle
from holdfast.maths.catalogue.systems.tractor_trailer import tractor_trailer

ALL = (
    marine_vehicle,
    unicycle,
    drifting_unicycle,
    slipping_unicycle,
    nonholonomic_integrator,
    chained_form,
    car,
    front_axle_car,
    tractor_trailer,
    leader_follower,
    chain,
    marine_craft,
)

__all__ = [
    "ALL",
    "car",
    "chain",
    "chained_form",
    "drifting_unicycle",
    "front_axle_car",
    "leader_follower",
    "marine_craft",
    "marine_vehicle",
    "nonholonomic_integrator",
    "slipping_unicycle",
    "tractor_trailer",
    "unicycle",
]

if not TYPE_CHECKING:
    __getattr__ = refused_attribute("holdfast.systems", [f.__name__ for f in ALL])
