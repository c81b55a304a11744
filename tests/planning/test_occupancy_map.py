"""Maps of occupied cells: their distances, the bodies that cover them, files, and updates."""

from __future__ import annotations

import doctest

import maps
import numpy as np
import pytest
import shapely
from PIL import Image
from scipy.ndimage import gaussian_filter

import holdfast as hf
from holdfast.errors import DefinitionError
from holdfast.execution.leaf import Evaluator
from holdfast.planning.outlines import outlines, rectangles

TEXT = (
    "image: room.pgm\nresolution: 0.05\norigin: [-1.0, -2.0, 0.0]\nnegate: 0\n"
    "occupied_thresh: 0.65\nfree_thresh: 0.196\n"
)


def blobs(seed, rows=40, columns=55, share=0.3):
    """Random cells in lumps."""
    field = gaussian_filter(np.random.default_rng(seed).random((rows, columns)), 1.5)
    return field > np.quantile(field, 1 - share)


def slanted(seed, size=70):
    """Walls that follow no row of cells, with single cells beside them."""
    random = np.random.default_rng(seed)
    cells = random.random((size, size)) < 0.004
    y, x = np.mgrid[:size, :size] + 0.5
    for _ in range(3):
        turn, shift = random.uniform(0, np.pi), random.uniform(20, 50, 2)
        cells |= np.abs((y - shift[1]) * np.cos(turn) - (x - shift[0]) * np.sin(turn)) < 1.2
    return cells


def in_the_plane(world, points):
    """Points in units of cells, in the plane."""
    x0, y0, yaw = world.origin
    turn = np.array([[np.cos(yaw), -np.sin(yaw)], [np.sin(yaw), np.cos(yaw)]])
    return world.resolution * np.asarray(points, dtype=float) @ turn.T + [x0, y0]


def squares_of(world):
    """The occupied cells of a map in the plane, and the outside where it counts."""
    cells = world.cells
    shapes = [shapely.box(*r) for r in rectangles(cells)]
    if world.unknown == "occupied":
        rows, columns = cells.shape
        outside = shapely.box(-30, -30, columns + 30, rows + 30)
        shapes.append(outside.difference(shapely.box(0, 0, columns, rows)))
    return shapely.transform(shapely.union_all(shapes), lambda p: in_the_plane(world, p))


def places_around(world, random, count):
    """Random points in the map and a little outside."""
    rows, columns = world.shape
    return in_the_plane(world, random.uniform([-3, -3], [columns + 3, rows + 3], (count, 2)))


MAPS = [
    hf.OccupancyMap(blobs(1), 0.1, (3, -2, 0.4)),
    hf.OccupancyMap(blobs(2), 0.25, (0, 0, 0), unknown="free"),
    hf.OccupancyMap(slanted(3), 0.05, (1, 1, -2.0)),
    hf.OccupancyMap(slanted(4), 1.0, unknown="free"),
    hf.OccupancyMap(np.random.default_rng(5).random((30, 30)) < 0.3, 0.1),
]


def test_examples_of_the_reference_run():
    scope = {"hf": hf, "robot": hf.systems.unicycle()}
    examples = doctest.DocTestFinder().find(hf.OccupancyMap, globs=scope)
    said = []
    for example in examples:
        doctest.DocTestRunner().run(example, out=said.append)
    assert not said
    assert sum(bool(example.examples) for example in examples) == 6


# -- distances --------------------------------------------------------------------------------


