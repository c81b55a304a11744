"""The walls of the house: which room may import which, and that no room grows too large."""

import ast
import importlib.util
import re
import subprocess
import sys
import tomllib
from pathlib import Path

import networkx
import pytest

SOURCE = Path(__file__).parent.parent / "src" / "holdfast"
FILES = sorted(SOURCE.rglob("*.py"))


def imported(path):
    for node in ast.walk(ast.parse(path.read_text("utf-8"))):
        if isinstance(node, ast.Import):
            yield from (alias.name.split(".")[0] for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            yield (node.module or "").split(".")[0]


CONTRACTS = tomllib.loads((SOURCE.parent.parent / "pyproject.toml").read_text("utf-8"))["tool"][
    "importlinter"
]["contracts"]


def test_contracts_name_rooms_only():
    """A new module needs no line in them: a room is a folder, or one of two files at the top."""
    for contract in CONTRACTS:
        named = contract.get("layers", contract.get("source_modules", contract.get("modules")))
        for line in named:
            if line == "holdfast_check":  # a program of its own
                continue
            for room in line.split(" | "):
                path = SOURCE.joinpath(*room.split(".")[1:])
                at_the_top = path.parent == SOURCE and path.with_suffix(".py").is_file()
                assert path.is_dir() or at_the_top, room


def module_of(path):
    parts = path.relative_to(SOURCE.parent).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


def modules_imported(path, modules):
    """Every module of ours that a file imports, wherever in it: in a function, for types alone."""
    package = path.relative_to(SOURCE.parent).parts[:-1]
    for node in ast.walk(ast.parse(path.read_text("utf-8"))):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names if alias.name in modules)
        elif isinstance(node, ast.ImportFrom):
            above = package[: len(package) - node.level + 1] if node.level else ()
            source = ".".join([*above, *([node.module] if node.module else [])])
            for alias in node.names:
                inner = f"{source}.{alias.name}"
                yield from (
                    name for name in (inner if inner in modules else source,) if name in modules
                )


def circles(imports):
    """Groups of modules of which each imports, over others or at once, every other; or itself."""
    graph = networkx.DiGraph([(name, of) for name, others in imports.items() for of in others])
    groups = networkx.strongly_connected_components(graph)
    return sorted(
        sorted(g) for g in groups if len(g) > 1 or any(n in imports.get(n, ()) for n in g)
    )


def test_no_modules_import_each_other():
    """Where two need each other, one of them is said in the words of a third, or they are one."""
    files = {module_of(path): path for path in SOURCE.parent.rglob("*.py")}
    imports = {name: set(modules_imported(path, files)) for name, path in files.items()}
    assert sum(map(len, imports.values())) > 1000
    assert circles(imports) == []


def test_circles_are_found_in_functions_and_for_types(tmp_path, monkeypatch):
    monkeypatch.setattr(sys.modules[__name__], "SOURCE", tmp_path / "room")
    (tmp_path / "room").mkdir()
    texts = {
        "one": "def late():\n    from room.two import three\n",
        "two": "if TYPE_CHECKING:\n    from . import three\n",
        "three": "import room.one\n",
        "apart": "from room.one import late\n",
        "itself": "from room import itself\n",
    }
    for name, text in texts.items():
        (tmp_path / "room" / f"{name}.py").write_text(text)
    files = {module_of(path): path for path in (tmp_path / "room").glob("*.py")}
    imports = {name: set(modules_imported(path, files)) for name, path in files.items()}
    assert circles(imports) == [["room.itself"], ["room.one", "room.three", "room.two"]]


def test_contracts_forbid_modules_that_exist():
    """A contract on a name that is misspelt could not be broken."""
    sources = [*FILES, *SOURCE.parent.joinpath("holdfast_check").rglob("*.py")]
    used = {name for path in sources for name in imported(path)}
    for contract in CONTRACTS:
        for name in set(contract.get("forbidden_modules", ())) - used:
            assert importlib.util.find_spec(name), (contract["name"], name)


def test_layers_name_every_room():
    layers = {room for line in CONTRACTS[0]["layers"] for room in line.split(" | ")}
    rooms = {p.parent.name for p in SOURCE.glob("*/__init__.py")} - {"scenarios", "vehicles"}
    assert rooms <= {room.removeprefix("holdfast.") for room in layers}
    assert len(CONTRACTS[0]["layers"]) <= 12


def test_few_modules_stand_at_the_top():
    assert len(list(SOURCE.glob("*.py"))) <= 8


def test_every_room_says_what_it_is_for():
    rooms = [folder / "__init__.py" for folder in sorted({p.parent for p in FILES})]
    assert not [p for p in rooms if not ast.get_docstring(ast.parse(p.read_text("utf-8")))]


def test_mathematics_uses_no_arrays():
    for path in SOURCE.glob("maths/**/*.py"):
        assert not {"numpy", "xarray", "numba"} & set(imported(path)), path.name


