"""One of each is added in a copy of the package, in the files that docs/extending.md names, and used."""

import json
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from holdfast.execution.device.program import COMPILERS

ROOT = Path(__file__).parent.parent
PAGE = (ROOT / "docs" / "extending.md").read_text("utf-8")

SCHEME = '''"""Central slopes, as upwind ones of first order with a wider reach would be: a scheme of a test."""

from holdfast.execution.level_set.schemes import Scheme


def slopes(a, b, c):
    """First differences at both ends of an interval."""
    return b, b


SCHEME = Scheme("plain", ghosts=2, order=1, slopes=slopes)
'''

GUSTS = '''class gusts(Process):
    """A Gauss-Markov process with the deviation s and the correlation time T [s]."""

    nargs = 2

    def following(self, value, h, normal):
        s, T = self.args
        stays = sp.exp(-h / T)
        return stays * value + s * sp.sqrt(1 - stays**2) * normal


@checked
def wiener_process'''

KIND = '''"""A kind of scenario that counts the starts of a list: its tables, its answer, its files."""

from dataclasses import dataclass

from pydantic import BaseModel

from holdfast.analysis.simulation.law_comparison import Entry
from holdfast.host.files import make_folder, write_summary
from holdfast.scenario.kinds.base import Composed, Kind
from holdfast.scenario.schema.values import validated


class Tables(BaseModel):
    scenario: dict
    count: dict[str, float]


@dataclass(frozen=True)
class Answer:
    total: float

    def summary(self):
        return {"total": self.total}


@dataclass(frozen=True)
class Counted(Composed):
    name: str
    file: str
    text: str
    title: str
    kind: str
    numbers: dict

    def run(self, progress=None):
        return Answer(sum(self.numbers.values()))

    def write(self, answer, folder, *, figures=True, bar=None):
        make_folder(folder)
        files = [write_summary(folder / "summary.json", answer.summary())]
        if figures:
            from holdfast.presentation.figures import style
            from holdfast.presentation.figures.bars import bars_figure

            files += style.write(bars_figure(self.numbers), folder, "bars")
        return files

    def report(self, answer, files):
        return f"total {answer.total:g}"

    def complaints(self, answer):
        return [] if answer.total > 0 else ["the total is not above 0"]

    def tally(self, part, threads):
        return {"total": Entry("most", self.run().total, 0.0, "1", "sum of the numbers")}

    @property
    def given(self):
        return {}


def compose(file, text, data, runs, seed):
    spec = validated(Tables, data, file)
    return Counted("counted", file, text, spec.scenario["title"], "count", spec.count)


KINDS = (Kind("count", compose),)
'''

FIGURE = '''"""Bars of named numbers."""

import matplotlib.pyplot as plt


def bars_figure(numbers):
    """One bar for each number."""
    figure, axis = plt.subplots()
    axis.bar(list(numbers), list(numbers.values()))
    return figure
'''

COMMAND = '''"""`holdfast count-words`: the words of a text."""

import click


@click.command("count-words")
@click.argument("text")
def command(text):
    """Count the words of TEXT."""
    click.echo(f"{len(text.split())} words")
'''

SET = '''"""An ellipse: bounded speeds along two axes that are not free of each other."""

from dataclasses import dataclass

import sympy as sp

from holdfast.maths.definitions.sets.base import Bounds
from holdfast.maths.expressions.functions import least


@dataclass(frozen=True)
class Ellipse(Bounds):
    """sum_i (u_i / a_i)^2 <= 1"""

    axes: tuple

    @property
    def dimension(self):
        return len(self.axes)

    @property
    def free_symbols(self):
        return set().union(*(sp.sympify(a).free_symbols for a in self.axes))

    def at(self, parameters):
        return Ellipse(tuple(sp.sympify(a).subs(parameters) for a in self.axes))

    def contains(self, values, slack=1e-9):
        return sum((v / float(a)) ** 2 for v, a in zip(values, self.axes)) <= 1 + slack

    def saturate(self, values):
        size = sp.sqrt(sum((v / a) ** 2 for v, a in zip(values, self.axes)))
        share = least(1, 1 / (size + sp.Float(1e-300)))
        return tuple(share * v for v in values)

    def support(self, weights, sign):
        size = sp.sqrt(sum((w * a) ** 2 for w, a in zip(weights, self.axes)))
        best = [sign * w * a**2 / (size + sp.Float(1e-300)) for w, a in zip(weights, self.axes)]
        return sign * size, best
'''

