"""The table of an exported law in a file: the bits of one in the source, and what is refused."""

import ctypes
import os
import subprocess

import numpy as np
import pytest

import holdfast as hf
from holdfast.errors import DefinitionError
from holdfast.execution.codegen import c_source
from tests.c_code import STRICT, needs_gcc, pointer
from tests.carts import BOX, WALLS, cart, swinging

pytestmark = needs_gcc

HARNESS = """
void many(long n, const double *t, const double *seen, double *out) {
    NAME_state s;
    for (long i = 0; i < n; i++) {
        double actuators[UPPER_ACTUATORS];
        NAME_start(&s);
        NAME_step(&s, t[i], 0.02, seen + 2 * i, NAME_parameters, out + 2 * i, actuators);
        out[2 * i + 1] = s.outside;
    }
}
int load(const char *path) { return NAME_load(path); }
int use(const void *memory, size_t size) { return NAME_use(memory, size); }
"""
READY, NOT_FOUND, TRUNCATED, NONE, VERSION, BYTE_ORDER, OTHER, DAMAGED, ALIGNMENT = range(9)


def law_of(precision, nodes=41):
    system = cart()
    grid = hf.grid(system, BOX, nodes)
    value = hf.discriminating_kernel(
        system, WALLS, grid, 0.3, scheme="upwind", precision=precision, times=[0, 0.15, 0.3]
    )
    return hf.safety_law(system, value, swinging(), margin=0.05)


def compiled(folder, law, name, table, *flags):
    """The law and the harness as a library."""
    text = hf.export_c(cart(), law, name, table=table)
    harness = HARNESS if table == "file" else HARNESS.partition("int load")[0]
    source = folder / f"{name}_{table}.c"
    source.write_text(text + harness.replace("NAME", name).replace("UPPER", name.upper()))
    library = source.with_suffix(f".{len(flags)}.so")
    command = ["gcc", *STRICT, *flags, "-shared", "-fPIC", str(source), "-o", str(library), "-lm"]
    done = subprocess.run(command, capture_output=True, text=True, cwd=folder)
    assert done.returncode == 0, done.stderr
    return ctypes.CDLL(str(library))


def answers(library):
    rng = np.random.default_rng(1)
    seen, times = rng.uniform(-1.6, 1.6, (2000, 2)), rng.uniform(0, 0.4, 2000)
    out = np.zeros((2000, 2))
    library.many(ctypes.c_long(2000), pointer(times), pointer(seen), pointer(out))
    return out


@pytest.fixture(scope="module", params=["float32", "float64"])
def exported(request, tmp_path_factory):
    folder = tmp_path_factory.mktemp("table")
    law = law_of(request.param)
    hf.export_c_table(law, folder / "keep.bin")
    return folder, law, compiled(folder, law, "keep", "file")


@pytest.mark.few("float64")
def test_a_loaded_table_gives_the_bits_of_one_in_the_source(exported):
    folder, law, library = exported
    assert library.load(str(folder / "keep.bin").encode()) == READY
    expected = answers(compiled(folder, law, "keep", "text"))
    assert np.isfinite(expected).all()
    assert answers(library).tobytes() == expected.tobytes()


@pytest.mark.few("float64")
def test_a_linked_table_gives_the_same_bits_without_a_file(exported):
    folder, law, library = exported
    linked = compiled(folder, law, "keep", "file", '-DKEEP_LINKED="keep.bin"')
    assert linked.load(None) == READY
    assert library.load(str(folder / "keep.bin").encode()) == READY
    assert answers(linked).tobytes() == answers(library).tobytes()


def test_a_table_is_read_without_a_memory_map_too(exported):
    folder, law, library = exported
    plain = compiled(folder, law, "keep", "file", "-U__unix__", "-U__APPLE__")
    assert plain.load(b"nowhere.bin") == NOT_FOUND
    assert plain.load(str(folder / "keep.bin").encode()) == READY
    assert library.load(str(folder / "keep.bin").encode()) == READY
    assert answers(plain).tobytes() == answers(library).tobytes()


def test_before_a_table_is_loaded_the_answer_is_not_a_number(exported):
    folder, law, _ = exported
    fresh = compiled(folder, law, "fresh", "file")
    out = answers(fresh)
    assert np.isnan(out[:, 0]).all()
    assert (out[:, 1] == 1).all()