@pytest.mark.parametrize("world", MAPS, ids=range(len(MAPS)))
def test_the_distance_to_all_cells_is_within_its_bounds(world):
    """Against Shapely, which has the cells as polygons."""
    random = np.random.default_rng(6)
    places = places_around(world, random, 3000)
    exact = shapely.distance(squares_of(world), shapely.points(places))
    below, above = world.distance_error
    error = world.distance(places) - exact
    assert error.max() <= above + 1e-12
    rows, columns = world.shape
    corners = in_the_plane(world, [[0, 0], [columns, 0], [columns, rows], [0, rows]])
    inside = shapely.covers(shapely.Polygon(corners), shapely.points(places))
    assert inside.sum() > 2000
    assert error[inside].min() >= -below - 1e-12
    assert above == pytest.approx(0.1464 * world.resolution, rel=1e-3)
    assert below == pytest.approx(0.7071 * world.resolution, rel=1e-3)


def test_the_bound_of_the_interpolation_is_attained_at_the_middle_beside_a_corner():
    world = hf.OccupancyMap([[100, 0], [0, 0]], 2.0, unknown="free")
    assert world.distance([[3.0, 3.0]])[0] - np.sqrt(2) == pytest.approx(world.distance_error[1])


def test_the_distance_at_corners_of_cells_is_exact():
    world = MAPS[0]
    rows, columns = world.shape
    grid = np.stack(np.meshgrid(np.arange(columns + 1), np.arange(rows + 1)), -1).reshape(-1, 2)
    places = in_the_plane(world, grid)
    exact = shapely.distance(squares_of(world), shapely.points(places))
    assert world.distance(places) == pytest.approx(exact, abs=1e-9)


def test_occupied_says_what_the_cells_say_and_outside_what_unknown_says():
    for world in MAPS:
        places = places_around(world, np.random.default_rng(8), 2000)
        inside = shapely.distance(squares_of(world), shapely.points(places)) < 1e-12
        assert (world.occupied(places) == inside).all()
    assert MAPS[0].occupied([[np.nan, 0]]).all()
    assert np.isnan(MAPS[0].distance([[np.nan, 0]])).all()


# -- bodies -----------------------------------------------------------------------------------


@pytest.mark.parametrize("world", MAPS, ids=range(len(MAPS)))
def test_bodies_cover_the_outline_and_reach_one_cell_beyond_it_at_most(world):
    cells = squares_of(world)
    far = world.near(np.array(cells.centroid.coords[0]), within=1e4)
    bodies = [shapely.Polygon(o.bodies[0][0]) for o in far if "itself" not in o.name]
    together = shapely.union_all(bodies).buffer(1e-9 * world.resolution)
    rows, columns = world.shape
    inner = shapely.box(-0.5, -0.5, columns + 0.5, rows + 0.5)
    inner = shapely.transform(inner, lambda p: in_the_plane(world, p))
    line = cells.boundary.intersection(inner)
    assert together.covers(line)
    for body in bodies:
        assert body.convex_hull.area == pytest.approx(body.area)
    rim = shapely.get_coordinates(shapely.segmentize(together.boundary, 0.2 * world.resolution))
    beyond = shapely.distance(cells, shapely.points(rim)) / world.resolution
    assert beyond.max() <= 1.0 + 1e-6


def test_a_straight_wall_is_one_body_however_it_lies():
    size = 80
    y, x = np.mgrid[:size, :size] + 0.5
    for turn in np.linspace(0, np.pi, 13):
        across = (y - 40) * np.cos(turn) - (x - 40) * np.sin(turn)
        along = (y - 40) * np.sin(turn) + (x - 40) * np.cos(turn)
        world = hf.OccupancyMap((np.abs(across) < 1.5) & (np.abs(along) < 30), 0.1, unknown="free")
        assert len(world.near([4.0, 4.0], within=10.0)) == 2  # and the cell of the place


def test_walls_along_rows_have_bodies_without_anything_beyond():
    world = hf.OccupancyMap.from_file("examples/rooms.yaml")
    named = world.polygons(((5.5, 9.5), (10.5, 19.5)))
    walls = shapely.union_all([shapely.Polygon(p) for p in named.values()])
    cells = squares_of(world)
    straight = shapely.box(7.5, 13.5, 9.5, 19.5)
    assert walls.intersection(straight).difference(cells.buffer(1e-9)).area == pytest.approx(0)


