"""Charts in geographic coordinates, against distances on the ellipsoid."""

from __future__ import annotations

import json

import numpy as np
import pytest

import holdfast as hf
from holdfast.errors import DefinitionError

pyproj = pytest.importorskip("pyproj", reason="needs holdfast[interop]: pyproj")

from holdfast.interop.charts import Chart  # noqa: E402


def written(folder, *geometries):
    features = [
        {
            "type": "Feature",
            "properties": {"name": name},
            "geometry": {"type": kind, "coordinates": c},
        }
        for name, kind, c in geometries
    ]
    path = folder / "chart.geojson"
    path.write_text(json.dumps({"type": "FeatureCollection", "features": features}))
    return path


PIER = [[10.40, 63.441], [10.402, 63.441], [10.402, 63.4415], [10.40, 63.441]]


def test_distances_and_courses_from_the_place_are_those_on_the_ellipsoid():
    chart, globe = Chart(63.44, 10.40), pyproj.Geod(ellps="WGS84")
    random = np.random.default_rng(1)
    places = np.array([63.44, 10.40]) + random.uniform(-0.1, 0.1, (50, 2))
    points = chart.metres(places)
    course, _, far = globe.inv(*np.tile([[10.40], [63.44]], 50), places[:, 1], places[:, 0])
    assert np.linalg.norm(points, axis=1) == pytest.approx(far, rel=1e-9)
    assert np.arctan2(points[:, 0], points[:, 1]) == pytest.approx(np.radians(course), abs=1e-9)
    assert chart.degrees(points) == pytest.approx(places, abs=1e-10)


def test_distances_between_places_ten_kilometres_away_are_off_by_less_than_a_millionth():
    chart, globe = Chart(63.44, 10.40), pyproj.Geod(ellps="WGS84")
    places = chart.degrees([[-300.0, 10_000.0], [300.0, 10_000.0]])
    _, _, far = globe.inv(*places[0, ::-1], *places[1, ::-1])
    assert abs(far - 600.0) / 600.0 < 1e-6


def test_polygons_of_a_chart_are_obstacles_in_metres(tmp_path):
    chart = Chart(63.44, 10.40)
    path = written(
        tmp_path, ("pier", "Polygon", [PIER]), ("isles", "MultiPolygon", [[PIER], [PIER]])
    )
    named = chart.polygons(path)
    assert list(named) == ["pier", "isles_1", "isles_2"]
    assert np.array(named["pier"])[0] == pytest.approx([0.0, 111.47], abs=0.05)
    region = hf.obstacles(hf.systems.unicycle(), {"pier": named["pier"]}, clearance=2.0)
    assert region.inequality_names == ("pier",)


@pytest.mark.parametrize(
    ("coordinates", "said"),
    [
        ([[[500.0, 7000.0], [600.0, 7000.0], [600.0, 7100.0]]], "latitude 7000, longitude 500"),
        ([[[10.0, "north"], [10.1, 63.0], [10.1, 63.1]]], "no place"),
        ([PIER, PIER], "expected a Polygon or MultiPolygon without holes"),
    ],
)
def test_a_chart_that_is_none_is_refused_in_a_line(tmp_path, coordinates, said):
    with pytest.raises(DefinitionError, match=said) as refused:
        Chart(63.44, 10.40).polygons(written(tmp_path, ("pier", "Polygon", coordinates)))
    assert "\n" not in str(refused.value)


def test_a_place_that_is_nowhere_is_refused():
    with pytest.raises(DefinitionError, match="latitude 163"):
        Chart(163.0, 10.0)
    with pytest.raises(DefinitionError, match="shape"):
        Chart(63.0, 10.0).metres([63.0, 10.0])
