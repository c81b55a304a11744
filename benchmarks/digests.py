"""Does a change of the code leave every number as it was? A digest of every shipped scenario.

  python benchmarks/digests.py > before        # then change the code
  python benchmarks/digests.py > after; diff before after

Every scenario runs as it is shipped, with fewer runs (40) and nodes (21 in three states, 9 in six).
A digest is of every array of its result: states, inputs, modes, outcomes, values; a kernel with a
promise has the verdict of that too, and one that fewer nodes do not resolve has its refusal.
Digests of two machines may differ in the last bit of a number.
"""

import hashlib
import json
import sys

import numpy as np
import xarray as xr

import holdfast as hf
from holdfast.errors import HoldfastError
from holdfast.scenario.files import scenario_names
from holdfast.scenario.kinds.parts import PartsScenario

NODES = {1: 101, 2: 41, 3: 21, 4: 11, 5: 9, 6: 9}


def digest(dataset: xr.Dataset) -> str:
    """Of every array, in the order of their names."""
    found = hashlib.sha256()
    for name in sorted(map(str, dataset.variables)):
        values = np.ascontiguousarray(dataset[name].values)
        found.update(f"{name} {values.shape}".encode())
        found.update(str(values.tolist()).encode() if values.dtype == object else values.tobytes())
    return found.hexdigest()[:24]


def digest_of(name: str) -> str:
    loaded = hf.load_scenario(name)
    if isinstance(loaded, hf.Scenario):
        changes = ["kernels.ch7-six-states.grid.nodes=9"] if name == "ch7-rescue" else []
        runs = min(loaded.runs, 40) if loaded.independent_runs else None
        loaded = hf.load_scenario(name, changes, runs)
        return digest(loaded.run().dataset)
    in_parts = isinstance(loaded, PartsScenario)
    changes = [] if in_parts else [f"grid.nodes={NODES[len(loaded.grid.axes)]}"]
    if loaded.promised is not None:
        changes.append("promise.runs=40")
    result = hf.load_scenario(name, changes).run()
    said = json.dumps(result.promise.summary(), sort_keys=True) if result.promise else ""
    parts = result.value.parts if in_parts else ()
    values = [one.value for both in parts for one in both] or [result.value]
    of_values = " ".join(digest(value.dataset) for value in values)
    return of_values + " " + hashlib.sha256(said.encode()).hexdigest()[:12]


def main() -> None:
    for name in sys.argv[1:] or scenario_names():
        try:
            answer = digest_of(name)
        except HoldfastError as error:
            answer = f"refused: {error}"
        print(f"{name:<28}{answer}", flush=True)


if __name__ == "__main__":
    main()