def test_the_shipped_map_is_the_one_that_the_benchmark_draws():
    cells = maps.rooms()
    for unknown in ("free", "occupied"):
        world = hf.OccupancyMap.from_file("examples/rooms.yaml", unknown=unknown)
        assert (world.cells == ((cells > 0) | ((cells < 0) & (unknown == "occupied")))).all()


@pytest.mark.parametrize("world", MAPS, ids=range(len(MAPS)))
def test_near_leaves_out_no_cell_that_is_near(world):
    """Between what `near` gives and the place there is no occupied cell that it does not have."""
    random = np.random.default_rng(9)
    places = places_around(world, random, 60)
    cells = squares_of(world)
    within = 6 * world.resolution
    for place, near in zip(places, world.near_many(places, within=within), strict=True):
        point = shapely.Point(place)
        exact = cells.distance(point)
        bodies = [shapely.Polygon(o.bodies[0][0]).distance(point) for o in near]
        if exact <= within:
            assert min(bodies) <= exact + 1e-9
            assert min(bodies) >= exact - world.resolution - 1e-9
        else:
            assert all(b > exact - world.resolution - 1e-9 for b in bodies)


@pytest.mark.parametrize("world", MAPS, ids=range(len(MAPS)))
def test_polygons_cover_every_occupied_cell(world):
    together = shapely.union_all([shapely.Polygon(p) for p in world.polygons().values()])
    occupied = shapely.union_all([shapely.box(*r) for r in rectangles(world.cells)])
    placed = shapely.transform(occupied, lambda p: in_the_plane(world, p))
    assert placed.difference(together.buffer(1e-9)).area < 1e-9
    assert together.difference(squares_of(world).buffer(1.0001 * world.resolution)).area < 1e-9


def test_outlines_have_the_area_of_the_cells():
    for seed in range(20):
        cells = np.pad(np.random.default_rng(seed).random((13, 17)) < 0.4, 1)
        area = 0.0
        for ring in outlines(cells):
            x, y = ring.T
            area += (x * np.roll(y, -1) - np.roll(x, -1) * y).sum() / 2
        assert area == cells.sum()


# -- what a filter and a kernel make of them --------------------------------------------------


def test_a_filter_among_the_bodies_of_a_map_hits_no_cell_where_the_command_alone_does():
    world, robot = hf.OccupancyMap.from_file("examples/rooms.yaml"), hf.systems.unicycle()
    keep = hf.SafetyFilter(
        robot, obstacles=hf.Obstacles(30, hull=0.15, lead=0.25, clearance=0.03), gains=(1, 4)
    )
    starts = [[2.5, 2.5, 0.3], [7.5, 6.0, 2.0], [17.0, 12.0, -1.0]]
    cells, least = squares_of(world), {}
    drive = keep.among(
        lambda t, q: [[1.0, 0.0]] * len(q), lambda t, q: world.near_many(q[:, :2], within=1.5)
    )
    for name, law, command in (
        ("filtered", keep.law, drive),
        ("alone", hf.commanded(robot), lambda t, q: [[1.0, 0.0]] * len(q)),
    ):
        result = hf.simulate(
            robot, law, command=command, starts=starts, horizon=8, sample_time=0.02,
            record_every=0.1,
        )  # fmt: skip
        paths = result.arrays["state"].values[:, :, :2]
        least[name] = shapely.distance(cells, shapely.points(paths)).min(axis=1) - 0.15
    assert (least["filtered"] > 0).all()
    assert (least["alone"] < 0).all()


