"""What is proved of shipped scenarios: the record, the page, the other program, and closed loops."""

import importlib.util
import json
import math
import sys
from functools import cache
from pathlib import Path

import numpy as np
import pytest
import sympy as sp

import holdfast as hf
from holdfast.studies.certification import certified
from holdfast.studies.law_certification import judged_law
from holdfast_check.checker import check

ROOT = Path(__file__).parents[2]
RECORD = json.loads((ROOT / "benchmarks/certificates.json").read_text("utf-8"))
PAGE = (ROOT / "docs/certificates.md").read_text("utf-8")
SMALL = (
    "seen-target",
    "seen-leader", "leader-gains", "leader-gains-any", "held-station", "ferry-banks", "loaded-cart",
)  # fmt: skip

LARGE = ("seen-with-sway", "seen-with-lasers", "pushed-cart", "seen-by-thrust", "seen-by-torque")
EVERY = [*SMALL, *(pytest.param(n, marks=pytest.mark.heavy) for n in LARGE)]

FUNCTIONS = [{"least": np.minimum, "greatest": np.maximum, "magnitude": np.abs}, "numpy"]


@cache
def benchmark():
    path = ROOT / "benchmarks/certificates.py"
    spec = importlib.util.spec_from_file_location("certificates_benchmark", path)
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module
    spec.loader.exec_module(module)
    return module


@cache
def proof(name, part="CERTIFIED"):
    case = getattr(benchmark(), part)[name]
    return certified(case.scenario, case.overrides, **case.options)


def percent(share):
    """No more than is certified."""
    return f"{math.floor(1000 * share) / 10:.1f} %"


def row(name):
    """A row of the page's table of certificates."""
    r = RECORD["certified"][name]
    lasts = "ever" if r["horizon"] is None else f"{r['horizon']:g} s"
    says = "valid" if r["valid"] else "not valid"
    if r["checked_share"] < 1:
        says = f"{100 * r['checked_share']:g} % checked"
    cells = " x ".join(map(str, r["cells"]))
    return (
        f"| `{r['scenario']}` | {r['what']} | {cells} | {r['inputs_tried']} | "
        f"{r['sample_time']:g} s | {lasts} | {r['cells_certified']:,} of {r['cells_in_region']:,}, "
        f"{percent(r['share'])} | {r['seconds_to_certify']:.1f} s | {r['peak_gib']:.1f} GiB | {says} |"
    )


def row_of_law(name):
    """A row of the page's table of laws."""
    r = RECORD["judged"][name]
    says = f"{100 * r['checked_share']:g} % checked" if r["checked_share"] < 1 else "valid"
    assert r["valid"]
    assert r["horizon"] is None
    cells = " x ".join(map(str, r["cells"]))
    return (
        f"| `{r['scenario']}` | {r['what']} | {cells} | {r['sample_time']:g} s | "
        f"{r['cells_certified']:,} of {r['cells_in_region']:,}, {percent(r['share'])} | "
        f"{r['seconds_to_certify']:.1f} s | {says} |"
    )


def row_of_search(name):
    """A row of the page's table of searches."""
    r = RECORD["largest"][name]
    asked = "one cell" if r["share"] == 0 else f"{100 * r['share']:g} %"
    low = f"{math.floor(1000 * r['low']) / 1000:.3f}"  # no more than is proved
    high = f"{math.ceil(1000 * r['high']) / 1000:.3f}"
    return (
        f"| `{r['scenario']}` | {r['name']} | {asked} | {low} {r['unit']}, "
        f"{percent(r['share_certified'])} | {high} {r['unit']} |"
    )


@pytest.mark.parametrize("name", RECORD["certified"])
def test_certificates_of_the_page_are_those_of_the_record(name):
    assert row(name) in PAGE


@pytest.mark.parametrize("name", RECORD["halved"])
def test_halved_cells_of_the_page_are_those_of_the_record(name):
    """What they certify is what all cells that small do, from half of the entries at most."""
    few, all_small = RECORD["halved"][name]
    for r in (few, all_small):
        says = ""
        if r["halved"]:
            whole = r["checked_share"] == 1
            says = "valid" if whole else f"{100 * r['checked_share']:g} % checked"
        told = (
            f"| `{r['scenario']}` | {' x '.join(map(str, r['cells']))} | {r['halved']} | "
            f"{percent(r['volume'])} | {r['entries']:,} | {r['file_bytes'] / 1000:,.0f} kB | "
            f"{r['seconds']:.1f} s | {says} |"
        )
        assert told in PAGE
    assert abs(few["volume"] - all_small["volume"]) < 5e-4
    assert 2 * few["entries"] < all_small["entries"]


