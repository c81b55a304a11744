"""The catalogue of reference fields; membership in `ALL` enrols an entry in the tests."""

from typing import TYPE_CHECKING

from holdfast.errors import refused_attribute
from holdfast.maths.catalogue.fields.charge_pair import charge_pair
from holdfast.maths.catalogue.fields.dipolar import dipolar
from holdfast.maths.catalogue.fields.dipole_in_current import dipole_in_current
from holdfast.maths.catalogue.fields.dipole_like import dipole_like
from holdfast.maths.catalogue.fields.electric_dipole import electric_dipole

ALL = (dipolar, dipole_like, dipole_in_current, electric_dipole, charge_pair)

__all__ = [
    "ALL",
    "charge_pair",
    "dipolar",
    "dipole_in_current",
    "dipole_like",
    "electric_dipole",
]

if not TYPE_CHECKING:
    __getattr__ = refused_attribute("holdfast.fields", [f.__name__ for f in ALL])