def test_a_command_along_a_wall_passes_where_a_disc_for_every_cell_slows_it_down():
    cells = np.zeros((20, 100), dtype=bool)
    cells[:2] = True
    world, robot = hf.OccupancyMap(cells, 0.1, unknown="free"), hf.systems.unicycle()
    keep = hf.SafetyFilter(robot, obstacles=hf.Obstacles(40, hull=0.15, lead=0.25), gains=(1, 4))
    state = [5.0, 0.65, 0.0]
    by_body = keep.step(state, [1.0, 0.0], obstacles=world.near(state[:2], within=2.0))
    assert by_body.status is hf.Status.PASSED
    row, column = np.nonzero(cells[1:2, 40:60])
    half = 0.1 * np.sqrt(0.5)
    discs = np.column_stack([0.1 * (column + 40.5), 0.1 * (row + 1.5), np.full(len(row), half)])
    by_discs = keep.step(state, [1.0, 0.0], obstacles=discs)
    assert by_discs.status is hf.Status.CHANGED
    assert by_discs.input[0] < 0.7


def test_a_place_in_a_wall_or_outside_is_an_obstacle_itself():
    world = hf.OccupancyMap(np.ones((9, 9), dtype=bool), 0.5)
    robot = hf.systems.unicycle()
    keep = hf.SafetyFilter(robot, obstacles=hf.Obstacles(5, lead=0.3), gains=(1, 4))
    for place in ([2.25, 2.25], [-7.0, 30.0]):
        decision = keep.step([*place, 0.0], [1, 0], obstacles=world.near(place, within=1.0))
        assert decision.clearances["the occupied cell at the place itself"] < 0
    assert hf.OccupancyMap(np.zeros((9, 9)), 0.5, unknown="free").near([2, 2], within=9.0) == []
    assert world.near([np.nan, 0.0], within=1.0) == []


def test_the_region_of_a_map_is_outside_all_of_its_cells():
    cells = np.zeros((20, 20), dtype=bool)
    cells[5:8, 3:15] = cells[12:18, 9:11] = True
    world = hf.OccupancyMap(cells, 0.25, (-2.5, -2.5, 0.0), unknown="free")
    robot = hf.systems.unicycle()
    region = hf.obstacles(robot, world.polygons(), clearance=0.2)
    of_all = [i.expression for i in region.inequalities]
    values = Evaluator(of_all, [q.symbol for q in robot.states], region.parameters)
    random = np.random.default_rng(11)
    states = np.column_stack([random.uniform(-2.4, 2.4, (2000, 2)), np.zeros(2000)])
    exact = shapely.distance(squares_of(world), shapely.points(states[:, :2]))
    worst = values.values(states).max(axis=1)
    assert (worst > 0)[exact < 0.2 - 1e-9].all()
    assert (worst <= 0)[exact > 0.2 + 1e-9].all()  # walls along rows: nothing beyond


def test_a_kernel_on_a_map_keeps_no_node_that_is_nearer_to_a_cell_than_its_clearance():
    """A car that cannot stop, in a room with a wall across it."""
    car = hf.System(
        "car", states=(hf.Quantity("x", "m"), hf.Quantity("y", "m"), hf.Quantity("psi", "rad", angle=True)),
        inputs=(hf.Quantity("r", "rad/s"),), rates={"x": "0.5*cos(psi)", "y": "0.5*sin(psi)", "psi": "r"},
        input_bounds=hf.Box((-1.5,), (1.5,)),
    )  # fmt: skip
    cells = np.zeros((40, 40), dtype=bool)
    cells[[0, -1]] = cells[:, [0, -1]] = cells[18:21, :22] = True
    world = hf.OccupancyMap(cells, 0.1, (-2, -2, 0))
    region = hf.obstacles(car, world.polygons(), clearance=0.1)
    box = {"x": (-2, 2), "y": (-2, 2), "psi": (-np.pi, np.pi)}
    kernel = hf.viability_kernel(car, region, hf.grid(car, box, {"x": 31, "y": 31, "psi": 20}), 4.0)
    line, turns = np.linspace(-2, 2, 31), np.linspace(-np.pi, np.pi, 20, endpoint=False)
    states = np.stack(np.meshgrid(line, line, turns, indexing="ij"), -1).reshape(-1, 3)
    inside = kernel.contains(states)
    exact = shapely.distance(squares_of(world), shapely.points(states[:, :2]))
    assert 0.5 < inside.mean() < 0.8
    assert exact[inside].min() > 0.1