HALVED = [
    pytest.param(n, marks=[pytest.mark.heavy] if n in LARGE else []) for n in RECORD["halved"]
]


@pytest.mark.few("seen-target")
@pytest.mark.parametrize("name", HALVED)
def test_halved_cells_of_the_record_keep_the_region_against_adversaries_in_closed_loop(name):
    found, (few, _) = proof(name, "HALVED"), RECORD["halved"][name]
    assert len(found.kept.entries) == few["entries"]
    assert benchmark().certified_volume(found) == pytest.approx(few["volume"], abs=2e-4)
    assert closed_loop(found, starts=500, holds=100, seed=4) < 2e-4


@pytest.mark.parametrize("name", RECORD["judged"])
def test_laws_of_the_page_are_those_of_the_record(name):
    assert row_of_law(name) in PAGE


@pytest.mark.parametrize(
    "name",
    [
        pytest.param(n, marks=() if n == "ferry-tacks" else pytest.mark.heavy)
        for n in RECORD["judged"]
    ],
)
def test_law_of_the_record_is_judged_so_and_the_checker_finds_no_cell_wrong(name, tmp_path):
    case, r = benchmark().JUDGED[name], RECORD["judged"][name]
    found = judged_law(case.scenario, case.overrides, **case.options).certificate
    assert len(found.kept.members) == r["cells_certified"]
    assert found.kept.inside == r["cells_in_region"]
    assert check(str(found.write(tmp_path / "c.holdfast")), share=100 / len(found.kept.members))


def test_ferry_that_tacks_stays_off_the_banks_from_its_certified_cells():
    case = benchmark().JUDGED["ferry-tacks"]
    found = judged_law(case.scenario, case.overrides, **case.options)
    assert found.verdict == "refuted"  # from the corners, heading for the bank
    loaded = hf.load_scenario(case.scenario)
    rng = np.random.default_rng(1)
    low, high = found.certificate.cells.corners(rng.choice(found.certificate.kept.members, 500))
    starts = low + (high - low) * rng.random(low.shape)
    for drift in (-0.15, 0.15):
        runs = hf.simulate(
            loaded.system, loaded.law, starts=starts, region=loaded.region, horizon=60,
            sample_time=0.5, substeps=10, record_every=0.5, disturbance={"drift": drift},
        )  # fmt: skip
        assert runs.outcomes["stayed"] == 500


@pytest.mark.parametrize("name", RECORD["largest"])
def test_largest_numbers_of_the_page_are_those_of_the_record(name):
    assert RECORD["largest"][name]["valid"]
    assert row_of_search(name) in PAGE


@pytest.mark.few("loaded-cart")
@pytest.mark.parametrize("name", EVERY)
def test_record_is_what_is_certified_and_the_checker_finds_no_cell_wrong(name, tmp_path):
    found, r = proof(name), RECORD["certified"][name]
    assert len(found.kept.members) == r["cells_certified"]
    assert found.kept.inside == r["cells_in_region"]
    assert r["valid"]
    assert check(str(found.write(tmp_path / "c.holdfast")), share=300 / len(found.kept.members))


@pytest.mark.few("loaded-cart")
@pytest.mark.parametrize("name", EVERY)
def test_certified_inputs_keep_the_region_against_adversaries_in_closed_loop(name):
    """500 starts in certified cells, 150 holds; at every step the corner that is worst for the
    constraint that is nearest, or a random one."""
    found = proof(name)
    worst = closed_loop(found, starts=500, holds=150, seed=3)
    assert worst < 2e-4  # the error of the steps


def window(leader_speed):
    """The gains k2 of chapter 6, corrected, for the numbers of leader-gains."""
    return hf.visibility_gains(
        k1=0.6, distance=1.0, range_max=2.5, half_angle=np.deg2rad(35), leader_speed=leader_speed,
        robot_radius=0.2,
    )  # fmt: skip


