"""Scalar functions: one text, which Python, LLVM and C run to the same bits."""

import ctypes
import math
import types

import numpy as np
import pytest

from holdfast.execution.codegen.c_printer import scalars_c
from holdfast.execution.codegen.scalar_llvm import scalars_text
from holdfast.execution.codegen.scalar_reader import read
from holdfast.execution.leaf import compiled_text
from tests.c_code import built, needs_gcc

HEAD = "import math\nfrom holdfast.execution.arrays import Floats, Table, Wholes\nHALF = -0.5\n"
EVERY = '''
def last_below(a: Floats, count: int, bound: float) -> int:
    """The place of the last entry below a bound, -1 if there is none."""
    found = -1
    for i in range(count):
        if not a[i] < bound:
            continue
        found = i
    return found


def scaled(a: Floats, count: int, factor: float) -> None:
    for i in range(1, count):
        a[i] *= factor


def evaluate(a: Floats, k: Wholes, count: int, out: Floats) -> None:
    """Every statement and every expression of the language."""
    rest = a[1:]
    total, turns = 0.0, 0
    while True:
        turns += 1
        if turns > count or (total > 50.0 and turns % 2 == 0):
            break
        total += rest[turns - 1] / 3 if turns < 3 else abs(rest[turns - 1])
    out[0], out[1] = total, float(turns)
    out[2] = min(a[0], a[1]) - max(a[0], a[1])
    out[3] = math.sqrt(abs(a[2])) + math.floor(a[3]) + int(a[3])
    out[4] = HALF if -1.0 <= a[0] <= 1.0 or math.isnan(a[0]) else math.inf
    out[5] = last_below(rest, count, 0.25) * 2 - (turns >> 1 & 1)
    bits = turns
    bits |= 4
    bits <<= 1
    k[0] = -(-bits) + max(min(turns, 3), 2) - (1 << 2) + abs(k[1]) // 2
    for i in range(count, count - 2, -1):
        out[4] += i | 1
    scaled(out[5:], 2, 0.1)
    out[6] = out[7] = -a[0] if not math.isfinite(a[1]) and k[1] != 0 else k[1] / 7
'''


def python(text):
    module = types.ModuleType("text")
    exec(compile(HEAD + text, "text", "exec"), module.__dict__)
    return module


def cases():
    rng = np.random.default_rng(4)
    for count in range(2, 9):
        a = rng.normal(size=count + 2) * 10.0 ** rng.integers(-2, 3)
        yield a, np.array([0, int(rng.integers(-5, 6))]), count
    yield np.array([0.5, math.inf, -4.0, 2.5, 1.0]), np.array([0, 3]), 3
    yield np.array([-0.0, 0.0, 4.0, -2.5, 1.0]), np.array([7, 0]), 3


def outcome(function, a, k, count, pointers=False):
    a, k, out = a.copy(), k.copy(), np.zeros(8)
    with np.errstate(invalid="ignore"):
        function(*((x.ctypes.data if pointers else x) for x in (a, k)), count,
                 out.ctypes.data if pointers else out)  # fmt: skip
    return np.concatenate([out, k]).view(np.int64)


def test_llvm_gives_the_bits_that_python_gives():
    machine = compiled_text(scalars_text(read(HEAD + EVERY), ["evaluate"]), optimised=True)
    kinds = [ctypes.c_void_p, ctypes.c_void_p, ctypes.c_int64, ctypes.c_void_p]
    compiled = ctypes.CFUNCTYPE(None, *kinds)(machine.address("evaluate"))
    for case in cases():
        expected = outcome(python(EVERY).evaluate, *case)
        assert outcome(compiled, *case, pointers=True).tolist() == expected.tolist()


@needs_gcc
def test_c_gives_the_bits_that_python_gives(tmp_path):
    text = scalars_c(read(HEAD + EVERY), ["evaluate"])
    assert "The place of the last entry below a bound" in text
    assert max(map(len, text.splitlines())) <= 100
    head = "#include <math.h>\n#include <stddef.h>\n"
    public = "void evaluate(const double *a, long *k, long count, double *out) {\n"
    c = built(tmp_path, f"{head}{text}\n{public}    hf_evaluate(a, k, count, out);\n}}\n", "every")
    c.evaluate.argtypes = [ctypes.c_void_p, ctypes.c_void_p, ctypes.c_long, ctypes.c_void_p]
    for case in cases():
        expected = outcome(python(EVERY).evaluate, *case)
        assert outcome(c.evaluate, *case, pointers=True).tolist() == expected.tolist()


def test_tables_in_single_precision_are_read_as_doubles():
    text = "def sum_of(t: Table, count: int) -> float:\n    s = 0.0\n"
    text += "    for i in range(count):\n        s += t[i]\n    return s\n"
    for dtype in (np.float32, np.float64):
        machine = compiled_text(
            scalars_text(read(HEAD + text), ["sum_of"], single=dtype == np.float32), optimised=True
        )
        call = ctypes.CFUNCTYPE(ctypes.c_double, ctypes.c_void_p, ctypes.c_int64)
        values = np.array([0.1, 0.2, 0.7], dtype=dtype)
        found = call(machine.address("sum_of"))(values.ctypes.data, 3)
        assert found == (0.0 + float(values[0])) + float(values[1]) + float(values[2])