@pytest.mark.heavy
@pytest.mark.parametrize("vehicle", maps.VEHICLES)
@pytest.mark.parametrize("growing", [False, True], ids=["known", "growing"])
def test_no_vehicle_hits_a_cell_of_a_map_that_is_known_or_grows(vehicle, growing):
    filtered = maps.drive(vehicle, 6, growing=growing, seconds=20.0)
    assert (
        filtered["hit"] == filtered["runs with an infeasible sample"] == filtered["left out"] == 0
    )
    assert filtered["way"] > 2.0
    assert maps.drive(vehicle, 6, filtered=False, seconds=20.0)["hit"] >= 5


@pytest.mark.heavy
def test_a_smooth_field_has_a_ridge_at_which_no_input_is_left_and_bodies_have_none():
    answers = maps.ridge(1.2, runs=20)
    assert answers["smooth field"]["runs"] == 20
    assert answers["bodies"]["runs"] == 0
    assert answers["bodies"]["least"] > 0


# -- updates ----------------------------------------------------------------------------------


@pytest.mark.parametrize("unknown", ["occupied", "free"])
def test_a_map_that_is_updated_is_the_map_that_is_made_anew(unknown):
    random = np.random.default_rng(12)
    cells = blobs(13, 60, 80, 0.1)
    world = hf.OccupancyMap(cells, 0.1, (1, 2, 0.3), unknown=unknown)
    places = places_around(world, random, 500)
    world.distance(places)
    world.near([3, 4], within=2.0)
    for step in range(9):
        rows, columns = (int(n) for n in random.integers(1, 30, 2))
        row, column = int(random.integers(0, 60 - rows)), int(random.integers(0, 80 - columns))
        patch = random.random((rows, columns)) < (0.0, 0.05, 0.5)[step % 3]
        cells = cells.copy()
        cells[row : row + rows, column : column + columns] = patch
        world.update(patch, row=row, column=column)
        anew = hf.OccupancyMap(cells, 0.1, (1, 2, 0.3), unknown=unknown)
        assert (world.cells == cells).all()
        assert np.array_equal(world._distances(), anew._distances())
        assert [o.bodies for o in world.near([3, 4], within=20.0)] == [
            o.bodies for o in anew.near([3, 4], within=20.0)
        ]


def test_a_map_without_anything_occupied_has_no_distance_until_something_is():
    world = hf.OccupancyMap(np.zeros((30, 30)), 0.1, unknown="free")
    assert np.isinf(world.distance([[1.0, 1.0], [9.0, 1.0]])).all()
    world.update([[True]], row=3, column=4)
    assert world.distance([[1.4, 0.4]])[0] == pytest.approx(0.9)
    world.update([[False]], row=3, column=4)
    assert np.isinf(world.distance([[1.0, 1.0]])).all()


# -- files ------------------------------------------------------------------------------------


def written(folder, text=TEXT, pixels=None, name="room.pgm", mode="L"):
    """A map file with its image."""
    shape = (6, 8) if pixels is None else np.shape(pixels)[:2]
    shade = np.full(shape, 254, dtype=np.uint8) if pixels is None else np.asarray(pixels, np.uint8)
    Image.fromarray(shade, mode).save(folder / name) if mode else None
    (folder / "room.yaml").write_text(text)
    return folder / "room.yaml"


