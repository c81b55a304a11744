"""Enclosures of another kind: what they certify the checker follows by its own means."""

from dataclasses import replace

import pytest

import holdfast as hf
from holdfast.analysis.certificates import certificate
from holdfast.errors import ModelWarning, OutputError, SimulationError
from holdfast.execution.intervals.enclosures import enclosures
from holdfast_check.checker import MOST_HALVES, checked
from holdfast_check.reading import NotValidError

SHARE = 0.05
"""Of the entries that the checker reads here."""


@pytest.fixture(scope="module")
def spring():
    """An undamped spring that is pushed, held for 0.9 s: four tenths of its period."""
    x, v, u, d = (hf.symbol(n) for n in "xvud")
    system = hf.System(
        "spring",
        (hf.Quantity("x"), hf.Quantity("v")),
        (hf.Quantity("u"),),
        {"x": v, "v": -9 * x + u + d},
        disturbances=(hf.Quantity("d"),),
        input_bounds=hf.Box((-1,), (1,)),
        disturbance_bounds=hf.Box((-0.2,), (0.2,)),
    )
    return system, hf.Region("room", system.states, (hf.Inequality("end", abs(x) - 0.6),))


def certified(spring, **more):
    box = {"x": (-0.7, 0.7), "v": (-2, 2)}
    return hf.certify(*spring, box=box, cells=61, sample_time=0.9, **more)


@pytest.fixture(scope="module")
def turned(spring):
    return certified(spring, enclosure="zonotope")


def test_zonotopes_certify_what_turns_where_parallelepipeds_certify_nothing(spring, turned):
    assert certified(spring, steps=turned.sampling.steps).kept.share == 0
    assert turned.sampling.steps == 8
    assert round(100 * turned.kept.share) == 69


def test_checker_follows_what_zonotopes_certify(turned, tmp_path):
    path = turned.write(tmp_path / "spring.certificate")
    assert checked(str(path), SHARE, seed=1)["checked"] > 20
    with pytest.warns(ModelWarning, match="was not checked"):
        again = hf.read_certificate(path, check=0)
    assert again.header() == turned.header()
    assert again.sampling == turned.sampling


@pytest.mark.parametrize("name", ["octagon", ["zonotope"]])
def test_file_of_an_enclosure_that_there_is_not_is_refused(turned, name, tmp_path):
    other = replace(turned, sampling=replace(turned.sampling, enclosure=name))
    said = "its enclosures are .*, and this version has parallelepiped, zonotope"
    with pytest.raises(OutputError, match=said):
        hf.read_certificate(other.write(tmp_path / "spring.certificate"), check=0)


@pytest.mark.parametrize(
    "changed",
    [
        lambda c: replace(c, sampling=replace(c.sampling, halves=0)),  # not followed closely
        lambda c: replace(c, candidates=-c.candidates),
        lambda c: replace(c, ranges={**c.ranges, "d": (-0.4, 0.4)}),
    ],
    ids=["as ever", "inputs", "more of the disturbance"],
)
def test_checker_halves_no_claim_into_truth(turned, changed, tmp_path):
    path = changed(turned).write(tmp_path / "spring.certificate")
    with pytest.raises(NotValidError):
        checked(str(path), 0.5, seed=1)


@pytest.mark.parametrize("halves", [-1, MOST_HALVES + 1])
def test_file_that_asks_for_other_halves_than_are_written_is_refused(turned, halves, tmp_path):
    other = replace(turned, sampling=replace(turned.sampling, halves=halves))
    path = other.write(tmp_path / "spring.certificate")
    with pytest.raises(OutputError, match=f"may be halved {halves} times"):
        hf.read_certificate(path, check=0)
    with pytest.raises(NotValidError, match=f"may be halved {halves} times"):
        checked(str(path), SHARE, seed=1)


def test_no_enclosure_asks_for_more_halves_than_are_read():
    most = max(kind.halves for kind in enclosures().values())
    assert most == MOST_HALVES == certificate.MOST_HALVES


def test_enclosure_that_there_is_not_is_refused(spring):
    with pytest.raises(SimulationError, match=r"enclosure is 'zonotop'.*did you mean 'zonotope'"):
        certified(spring, enclosure="zonotop")