VEHICLE = """
title = "a delivery van"
system = "car"
[parameters]
wheelbase = { value = 3.2, unit = "m", source = "data sheet" }
"""

REGION = '''"""Gently: the speed and the acceleration are bounded."""

from holdfast.arguments import checked
from holdfast.maths.definitions.quantity import Parameter, Quantity, symbol
from holdfast.maths.definitions.region import Inequality, Region


@checked
def gentle(acceleration_limit: float = 0.5) -> Region:
    """|u| <= 1 m/s, |tau_u| / m <= acceleration_limit, of 5.4 kg."""
    speed, force, most = (symbol(n) for n in ("u", "tau_u", "acceleration_limit"))
    return Region(
        name="gentle",
        reads=(Quantity("u", "m/s"), Quantity("tau_u", "N")),
        inequalities=(
            Inequality("fast", abs(speed) - 1, "m/s"),
            Inequality("acceleration", abs(force) / 5.4 - most, "m/s^2"),
        ),
        parameters=(Parameter("acceleration_limit", "m/s^2", "most", value=acceleration_limit),),
        description="a gentle ride",
        source="test",
    )
'''

SYSTEM = '''"""A drifter that only its own speed moves."""

from holdfast.arguments import checked
from holdfast.maths.definitions.quantity import Quantity, symbol
from holdfast.maths.definitions.bounds import Box
from holdfast.maths.definitions.system import System


@checked
def drifter() -> System:
    """xdot = u, |u| <= 2 m/s."""
    return System(
        name="drifter",
        states=(Quantity("x", "m"),),
        inputs=(Quantity("u", "m/s"),),
        rates={"x": symbol("u")},
        input_bounds=Box((-2,), (2,)),
        description="a drifter",
        source="test",
    )
'''

ACTUATOR = '''"""A tunnel thruster: a force across the hull that a fast hull takes away."""

import math

import sympy as sp

from holdfast.maths.definitions.actuator import Actuator, ActuatorKind
from holdfast.maths.definitions.bounds import Box
from holdfast.maths.definitions.quantity import Quantity, symbol


def tunnel(name, x, limit, fades):
    """A force to port at x, of which 1 / (1 + (u / fades)^2) remains at the surge u."""
    share = 1 / (1 + (symbol("u") / fades) ** 2)
    inputs = (Quantity(name, "N", f"force of {name} at rest"),)
    return Actuator(inputs, ((sp.S.Zero, share, x * share),), Box((-limit,), (limit,)))


TUNNEL = ActuatorKind(
    "tunnel",
    {
        "x": ("m", "place ahead of the origin", -math.inf),
        "limit": ("N", "largest force at rest", 0.0),
        "fades": ("m/s", "speed at which half of it is left", 0.0),
    },
    optional=(),
    fixed=("x",),
    build=tunnel,
)
'''

ENCLOSURE = '''"""A box of the differences alone, which turning widens: the shortest enclosure that there is."""

from dataclasses import dataclass

from holdfast.execution.intervals.enclosures.base import Enclosure, times


@dataclass(frozen=True)
class PlainBox(Enclosure):
    rest: list

    @staticmethod
    def sizes(states):
        return 1, 0

    @classmethod
    def begun(cls, steps, box, center):
        return cls(box, center, [q - c for q, c in zip(box, center)])

    @classmethod
    def of(cls, steps, box, nominal, rows):
        return cls(box, nominal, rows[0])

    def rows(self):
        return [self.rest], []

    def spread(self, steps):
        return self.rest

    def hull(self, steps):
        return [c + q for c, q in zip(self.nominal, self.rest)]

    def after(self, motion):
        rest = times(motion.carries, self.rest, motion.steps)
        for more in motion.added:
            rest = [q + r for q, r in zip(rest, more)]
        return PlainBox(self.box, motion.nominal, rest)


ENCLOSURE = PlainBox
'''