def test_a_map_server_file_has_its_first_row_at_the_top(tmp_path):
    pixels = np.full((6, 8), 254)
    pixels[0, 0], pixels[5, 7], pixels[2, 3] = 0, 0, 205
    world = hf.OccupancyMap.from_file(written(tmp_path, pixels=pixels))
    expected = np.zeros((6, 8), dtype=bool)
    expected[5, 0] = expected[0, 7] = expected[3, 3] = True
    assert (world.cells == expected).all()
    assert world.resolution == 0.05
    assert world.origin == (-1.0, -2.0, 0.0)
    free = hf.OccupancyMap.from_file(tmp_path / "room.yaml", unknown="free")
    assert free.cells.sum() == 2
    assert world.occupied([[-1.0 + 0.02, -2.0 + 0.28]])[0]


@pytest.mark.parametrize(
    ("change", "occupied"),
    [
        (("negate: 0", "negate: 1"), [True, True, False]),
        (("negate: 0", "negate: 0\nmode: scale"), [False, True, True]),
        (("negate: 0", "negate: 0\nmode: raw"), [True, False, True]),
        (("free_thresh: 0.196", "free_thresh: 0.6"), [False, False, True]),
    ],
    ids=["negate", "scale", "raw", "threshold"],
)
def test_modes_and_thresholds_are_those_of_map_server(tmp_path, change, occupied):
    """Of a white pixel, a grey one, a black one; unknown cells are occupied."""
    shades = [254, 110, 0] if "raw" not in change[1] else [254, 10, 100]
    path = written(tmp_path, TEXT.replace(*change), [shades])
    assert hf.OccupancyMap.from_file(path).cells[0].tolist() == occupied


def test_colours_and_16_bits_and_transparency_are_read(tmp_path):
    path = written(tmp_path, TEXT.replace("room.pgm", "room.png"), np.zeros((2, 2)), "room.png")
    colours = np.full((2, 3, 3), 255, dtype=np.uint8)
    colours[0, 0] = [0, 90, 60]
    Image.fromarray(colours, "RGB").save(tmp_path / "room.png")
    assert hf.OccupancyMap.from_file(path).cells.sum() == 1
    Image.fromarray(np.array([[0, 65535]], dtype=np.uint16)).save(tmp_path / "room.png")
    assert hf.OccupancyMap.from_file(path).cells.tolist() == [[True, False]]
    through = np.full((1, 2, 4), 255, dtype=np.uint8)
    through[0, 1, 3] = 100
    Image.fromarray(through, "RGBA").save(tmp_path / "room.png")
    path.write_text(TEXT.replace("room.pgm", "room.png") + "mode: scale\n")
    assert hf.OccupancyMap.from_file(path).cells.tolist() == [[False, True]]
    assert not hf.OccupancyMap.from_file(path, unknown="free").cells.any()


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (("image: room.pgm\n", ""), "lacks 'image'"),
        (("origin: [-1.0, -2.0, 0.0]\n", ""), "lacks 'origin'"),
        (("[-1.0, -2.0, 0.0]", "[-1.0, -2.0]"), "origin is"),
        (("[-1.0, -2.0, 0.0]", "[-1.0, .nan, 0.0]"), "origin is nan"),
        (("0.05", "-0.05"), "resolution of the map is -0.05"),
        (("0.05", "0.0"), "resolution of the map is 0"),
        (("0.05", "fine"), "resolution is 'fine'"),
        (("0.196", "0.9"), "free_thresh is 0.9"),
        (("0.65", "65"), "occupied_thresh 65"),
        (("room.pgm", "other.pgm"), "there is no image"),
        (("room.pgm", "room.yaml"), "is no image"),
        (("negate: 0", "negate: 3"), "negate is 3"),
        (("negate: 0", "negate: 0\nmode: grey"), "mode is 'grey'"),
        ((TEXT, "- 1\n- 2"), "is no YAML file of a map"),
        ((TEXT, "{: : ["), "is no YAML file of a map"),
    ],
)  # fmt: skip
def test_a_map_file_that_is_none_is_refused_in_a_line(tmp_path, change, said):
    with pytest.raises(DefinitionError, match=said) as refused:
        hf.OccupancyMap.from_file(written(tmp_path, TEXT.replace(*change)))
    assert "\n" not in str(refused.value)
    assert str(tmp_path) in str(refused.value)


