"""Charts in geographic coordinates: polygons and places in metres around a place, by pyproj.

The plane is that of an azimuthal equidistant projection on the ellipsoid of WGS 84: distances and
courses from the place are exact, and at the distance d the scale across is off by d^2 / (6 R^2),
with R the radius of the earth: 4e-7 at 10 km.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import numpy.typing as npt

from holdfast.arguments import checked
from holdfast.errors import DefinitionError
from holdfast.execution.arrays import Array
from holdfast.planning.environment import geojson_cells


class Chart:
    """Metres to the east and to the north of a place.

    latitude, longitude [degrees]: of the place that is (0, 0). Raises `DefinitionError` for one
    that is nowhere, and where the package pyproj is not installed.
    """

    @checked
    def __init__(self, latitude: float, longitude: float) -> None:
        _check(np.array([[latitude, longitude]]), "the place of the chart")
        try:
            import pyproj
        except ModuleNotFoundError:
            raise DefinitionError(
                "charts need the package pyproj",
                remedy='python -m pip install "holdfast[interop]"',
            ) from None
        self.latitude, self.longitude = float(latitude), float(longitude)
        plane = pyproj.CRS.from_dict(
            {"proj": "aeqd", "lat_0": latitude, "lon_0": longitude, "datum": "WGS84"}
        )
        self._to_plane = pyproj.Transformer.from_crs("EPSG:4326", plane, always_xy=True)

    def metres(self, places: npt.ArrayLike) -> Array:
        """Places (latitude, longitude) [degrees] as x to the east and y to the north [m].

        places: shape (places, 2), as is what it returns. Raises `DefinitionError` for places that
        are nowhere.
        """
        rows = _check(np.asarray(places, dtype=np.float64), "a place")
        return np.stack(self._to_plane.transform(rows[:, 1], rows[:, 0]), axis=1)

    def degrees(self, points: npt.ArrayLike) -> Array:
        """Points x, y [m] as latitude and longitude [degrees], shapes (points, 2)."""
        rows = np.asarray(points, dtype=np.float64)
        longitude, latitude = self._to_plane.transform(rows[:, 0], rows[:, 1], direction="INVERSE")
        return np.stack([latitude, longitude], axis=1)

    @checked
    def polygons(self, path: str | Path) -> dict[str, Sequence[tuple[float, float]]]:
        """The polygons of a GeoJSON file of longitudes and latitudes, for `holdfast.obstacles`:
        name -> corners (x, y) [m].

        Sides are straight in the plane. Raises `DefinitionError` for a file that is none, and for
        numbers that are no longitudes and latitudes.
        """
        named: dict[str, Sequence[tuple[float, float]]] = {}
        for name, corners in geojson_cells(path).items():
            try:
                rows = np.array(corners, dtype=np.float64).reshape(-1, 2)
            except (TypeError, ValueError):
                raise DefinitionError(
                    f"{path}: a corner of '{name}' is no place", expected="[longitude, latitude]"
                ) from None
            places = _check(rows[:, ::-1], f"{path}: a corner of '{name}'")
            named[name] = [(float(x), float(y)) for x, y in self.metres(places)]
        return named


def _check(places: Array, what: str) -> Array:
    """The places; refuses what is no latitude and longitude. places: shape (places, 2)."""
    if places.ndim != 2 or places.shape[1] != 2:
        raise DefinitionError(
            f"places have the shape {places.shape}", expected="(places, 2): latitude, longitude"
        )
    for latitude, longitude in places:
        if not (math.isfinite(longitude) and abs(latitude) <= 90 and abs(longitude) <= 360):
            raise DefinitionError(
                f"{what} is at latitude {latitude:g}, longitude {longitude:g}",
                expected="degrees, -90 to 90 and -180 to 180",
                remedy="a file in metres goes to holdfast.obstacles as it is",
            )
    return places