BOAT = """
[tunnels.bow]
x = { value = 0.8, unit = "m", source = "drawing" }
limit = { value = 40, unit = "N", source = "drawing" }
fades = { value = 1.5, unit = "m/s", source = "sea trial" }
"""

EXPERIMENT = """
[scenario]
title = "a drifter comes home"
kind = "closed-loop"
[system]
name = "drifter"
[law]
name = "back"
empirical = "numbers"
outputs = { u = "-x" }
[starts]
random = 5
box = { x = [-1, 1] }
[region]
name = "road"
constraints = { wall = "x - 3" }
[goal]
name = "home"
constraints = { near = "abs(x) - 0.05" }
[run]
horizon = 8
"""

ADDED = {
    "system, law, region, field": {
        "maths/catalogue/systems/drifter.py": SYSTEM,
        "maths/catalogue/systems/__init__.py": (
            "from holdfast.maths.catalogue.systems.marine_vehicle import marine_vehicle\n",
            "from holdfast.maths.catalogue.systems.drifter import drifter\n"
            "from holdfast.maths.catalogue.systems.marine_vehicle import marine_vehicle\n",
        ),
    },
    "an actuator of a craft": {
        "maths/catalogue/actuators/tunnel.py": ACTUATOR,
        "maths/catalogue/actuators/__init__.py": (
            "import THRUSTER\n\nALL = (",
            "import THRUSTER\nfrom holdfast.maths.catalogue.actuators.tunnel import TUNNEL\n\n"
            "ALL = (TUNNEL, ",
        ),
    },
    "an enclosure of certificates": {"execution/intervals/enclosures/plain_box.py": ENCLOSURE},
    "an experiment": {"scenarios/drift.toml": EXPERIMENT},
    "a scheme of kernels": {
        "execution/level_set/schemes/plain.py": SCHEME,
    },
    "an option of a march": {
        "analysis/reachability/problem.py": (
            "    cluster: Any = None\n",
            "    cluster: Any = None\n    patience: Seconds = 1.0\n",
            "    cluster: Any\n",
            "    cluster: Any\n    patience: Seconds\n",
        ),
    },
    "a kind of scenario": {
        "scenario/kinds/count.py": KIND,
        "presentation/figures/bars.py": FIGURE,
    },
    "a set of bounds": {"maths/definitions/sets/ellipse.py": SET},
    "a vehicle, of any system": {"vehicles/van.toml": VEHICLE},
    "an outcome of a run": {
        "execution/simulation/settings.py": (
            '    OFF_GRID = 5, "left grid"\n',
            '    OFF_GRID = 5, "left grid"\n    HASTY = 6, "was hasty"\n',
        ),
        "execution/simulation/loop.py": (
            "        if w[at.outcome + lane] == Outcome.DIVERGED:\n",
            "        if w[at.peaks + lane] > 50.0:\n"
            "            w[at.outcome + lane] = Outcome.HASTY\n"
            "        if w[at.outcome + lane] == Outcome.DIVERGED:\n",
        ),
    },
    "a stochastic disturbance": {
        "maths/expressions/functions.py": ("@checked\ndef wiener_process", GUSTS),
    },
    "a command": {"commands/count_words.py": COMMAND},
    "a figure": {"presentation/figures/bars.py": FIGURE, "scenario/kinds/count.py": KIND},
    "a constraint on an input": {
        "maths/catalogue/regions/gentle.py": REGION,
        "maths/catalogue/regions/__init__.py": (
            "from holdfast.maths.catalogue.regions.inspection_goal import inspection_goal\n",
            "from holdfast.maths.catalogue.regions.gentle import gentle\n"
            "from holdfast.maths.catalogue.regions.inspection_goal import inspection_goal\n",
        ),
    },
}
"""Row of the page -> the files that are new or changed."""

