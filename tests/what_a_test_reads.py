"""The numbers that a test has: in its code, in the code and the files that it uses.

A tie from a sentence to a test holds where the test has the numbers of the sentence. Comments and
docstrings are no code: a number that stands in them alone is none of the test.
"""

import ast
import math
import operator
import re
from collections.abc import Iterable
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path

ROOT = Path(__file__).parents[1]
IN_TEXT = re.compile(r"(?<![\w.])(?:\d[\d,_]*(?:\.\d+)?(?:[eE][+-]?\d+)?|\.\d+)")
OPERATIONS = {
    ast.Add: operator.add, ast.Sub: operator.sub, ast.Mult: operator.mul,
    ast.Div: operator.truediv, ast.Pow: operator.pow,
}  # fmt: skip
FUNCTIONS = ("exp", "log", "sqrt", "sin", "cos", "tan", "radians", "degrees")
SCALES = {
    "%": 1e-2, "cm": 1e-2, "mm": 1e-3, "ms": 1e-3, "mrad": 1e-3, "us": 1e-6, "microseconds": 1e-6,
    "min": 60.0, "minutes": 60.0, "hours": 3600.0, "km": 1e3, "million": 1e6, "KiB": 1024.0,
    "MB": 1e6, "GB": 1e9, "degrees": math.pi / 180, "deg": math.pi / 180,
}  # fmt: skip
"""Units in which a sentence may say what a test has in percent as a share, in cm in m, ..."""


@dataclass
class Reading:
    """numbers; patterns: texts with places for numbers, as regular expressions; files; texts."""

    numbers: set[float] = field(default_factory=set)
    patterns: set[str] = field(default_factory=set)
    files: set[Path] = field(default_factory=set)
    texts: set[str] = field(default_factory=set)

    @classmethod
    def of(cls, readings: Iterable["Reading"]) -> "Reading":
        """What several tests read."""
        several = [(r.numbers, r.patterns, r.files, r.texts) for r in readings]
        return cls(*(set().union(*parts) for parts in zip(*several, strict=True)))

    def has(self, number: str, unit: str = "") -> bool:
        """Whether a number of a sentence is one of these; to its last digit, if it is no count."""
        if unit == "Hz" and any(n and same(number, "", 1 / n, counts=True) for n in self.numbers):
            return True
        return any(same(number, unit, n, counts=True) for n in self.numbers)

    def takes(self, text: str, begin: int, end: int) -> bool:
        """Whether a pattern finds this place of a text, and a number in it."""
        return any(
            m.start() <= begin and end <= m.end()
            for pattern in self.patterns
            for m in re.finditer(pattern, text)
        )


def same(number: str, unit: str, value: float, *, counts: bool = False) -> bool:
    """Whether a text with a unit says a number, to its last digit.

    counts: a whole number without such a unit is one to the last bit.
    """
    stated, digits = float(number.replace(",", "")), len(number.partition(".")[2])
    for scale in {1.0, SCALES.get(unit, 1.0)}:
        last = 0.0 if counts and scale == 1 and not digits else 0.5 * 10.0**-digits * scale
        if abs(value - stated * scale) <= last + 1e-9 * max(1.0, abs(stated * scale)):
            return True
    return False


def in_text(text: str) -> set[float]:
    words = (w.strip(",_").replace(",", "") for w in IN_TEXT.findall(text.replace("\\.", ".")))
    return {float(w) for w in words}


def value_of(node: ast.AST) -> float | None:
    """The number that numbers alone come to, if this is one."""
    match node:
        case ast.Expression():
            return value_of(node.body)
        case ast.Constant(value=int() | float()) if not isinstance(node.value, bool):
            return node.value
        case ast.Name(id="pi") | ast.Attribute(attr="pi"):
            return math.pi
        case ast.Call(
            func=ast.Name(id=function) | ast.Attribute(attr=function), args=[argument]
        ) if function in FUNCTIONS and (inner := value_of(argument)) is not None:
            try:
                return getattr(math, function)(inner)
            except (ArithmeticError, ValueError):
                return None
        case ast.UnaryOp(op=ast.USub()):
            return None if (inner := value_of(node.operand)) is None else -inner
        case ast.BinOp() if type(node.op) in OPERATIONS:
            sides = value_of(node.left), value_of(node.right)
            if None not in sides and not (isinstance(node.op, ast.Pow) and max(sides) > 1e3):
                try:
                    return OPERATIONS[type(node.op)](*sides)
                except ArithmeticError:
                    return None
    return None


def computed(text: str) -> tuple[float, list[float]]:
    """What an arithmetic expression comes to, and the numbers that it has."""
    tree = ast.parse(text, mode="eval")
    if (value := value_of(tree)) is None or isinstance(value, complex):
        raise ValueError(f"{text} is no arithmetic of numbers")
    return value, [n.value for n in ast.walk(tree) if isinstance(n, ast.Constant)]


@cache
def records() -> dict[str, Path]:
    """The files of numbers that a test may name, by name, and scenarios by their own."""
    named = {}
    for pattern in ("benchmarks/*.json", "src/holdfast/**/*.toml", "tests/**/*.csv"):
        for path in ROOT.glob(pattern):
            named |= {path.name: path, path.stem if path.suffix == ".toml" else path.name: path}
    return named