@pytest.mark.parametrize(
    ("image", "said"),
    [
        (b"P5 0 0 255\n", "is no image"),
        (b"P5 4 4 255\n" + bytes(3), "is no image"),
        (b"", "is no image"),
        (b"P5 20000 5000 255\n", "has 20000 x 5000 pixels"),
        (b"P5 200000 50000 255\n", "has too many pixels"),
    ],
    ids=["size 0", "cut off", "empty", "large", "larger"],
)
def test_an_image_that_is_none_is_refused_in_a_line(tmp_path, image, said):
    path = written(tmp_path)
    (tmp_path / "room.pgm").write_bytes(image)
    with pytest.raises(DefinitionError, match=said) as refused:
        hf.OccupancyMap.from_file(path)
    assert "\n" not in str(refused.value)


def test_an_image_with_an_alpha_channel_is_refused_but_for_scale(tmp_path):
    path = written(tmp_path, TEXT.replace("room.pgm", "room.png"), np.zeros((2, 2)), "room.png")
    Image.fromarray(np.zeros((2, 2, 4), dtype=np.uint8), "RGBA").save(tmp_path / "room.png")
    with pytest.raises(DefinitionError, match="alpha channel"):
        hf.OccupancyMap.from_file(path)


@pytest.mark.parametrize(
    ("cells", "how", "said"),
    [
        ([[0, 1], [2]], {}, "shape"),
        (np.zeros((0, 4)), {}, "shape \\(0, 4\\)"),
        ([[0.0, np.nan]], {}, "row 0, column 1 is nan"),
        ([[0, 101]], {}, "row 0, column 1 is 101"),
        ([["a"]], {}, "shape"),
        ([0, 1], {}, "shape"),
        ([[0]], {"resolution": -1.0}, "resolution of the map is -1"),
        ([[0]], {"resolution": np.inf}, "resolution of the map is inf"),
        ([[0]], {"origin": (0, 0)}, "origin"),
        ([[0]], {"origin": (0, np.nan, 0)}, "origin"),
        ([[0]], {"free_thresh": 0.8}, "free_thresh is 0.8"),
    ],
)
def test_cells_that_are_none_are_refused_in_a_line(cells, how, said):
    with pytest.raises(DefinitionError, match=said) as refused:
        hf.OccupancyMap(cells, **{"resolution": 1.0, **how})
    assert "\n" not in str(refused.value)


def test_a_patch_beyond_the_map_and_a_distance_that_is_none_are_refused():
    world = hf.OccupancyMap(np.zeros((4, 4)), 1.0)
    with pytest.raises(DefinitionError, match="a patch of 2 x 1 cells at row 3, column 0"):
        world.update([[True], [True]], row=3)
    with pytest.raises(DefinitionError, match="within is nan"):
        world.near([1, 1], within=np.nan)
    with pytest.raises(DefinitionError, match="points have the shape"):
        world.distance([1.0, 2.0])


def test_a_distance_field_leaves_no_obstacle_out():
    """A cell in which an obstacle is counts as occupied, wherever in the cell it is."""
    random = np.random.default_rng(14)
    obstacles = shapely.points(random.uniform(0, 6, (25, 2)))
    y, x = (np.mgrid[:24, :24] + 0.5) * 0.25
    field = np.min([shapely.distance(o, shapely.points(x, y)) for o in obstacles], axis=0)
    world = hf.OccupancyMap.from_distances(field, 0.25)
    assert world.occupied(shapely.get_coordinates(obstacles)).all()
    assert not world.cells[field > 0.25].any()
    field[3, 4] = np.nan
    assert hf.OccupancyMap.from_distances(field, 0.25).cells[3, 4]
