"""Kinds of actuators of a craft on the plane: one kind, one file; `ALL` lists them."""

from holdfast.maths.catalogue.actuators.azimuth_thruster import AZIMUTH_THRUSTER
from holdfast.maths.catalogue.actuators.rudder import RUDDER
from holdfast.maths.catalogue.actuators.thruster import THRUSTER

ALL = (THRUSTER, AZIMUTH_THRUSTER, RUDDER)