@cache
def names_of(path: Path) -> dict[str, ast.AST]:
    """What stands at the top of a module, by name."""
    named: dict[str, ast.AST] = {}
    todo = [*ast.parse(path.read_text("utf-8")).body]
    for node in todo:
        match node:
            case ast.FunctionDef() | ast.ClassDef():
                named[node.name] = node
            case ast.Assign() | ast.AnnAssign() | ast.AugAssign():
                targets = node.targets if isinstance(node, ast.Assign) else [node.target]
                names = (n for t in targets for n in ast.walk(t) if isinstance(n, ast.Name))
                named |= {n.id: node for n in names}
            case ast.Import() | ast.ImportFrom():
                named |= {a.asname or a.name.split(".")[0]: node for a in node.names}
            case ast.If() | ast.Try() | ast.With() | ast.For():
                todo += node.body
    return named


@cache
def functions() -> dict[str, list[Path]]:
    """Name -> the files that have a test of this name."""
    every: dict[str, list[Path]] = {}
    for path in (ROOT / "tests").rglob("test_*.py"):
        for name in re.findall(r"^def (test\w+)", path.read_text("utf-8"), re.M):
            every.setdefault(name, []).append(path)
    return every


@cache
def reading_of(path: Path, name: str) -> Reading:
    """What a function reads: its code, and what of other code it names."""
    reading, seen = Reading(), set()
    todo = [(path, name)]
    while todo:
        place = todo.pop()
        if place in seen or (node := names_of(place[0]).get(place[1])) is None:
            continue
        seen.add(place)
        if isinstance(node, ast.Import | ast.ImportFrom):
            todo += _imported(node, place[1])
            continue
        for inner in ast.walk(node):  # within a function
            if isinstance(inner, ast.Import | ast.ImportFrom):
                names = (a.asname or a.name.split(".")[0] for a in inner.names)
                todo += [at for name in names for at in _imported(inner, name)]
        todo += [(place[0], n.id) for n in ast.walk(node) if isinstance(n, ast.Name)]
        if isinstance(node, ast.FunctionDef):  # fixtures
            folders = [f for f in place[0].parents if f.is_relative_to(ROOT / "tests")]
            homes = [place[0], *(c for f in folders if (c := f / "conftest.py").exists())]
            arguments = [a.arg for a in (*node.args.args, *node.args.kwonlyargs)]
            todo += [(home, a) for home in homes for a in arguments]
        todo += _look(node, reading)
    todo_files = [*reading.files]
    for file in todo_files:
        text = file.read_text("utf-8")
        reading.numbers |= in_text(text)
        if file.suffix == ".toml":  # a scenario names its vehicle, and what it is made of
            named = {records()[w] for w in re.findall(r'"([\w-]+)"', text) if w in records()}
            todo_files += named - reading.files
            reading.files |= named
    return reading


def _imported(node: ast.Import | ast.ImportFrom, name: str) -> list[tuple[Path, str]]:
    """The places of a name of a test's helper, of a benchmark, or of a constant of the library."""
    module = node.module or "" if isinstance(node, ast.ImportFrom) else ""
    alias = next(a for a in node.names if name == (a.asname or a.name.split(".")[0]))
    if module.startswith("holdfast"):
        file = ROOT / "src" / f"{module.replace('.', '/')}.py"
        constant = file.exists() and isinstance(names_of(file).get(alias.name), ast.Assign)
        return [(file, alias.name)] if constant else []
    for base in (ROOT, ROOT / "benchmarks"):
        for whole in (f"{module}.{alias.name}".strip("."), module):
            file = base / f"{whole.replace('.', '/')}.py"
            if whole and file.exists():
                return [(file, alias.name)] if whole == module else everything(file)
    return []


def everything(file: Path) -> list[tuple[Path, str]]:
    return [(file, name) for name in names_of(file)]


def _look(root: ast.AST, reading: Reading) -> list[tuple[Path, str]]:
    """Take down what stands in a piece of code; the benchmarks that it names as texts."""
    said = {id(n.value) for n in ast.walk(root) if isinstance(n, ast.Expr)}  # docstrings
    parts = {id(p) for n in ast.walk(root) if isinstance(n, ast.JoinedStr) for p in n.values}
    benchmarks: list[tuple[Path, str]] = []
    for node in ast.walk(root):
        value = value_of(node) if isinstance(node, ast.expr) else None
        if isinstance(value, int | float) and math.isfinite(value):
            reading.numbers.add(abs(float(value)))
        if isinstance(node, ast.Constant) and isinstance(node.value, complex):
            reading.numbers.add(abs(node.value.imag))
        if isinstance(node, ast.JoinedStr):
            gaps = (
                re.escape(p.value) if isinstance(p, ast.Constant) else ".+?" for p in node.values
            )
            _take_pattern("".join(gaps), reading)
        if not (isinstance(node, ast.Constant) and isinstance(node.value, str)) or id(node) in said:
            continue
        text = node.value
        reading.texts.add(text)
        reading.numbers |= in_text(text)
        if id(node) not in parts and "(" in text and "\\d" in text:
            _take_pattern(text, reading)
        words = {text, *(w for w in re.findall(r"[\w.-]+", text) if "-" in w or "." in w)}
        files = {records()[w] for w in words if w in records()}
        reading.files |= files
        makers = {f.with_suffix(".py") for f in files}  # a record is made by its benchmark
        if re.fullmatch(r"[a-z_]+(\.py)?", text):
            makers.add(ROOT / "benchmarks" / f"{text.removesuffix('.py')}.py")
        benchmarks += [at for file in makers if file.exists() for at in everything(file)]
    return benchmarks


def _take_pattern(pattern: str, reading: Reading) -> None:
    """A pattern says something beside its gaps, and is one."""
    if len(re.findall(r"[A-Za-z]{2}", pattern)) >= 2:
        try:
            re.compile(pattern)
        except re.error:
            return
        reading.patterns.add(pattern)