@pytest.mark.parametrize(
    ("line", "why"),
    [
        ("x = [1.0]", "no expression of a scalar function: [1.0]"),
        ("x = unknown(a)", "an unknown function"),
        ("x = y", "a name without a value"),
        ("with a: pass", "no statement of a scalar function"),
        ("for i in range(a[0]): pass", "a bound that is not whole"),
        ("n = 0.5", "'n' is int and float"),
        ("f(n, n)", "'a' of 'f' is Floats"),
        ("x = min(1.0)", "'min' of 1 values"),
        ("x = min(n, 3, key=abs)", "no expression of a scalar function"),
        ("x = a[1::2]", "no expression of a scalar function"),
        ("x = a[-1]", "an entry whose place is not a whole number from 0 on"),
        ("x = n or 1", "'and' or 'or' of numbers"),
        ("m = 1; n, m = m, n", "a value that is read after it is replaced"),
        ("if n > 0: x = 1\n    y = x", "'x' may have no value"),
        ("for i in range(3): pass\n    x = i", "'i' may have no value"),
        ("for i in range(n): n = 2", "a bound or a counter that the loop changes"),
        ("return 1", "the result is None"),
        ("n = n ^ 2", "an operator that scalar functions lack"),
        ("x = a[0] % 2.0", "an operator that scalar functions lack"),
        ("for i in range(9, 0, -2): pass", "a step that is not 1 or -1"),
    ],
)
def test_what_is_no_part_of_the_language_is_refused_with_its_line(line, why):
    with pytest.raises(SyntaxError) as raised:
        read(f"{HEAD}def f(a: Floats, n: int) -> None:\n    {line}\n")
    assert str(raised.value).startswith(f"f, line {4 + len(line.splitlines())}")
    assert why in str(raised.value)


def test_function_with_a_result_returns_it_on_every_way():
    head = f"{HEAD}def f(n: int) -> int:\n"
    with pytest.raises(SyntaxError, match="a way to the end without a result"):
        read(f"{head}    if n > 0:\n        return 1\n")
    with pytest.raises(SyntaxError, match="the result is int"):
        read(f"{head}    return 0.5\n")
    assert read(f"{head}    if n > 0:\n        return 1\n    return n\n").functions


def test_functions_of_other_values_are_for_python_alone():
    known = read(f"{HEAD}def room(n: int) -> tuple[int, int]:\n    return n, {{}}\n")
    assert not known.functions


FIXED = """
def both(a: Floats, n: int) -> float:
    total = 0.0
    if shape.doubled or n > 3:
        total = 2.0
    if not shape.doubled and n > 0:
        total += 100.0
    for k in each(shape.count):
        if shape.used[k]:
            total += a[k + at.first]
    return total
"""


@pytest.mark.parametrize(
    ("doubled", "used", "n", "expected"),
    [(True, (1, 0, 1), 0, 2 + 5 + 7), (False, (0, 1, 0), 1, 100 + 6), (False, (0, 0, 0), 4, 102)],
)
def test_a_text_is_read_for_what_is_fixed(doubled, used, n, expected):
    """Branches that are decided are taken, loops of a fixed number of turns are written out."""
    fixed = {"shape.doubled": doubled, "shape.count": 3, "shape.used": used, "at.first": 1}
    library = read(FIXED, fixed)
    machine = compiled_text(scalars_text(library, ["both"]))
    function = ctypes.CFUNCTYPE(ctypes.c_double, ctypes.c_void_p, ctypes.c_int64)(
        machine.address("both")
    )
    a = np.array([0.0, 5.0, 6.0, 7.0])
    assert function(a.ctypes.data, n) == expected
    printed = scalars_c(library, ["both"])
    assert "for" not in printed
    assert ("n > 3" in printed) is not doubled
    assert ("n > 0" in printed) is not doubled


@pytest.mark.parametrize(
    ("line", "said"),
    [
        ("for k in each(n):\n        leaf('rates', out=0)", "the turns are not fixed: each"),
        ("leaf('rates', to=4)", "no places of a leaf: to"),
        ("leaf('rates', out=shape.unknown)", "no expression of a scalar function"),
    ],
)
def test_what_is_not_fixed_is_refused(line, said):
    text = f"def some(w: Floats, leaves: Wholes, n: int):\n    {line}\n"
    with pytest.raises(SyntaxError, match=said):
        read(text, {"shape.known": 1})


def test_leaves_are_called_by_name_number_and_place():
    text = (
        "def some(w: Floats, s: Wholes, leaves: Wholes, stop: Wholes):\n"
        "    for k in each(1, 3):\n"
        "        leaf('law', k, q=at.q, out=at.u + k)\n"
        "    part(names.look_up, s, w, 7)\n"
    )
    library = read(text, {"at.q": 8, "at.u": 16, "names.look_up": "look"})
    assert library.called(["some"]) == ["law1", "law2", "look"]
    printed = scalars_c(library, ["some"])
    assert "leaf_law2(w + 0, w + 8, w + 0, w + 0, w + 18);" in printed
    assert "hf_look(s, w, 7);" in printed