def test_what_is_not_the_table_is_refused_and_says_why(exported):
    folder, law, library = exported
    good = (folder / "keep.bin").read_bytes()
    header = len(good) - 3 * 41 * 41 * law.lookup.table[0].itemsize
    other = folder / "other.bin"
    hf.export_c_table(law_of(law.lookup.table[0].dtype.name, 31), other)

    def changed(at, value):
        return good[:at] + bytes([value]) + good[at + 1 :]

    cases = {
        b"": TRUNCATED,
        good[:20]: TRUNCATED,
        good[:-1]: TRUNCATED,
        good + b"\0": TRUNCATED,
        changed(0, 0): NONE,
        changed(8, 2): VERSION,
        changed(12, 16): OTHER,
        changed(40, good[40] ^ 1): OTHER,
        other.read_bytes(): OTHER,
        changed(header, good[header] ^ 1): DAMAGED,
        changed(len(good) - 1, good[-1] ^ 0x80): DAMAGED,
    }
    for number, (data, fault) in enumerate(cases.items()):
        path = folder / f"bad{number}.bin"
        path.write_bytes(data)
        assert library.load(str(path).encode()) == fault, number
        assert np.isnan(answers(library)[:, 0]).all()
    os.mkfifo(folder / "pipe")
    for odd in (folder, folder / "pipe", "/dev/null"):
        assert library.load(str(odd).encode()) == NONE
    (folder / "pipe").unlink()
    assert library.load(str(folder / "nowhere").encode()) == NOT_FOUND
    memory = ctypes.create_string_buffer(bytes(8) + good, len(good) + 8)
    begin = ctypes.addressof(memory)
    assert library.use(ctypes.c_void_p(begin + 8), ctypes.c_size_t(len(good))) == READY
    memory = ctypes.create_string_buffer(bytes(1) + good, len(good) + 1)
    begin = ctypes.addressof(memory)
    assert library.use(ctypes.c_void_p(begin + 1), ctypes.c_size_t(len(good))) == ALIGNMENT
    assert np.isnan(answers(library)[:, 0]).all()


@pytest.mark.few("float32")
def test_a_program_under_sanitizers_finds_no_fault(exported):
    folder, law, _ = exported
    good = (folder / "keep.bin").read_bytes()
    (folder / "short.bin").write_bytes(good[:-8])
    (folder / "empty.bin").write_bytes(b"")
    main = """
int main(void) {
    keep_state s;
    double seen[2] = {0.1, 0.2}, command[KEEP_INPUTS], actuators[KEEP_ACTUATORS];
    if (keep_load("empty.bin") != KEEP_TABLE_TRUNCATED) return 1;
    if (keep_load("short.bin") != KEEP_TABLE_TRUNCATED) return 2;
    if (keep_load("keep.bin") != KEEP_TABLE_READY) return 3;
    keep_start(&s);
    for (int i = -40; i <= 40; i++) {
        seen[0] = 0.05 * i;
        keep_step(&s, 0.1 * i, 0.02, seen, keep_parameters, command, actuators);
    }
    keep_unload();
    keep_step(&s, 0.0, 0.02, seen, keep_parameters, command, actuators);
    return command[0] == command[0] ? 4 : 0;
}
"""
    (folder / "sound.c").write_text(hf.export_c(cart(), law, "keep", table="file") + main)
    sanitizers = ["-fsanitize=address,undefined", "-fno-sanitize-recover=all", "-g", "-O1"]
    command = ["gcc", *STRICT, *sanitizers, "sound.c", "-o", "sound", "-lm"]
    done = subprocess.run(command, capture_output=True, text=True, cwd=folder)
    assert done.returncode == 0, done.stderr
    done = subprocess.run(["./sound"], capture_output=True, text=True, cwd=folder)
    assert done.returncode == 0, done.stderr


def test_the_header_serves_c_and_c_plus_plus(exported):
    folder, law, _ = exported
    (folder / "keep.h").write_text(hf.export_c_header(cart(), law, "keep", table="file"))
    (folder / "keep_alone.c").write_text(
        '#include "keep.h"\n' + hf.export_c(cart(), law, "keep", table="file")
    )
    (folder / "user.cpp").write_text(
        '#include "keep.h"\nint main() { return keep_load("keep.bin"); }\n'
    )
    for command in (
        ["gcc", *STRICT, "-c", "keep_alone.c", "-o", "keep.o"],
        ["g++", "-Wall", "-Wextra", "-Werror", "-pedantic", "user.cpp", "keep.o", "-o", "user"],
    ):
        done = subprocess.run(command, capture_output=True, text=True, cwd=folder)
        assert done.returncode == 0, done.stderr
    assert subprocess.run(["./user"], cwd=folder).returncode == READY


def test_the_numbers_are_in_the_file_and_not_in_the_source(exported):
    _, law, _ = exported
    texts = [len(hf.export_c(cart(), law, "keep", table=where)) for where in ("text", "file")]
    assert texts[1] < 45_000 < texts[0]


def test_a_table_of_more_numbers_than_a_long_may_count_says_so_to_the_compiler():
    assert c_source._fits(2**31 - 1) == ""
    guard = c_source._fits(2**31)
    for most, accepted in ((2**63 - 1, True), (2**31 - 1, False)):
        source = f"{guard.replace('LONG_MAX', str(most))}\nint x;\n"
        command = ["gcc", "-std=c99", "-fsyntax-only", "-xc", "-"]
        done = subprocess.run(command, input=source, capture_output=True, text=True)
        assert (done.returncode == 0) is accepted


def test_a_law_without_a_kernel_has_no_table_file(tmp_path):
    with pytest.raises(DefinitionError, match="has no kernel"):
        hf.export_c_table(swinging(), tmp_path / "none.bin")
    with pytest.raises(DefinitionError, match="has no table"):
        hf.export_c(cart(), swinging(), table="file")
    with pytest.raises(DefinitionError, match='expected "text" or "file"'):
        hf.export_c(cart(), swinging(), table="disk")
