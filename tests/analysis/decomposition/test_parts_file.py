"""Files of sets that are put together: the same bits, kept by name, and refused where damaged."""

import json
import shutil
from functools import cache

import netCDF4
import numpy as np
import pytest
import sympy as sp
from click.testing import CliRunner

import holdfast as hf
from holdfast.analysis.kernel_store import Store, entry_of
from holdfast.commands.store import command
from holdfast.errors import OutputError, ScenarioError
from holdfast.maths.expressions.functions import least
from holdfast.scenario.kernel_reference import named_kernel
from tests.parted_systems import Q, box, late_cart, plane, symbols, towed, walls

PLANE = box("x", "vx", "y", "vy")
LATE = {**box("x", "v"), "actual_u": (-0.6, 0.6)}


@cache
def two_parts():
    return hf.solve_parts(hf.decompose(plane(), walls("x", "y")), PLANE, 11, 0.5, times=[0.2, 0.5])


@cache
def cut_off():
    parted = hf.decompose(towed(), walls("x", "w", at=0.5), cut={"w": None})
    return hf.solve_parts(parted, {**box("x", "v"), "w": (-0.6, 0.6)}, 15, 0.5)


@cache
def predicted():
    parted = hf.decompose(late_cart(), walls("x"), lag_share=0.6, box=box("x", "v", at=1.5))
    return hf.solve_parts(parted, None, 41, 2.0)


@cache
def either():
    x, y = symbols("x y")
    near = (hf.Inequality("near", least(x**2 - 0.1, y**2 - 0.1)),)
    found = hf.decompose(
        plane(push=0.0), hf.Region("either", (Q("x"), Q("y")), near), kind="backward-reachable-tube"
    )
    return hf.solve_parts(found, PLANE, 11, 0.5)


def states(value, count=500):
    over = {**PLANE, **LATE, "w": (-0.6, 0.6)}
    low, high = np.array([over[n] for n in value.names]).T
    return np.random.default_rng(0).uniform(low, high, (count, len(low)))


@pytest.mark.few("two_parts-True", "cut_off-True", "predicted-True", "either-True")
@pytest.mark.parametrize("lazy", [False, True])
@pytest.mark.parametrize("made", [two_parts, cut_off, predicted, either])
def test_a_set_has_the_same_bits_from_its_file(made, lazy, tmp_path):
    value = made()
    found = hf.load(value.save(tmp_path / "set.nc"), lazy=lazy)
    assert str(found.decomposition) == str(value.decomposition)
    assert [s.value.stored is not None for parts in found.parts for s in parts] == [lazy] * len(
        value.values
    )
    points = states(value)
    for name in ("at", "gradient", "inputs", "contains"):
        before, after = (getattr(v, name)(points) for v in (value, found))
        assert np.array_equal(before, after, equal_nan=True)
    assert value.contains(points).any()


def test_a_time_that_was_asked_for_is_in_the_file(tmp_path):
    found = hf.load(two_parts().save(tmp_path / "set.nc"))
    points = states(found)
    assert np.array_equal(found.at(points, 0.2), two_parts().at(points, 0.2), equal_nan=True)


def test_margins_and_filters_from_the_file_are_the_same(tmp_path):
    value = predicted()
    found = hf.load(value.save(tmp_path / "set.nc"), lazy=True)
    push = hf.Law("push", late_cart().states[:2], {"u": 0.9 + 0 * hf.symbol("x")})
    starts = states(value, 2000)
    starts = starts[value.contains(starts, 0.1)][:5]

    def runs(of):
        (part,) = of.parts[0]
        margin = hf.sampled_margin(part.part.system, part.value, 0.01)
        law = hf.parts_law(of, push, sample_time=0.01)
        done = hf.simulate(late_cart(), law, starts=starts, horizon=0.5, sample_time=0.01)
        return margin, done.arrays["state"].values, done.arrays["input"].values

    for before, after in zip(runs(value), runs(found), strict=True):
        assert np.array_equal(before, after)


def test_a_state_of_a_set_on_a_disk_reads_its_chunks_only(tmp_path):
    parted = hf.decompose(plane(), walls("x", "y"))
    value = hf.solve_parts(parted, PLANE, 301, 0.01)
    found = hf.load(value.save(tmp_path / "set.nc"), lazy=True)
    assert sum(v.stored.bytes_read for v in found.values) == 0
    here = [[0.1, 0.0, 0.2, 0.0]]
    assert np.array_equal(found.at(here), value.at(here))
    assert 0 < sum(v.stored.bytes_read for v in found.values) < 2 * 8 * 301**2