USED = """
import json, sys
from pathlib import Path
import numpy as np
import holdfast as hf
from holdfast.maths.definitions.sets.ellipse import Ellipse

assert Path(hf.__file__).is_relative_to(Path.cwd()), hf.__file__
x, y, u, w = (hf.symbol(n) for n in "xyuw")
said = {}

# the scheme, beside the one that it equals, and the set of bounds, beside a ball and a box
plane = (hf.Quantity("x", "m"), hf.Quantity("y", "m"))
inputs = (hf.Quantity("u", "m/s"), hf.Quantity("w", "m/s"))
def craft(bounds):
    return hf.System("craft", plane, inputs, {"x": u, "y": w}, input_bounds=bounds)
goal = hf.Region("goal", plane, (hf.Inequality("near", x**2 + y**2 - 0.01, "m"),))
oval = craft(Ellipse((1.0, 0.5)))
grid = hf.grid(oval, {"x": (-2, 2), "y": (-2, 2)}, 61, {"x": "extrapolated", "y": "extrapolated"})
values = {
    scheme: hf.backward_reachable_tube(oval, goal, grid, 1.0, scheme=scheme)
    for scheme in ("plain", "upwind", "weno5")
}
said["scheme"] = float(np.abs(values["plain"].values() - values["upwind"].values()).max())
tips = [[1.0, 0.0], [0.0, 0.5], [0.7, 0.7 * 0.5]]
said["inside"] = values["weno5"].contains([[0.95 * a, 0.95 * b] for a, b in tips]).tolist()
said["outside"] = values["weno5"].contains([[1.3 * a + 0.1, 1.3 * b + 0.1] for a, b in tips]).tolist()
full = hf.Law("full", plane, {"u": 3 * u**0, "w": 3 * u**0})
run = hf.simulate(oval, full, starts=[[0.0, 0.0]], horizon=1.0).dataset["state"].values[0, -1]
said["end"] = run.tolist()
inside = hf.Region("left", plane, (hf.Inequality("wall", x - 1, "m"),))
said["map"] = "refused"
try:
    hf.regulation_map(oval, inside, [1.0, 0.0])
except hf.HoldfastError as error:
    said["map"] = str(error)

said["van"] = hf.load_vehicle("van").parameters[0].value

# the constraint: the thrust is a state, and the acceleration that it gives is bounded
marine = hf.systems.marine_vehicle()
vehicle = hf.dynamic_extension(marine, ("tau_u", "tau_r"), hf.Box((-9, -9), (9, 9)))
gentle = hf.both(hf.regions.gentle(), hf.input_limits(marine))
said["gentle"] = [c.name for c in gentle.inequalities]
push = hf.Law("push", vehicle.states, {"tau_u_rate": 9 * u**0, "tau_r_rate": 0 * u})
start = [[0.0] * 8]
for name, law in (("free", push), ("filtered", hf.safeguard(vehicle, push, hf.regions.gentle(), gains=(2.0, 8.0)))):
    run = hf.simulate(vehicle, law, starts=start, horizon=0.5, region=gentle).dataset["state"]
    said[name] = float(run.sel(state_name="tau_u").max()) / 5.4

# an outcome, and a process that has forgotten its start after a while
swift = craft(hf.Box((-99, -99), (99, 99)))
rush = hf.Law("rush", plane, {"u": 60 * u**0, "w": 0 * w})
said["hasty"] = [
    hf.simulate(swift, rush, starts=[[0.0, 0.0]], horizon=1.0, device=device).outcomes
    for device in sys.argv[1:]
]
d = hf.symbol("d")
blown = hf.System(
    "blown", plane, inputs, {"x": u, "y": w + d}, input_bounds=hf.Box((-1, -1), (1, 1)),
    disturbances=(hf.Quantity("d", "m/s"),),
)
still = hf.Law("still", plane, {"u": 0 * u, "w": 0 * w})
wind = {"d": hf.parse_expression("gusts(0.2, 0.5)", {})}
run = hf.simulate(blown, still, starts=np.zeros((500, 2)), horizon=20.0, disturbance=wind).dataset
felt = run["disturbance"].values[:, :, 0]
said["gusts"] = [float(felt[:, -1].std()), float((felt[:, 150] * felt[:, 200]).mean() / 0.04)]
# the kind of actuator: a vehicle file, its force at two speeds, a filter, C, and a run at its limit
Path("boat.toml").write_text(Path("holdfast/vehicles/otter.toml").read_text() + BOAT)
boat = hf.load_vehicle("boat.toml")
said["inputs"] = boat.input_names
values = {p.symbol: p.value for p in boat.parameters}
force = boat.rates["v"].diff(hf.symbol("bow"))
said["shares"] = [float(force.xreplace({**values, hf.symbol("u"): s})) for s in (0.0, 1.5)]
across = hf.Law("across", (), dict(zip(boat.input_names, (0 * u, 0 * u, 99 + 0 * u), strict=True)))
data = hf.simulate(boat, across, starts=[[0.0] * 6], horizon=5.0).dataset
said["across"] = [float(abs(data["input"]).max()), float(data["state"].values[0, -1, 1])]
bank = hf.Region("bank", boat.states, (hf.Inequality("bank", y - 1, "m"),))
kept = hf.safeguard(boat, across, bank, gains=(1.0, 2.0))
run = hf.simulate(boat, kept, starts=[[0.0] * 6], horizon=20.0, region=bank)
said["kept"] = run.viable
said["c"] = "bow" in hf.export_c(boat, across, "boat")

# the enclosure: what it certifies of a cart is no more than others do, and the checker accepts it
from holdfast_check.checker import checked
v = hf.symbol("v")
line = (hf.Quantity("x", "m"), hf.Quantity("v", "m/s"))
cart = hf.System("cart", line, (hf.Quantity("u", "m/s^2"),), {"x": v, "v": -x - v + u},
                 input_bounds=hf.Box((-1,), (1,)))
room = hf.Region("room", line, (hf.Inequality("wall", abs(x) - 0.9, "m"),))
asked = {"box": {"x": (-1.0, 1.0), "v": (-1.5, 1.5)}, "cells": 31, "sample_time": 0.4, "steps": 4}
shares = {}
for kind in ("plain_box", "parallelepiped"):
    certificate = hf.certify(cart, room, enclosure=kind, **asked)
    shares[kind] = certificate.kept.share
    checked(str(certificate.write(Path(f"{kind}.certificate"))))
said["shares of enclosures"] = shares
print(json.dumps(said))
"""

