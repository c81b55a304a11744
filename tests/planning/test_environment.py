"""Cells, passages and routes: what robots have of a free space, and what is refused."""

import json
import math

import numpy as np
import pytest
import shapely

from holdfast.errors import DefinitionError
from holdfast.planning.environment import environment, geojson_cells, plan_route
from tests.planning.spaces import CORNER, SOUTH, WEST, box, ring


def test_corridor_of_the_thesis_is_that_of_inflated_obstacles():
    """w = 1.6 - 2 r0, and the exit is where the inflated corner is."""
    found = environment(CORNER, 0.2)
    west, south = (shapely.Polygon(c.corners) for c in found.inner)
    assert west.equals_exact(shapely.box(-5.8, -0.6, 0.0, 0.6).normalize(), 1e-9) or (
        west.symmetric_difference(shapely.box(-5.8, -0.6, 0.0, 0.6)).area < 1e-9
    )
    assert south.symmetric_difference(shapely.box(0.0, -5.0, 1.2, 0.6)).area < 1e-9
    exit = found.passages[0, 1]
    assert exit.middle == pytest.approx((0, 0), abs=1e-9)
    assert exit.normal == pytest.approx((1, 0))
    assert exit.width == pytest.approx(1.2)
    assert found.passages[1, 0].normal == pytest.approx((-1, 0))
    length = sum(math.dist(a, b) for a, b in found.walls)
    assert length == pytest.approx(
        shapely.union_all([shapely.Polygon(c) for c in CORNER.values()]).length
    )
    assert len(found.walls) == 6


@pytest.mark.parametrize("radius", [0.1, 0.2, 0.35])
def test_wherever_the_centre_of_a_robot_may_be_it_touches_no_wall(radius):
    room = ring()["ring_0"][1:3]  # the outer face of a trapezoid, open to a room beyond it
    (ax, ay), (bx, by) = room
    out = np.array([by - ay, ax - bx])
    far = [[ax + out[0], ay + out[1]], [bx + out[0], by + out[1]]]
    cells = {**ring(), "room": [room[1], room[0], far[0], far[1]]}
    found = environment(cells, radius)
    walls = shapely.MultiLineString([list(w) for w in found.walls])
    for cell in found.inner:
        corners = shapely.points(np.array(cell.corners))
        assert shapely.distance(corners, walls).min() > radius - 1e-5
    # and little is given away: the cells cover what there is but for the rounding of corners
    best = (
        shapely.union_all([shapely.Polygon(c) for c in cells.values()]).buffer(1e-9).buffer(-radius)
    )
    mine = shapely.union_all([shapely.Polygon(c.corners) for c in found.inner])
    assert mine.area > 0.97 * best.area


def test_shortest_way_around_a_ring_is_taken():
    found = environment(ring(), 0.2)
    start = (3.3, 0.5)
    assert plan_route(found, start, (-1.2, 3.0)).names == ("ring_0", "ring_1", "ring_2")
    assert plan_route(found, start, (-1.2, -3.0)).names == ("ring_0", "ring_7", "ring_6", "ring_5")
    assert plan_route(found, start, (3.0, 1.0)).names == ("ring_0",)
    legs = plan_route(found, start, (-1.2, 3.0)).legs
    assert legs[-1].exit is None
    assert legs[0].exit.middle == pytest.approx(
        (3.3 * math.cos(math.pi / 4), 3.3 * math.sin(math.pi / 4)), abs=0.01
    )


@pytest.mark.parametrize(
    ("cells", "message"),
    [
        ({}, "the environment has no cells"),
        ({"a": box(0, 0, 2, 2), "b": box(1, 1, 3, 3)}, r"'a' and 'b' overlap by 1 m\^2 at \(1.5, 1.5\)"),
        ({"a": [[0, 0], [2, 0], [1, 0.2], [0, 2]]}, r"cell 'a' is not convex at \(1, 0.2\)"),
        ({"a": [[0, 0], [2, 0]]}, "cell 'a' has 2 vertices"),
        ({"a": [[0, 0], [2, "x"], [0, 2]]}, "of cell 'a'; expected two finite numbers"),
        ({"a": box(0, 0, 5, 0.3)}, "cell 'a' is narrower than a robot"),
        (
            {"a": box(0, 0, 4, 2), "b": box(4, 1, 8, 3)},
            r"cells 'a' and 'b' share a part of a face of each, from \(4, 1\) to \(4, 2\)",
        ),
        (
            {"a": box(0, 0, 2, 4), "b": box(2, 0, 4, 2), "c": box(2, 2, 4, 6)},
            r"the face of cell 'a' from \(2, 0\) to \(2, 4\) borders on cells that end there and on one",
        ),
    ],
)  # fmt: skip
def test_cells_that_cannot_be_used_are_named(cells, message):
    with pytest.raises(DefinitionError, match=message):
        environment(cells, 0.2)


