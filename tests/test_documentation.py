"""Every block of the documentation is executed; where that takes long, on fewer runs and nodes."""

import contextlib
import io
import json
import math
import os
import re
import shlex
import shutil
import subprocess
import sys
import time
import tomllib
from pathlib import Path

import click
import numpy as np
import pytest

import holdfast as hf
from holdfast.analysis.reachability.solve import set_on_grid
from holdfast.commands.main import cli, main
from holdfast.interop.logs.read import write_log
from holdfast.presentation.text.runs import summary_text
from holdfast.presentation.text.values import value_text
from holdfast.scenario.kinds.kernel import KernelScenario
from tests.boats import vehicle_log
from tests.c_code import STRICT, needs_gcc
from tests.command_line import PD
from tests.decisions import START, sample

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


NUMBER = re.compile(r"(?<![\w.])[-+]?\d+(?:\.\d+)?(?:e[-+]?\d+)?(?![\w/])")


def examples(page):
    """Every block of Python, and what its page says that it prints.

    That is a block without a language behind it, a paragraph behind it that begins with "prints",
    or the comment of a line `print(...)`. What follows a semicolon in a comment, or is in
    parentheses in a paragraph, explains.
    """
    found = re.findall(
        r"```python\n(.*?)```\n+(?:```\n(.*?)```|prints (.*?)(?:\n\n|\Z))?",
        page.read_text("utf-8"),
        re.S,
    )
    for code, output, paragraph in found:
        if code.startswith("--8<--"):  # a program of a file, which has tests of its own
            continue
        remarks = re.findall(r"^print\(.*\)\s+# ([^;\n]*)", code, re.M)
        yield code, output, " ".join([re.sub(r"\([^)]*\)", "", paragraph), *remarks])


def rounded(said, printed):
    """Whether a number that is said is the printed one to its own digits, up or down as a bound is."""
    return abs(float(said) - float(printed)) < 0.999 * 10.0 ** -len(said.partition(".")[2])


def missing(said, printed):
    """The first number of one text that the other has not, in the same order."""
    left = iter(NUMBER.findall(printed))
    for number in NUMBER.findall(said):
        if not any(rounded(number, other) for other in left):
            return number
    return None


SAID = {"certificates": 5, "craft": 2, "formations": 9, "own_controller": 11, "station_keeping": 4}
"""Numbers that pages say their examples print; another page with some is to be entered here."""