USED = f"BOAT = {BOAT!r}\n{USED}"

COUNT = '[scenario]\ntitle = "t"\nkind = "count"\n[count]\na = 1\nb = 2\n'


@pytest.fixture(scope="module")
def package(tmp_path_factory):
    """A folder with a copy of the package, in which one of each is added."""
    folder = tmp_path_factory.mktemp("copy")
    shutil.copytree(
        ROOT / "src" / "holdfast", folder / "holdfast", ignore=shutil.ignore_patterns("__pycache__")
    )
    shutil.copytree(ROOT / "src" / "holdfast_check", folder / "holdfast_check")
    for files in ADDED.values():
        for name, text in files.items():
            path = folder / "holdfast" / name
            if isinstance(text, tuple):
                changes, text = text, path.read_text("utf-8")
                for old, new in zip(changes[::2], changes[1::2], strict=True):
                    assert text.count(old) == 1, old
                    text = text.replace(old, new)
                added = Path(next(iter(files))).stem
                text = re.sub(r"ALL = \(\n", f"ALL = (\n    {added},\n", text)
            path.write_text(text, "utf-8")
    return folder


def called(folder, *arguments):
    environment = {**os.environ, "PYTHONPATH": str(folder), "HOLDFAST_CACHE_DIR": str(folder / "c")}
    (folder / "c").mkdir(exist_ok=True, mode=0o700)
    return subprocess.run(
        [sys.executable, *arguments], cwd=folder, env=environment, capture_output=True, text=True
    )


@pytest.mark.parametrize("row", ADDED)
def test_page_names_as_many_files_as_it_takes(row):
    (line,) = [line for line in PAGE.splitlines() if line.startswith(f"| {row} |")]
    assert line.rstrip("| ").endswith(f"| {len(ADDED[row])}")