@pytest.mark.heavy
@pytest.mark.parametrize(("k2", "share"), [(0.66, 0.0), (0.68, 0.995)])
def test_gains_of_chapter_6_are_certified_down_to_near_the_end_of_their_window(k2, share):
    found = certified("leader-gains", [f"system.parameters.k2.value={k2}"], sample_time=0.01)
    assert found.kept.share == pytest.approx(share, abs=1e-3)
    assert window(0.25).low == pytest.approx(0.640, abs=1e-3)
    assert window(0.25).high == pytest.approx(1.027, abs=1e-3)


@pytest.mark.heavy
@pytest.mark.parametrize(("gains", "share"), [((0.68, 0.9), 0.995), ((0.9, 1.027), 0.916)])
def test_any_gain_of_the_window_of_chapter_6_keeps_the_leader_in_view(gains, share):
    found = certified("leader-gains", uncertain={"k2": gains}, sample_time=0.01)
    assert found.kept.share == pytest.approx(share, abs=1e-3)


@pytest.mark.heavy
def test_finer_cells_certify_the_smallest_gains_of_the_window():
    found = certified("leader-gains", uncertain={"k2": (0.65, 0.68)}, cells=801, sample_time=0.0025)
    assert found.kept.share == pytest.approx(0.9988, abs=5e-4)


@pytest.mark.heavy
def test_finer_cells_certify_smaller_gains_of_chapter_6():
    found = certified(
        "leader-gains", ["system.parameters.k2.value=0.66"], cells=401, sample_time=0.005
    )
    assert found.kept.share > 0.997


def test_largest_leader_is_near_the_one_for_which_the_window_ends():
    assert RECORD["largest"]["leader-gains"]["low"] == pytest.approx(0.296, abs=1e-3)
    assert window(0.3145).low < 0.8 < window(0.3155).low  # at 0.315 m/s
    assert window(0.315).low == pytest.approx(0.8, abs=1e-3)


def closed_loop(found, *, starts, holds, seed, steps=4):
    """The largest value of a constraint; fails where a state is in no certified cell."""
    cells, kept = found.cells, found.kept
    names = [n for n, _ in (*found.states, *found.inputs, *found.disturbances, *found.parameters)]
    symbols = {
        s.name: s
        for e in (*found.rates, *(c for *_, c in found.constraints))
        for s in e.free_symbols
    }
    order = [symbols.get(n, sp.Symbol(n, real=True)) for n in names]
    rates = sp.lambdify(order, list(found.rates), FUNCTIONS)
    limits = sp.lambdify(order, [c for *_, c in found.constraints], FUNCTIONS)
    free = [n for n, _ in (*found.disturbances, *found.parameters)]
    low, high = (np.array([found.ranges[n][k] for n in free]) for k in (0, 1))
    generator = np.random.default_rng(seed)
    table = np.full(int(np.prod(cells.counts)), -1)
    table[kept.members] = kept.inputs
    a, b = cells.corners(generator.choice(kept.members, starts))
    q = a + (b - a) * generator.random(a.shape)

    def at(function, q, u, d):
        values = function(*q.T, *u.T, *d.T)
        return np.stack([np.broadcast_to(v, len(q)) for v in values], axis=1)

    def moved(q, u, d, step):
        k1 = at(rates, q, u, d)
        k2 = at(rates, q + 0.5 * step * k1, u, d)
        return q + step * k2

    step, most = found.hold / steps, -np.inf
    for _ in range(holds):
        for k, turns in enumerate(cells.periodic):
            if turns:
                q[:, k] = (q[:, k] - cells.edges[k][0]) % (2 * np.pi) + cells.edges[k][0]
        place = [np.searchsorted(e, q[:, k], side="right") - 1 for k, e in enumerate(cells.edges)]
        assert all(((p >= 0) & (p < c)).all() for p, c in zip(place, cells.counts, strict=True))
        choice = table[np.ravel_multi_index(place, cells.counts)]
        assert (choice >= 0).all()
        u = found.candidates[choice]
        for _ in range(steps):
            tried = generator.random((6, starts, len(free))) < 0.5
            values = np.where(tried, low, high)
            after = np.stack([at(limits, moved(q, u, d, step), u, d).max(axis=1) for d in values])
            adverse = generator.random(starts) < 0.8
            best = np.where(adverse, after.argmax(axis=0), 0)
            q = moved(q, u, values[best, np.arange(starts)], step)
            most = max(most, float(at(limits, q, u, values[0]).max()))
    return most