def test_user_text_is_never_run():
    for path in FILES:
        for node in ast.walk(ast.parse(path.read_text("utf-8"))):
            if isinstance(node, ast.Call) and isinstance(node.func, ast.Name):
                assert node.func.id not in {"eval", "exec", "compile"}, path
        if path.name in {"parser.py", "composer.py", "load.py", "closed_loop.py"}:
            text = path.read_text("utf-8")
            assert not re.search(r"sympify\(\s*(text|table|spec|value|given)", text), path


def test_no_module_outgrows_its_room():
    """A module is one idea, whole: many files of one caller are as hard to read."""
    lines = {p: len(p.read_text("utf-8").splitlines()) for p in FILES}
    assert not {p.name: count for p, count in lines.items() if count > 800}


MOST_FILES = {"viability_kernel": 28, "simulate": 30, "explain": 25, "certify": 25}
"""Files of which one call enters a function: who follows the call reads as many."""


@pytest.mark.heavy
def test_one_call_goes_through_few_files():
    roads = [sys.executable, TESTS.parent / "benchmarks" / "roads.py"]
    ended = subprocess.run(roads, capture_output=True, text=True, check=True)
    files = dict(re.findall(r"(\w+): (\d+) files", ended.stdout))
    assert files.keys() == MOST_FILES.keys()
    assert not {name: count for name, count in files.items() if int(count) > MOST_FILES[name]}


def test_importing_the_package_is_light():
    code = (
        "import sys, holdfast\n"
        "sys.exit(len({'numpy', 'sympy', 'numba', 'matplotlib'} & set(sys.modules)))"
    )
    assert subprocess.run([sys.executable, "-c", code]).returncode == 0


def test_run_loads_what_it_uses(tmp_path):
    code = (
        "import sys\n"
        "from holdfast.__main__ import main\n"
        "sys.argv = ['holdfast', 'run', 'ch2-unicycle', '--runs=2', '--no-figures', '--out', "
        f"{str(tmp_path)!r}]\n"
        "try:\n    main()\n"
        "except SystemExit as ended:\n    assert not ended.code\n"
        "spared = {'xarray', 'pandas', 'scipy', 'matplotlib', 'numba', 'pint', 'shapely'}\n"
        "sys.exit(' '.join(spared & set(sys.modules)) or 0)"
    )
    found = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert found.returncode == 0, found.stderr


def test_every_public_name_exists():
    import holdfast

    for name in holdfast.__all__:
        assert getattr(holdfast, name) is not None
    assert set(holdfast.__all__) <= set(dir(holdfast))
    with pytest.raises(AttributeError, match="has no 'nonsense'"):
        _ = holdfast.nonsense


TESTS = Path(__file__).parent
MODULES = sorted(p for folder in (TESTS, TESTS.parent / "benchmarks") for p in folder.rglob("*.py"))


def parts_of_imports(path):
    """Every folder, module and name in the import statements of a file."""
    for node in ast.walk(ast.parse(path.read_text("utf-8"))):
        if isinstance(node, ast.Import | ast.ImportFrom):
            names = [alias.name for alias in node.names] + [getattr(node, "module", None) or ""]
            yield from (part for name in names for part in name.split("."))


def test_no_module_imports_a_test_module():
    """What tests share stands in a module of its own: a test that moves takes nothing along."""
    for path in MODULES:
        assert not [n for n in parts_of_imports(path) if n.startswith("test_")], path


ACROSS = {"documented", "known_solutions", "promises", "thesis"}
"""Folders of tests that are of no single room."""


def test_tests_of_a_room_stand_in_a_folder_of_its_name():
    for folder in sorted({p.parent for p in TESTS.rglob("test_*.py")}):
        room = folder.relative_to(TESTS)
        assert (folder / "__init__.py").exists(), f"or two modules of one name would be one: {room}"
        assert ACROSS & set(room.parts) or (SOURCE / room).is_dir(), room


REGION_FILTER = """
import sys
import holdfast as hf

x, u = hf.symbol("x"), hf.symbol("u")
line = hf.System(
    "line", (hf.Quantity("x", "m"),), (hf.Quantity("u", "m/s"),), {"x": u}, input_bounds=hf.Box((-1,), (1,))
)
end = hf.Region("end", line.states, (hf.Inequality("wall", x - 1, "m"),))
assert hf.SafetyFilter(line, end).step([0.0], [1.0]).input == [1.0]
loaded = [name for name in sys.modules if name.split(".")[0] == "holdfast"]
assert len(loaded) <= 90, len(loaded)
other = {"xarray", "pandas", "scipy", "matplotlib"} & set(sys.modules)
of_kernels = [name for name in loaded if "reachability" in name or "level_set" in name]
assert not other and not of_kernels, (other, of_kernels)
"""


def test_a_filter_on_a_region_loads_nothing_of_kernels():
    ended = subprocess.run([sys.executable, "-c", REGION_FILTER], capture_output=True, text=True)
    assert ended.returncode == 0, ended.stderr


SAY_NOTHING = {"found", "given", "told", "own", "known", "kept"}
PRINTED = {
    "foreseen", "block_sweep", "slopes_once", "slopes_twice", "stencils", "sweep", "look_in_cells",
    "sampled_game", "parts", "quadratic_program",
}  # fmt: skip
"""Modules of scalar functions, whose names are in the texts that targets print."""
ARGUMENTS = {
    "section", "new_parameters", "regulation_map_figure", "certificate_figure", "comparison_figure",
    "identification_figure", "campaign_figure", "tuning_figure", "__init__",
}  # fmt: skip
"""Functions of which users may name these arguments."""


