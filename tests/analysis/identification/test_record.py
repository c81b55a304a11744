"""The table of docs/identify.md is what `benchmarks/identification.py` has recorded."""

import json
from pathlib import Path

ROOT = Path(__file__).parents[3]
NAMES = {"otter": "Otter", "rov": "ROV", "ship": "drillship", "wheels": "wheels"}


def row(name, told):
    width = "" if told["median_width"] is None else f"{told['median_width']:g} %"
    bound = "; ".join(f"{n} {a:g} to {b:g} {u}" for n, (a, b, u) in told["bound"].items())
    cells = (
        NAMES[name],
        told["guess"],
        f"{told['windows']} of {told['window']:g} s",
        f"{told['identified']}, {told['held']}",
        width,
        bound,
        ", ".join(f"{share} %" for share in told["by_noise"].values()),
        f"{told['second'] - told['outside']} of {told['second']}",
    )
    return f"| {' | '.join(cells)} |"


def test_table_of_identification_is_the_record_of_the_benchmark():
    record = json.loads((ROOT / "benchmarks" / "identification.json").read_text())["foreign"]
    page = (ROOT / "docs" / "identify.md").read_text()
    assert set(record) == set(NAMES)
    for name, told in record.items():
        assert row(name, told) in page


def test_coverage_of_the_page_is_the_record_of_the_benchmark():
    told = json.loads((ROOT / "benchmarks" / "identification.json").read_text())["known"]
    page = (ROOT / "docs" / "identify.md").read_text()
    assert f"{told['logs']} logs of an Otter with known numbers" in page
    assert (
        f"{told['inside']} of {told['intervals']} intervals at 95 % contain the truth, and "
        f"{told['covered']} of {told['logs']} second logs are within the bound"
    ) in page
