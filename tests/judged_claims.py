"""A claim about a few runs of the unicycle, and what was found of it."""

import json

import numpy as np
from PIL import Image

from holdfast.scenario.load import load_scenario
from holdfast.scenario.schema.claims import ClaimSpec
from holdfast.studies.thesis.reproduce import Found, Judged

SHORT = ["run.horizon=10"]
LONG = ["system.turn_limit=1000", "system.speed_limit=1000", "plant.turn_limit=1", "run.horizon=10"]


def unicycle(changes=SHORT, runs=12, says=""):
    """A trial of the scenario, as a table."""
    return {
        "scenario": "ch4-unicycle", "set": list(changes), "runs": runs, "says": says,
        "number": "success_fraction", "needs": [1, 1], "recorded": 1,
    }  # fmt: skip


def claim(stated, conditioned=None, name="unicycle"):
    more = {"condition": "if so", "conditioned": conditioned} if conditioned else {}
    return ClaimSpec.model_validate(
        {"name": name, "where": "(4.13), (4.14), Fig. 4.8(a)", "figure": "4.8(a)", "verdict": "holds", "stated": stated}
        | {"says": "The unicycle goes along a dipolar field to the origin from everywhere."} | more
    )  # fmt: skip


def found_of(spec, folder):
    """A number, the paths for a browser, and a picture beside them, which is grey."""
    folder.mkdir()
    loaded = load_scenario(spec.scenario, spec.set, spec.runs)
    (folder / "interactive.json").write_text(json.dumps(loaded.interactive(loaded.run())))
    Image.fromarray(np.full((900, 1440, 3), 128, dtype=np.uint8)).save(folder / "paths.png")
    return Found(1.0, folder, ("paths",))


def judged_in(folder):
    """The claim, judged by two trials."""
    told = claim(unicycle(LONG), unicycle())
    return Judged(
        4, told, found_of(told.stated, folder / "a"), found_of(told.conditioned, folder / "b")
    )