@pytest.mark.heavy
def test_scheme_set_vehicle_constraint_actuator_and_enclosure_are_used(package):
    devices = ["cpu", *(["c++"] if any(map(shutil.which, COMPILERS)) else [])]
    done = called(package, "-c", USED, *devices)
    assert done.returncode == 0, done.stderr[-2000:]
    said = json.loads(done.stdout.splitlines()[-1])
    assert said["scheme"] < 1e-12  # first differences are upwind ones
    assert said["inside"] == [True] * 3
    assert said["outside"] == [False] * 3
    assert said["end"] == pytest.approx([3 / (9 + 36) ** 0.5, 3 / (9 + 36) ** 0.5], abs=1e-6)
    assert "an ellipse, which is not a polytope" in said["map"]
    assert said["van"] == 3.2
    assert said["gentle"][:2] == ["fast", "acceleration"]
    assert len(said["gentle"]) == 6
    assert said["free"] == pytest.approx(4.5 / 5.4, rel=0.01)
    assert 0.3 < said["filtered"] <= 0.5
    assert [counts["was hasty"] for counts in said["hasty"]] == [1] * len(devices)
    deviation, remembered = said["gusts"]
    assert deviation == pytest.approx(0.2, rel=0.1)
    assert abs(remembered) < 0.15  # after ten times the time of its memory
    assert said["inputs"] == ["port", "starboard", "bow"]
    assert said["shares"][1] == pytest.approx(said["shares"][0] / 2)
    most, way = said["across"]
    assert most == 40
    assert way > 0.5
    assert said["kept"] == 1
    assert said["c"]
    shares = said["shares of enclosures"]
    assert 0.1 < shares["plain_box"] <= shares["parallelepiped"]


OPTION = """
import holdfast as hf
from holdfast.analysis.reachability.problem import marching_of

scene = hf.load_scenario("berth-kernel", ["march.patience=2 min"])
print(marching_of(scene.options).patience, end=" ")
try:
    hf.load_scenario("berth-kernel", ["march.patiense=2 min"])
except hf.HoldfastError as error:
    print(error, end=" ")
try:
    hf.load_scenario("berth-kernel", ["march.patience=2 m"])
except hf.HoldfastError as error:
    print(error)
"""


def test_option_of_a_march_is_a_key_with_its_unit(package):
    done = called(package, "-c", OPTION)
    assert done.returncode == 0, done.stderr[-2000:]
    assert done.stdout.startswith("120.0 ")
    assert "march.patiense: unknown key; did you mean 'patience'?" in done.stdout
    assert "march.patience: the unit 'm' does not fit" in done.stdout


@pytest.mark.heavy
def test_system_and_experiment_are_used(package):
    listed = called(package, "-m", "holdfast", "list").stdout
    assert re.search(r"^system +drifter +a drifter$", listed, re.M)
    assert re.search(r"^scenario +drift +a drifter comes home$", listed, re.M)
    done = called(package, "-m", "holdfast", "run", "drift", "--out", "home", "--no-figures")
    assert done.returncode == 0, done.stderr
    assert json.loads((package / "home" / "summary.json").read_text())["success_fraction"] == 1.0


@pytest.mark.heavy
def test_command_kind_and_figure_are_used(package):
    done = called(package, "-m", "holdfast", "count-words", "one two three")
    assert (done.returncode, done.stdout) == (0, "3 words\n")
    assert "count-words" in called(package, "-m", "holdfast", "--help").stdout
    (package / "count.toml").write_text(COUNT)
    done = called(package, "-m", "holdfast", "run", "count.toml", "--out", "out")
    assert (done.returncode, done.stdout) == (0, "total 3\n"), done.stderr
    assert json.loads((package / "out" / "summary.json").read_text()) == {"total": 3.0}
    assert (package / "out" / "bars.png").stat().st_size > 1000
    done = called(package, "-m", "holdfast", "run", "count.toml", "--device", "c++")
    assert done.returncode == 2
    assert "this kind of scenario has no program for the device 'c++'" in done.stderr
    (package / "count.toml").write_text(COUNT.replace("a = 1", "a = -9"))
    done = called(package, "-m", "holdfast", "run", "count.toml", "--out", "out", "--no-figures")
    assert done.returncode == 1
    assert "the total is not above 0" in done.stderr