def test_a_set_that_is_put_together_is_kept_shown_published_and_loaded(tmp_path, monkeypatch):
    monkeypatch.setenv("HOLDFAST_STORE", str(tmp_path / "store"))
    path = cut_off().save(tmp_path / "towed.nc")

    def said(*arguments):
        done = CliRunner().invoke(command, [str(a) for a in arguments], catch_exceptions=False)
        assert done.exit_code == 0, done.output
        return done.output

    assert "added: towed" in said("add", path, "--licence", "CC0")
    assert "viability-kernel of towed" in said("list")
    shown = said("show", "towed")
    assert '"verdict": "inner"' in shown
    assert '"w": [' in shown
    assert "as it was added: towed" in said("verify")
    said("publish", tmp_path / "paper", "towed")
    points = states(cut_off())
    digest = Store().entry("towed").sha256
    for reference in ("store:towed", f"store:{digest[:12]}", f"{tmp_path / 'paper'}#towed"):
        assert np.array_equal(hf.load(reference).at(points), cut_off().at(points), equal_nan=True)
    with pytest.raises(ScenarioError, match="put together from parts"):
        named_kernel("store:towed").value()
    file = tmp_path / "paper" / f"{digest}.nc"
    content = file.read_bytes()
    file.write_bytes(content[:-1] + bytes([content[-1] ^ 1]))
    with pytest.raises(OutputError, match="SHA-256"):
        hf.load(f"{tmp_path / 'paper'}#towed")


def test_two_problems_have_different_digests_in_the_store(tmp_path):
    digests = set()
    for k, made in enumerate((two_parts, cut_off, predicted, either)):
        path = made().save(tmp_path / f"{k}.nc")
        digests.add(entry_of(path, made(), f"k{k}").problem["digest"])
    assert len(digests) == 4


def damaged(path, change):
    """A copy of a file whose text or groups are changed."""
    copy = path.with_name("damaged.nc")
    shutil.copy(path, copy)
    with netCDF4.Dataset(copy, "a") as file:
        text = file["decomposition"]
        text.set_auto_chartostring(False)
        length = text.shape[1]
        new = change(file, json.loads(text[0].tobytes()))
        if new is not None:
            written = json.dumps(new, separators=(",", ":"))
            text[0] = np.array(list(written.ljust(length)), "S1")
    return copy


def without_layout(file, said):
    return {k: v for k, v in said.items() if k != "layout"}


def newer(file, said):
    return {**said, "layout": 2}


def unknown_function(file, said):
    row = next(r for r in said["steps"] if r[0] == "Add")
    row[0] = "Sub"
    return said


def another_class(file, said):
    said["what"]["is"] = "Part"
    return said


def fewer_steps(file, said):
    return {**said, "steps": said["steps"][:5]}


def without_a_group(file, said):
    file.renameGroup("part_2", "part_3")


def exchanged_groups(file, said):
    for old, new in (("part_1", "part_3"), ("part_2", "part_1"), ("part_3", "part_2")):
        file.renameGroup(old, new)


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        (without_layout, "layout"), (newer, "has the layout 2"), (unknown_function, "Sub"),
        (another_class, "Part"), (fewer_steps, "step"), (without_a_group, "part_2"),
        (exchanged_groups, "part_1 is over w"),
    ],
)  # fmt: skip
def test_a_file_that_nobody_wrote_is_refused(tmp_path, change, reason):
    path = cut_off().save(tmp_path / "towed.nc")
    hf.load(damaged(path, lambda file, said: said))
    with pytest.raises(OutputError, match=reason):
        hf.load(damaged(path, change))


def test_a_file_that_is_cut_or_has_a_flipped_bit_in_its_text_is_refused(tmp_path):
    path = cut_off().save(tmp_path / "towed.nc")
    content = path.read_bytes()
    at = content.index(b'"is":"Decomposition"') + 30
    for bad in (content[:-200], content[:at] + bytes([content[at] ^ 1]) + content[at + 1 :]):
        path.write_bytes(bad)
        with pytest.raises(OutputError, match="cannot be read as NetCDF"):
            hf.load(path)


def test_an_expression_that_no_file_has_is_refused_and_nothing_is_written(tmp_path):
    odd = hf.System("odd", (Q("x"),), (Q("u"),), {"x": hf.symbol("u") * sp.EulerGamma},
                    input_bounds=hf.Box((-1,), (1,)))  # fmt: skip
    value = two_parts()
    whole = hf.decompose(odd, walls("x"))
    broken = hf.PartsValue.of(whole, value.values[:1])
    with pytest.raises(OutputError, match="EulerGamma"):
        broken.save(tmp_path / "odd.nc")
    assert list(tmp_path.iterdir()) == []
