"""Certificates are read from their files as they were written, and nothing else is."""

import math
import sys

import numpy as np
import pytest
import sympy as sp

import holdfast as hf
from holdfast.analysis.certificates.certificate import KNOWN
from holdfast.analysis.certificates.reading import exact_expression
from holdfast.errors import DefinitionError, ExpressionError, ModelWarning, OutputError
from holdfast.maths.expressions.traversal import exact
from holdfast_check import checker
from tests.certified_systems import AHEAD, BOX, CART, LEFT, camera, cart, changed, view

CHECKED = checker.proved


def written(folder, **options):
    found = hf.certify(camera(), view(camera()), box=BOX, cells=21, **options)
    return found, found.write(folder / "view.holdfast")


@pytest.mark.parametrize("horizon", [None, 0.5])
def test_certificate_that_is_read_is_the_one_that_was_written(horizon, tmp_path):
    found, path = written(tmp_path, horizon=horizon)
    read = hf.read_certificate(path)
    assert read.header() == found.header()
    assert read.rates == tuple(exact(r) for r in found.rates)
    assert read.ranges == found.ranges
    for name in ("members", "inputs", "entries", "region"):
        assert np.array_equal(getattr(read.kept, name), getattr(found.kept, name)), name
    again = read.write(tmp_path / "again.holdfast")
    assert again.read_bytes() == path.read_bytes()


def test_uncertain_number_is_read_with_its_range(tmp_path):
    found = hf.certify(*cart(), box=CART, cells=41, sample_time=0.2, uncertain={"drag": (0.1, 0.3)})
    read = hf.read_certificate(found.write(tmp_path / "cart.holdfast"))
    assert read.header() == found.header()
    system = hf.certified_system(read)
    assert system.parameters[0].value == pytest.approx(0.2)
    assert system.rates.keys() == {"x", "v"}


def wider(header):
    """A current of 0.12 m/s, where 0.1 was counted."""
    header["disturbances"][0]["range"] = [(-0.12).hex(), (0.12).hex()]


def test_what_a_file_does_not_prove_is_refused(tmp_path):
    _, path = written(tmp_path)
    forged = changed(path, wider)
    with pytest.raises(OutputError, match=r"is not valid: cell .* is not kept; certify again"):
        hf.read_certificate(forged)
    with pytest.raises(OutputError, match="is not valid"):  # it is not kept as a valid one
        hf.read_certificate(forged)
    with pytest.warns(ModelWarning, match="was not checked: that its cells are kept is what it"):
        assert hf.read_certificate(forged, check=0).ranges["wa"] == (-0.12, 0.12)


def test_what_is_not_checked_is_said_each_time_and_a_whole_check_is_kept(tmp_path, monkeypatch):
    monkeypatch.setenv("HOLDFAST_CACHE_DIR", str(tmp_path / "cache"))
    found, path = written(tmp_path)
    entries = len(found.kept.entries)
    for _ in range(2):
        with pytest.warns(ModelWarning, match=rf"\d+ of {entries} entries of .* \(seed \d+\)"):
            hf.read_certificate(path, check=0.1)
    asked = []
    monkeypatch.setattr(checker, "proved", lambda *a: asked.append(a) or CHECKED(*a))
    hf.read_certificate(path)
    hf.read_certificate(path, check=0.1)  # all of it was checked: nothing is left to say
    assert asked == [(path.read_bytes(), 1.0)]
    later = written(tmp_path, horizon=0.5)[1]
    hf.read_certificate(later)
    assert len(asked) == 2
    with pytest.raises(
        OutputError, match=r"check is 1\.5; expected a share of the entries, 0 to 1"
    ):
        hf.read_certificate(path, check=1.5)


def test_a_checker_that_is_not_there_is_said(tmp_path, monkeypatch):
    monkeypatch.setenv("HOLDFAST_CACHE_DIR", str(tmp_path / "cache"))
    _, path = written(tmp_path)
    for name in [n for n in sys.modules if n.startswith("holdfast_check.")]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, "flint", None)
    with pytest.warns(ModelWarning, match=r"was not checked.*python-flint: .*holdfast\[check\]"):
        hf.read_certificate(path)


def test_what_is_checked_is_what_was_read(tmp_path, monkeypatch):
    """A file that is honest while it is checked alone."""
    _, path = written(tmp_path)
    honest = path.read_bytes()
    forged = changed(path, wider)
    content = forged.read_bytes()

    def replaced(*a):
        forged.write_bytes(honest)
        try:
            return CHECKED(*a)
        finally:
            forged.write_bytes(content)

    monkeypatch.setattr(checker, "proved", replaced)
    for _ in range(2):
        with pytest.raises(OutputError, match="is not valid"):
            hf.read_certificate(forged)


def test_a_check_leaves_the_numbers_of_others_and_needs_no_terminal(tmp_path, monkeypatch):
    monkeypatch.setenv("HOLDFAST_CACHE_DIR", str(tmp_path / "cache"))
    monkeypatch.setattr(sys, "stderr", None)
    _, path = written(tmp_path)
    monkeypatch.setattr(checker.flint.ctx, "prec", 53)
    hf.read_certificate(path)
    assert checker.flint.ctx.prec == 53


