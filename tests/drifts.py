"""A system that drifts, and a law that is told by how much: for the tests of observers."""

import holdfast as hf


def drifting():
    """xdot = u + d: one measured state, one unknown drift of at most 1 m/s."""
    u, d = hf.symbol("u"), hf.symbol("d")
    return hf.System(
        name="drifting",
        states=(hf.Quantity("x"),),
        inputs=(hf.Quantity("u"),),
        disturbances=(hf.Quantity("d"),),
        rates={"x": u + d},
        disturbance_bounds=hf.Ball(1, 1),
    )


def told(system):
    """u = -x - d by a law that is told the drift, recorded as a signal."""
    x, d = hf.symbol("x"), hf.symbol("d")
    reads = (*system.states, *system.disturbances)
    return hf.Law("told", reads, {"u": -x - d}, signals={"drift": d})