@pytest.mark.parametrize("radius", [0.0, -1.0, math.nan, True])
def test_robots_have_a_size(radius):
    with pytest.raises(DefinitionError, match="robot_radius"):
        environment(CORNER, radius)


def test_a_passage_that_no_robot_fits_through_is_no_way():
    cells = {"a": box(0, 0, 4, 2), "door": box(4, 0.9, 4.5, 1.25), "b": box(4.5, 0, 8, 2)}
    with pytest.raises(DefinitionError, match="cell 'door' is narrower than a robot"):
        environment(cells, 0.2)
    funnel = {"a": [[0, 0], [4, 0.85], [4, 1.15], [0, 2]], "b": box(4, 0, 8, 2)}
    with pytest.raises(
        DefinitionError, match=r"from cell 'a' to cell 'b' \(between 'a' and 'b' no"
    ):
        plan_route(environment(funnel, 0.2), (1, 1), (6, 1))
    found = environment({**cells, "door": box(4, 0.9, 4.5, 1.5)}, 0.2)
    assert plan_route(found, (1, 1), (6, 1)).names == ("a", "door", "b")


@pytest.mark.parametrize(
    ("start", "goal", "message"),
    [
        ((-3, 0), (5, 5), r"the goal \(5, 5\) is outside the free space"),
        ((-3, 0), (0.6, -5.1), r"at the goal \(0.6, -5.1\) a robot would touch a wall"),
        ((-9, 0), (0.6, -4), r"the start \(-9, 0\) is outside the free space"),
        ((-3, 0), (10, 10), "no way leads from cell 'west' to cell 'island'"),
    ],
)
def test_starts_and_goals_that_cannot_be_used_are_named(start, goal, message):
    found = environment({**CORNER, "island": box(9, 9, 12, 12)}, 0.2)
    with pytest.raises(DefinitionError, match=message):
        plan_route(found, start, goal)


# -- GeoJSON ----------------------------------------------------------------------------------


def feature(corners, **about):
    return {"type": "Feature", "geometry": {"type": "Polygon", "coordinates": [[*corners, corners[0]]]}, **about}  # fmt: skip


def test_cells_of_a_geojson_file_are_those_of_a_table(tmp_path):
    path = tmp_path / "rooms.geojson"
    features = [
        feature(WEST, properties={"name": "west"}),
        feature(SOUTH, id="south"),
        feature(box(9, 9, 12, 12)),
    ]
    path.write_text(json.dumps({"type": "FeatureCollection", "features": features}))
    found = geojson_cells(path)
    assert list(found) == ["west", "south", "cell_3"]
    assert environment(found, 0.2).inner[:2] == environment(CORNER, 0.2).inner


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("{", "is not a JSON file"),
        ("[]", "is not a GeoJSON file of cells"),
        ('{"type": "FeatureCollection", "features": []}', "is not a GeoJSON file of cells"),
        ('{"features": [3]}', "feature 1 is 3"),
        ('{"features": [{"type": "Feature"}]}', "'cell_1' is a feature without geometry"),
        ('{"features": [{"geometry": {"type": "Point", "coordinates": [0, 0]}}]}', "'cell_1' is a Point"),
        ('{"features": [{"geometry": {"type": "Polygon", "coordinates": [[], []]}}]}', "without holes"),
        (
            json.dumps({"features": [feature(WEST, id="a"), feature(SOUTH, id="a")]}),
            "two cells are called 'a'",
        ),
    ],
)  # fmt: skip
def test_geojson_that_is_none_is_refused(tmp_path, text, message):
    path = tmp_path / "rooms.geojson"
    path.write_text(text)
    with pytest.raises(DefinitionError, match=message):
        geojson_cells(path)
    with pytest.raises(DefinitionError, match="cannot be read"):
        geojson_cells(tmp_path / "none.geojson")