@pytest.mark.few("<lambda>-its digest is another1", "<lambda>-no certificate2")
@pytest.mark.parametrize(
    ("spoil", "named"),
    [
        (lambda raw: raw[:-1], "its digest is another"),
        (lambda raw: raw[:200] + bytes([raw[200] ^ 1]) + raw[201:], "its digest is another"),
        (lambda raw: b"", "no certificate"),
        (lambda raw: b"PK" + raw, "no certificate"),
        (lambda raw: raw.replace(b"certificate 1", b"certificate 2", 1), "no certificate"),
    ],
)
def test_file_that_is_not_what_was_written_is_refused(spoil, named, tmp_path):
    _, path = written(tmp_path)
    path.write_bytes(spoil(path.read_bytes()))
    with pytest.raises(OutputError, match=named):
        hf.read_certificate(path)


@pytest.mark.few("change1-s late", "change4-is no text")
@pytest.mark.parametrize(
    ("change", "named"),
    [
        ({"goal": []}, "says 'goal'"),
        ({"delay": "0x1p+4"}, "s late"),
        ({"errors": ["0x0p+0"]}, "with errors"),
        ({"law": ["0"]}, "of an earlier version"),
        ({"hold": None}, "is no text"),
        ({"hold": "nan"}, "not finite"),
        ({"holds": 0}, "holds inputs 0 times"),
        ({"rates": ["v", "__import__('os')"]}, "nothing of a certificate"),
        ({"rates": ["9**9**9", "0"]}, "the exponent"),
        ({"rates": ["unknown", "0"]}, "nothing of a certificate"),
        ({"rates": ["0"]}, "axes and states are not as many"),
        ({"cells_kept": 1}, "cells that are kept are not 1"),
        ({"entries": 3}, "its entries are not 3"),
        ({"entries": 10**12}, "its entries are not"),
        ({"candidates": [["0x0p+0", "0x0p+0"]]}, "an entry has a cell, an input"),
        ({"inputs": [{"name": "sin", "unit": "1"}, {"name": "r", "unit": "1"}]}, "'sin' is the name"),
        ({"edges": [["0x0p+0"], ["0x0p+0", "0x1p+0"]]}, "edges of an axis"),
        ({"periodic": ["yes", "no"]}, "axes and states"),
        ({"states": 7}, "is damaged"),
    ],
)  # fmt: skip
def test_header_that_is_not_understood_is_refused_by_name(change, named, tmp_path):
    _, path = written(tmp_path)
    with pytest.raises(OutputError, match=named):
        hf.read_certificate(changed(path, lambda header: header.update(change)))


def test_header_that_lacks_a_key_and_a_file_that_is_not_there_are_refused(tmp_path):
    _, path = written(tmp_path)
    with pytest.raises(OutputError, match="lacks 'rates'"):
        hf.read_certificate(changed(path, lambda header: header.pop("rates")))
    with pytest.raises(OutputError, match="cannot be read"):
        hf.read_certificate(tmp_path / "none.holdfast")


def test_every_function_of_a_certificate_is_read_back():
    x, y = hf.symbol("x"), hf.symbol("y")
    names = {"x": x, "y": y}
    for name in (*KNOWN, "sqrt"):
        for arguments in ("x", "x, y", "x, y, 1/1000000000000"):
            try:
                e = exact_expression(f"{name}({arguments})", names)
            except (TypeError, ValueError, AttributeError):
                continue
            assert exact_expression(sp.sstr(e), names) == e
            break
        else:
            pytest.fail(name)


def test_numbers_are_read_exactly():
    third = exact(sp.Float(0.1) ** 3 * hf.symbol("x") + sp.pi / 3)
    assert exact_expression(sp.sstr(third), {"x": hf.symbol("x")}) == third
    assert exact_expression("2**(-1/2)", {}) == 1 / sp.sqrt(2)
    for text in ("1.5", "True", "x", "pi.real", "sin(x=1)", "lambda: 0", "(" * 300, 7, math.nan):
        with pytest.raises(ExpressionError):
            exact_expression(text, {})


@pytest.mark.heavy
def test_delay_errors_a_target_and_a_law_come_back_from_the_file(tmp_path):
    system, region = camera(), view(camera())
    rates = {"u": 0 * AHEAD, "r": 2 * LEFT}
    turns = hf.Law("still", system.states, rates, empirical="a gain is a number")
    kinds = (
        {"delay": 0.02, "errors": {"left": 0.01}},
        {"target": hf.Region("near", system.states, (hf.Inequality("d", AHEAD - 1, "m"),))},
        {"law": turns, "horizon": 0.2},
    )
    for more in kinds:
        found = hf.certify(system, region, box=BOX, cells=31, **more)
        assert len(found.kept.members)
        again = hf.read_certificate(found.write(tmp_path / "some.certificate"))
        assert again.sampling.errors == found.sampling.errors
        assert again.header() == found.header()
        if "law" in more:
            with pytest.raises(DefinitionError, match="is of a law"):
                hf.certified_law(again)
        else:
            law, same = hf.certified_law(again), hf.certified_law(found)
            assert hf.export_c(system, law) == hf.export_c(system, same)


@pytest.mark.parametrize("text", ["(9**64)**64", "((x**8)**8)**2", "(1/3)**64**1*(7**60)**60"])
def test_powers_of_powers_are_refused(text):
    with pytest.raises(ExpressionError, match=r"too long|power of a power"):
        exact_expression(text, {"x": hf.symbol("x")})
