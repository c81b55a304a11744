"""Every block of the documentation is executed; where that takes long, on fewer runs and nodes."""

import contextlib
import io
import json
import re
import shlex
import shutil
import subprocess
import sys
import time
import tomllib
from pathlib import Path

import pytest

import holdfast as hf
from holdfast.cli import main
from holdfast.kernel_scenario import KernelScenario
from tests.c_code import STRICT, needs_gcc

ROOT = Path(__file__).parent.parent
DOCS = sorted((ROOT / "docs").glob("*.md"))
PAGES = [ROOT / "README.md", *DOCS]


def blocks(page, *languages):
    text = page.read_text("utf-8")
    return [
        b for language, b in re.findall(r"```(\w*)\n(.*?)```", text, re.S) if language in languages
    ]


def test_blocks_are_of_the_languages_that_are_executed():
    known = ("", "python", "toml", "c", "matlab")
    assert {m for page in PAGES for m in re.findall(r"```(\w+)\n", page.read_text("utf-8"))} <= set(
        known
    )


def test_examples_in_the_documentation_run(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    hf.load_scenario("inspection", ["run.horizon=4"], runs=3).run().save("result.nc")
    for page in DOCS:
        scope = {}
        for code in blocks(page, "python"):
            with contextlib.redirect_stdout(io.StringIO()):
                exec(code, scope)


def test_scenario_files_in_the_documentation_load(tmp_path):
    """Those with a name are run by the commands of their page."""
    for page in DOCS:
        for number, text in enumerate(blocks(page, "toml")):
            if "[scenario]" in text:
                path = tmp_path / (named(text) or f"{page.stem}{number}.toml")
                path.write_text(text)
                shorter = ["run.horizon=1"] if "[run]" in text else []
                loaded = hf.load_scenario(str(path), shorter)
                if not named(text):
                    loaded.run()
            else:
                tomllib.loads(text)


def named(text):
    """The file that a block says it is, so that others may refer to it."""
    found = re.match(r"# (\S+\.toml)\n", text)
    return found and found[1]


# -- what is typed in a shell

FEWER = {
    "run": "--runs 2 --set run.horizon=2",
    "run of one start": "--set run.horizon=2",
    "run ch6-polygons": "--set run.horizon=2 --no-figures",
    "run of a kernel": "--set grid.nodes=31 --set promise.runs=10",
    "compare": "--runs 2 --set run.horizon=2",
    "compare ch5-rescue": "--runs 2 --set run.horizon=2 --laws convergent --cases '5 N'",
    "compare ch7-rescue": "--runs 2 --set run.horizon=2 --laws filter --cases '5 N' "
    "--set kernels.ch7-six-states.grid.nodes=9",
    "margin": "--set grid.nodes=11 --tolerance 0.2",
    "sweep": "--runs 2 --workers 1 --set run.horizon=2",
    "sweep of a kernel": "--set grid.nodes=11",
    "reproduce": "--quick",
}
NOT_HERE = ("python -m pip ", "python -m pytest", "python benchmarks/", "dask ")
"""Lines of a shell that the checks themselves run, or that have tests of their own below."""


def lines(page):
    """Every line that is typed, without its comment."""
    for block in blocks(page, ""):
        for line in block.replace("\\\n", " ").splitlines():
            line = re.sub(r"\s#.*", "", line).strip()
            yield from (part.strip() for part in line.split("&&"))


def typed(page):
    return [x for x in lines(page) if re.match(r"(holdfast|gcc|dask|python) ", x)]


def shorter(words):
    """The command with fewer cells, runs, nodes and seconds, the last of which counts."""
    name, *rest = words
    if name == "sweep":  # two values, or three of a sample
        rest = [re.sub(r"^(.+=[^,]+?:[^,]+?):\d+", r"\1:2", w) for w in rest]
        rest = ["3" if before == "--latin" else w for before, w in zip(words, rest, strict=False)]
    if name in ("run", "sweep"):
        loaded = hf.load_scenario(rest[0])
        if isinstance(loaded, KernelScenario):
            name += " of a kernel"
        elif loaded.runs == 1:
            name += " of one start"
    more = shlex.split(FEWER.get(" ".join(words[:2])) or FEWER.get(name, ""))
    chosen = [w for w in ("--laws", "--cases") if w in rest and w in more]
    for option in chosen:  # the page's own choice stays
        del more[more.index(option) : more.index(option) + 2]
    return [words[0], *rest, *more]


def called(words, output=None):
    """The exit status of the command line, in this process."""
    written = io.StringIO()
    with pytest.MonkeyPatch.context() as patch, contextlib.redirect_stdout(written):
        patch.setattr(sys, "argv", ["holdfast", *words])
        with pytest.raises(SystemExit) as left:
            main()
    if output:
        Path(output).write_text(written.getvalue())
    return left.value.code


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Where all pages are tried: what `reproduce` has run is not run again."""
    return tmp_path_factory.mktemp("pages")


TRIED: set[str] = set()
"""Lines that stand on several pages are run on the first of them."""


@pytest.mark.parametrize("page", PAGES, ids=lambda p: p.stem)
def test_commands_of_the_documentation_run(page, folder, monkeypatch):
    """In the order of the page, with the files that the page shows."""
    monkeypatch.chdir(folder)
    called(["show", "inspection"], "mine.toml")
    for text in blocks(page, "toml"):
        if named(text):
            Path(named(text)).write_text(text)
    for line in typed(page):
        begun = time.time()
        if line.startswith("gcc "):
            if shutil.which("gcc"):
                subprocess.run(shlex.split(line), check=True)
            continue
        if line.startswith(NOT_HERE) or "ADDRESS" in line:
            continue
        if line in TRIED:
            continue
        TRIED.add(line)
        command, _, output = line.partition(" > ")
        words = shlex.split(command)[1:]
        assert called(shorter(words), output.strip()) == 0, line
        print(f"{time.time() - begun:6.1f} s  {line}")


def test_shell_lines_are_of_commands_that_the_tests_know():
    """Of what is installed the extras exist: the checks themselves install them."""
    seen = [line for page in PAGES for line in typed(page)]
    assert sum(line.startswith("holdfast ") for line in seen) > 50
    extras = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"][
        "optional-dependencies"
    ]
    for line in seen:
        assert line.startswith(("holdfast ", "gcc ", *NOT_HERE))
        assert set(re.findall(r"\[(\w+)\]", line)) <= set(extras) or " pip " not in line
    for extra in ("cluster", "interop"):
        assert set(extras[extra]) <= set(extras["test"])


@pytest.mark.heavy
@pytest.mark.parametrize(
    "line", [x for page in PAGES for x in typed(page) if x.startswith("python benchmarks/")]
)
def test_benchmarks_of_the_documentation_run(line):
    for peer in ("jax", "diffrax", "hj_reachability"):
        pytest.importorskip(peer, reason="the peers are not installed")
    subprocess.run([sys.executable, *shlex.split(line)[1:]], cwd=ROOT, check=True)


def test_cluster_of_the_documentation_computes(tmp_path, monkeypatch):
    pytest.importorskip("distributed")
    monkeypatch.chdir(tmp_path)
    (page,) = (p for p in DOCS if p.stem == "campaigns")
    scheduler, worker, sweep = (
        shlex.split(line) for line in typed(page) if line.startswith("dask ") or "ADDRESS" in line
    )
    dask = Path(sys.executable).with_name("dask")
    here = ["--no-dashboard", "--host", "127.0.0.1"]
    with contextlib.ExitStack() as stack:

        def begun(words, *more):
            process = subprocess.Popen(
                [str(dask), *words[1:], *here, *more],
                stdout=subprocess.DEVNULL,
                stderr=subprocess.DEVNULL,
            )
            stack.callback(process.wait)
            stack.callback(process.terminate)

        begun(scheduler, "--port", "0", "--scheduler-file", "scheduler.json")
        address = found("scheduler.json")
        begun([w.replace("ADDRESS", address) for w in worker])
        assert called(shorter([w.replace("ADDRESS", address) for w in sweep[1:]])) == 0
    assert Path("runs/ch5-current/sweep.nc").exists()


def found(file, patience=60.0):
    """The address in a file that a scheduler writes when it has begun."""
    end = time.monotonic() + patience
    while time.monotonic() < end:
        with contextlib.suppress(OSError, ValueError):
            return json.loads(Path(file).read_text())["address"]
        time.sleep(0.1)
    raise AssertionError("the scheduler did not begin")


@needs_gcc
def test_block_of_c_compiles_and_runs(tmp_path):
    (page,) = (p for p in DOCS if p.stem == "embedded")
    (block,) = blocks(page, "c")
    assert "for (;;)" in block
    scenario = hf.load_scenario("ch5-viable-goal-set")
    text = hf.export_c(scenario.system, scenario.law, scenario.name)
    program = (
        f"{text}int main(void) {{\n    double t = 0.0, sample_time = 0.02;\n"
        f"    double seen[{len(scenario.system.states)}] = {{-1.0, 0.2}};\n"
        + block.replace("for (;;)", "for (int i = 0; i < 9; i++)").replace("int mode =", "(void)")
        + "    return !(actuators[0] != 0.0 && actuators[0] == actuators[0]);\n}\n"
    )
    (tmp_path / "main.c").write_text(program)
    subprocess.run(["gcc", *STRICT, "main.c", "-o", "main", "-lm"], cwd=tmp_path, check=True)
    subprocess.run([tmp_path / "main"], check=True)


def test_block_of_matlab_runs_in_octave(tmp_path):
    """Where Octave and its package netcdf are, which have the functions of MATLAB that are used."""
    octave = shutil.which("octave-cli")
    if octave is None or subprocess.run([octave, "--eval", "pkg load netcdf"]).returncode:
        pytest.skip("there is no GNU Octave with its package netcdf")
    (page,) = (p for p in DOCS if blocks(p, "matlab"))
    (block,) = blocks(page, "matlab")
    hf.load_scenario("inspection", ["run.horizon=4"], runs=3).run().save(
        str(tmp_path / "result.nc")
    )
    (tmp_path / "plot.m").write_text("function plot(varargin)\nend\n")  # there may be no display
    before = "pkg load netcdf\n"
    after = "\nassert(size(state), [rows(names), numel(time), 3])\n"
    (tmp_path / "recipe.m").write_text(before + block + after)
    subprocess.run([octave, "recipe.m"], cwd=tmp_path, check=True)
