"""The loops of a sweep do what their text does in Python."""

from importlib import resources

import numpy as np
import pytest

from holdfast.execution.codegen.scalar_llvm import scalars_text
from holdfast.execution.codegen.scalar_reader import read
from holdfast.execution.leaf import compiled_text
from holdfast.execution.level_set import stencils, sweep

TEXT = """
def smallest(values: Values, count: int, out: Values):
    found, skipped = values[0], 0
    for k in range(1, count):
        if values[k] < 0.0 or k % 3 == 2 and not values[k] > 1.0:
            skipped += 1
            continue
        found = min(found, values[k])
    k = count
    while True:
        k -= 1
        if k == 0 or values[k] < 0.0:
            break
    out[0], out[1], out[2] = found, skipped, abs(-float(k))
"""


def compiled(text, real, *names):
    known = read(text)
    printed = scalars_text(known, names, single=real == "float", fused=True)
    machine = compiled_text(printed, optimised=True)
    return [machine.function(name, len(known.functions[name].parameters)) for name in names]


def source(name):
    return (resources.files("holdfast.execution.level_set") / f"{name}.py").read_text("utf-8")


@pytest.mark.parametrize(("real", "kind"), [("double", np.float64), ("float", np.float32)])
def test_branches_and_loops_are_those_of_python(real, kind):
    (function,) = compiled(TEXT, real, "smallest")
    values = np.array([4, 3, 0.5, -1, 0.25, 1.5, 2, 0.125, 7], dtype=kind)
    out = np.zeros(3, dtype=kind)
    function(values.ctypes.data, len(values), out.ctypes.data)
    assert out.tolist() == [0.125, 2, 3]


@pytest.mark.parametrize("kind", [stencils.EXTRAPOLATED, stencils.PERIODIC, stencils.LIMITED])
def test_marks_of_a_sweep_are_those_of_its_python_text(kind):
    mark, mark_rows = compiled(source("stencils"), "double", "mark", "mark_rows")
    for ghosts in (1, 2, 3):
        for place in range(7):
            found, expected = np.zeros((2, 200), dtype=np.uint8)
            mark(found.ctypes.data, 9 * place + 2, 2, place, 7, 9, kind, ghosts)
            stencils.mark(expected, 9 * place + 2, 2, place, 7, 9, kind, ghosts)
            arguments = (100, 2 * place, 2, 14, 2, 3, kind, ghosts)
            mark_rows(found.ctypes.data, *arguments)
            stencils.mark_rows(expected, *arguments)
            assert expected.any()
            np.testing.assert_array_equal(found, expected)


def test_bits_of_a_run_are_found_within_their_ends():
    text = source("stencils") + source("slopes_once") + source("sweep")
    text += "\ndef told(bits: Wholes, a: int, b: int, out: Wholes):\n"
    text += "    out[0] = any_of(bits, a, b)\n"
    (told,) = compiled(text, "double", "told")
    out = np.zeros(1, dtype=np.int64)
    for bit in (0, 5, 63, 64, 127, 130):
        bits = np.zeros(3, dtype=np.int64)
        bits[bit // 64] = np.uint64(1 << bit % 64).astype(np.int64)
        for first, last in ((0, 192), (0, bit), (bit, bit + 1), (bit + 1, 192), (60, 70)):
            told(bits.ctypes.data, first, last, out.ctypes.data)
            assert out[0] == (first <= bit < last)
            with np.errstate(over="ignore"):
                assert out[0] == sweep.any_of(bits, first, last)
