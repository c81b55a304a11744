"""The text of a loop: what is kept on the disk is what is read of `loop.py`."""

import holdfast as hf
from holdfast.execution.codegen.closed_loop_program import closed_loop_program
from holdfast.execution.simulation import built_loop
from holdfast.execution.simulation.built_loop import Kind, built, shape_of
from holdfast.execution.simulation.settings import RK4


def test_text_from_the_disk_is_the_text_that_was_read(tmp_path, monkeypatch):
    monkeypatch.setenv("HOLDFAST_CACHE_DIR", str(tmp_path))
    system = hf.systems.unicycle()
    law = hf.laws.steer_unicycle(system)
    shape = shape_of(
        closed_loop_program(system, law, region=None, goal=None, disturbance={}, stepper=RK4)
    )
    plain, late = (built.__wrapped__(shape, Kind(late=late)) for late in (False, True))
    monkeypatch.setattr(built_loop, "read", None)  # nothing is read again
    for loop, kind in ((plain, Kind()), (late, Kind(late=True))):
        again = built.__wrapped__(shape, kind)
        assert (again.text, again.called) == (loop.text, loop.called)
    assert plain.text != late.text
