"""The reference: every argument is explained, every error is named, every example runs."""

import ast
import doctest
import inspect
import re
import sys
import textwrap
from functools import cache
from pathlib import Path

import matplotlib.pyplot as plt
import pytest

import holdfast as hf
from holdfast.errors import HoldfastError
from holdfast.maths.catalogue.signature import CATALOGUES

DOCS = Path(__file__).parent.parent / "docs"
sys.path.insert(0, str(DOCS))
from arguments import EVERYWHERE, explained, of_the_catalogue, thing_at  # noqa: E402

PAGES = sorted((DOCS / "reference").glob("*.md"))
PLACES = re.findall(r"^::: holdfast\.(\S+)$", "".join(p.read_text("utf-8") for p in PAGES), re.M)


def named(place):
    """What the reference shows at this place."""
    return thing_at(f"holdfast.{place}")


def is_shown_as_a_call(thing):
    return callable(thing) and not (
        isinstance(thing, type) and issubclass(thing, (Warning, HoldfastError))
    )


CALLED = {p: named(p) for p in PLACES if is_shown_as_a_call(named(p))}
PUBLIC = [n for n in hf.__all__ if n in CALLED]

ANSWERS = {
    "Campaign": "sweep", "Certificate": "certify", "Command": "Controller", "Comparison": "compare", "Costs": "tune",
    "Decision": "SafetyFilter", "DecisionRecord": "Relay", "Decisions": "SafetyFilter", "Decomposition": "decompose",
    "Derivation": "explain", "Flowpipe": "flowpipe", "GainWindow": "visibility_gains", "Grid": "grid", "Hamiltonian": "hamiltonian",
    "Identified": "identify", "KernelScenario": "load_scenario", "LargestCertified": "largest_certified", "LawJudgement": "judge_law",
    "Leaving": "judge_law", "Margin": "disturbance_margin", "Outcome": "simulate", "OuterSet": "outer_set", "PartsValue": "solve_parts",
    "Promise": "check_promise", "RestingState": "resting_state", "Result": "simulate", "Safeguard": "safeguard",
    "Scenario": "load_scenario", "StationKeepingLimits": "station_keeping_limits", "Status": "SafetyFilter", "Tuning": "tune",
    "ValueFunction": "viability_kernel", "analysis.reachability.march_report.Report": "viability_kernel",
}  # fmt: skip
"""Classes that nobody constructs: the function that gives them has the example, and takes the
arguments."""

WITHOUT = {
    "backward_reachable_set": "a former name",
    "disturbance_margin": "computes kernels for seconds; one stands on the page of kernels",
    "identification_figure": "draws what the example of `identify` finds",
    "largest_certified": "certifies for seconds; one stands on the page of certificates",
}
"""What has no example, and why."""


@cache
def beginning():
    """The names that the pages say examples begin with."""
    scope = {}
    exec((DOCS / "reference/begin.py").read_text("utf-8"), scope)
    return scope


def examples(name):
    text = inspect.getdoc(named(name))
    return doctest.DocTestParser().get_doctest(text, dict(beginning()), name, name, 0)


@pytest.mark.parametrize("name", [n for n in PUBLIC if ">>> " in inspect.getdoc(named(n))])
def test_example_of_the_reference_runs(name, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    said = []
    runner = doctest.DocTestRunner(optionflags=doctest.NORMALIZE_WHITESPACE)
    outcome = runner.run(examples(name), out=said.append)
    plt.close("all")
    assert outcome.attempted
    assert not outcome.failed, "".join(said)


def test_everything_that_is_called_has_an_example():
    without = {n for n in PUBLIC if ">>> " not in inspect.getdoc(named(n))}
    assert without == (set(ANSWERS) & set(PUBLIC)) | set(WITHOUT)
    assert {n for n in ANSWERS.values() if n not in WITHOUT} & without == set()


def test_pages_with_examples_say_what_they_begin_with():
    for page in PAGES:
        text = page.read_text("utf-8")
        names = re.findall(r"^::: holdfast\.(\w+)$", text, re.M)
        if any(">>> " in inspect.getdoc(named(n)) for n in names):
            assert '--8<-- "docs/reference/begin.py"' in text, page


def test_blocks_of_the_pages_run():
    for page in PAGES:
        for block in re.findall(r"```python\n(.*?)```", page.read_text("utf-8"), re.S):
            if "--8<--" not in block:
                exec(block, dict(beginning()))


def arguments_of(thing):
    return [n for n in inspect.signature(thing).parameters if n not in ("self", "_")]


def said_of(thing):
    """What the reference says of each argument."""
    _, about = explained(inspect.getdoc(thing), arguments_of(thing))
    return {**EVERYWHERE, **of_the_catalogue(thing), **about}


@pytest.mark.parametrize("place", [p for p in CALLED if p not in ANSWERS])
def test_every_argument_is_explained(place):
    thing = CALLED[place]
    about = said_of(thing)
    silent = [n for n in arguments_of(thing) if n not in about]
    assert not silent, f"{place} says nothing of {', '.join(silent)}"
    for name, parameter in inspect.signature(thing).parameters.items():
        if "Seconds" in str(parameter.annotation):
            assert about[name].startswith("[s]"), f"{place}: {name} is in seconds"


def raised_by(thing):
    """The errors that its own lines raise."""
    (tree,) = ast.parse(textwrap.dedent(inspect.getsource(inspect.unwrap(thing)))).body
    bodies = [tree]
    if isinstance(tree, ast.ClassDef):
        bodies = [f for f in tree.body if getattr(f, "name", "") in ("__init__", "__post_init__")]
    calls = [
        node.exc.func
        for body in bodies
        for node in ast.walk(body)
        if isinstance(node, ast.Raise) and isinstance(node.exc, ast.Call)
    ]
    return {c.id for c in calls if isinstance(c, ast.Name) and c.id.endswith("Error")}


@pytest.mark.parametrize("place", CALLED)
def test_errors_that_are_raised_are_named(place):
    text = inspect.getdoc(CALLED[place])
    if "which says what is raised" in text or "which also says what is raised" in text:
        return
    silent = {name for name in raised_by(CALLED[place]) if f"`{name}`" not in text}
    assert not silent, f"{place} does not say that it raises {', '.join(sorted(silent))}"


def test_what_is_said_of_arguments_is_read_as_it_is_written():
    text = """A thing.

    low, high [m]: of the box, low: first. mode: "a" or
    "b"; scale [unit of V]: 1. Raises `DefinitionError` for low > high.
    """
    rest, about = explained(inspect.cleandoc(text), ["low", "high", "mode", "scale"])
    assert rest == ["A thing.", "Raises `DefinitionError` for low > high."]
    assert about == {
        "low": "[m] of the box, low: first.",
        "high": "[m] of the box, low: first.",
        "mode": '"a" or "b"',
        "scale": "[unit of V] 1.",
    }


def test_entries_of_the_catalogue_stand_in_the_reference_as_functions():
    for functions in CATALOGUES.values():
        for function in functions:
            home = inspect.unwrap(function)
            assert f"{home.__module__}.{home.__name__}".removeprefix("holdfast.") in PLACES