def test_variables_are_named_by_what_they_are():
    """A participle says what happened to a thing, and not what it is."""
    for path in [*FILES, *SOURCE.parent.joinpath("holdfast_check").rglob("*.py")]:
        for function in ast.walk(ast.parse(path.read_text("utf-8"))):
            if not isinstance(function, ast.FunctionDef) or path.stem in PRINTED:
                continue
            nodes = list(ast.walk(function))
            names = {
                n.id for n in nodes if isinstance(n, ast.Name) and isinstance(n.ctx, ast.Store)
            }
            if function.name not in ARGUMENTS:
                names |= {n.arg for n in nodes if isinstance(n, ast.arg)}
            assert not names & SAY_NOTHING, (path.name, function.name, names & SAY_NOTHING)


ARRAYS = {"Array", "AnyArray", "Wholes", "Ranks", "Truths", "Floats", "Table", "DoubleArray"}

COUNTED = r"(\.\.\.|\w[\w\s^*+/()-]*)"
SHAPE = re.compile(rf"\(({COUNTED},\s*)+{COUNTED}?\)|(any|same) shape")
"""What the axes of an array count: "(runs, samples, states)", "(2 * axes,)", "(count, ...)"."""

LAID_OUT = re.compile(r"^ {4}(\w+(?:, \w+)*) {2,}\(", re.MULTILINE)
"""A line of a table in the docstring of a module, of arguments that all its functions share."""


def is_array(annotation):
    for node in ast.walk(annotation) if annotation is not None else ():
        if isinstance(node, ast.Name) and node.id in ARRAYS:
            return True
        if isinstance(node, ast.Attribute) and node.attr in ("NDArray", "ArrayLike", "ndarray"):
            return True
    return False


def public_functions(body, owner=None):
    """The functions and the methods of public names, with the class that they are of."""
    for node in body:
        if isinstance(node, ast.ClassDef) and not node.name.startswith("_"):
            yield from public_functions(node.body, node)
        if isinstance(node, ast.FunctionDef) and (
            node.name in ("__init__", "__call__") or not node.name.startswith("_")
        ):
            yield node, owner


def without_shapes(text):
    """The names of the functions that take or give arrays, and do not say their shapes."""
    tree = ast.parse(text)
    layout = LAID_OUT.findall(ast.get_docstring(tree, clean=False) or "")
    laid_out = {name for names in layout for name in names.split(", ")}
    for function, owner in public_functions(tree.body):
        arguments = function.args.posonlyargs + function.args.args + function.args.kwonlyargs
        arrays = {a.arg for a in arguments if is_array(a.annotation)}
        gives = is_array(function.returns)
        says = ast.get_docstring(function) or ""
        if owner is not None and function.name in ("__init__", "__call__"):
            says += ast.get_docstring(owner) or ""
        if (gives or not arrays <= laid_out) and not SHAPE.search(says):
            yield function.name


def test_functions_of_arrays_say_their_shapes():
    for path in FILES:
        names = sorted(without_shapes(path.read_text("utf-8")))
        assert not names, (path.relative_to(SOURCE).as_posix(), names)


@pytest.mark.parametrize(
    ("says", "names"),
    [
        ("The states, shape (runs, states).", []),
        ("Points (..., 2) in m.", []),
        ("A row of (2 * axes,) numbers.", []),
        ("Values of any shape.", []),
        ("The states of all runs.", ["of"]),
        ("The states of all runs (in m), from (6.10) on.", ["of"]),
    ],
)
def test_a_shape_is_a_tuple_of_what_is_counted(says, names):
    text = f'def of(values: Array) -> None:\n    """{says}"""\n'
    assert list(without_shapes(text)) == names
    assert list(without_shapes(text.replace("of(", "_of("))) == []
    assert list(without_shapes(text.replace("Array", "float"))) == []
    assert list(without_shapes('"""\n    values  (nodes,)\n"""\n' + text)) == []


def test_types_of_arrays_have_few_names():
    """Each is one kind of numbers; a name for each purpose says nothing that the docstring lacks."""
    aliases = re.compile(r"^(\w+)(?:: TypeAlias)? = npt\.NDArray", re.MULTILINE)
    names = {p.relative_to(SOURCE).as_posix(): aliases.findall(p.read_text()) for p in FILES}
    home = set(names.pop("execution/arrays.py"))
    assert home == ARRAYS - {"DoubleArray"}
    elsewhere = {module for module, some in names.items() if some}
    assert elsewhere <= {
        "analysis/reachability/stored_values.py", "analysis/reachability/value_function.py",
        "execution/level_set/fold.py", "execution/level_set/march.py",
        "execution/level_set/refined_march.py",
        "execution/level_set/stage_leaf.py", "execution/level_set/sweeping.py",
        "execution/simulation/blocks.py", "execution/simulation/closed_loop.py",
    }  # fmt: skip