@pytest.mark.slow(
    "autopilots",
    "campaigns",
    "certificates",
    "decomposition",
    "identify",
    "interop",
    "kernels",
    "own_controller",
    "results",
    "ros2",
    "two_vehicles",
)
@pytest.mark.parametrize("page", DOCS, ids=lambda p: p.stem)
def test_examples_in_the_documentation_run_and_print_what_is_said(page, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    if 'load("result.nc")' in page.read_text("utf-8"):
        hf.load_scenario("inspection", ["run.horizon=4"], runs=3).run().save("result.nc")
    write_named(page)
    scope, count = {}, 0
    for code, output, remarks in examples(page):
        if code.startswith("# pd.py\n"):  # a program, which the commands of the page start
            assert code.split("\n", 1)[1].split() == PD.split()
            continue
        written = io.StringIO()
        with contextlib.redirect_stdout(written):
            exec(code, scope)
        printed = written.getvalue()
        if output:
            assert output.split() == printed.split()
        assert missing(remarks, printed) is None, printed
        count += len(NUMBER.findall(output + remarks))
    assert count == SAID.get(page.stem, 0)


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


def write_named(page):
    """The files that a page shows."""
    for text in blocks(page, "toml"):
        if named(text):
            Path(named(text)).write_text(text)


def named(text):
    """The file that a block says it is, so that others may refer to it."""
    found = re.match(r"# (\S+\.toml)\n", text)
    return found and found[1]


# -- what is typed in a shell

FEWER = {
    "identify": "--no-figures",
    "identify dive.csv": "--no-figures --runs 3 --set run.horizon=4",
    "run": "--runs 2 --set run.horizon=2",
    "run of one start": "--set run.horizon=2",
    "run of a kernel": "--set promise.runs=10",
    "compare": "--runs 2 --set run.horizon=2",
    "compare inspection": "--runs 2 --set run.horizon=2 --cases '5 N'",
    "compare ch5-rescue": "--runs 2 --set run.horizon=2 --laws convergent --cases '5 N'",
    "compare ch7-rescue": "--runs 2 --set run.horizon=2 --laws filter --cases '5 N' "
    "--set kernels.ch7-six-states.grid.nodes=9",
    "margin": "--set grid.nodes=11 --tolerance 0.2",
    "sweep": "--runs 2 --workers 1 --set run.horizon=2",
    "sweep of a kernel": "--set grid.nodes=11",
    "reproduce": "--quick --no-explorers",  # pages to drag have tests of their own
}
DRAWN = "inspection"
"""The scenario whose figures are drawn here: other tests draw those of every kind."""
NOT_HERE = ("python -m pip ", "python -m pytest", "python benchmarks/", "python examples/", "dask ")
"""Lines of a shell that the checks themselves run, or that have tests of their own below."""

ELSEWHERE = ("--device gpu", "--on-disk /scratch")
"""How lines end that need a graphics processor, or a disk for an hour."""


def lines(page):
    """Every line that is typed, without its comment."""
    for block in blocks(page, ""):
        for line in block.replace("\\\n", " ").splitlines():
            line = re.sub(r"\s#.*", "", line).strip()
            yield from (part.strip() for part in line.split("&&"))


def typed(page):
    return [x for x in lines(page) if re.match(r"(holdfast|gcc|dask|python) ", x)]


def few_nodes(kernel):
    """Along every axis, so that a grid of any number of states has some 30,000 nodes or fewer."""
    return min(31, max(6, int(30_000.5 ** (1 / len(kernel.grid.axes)))))


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
    if name == "margin" and not isinstance(hf.load_scenario(rest[0]), KernelScenario):
        name += " of closed loops"
    exact = FEWER.get(" ".join(words[:2])) if name != "margin of closed loops" else None
    more = shlex.split(exact or FEWER.get(name, ""))
    if name == "run of a kernel":
        more += ["--set", f"grid.nodes={few_nodes(loaded)}"]
    if words[0] in ("run", "compare", "margin", "sweep") and DRAWN not in rest:
        more.append("--no-figures")
    chosen = [w for w in ("--laws", "--cases") if w in rest and w in more]
    for option in chosen:  # the page's own choice stays
        del more[more.index(option) : more.index(option) + 2]
    return [words[0], *rest, *more]


def called(words, output=None):
    """The exit status of the command line, in this process."""
    written, told = io.StringIO(), os.devnull
    if "<" in words:
        words, told = words[: words.index("<")], words[words.index("<") + 1]
    with (
        pytest.MonkeyPatch.context() as patch,
        contextlib.redirect_stdout(written),
        open(told) as read,
    ):
        patch.setattr(sys, "argv", ["holdfast", *words])
        patch.setattr(sys, "stdin", read)
        with pytest.raises(SystemExit) as left:
            main()
    if output:
        Path(output).write_text(written.getvalue())
    return left.value.code


def write_logs():
    """The logs that the page of identification names."""
    for vehicle, names in (
        ("otter", ("trial", "second")),
        ("videoray_pro_iii", ("dive", "second_dive")),
    ):
        system = hf.load_vehicle(vehicle)
        for seed, name in enumerate(names):
            write_log(vehicle_log(system, seconds=40.0, seed=seed), f"{name}.csv")


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Where all pages are tried: what `reproduce` has run is not run again."""
    return tmp_path_factory.mktemp("pages")


TRIED: set[str] = set()
"""Lines that stand on several pages are run on the first of them."""


WITH_COMMANDS = [p for p in PAGES if any(line.startswith("holdfast ") for line in typed(p))]


@pytest.mark.parametrize("page", WITH_COMMANDS, ids=lambda p: p.stem)
def test_commands_of_the_documentation_are_read(page, tmp_path, monkeypatch):
    """Their options are those of the command, and their scenarios take the values that are set."""
    monkeypatch.chdir(tmp_path)
    write_named(page)
    for line in typed(page):
        if line.startswith("holdfast "):
            words = shlex.split(re.split(" [<>] ", line)[0])[1:]
            name, command, rest = cli.resolve_command(click.Context(cli), words)
            asked = command.make_context(name, list(rest)).params
            if asked.get("overrides") and "scenario" in asked and Path(words[1]).suffix != ".toml":
                hf.load_scenario(asked["scenario"], asked["overrides"])


LONG = {
    "campaigns", "certificates", "commands", "currents", "explore", "formations", "gains", "identify",
    "kernels", "reproduce", "rescue", "tutorial",
}  # fmt: skip
"""Pages whose commands take long, with few runs and nodes too."""


@pytest.mark.few("gpu", "large_kernels")
@pytest.mark.parametrize(
    "page",
    [
        pytest.param(p, marks=[pytest.mark.heavy] * (p.stem in LONG), id=p.stem)
        for p in WITH_COMMANDS
    ],
)
def test_commands_of_the_documentation_run(page, folder, monkeypatch):
    """In the order of the page, with the files that the page shows."""
    monkeypatch.chdir(folder)
    called(["show", "inspection"], "mine.toml")
    Path("pd.py").write_text(PD)
    Path("samples.jsonl").write_text(sample(START) * 3)
    if page.stem == "identify":
        write_logs()
    write_named(page)
    for line in typed(page):
        begun = time.time()
        if line.startswith("gcc "):
            if shutil.which("gcc"):
                subprocess.run(shlex.split(line), check=True)
            continue
        if line.startswith(NOT_HERE) or "ADDRESS" in line or line.endswith(ELSEWHERE):
            continue
        if line in TRIED:
            continue
        TRIED.add(line)
        command, _, output = line.partition(" > ")
        words = shlex.split(command)[1:]
        assert called(shorter(words), output.strip()) == 0, line
        print(f"{time.time() - begun:6.1f} s  {line}")


@pytest.fixture(scope="module")
def ferry(tmp_path_factory):
    """The three files of the tutorial, run: what each found."""
    (page,) = (p for p in DOCS if p.stem == "tutorial")
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(tmp_path_factory.mktemp("ferry"))
        for text in blocks(page, "toml"):
            if named(text):
                Path(named(text)).write_text(text)
        names = ("ferry", "ferry-kernel", "ferry-safe")
        loaded = {name: hf.load_scenario(f"{name}.toml") for name in names}
        yield {name: (scenario, scenario.run()) for name, scenario in loaded.items()}


def printed(scenario, result):
    """What `holdfast run` says of it, but for the files that it writes."""
    if not isinstance(scenario, KernelScenario):
        return summary_text(result)
    region = set_on_grid(scenario.about, scenario.grid)
    return value_text(result.value, result.promise, region)


@pytest.mark.heavy
@pytest.mark.parametrize("name", ["ferry", "ferry-kernel", "ferry-safe"])
def test_tutorial_shows_what_its_scenarios_print(ferry, name):
    """Every line but the times they took; so its counts of runs and samples are those of today."""
    (page,) = (p for p in DOCS if p.stem == "tutorial")
    said = printed(*ferry[name])
    shown = [b for b in blocks(page, "") if b.startswith(said.splitlines()[0])]
    assert len(shown) == 1
    steady = re.compile(r", [\d.]+ m?s$", re.M)
    assert steady.sub("", said).startswith(steady.sub("", shown[0].rstrip()))


@pytest.mark.heavy
def test_tutorial_counts_the_ferries_that_its_kernel_can_save(ferry):
    """254 of 300 start inside: five lost by the law alone, none when kept; of 46 outside 29 are.

    The law alone loses 49, 44 of them from outside.
    """
    alone, safe = (ferry[n][1].dataset for n in ("ferry", "ferry-safe"))
    starts = alone["state"].values[:, 0]
    assert np.array_equal(starts, safe["state"].values[:, 0])
    assert len(starts) == 300
    assert np.abs(starts[:, 1]).max() <= math.radians(90)
    inside = ferry["ferry-kernel"][1].value.at(starts) > 0
    alone, kept = (d["outcome"].values == hf.Outcome.LEFT for d in (alone, safe))
    assert (inside.sum(), (~inside).sum(), alone.sum()) == (254, 46, 49)
    assert ((alone & inside).sum(), (kept & inside).sum(), (kept & ~inside).sum()) == (5, 0, 29)


@pytest.mark.heavy
def test_ferry_that_heads_for_a_bank_needs_the_room_that_the_tutorial_states(ferry):
    """2.1 m, for a circle of 0.4 m/s / 0.3 rad/s = 1.3 m and the water."""
    across = np.linspace(0, 3, 3001)
    states = np.stack([across, np.full_like(across, np.pi / 2)], axis=1)
    kept = ferry["ferry-kernel"][1].value.at(states) > 0
    assert 3 - across[kept].max() == pytest.approx(2.1, abs=0.05)
    assert pytest.approx(1.3, abs=0.05) == 0.4 / 0.3


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


@pytest.mark.heavy
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
    (block,) = blocks(ROOT / "docs/results.md", "matlab")
    hf.load_scenario("inspection", ["run.horizon=4"], runs=3).run().save(
        str(tmp_path / "result.nc")
    )
    (tmp_path / "plot.m").write_text("function plot(varargin)\nend\n")  # there may be no display
    before = "pkg load netcdf\n"
    after = "\nassert(size(state), [rows(names), numel(time), 3])\n"
    (tmp_path / "recipe.m").write_text(before + block + after)
    subprocess.run([octave, "recipe.m"], cwd=tmp_path, check=True)
