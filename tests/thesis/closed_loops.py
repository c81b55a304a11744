"""What the tests of the thesis's claims share: a closed loop solved tightly, a law with other gains."""

from dataclasses import replace

import numpy as np

import holdfast as hf


def solved(system, law, starts, horizon, **settings):
    """The runs as a dataset: the control never held, the error of a step below 1e-11."""
    chosen = {
        "continuous": True,
        "stepper": "dormand-prince",
        "absolute": 1e-12,
        "relative": 1e-11,
        "sample_time": 0.01,
        "substeps": 1,
        "record_every": 0.01,
    }
    return hf.simulate(
        system, law, starts=np.atleast_2d(starts), horizon=horizon, **(chosen | settings)
    ).dataset


def with_gains(law, **values):
    """The same law with other gains, unchecked: what the catalogue refuses can be tried here."""
    if isinstance(law, hf.Switching):
        return law.map_laws(lambda mode: with_gains(mode, **values), law.name)
    parameters = tuple(replace(p, value=values.get(p.name, p.value)) for p in law.parameters)
    return replace(law, parameters=parameters)
