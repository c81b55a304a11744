"""C of the project, compiled with warnings as errors."""

import ctypes
import shutil
import subprocess

import numpy as np
import pytest

STRICT = ["-std=c99", "-Wall", "-Wextra", "-Werror", "-pedantic", "-O2"]

needs_gcc = pytest.mark.skipif(shutil.which("gcc") is None, reason="there is no gcc")


def built(folder, text, name, harness=""):
    """The file as a library, with functions of the test behind it."""
    upper = name.upper()
    sizes = harness.replace("INPUTS", f"{upper}_INPUTS").replace("ACTUATORS", f"{upper}_ACTUATORS")
    (folder / f"{name}.c").write_text(text + sizes)
    library = folder / f"{name}.so"
    alone = [*STRICT, "-c", str(folder / f"{name}.c"), "-o", str(folder / f"{name}.o")]
    for command in (
        alone,
        [*STRICT, "-shared", "-fPIC", str(folder / f"{name}.c"), "-o", str(library), "-lm"],
    ):
        done = subprocess.run(["gcc", *command], capture_output=True, text=True)
        assert done.returncode == 0, done.stderr
    return ctypes.CDLL(str(library))


def pointer(array):
    return array.ctypes.data_as(ctypes.POINTER(ctypes.c_double))


RUN = """
void run(const double *seen, const double *handed, int count, double hold, double *answer) {
    keep_state s;
    double actuators[1];
    keep_start(&s);
    for (int k = 0; k < count; k++)
        keep_step(&s, k * hold, hold, seen + 2 * k, handed + k, keep_parameters, answer + k,
                  actuators);
}
"""


def answers_of_c(folder, keep, states, commands):
    """The inputs of a filter with two states and one input, sample by sample, in C."""
    c, answers = built(folder, keep.export_c("keep") + RUN, "keep"), np.zeros(len(states))
    hold = ctypes.c_double(keep.sample_time)
    c.run(pointer(states), pointer(commands), len(states), hold, pointer(answers))
    return answers
