"""The leaf of a stage and the sweep that calls it agree on where things are."""

from holdfast.execution.level_set import stage_leaf, stencils


def test_sweep_and_stage_count_the_same_places():
    places = [getattr(stencils, name.upper()) for name in stage_leaf.PLACES]
    assert places == list(range(len(places)))
    assert len(places) == stencils.SLOPES
    assert stencils.PITCH == stage_leaf.PITCH
