"""Several exported laws in one program, in C and in C++, called through their headers."""

import re
import shutil
import subprocess

import numpy as np
import pytest

import holdfast as hf
from tests.c_code import STRICT, needs_gcc
from tests.carts import BOX, WALLS, cart, swinging

pytestmark = needs_gcc

STARTS = np.array([[-0.8, -0.4, 0.3], [0.9, 0.2, -1.2], [0.5, 0.6, 2.0], [-0.1, -0.9, 0.0]])
CALL = """
static void call_NAME(void) {
    const double starts[][NAME_SEEN] = {STARTS};
    double command[UPPER_INPUTS], actuators[UPPER_ACTUATORS];
    for (int i = 0; i < (int)(sizeof starts / sizeof starts[0]); i++) {
        NAME_state s;
        NAME_start(&s);
        NAME_step(&s, 0.0, 0.02, starts[i], NAME_parameters, command, actuators);
        for (int j = 0; j < UPPER_ACTUATORS; j++) printf("%.17g\\n", actuators[j]);
    }
}
"""


def kept(nodes, **options):
    """A law with a quadratic program, over the table of a kernel."""
    system = cart()
    found = hf.discriminating_kernel(system, WALLS, hf.grid(system, BOX, nodes), horizon=3)
    return system, hf.safety_law(system, found, swinging(), **options)


def limited():
    """A law with a quadratic program of its own: two inputs and a region."""
    vehicle, view = hf.systems.marine_vehicle("videoray_pro_iii"), hf.regions.camera_view()
    go = hf.laws.inspect_target(vehicle, distance=0.5)
    law = hf.track_velocity(vehicle, go, {"u": 5.0, "r": 10.0})
    return vehicle, hf.safeguard(vehicle, law, view, gains=(2, 6))


@pytest.fixture(scope="module")
def laws():
    robot = hf.systems.unicycle()
    return {
        "dock": (robot, hf.laws.steer_unicycle(robot)),
        "keep": kept(31),
        "keep_closer": kept(41, margin=0.05),
        "inspect": limited(),
    }


def starts_of(system):
    wide = np.zeros((len(STARTS), len(system.states)))
    count = min(3, wide.shape[1])
    wide[:, :count] = STARTS[:, :count]
    if "tau_u" in system.input_names:
        wide[:, :3] = [[-1.0, 0.2, 0.1], [-0.6, -0.1, 0.0], [-1.5, 0.5, -0.4], [-0.8, 0.0, 0.3]]
    return wide


def written(folder, laws):
    """The files of all laws, and a program that prints what the actuators do at every start."""
    headers, calls, main = [], [], []
    for name, (system, law) in laws.items():
        (folder / f"{name}.c").write_text(hf.export_c(system, law, name))
        (folder / f"{name}.h").write_text(hf.export_c_header(system, law, name))
        headers.append(f'#include "{name}.h"')
        rows = (", ".join(map(repr, map(float, row))) for row in starts_of(system))
        starts = ", ".join(f"{{{row}}}" for row in rows)
        text = CALL.replace("NAME_SEEN", "UPPER_SEEN").replace("{STARTS}", f"{{{starts}}}")
        calls.append(text.replace("NAME", name).replace("UPPER", name.upper()))
        main.append(f"    call_{name}();")
    include = "\n".join([*headers, *headers, "#include <stdio.h>"])  # twice: they are guarded
    body = "\n".join([*calls, "int main(void) {", *main, "    return 0;", "}"])
    (folder / "main.c").write_text(f"{include}\n{body}\n")
    return folder / "main.c"


def done(folder, *command):
    found = subprocess.run(command, capture_output=True, text=True, cwd=folder)
    assert found.returncode == 0, found.stderr
    return found.stdout


def simulated(system, law):
    """What the actuators do at every start, in the compiled closed loop."""
    data = hf.simulate(
        system, law, starts=starts_of(system), horizon=0.02, sample_time=0.02, record_every=0.02
    ).dataset
    acted = data["actuator"] if data.sizes.get("actuator_name") else data["input"]
    return acted.values[:, 0]


@pytest.mark.heavy
def test_two_laws_and_two_kernels_are_in_one_program(laws, tmp_path):
    """A steering law, a safeguard, and two safety laws with tables of different size, in C, in C++,
    and all in one translation unit."""
    main = written(tmp_path, laws)
    sources = [f"{name}.c" for name in laws]
    done(tmp_path, "gcc", *STRICT, "-Wmissing-prototypes", "-c", *sources)
    objects = [f"{name}.o" for name in laws]
    done(tmp_path, "gcc", *STRICT, "main.c", *objects, "-o", "in_c", "-lm")
    told = done(tmp_path, "./in_c")
    found, at = np.array(told.split(), dtype=float), 0
    for name, (system, law) in laws.items():
        expected = simulated(system, law)
        of_this = found[at : at + expected.size].reshape(expected.shape)
        assert of_this == pytest.approx(expected, rel=1e-12, abs=1e-12), name
        assert np.abs(of_this).max() > 0.1, name
        at += expected.size
    assert at == len(found)

    together = "".join(f'#include "{source}"\n' for source in sources) + main.read_text()
    (tmp_path / "together.c").write_text(together)
    done(tmp_path, "gcc", *STRICT, "together.c", "-o", "in_one_unit", "-lm")
    assert done(tmp_path, "./in_one_unit") == told

    if shutil.which("g++"):
        (tmp_path / "main.cpp").write_text(main.read_text())
        strict = ["-std=c++11", "-Wall", "-Wextra", "-Werror", "-pedantic"]
        done(tmp_path, "g++", *strict, "main.cpp", *objects, "-o", "in_cpp", "-lm")
        assert done(tmp_path, "./in_cpp") == told


@pytest.mark.heavy
def test_every_name_at_file_scope_begins_with_the_name_of_the_law(laws):
    system, law = laws["keep"]
    text = hf.export_c(system, law, "keep")
    code = re.sub(r"/\*.*?\*/", "", text, flags=re.DOTALL)
    names = set(re.findall(r"^#define (\w+)", code, re.MULTILINE))
    names |= set(
        re.findall(r"^[a-z][\w \t*]*?\b(\w+)(?:\[\d*\w*\])*\s*(?:\(|=|;)", code, re.MULTILINE)
    )
    names |= set(re.findall(r"^} (\w+);", code, re.MULTILINE))
    assert {"keep_step", "keep_state", "keep_parameters", "KEEP_SEEN"} <= names
    assert len(names) > 20
    assert not [n for n in names if not n.startswith(("keep_", "KEEP_"))]


@pytest.mark.heavy
def test_header_stands_in_the_file_of_c_word_for_word(laws):
    system, law = laws["dock"]
    header, text = hf.export_c_header(system, law, "dock"), hf.export_c(system, law, "dock")
    block = header[header.index("#ifndef DOCK_H") :]
    assert block in text
    assert "seen[2]: psi [rad]" in header
