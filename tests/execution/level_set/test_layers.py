"""A grid cut into parts along its first axis."""

from hypothesis import given
from hypothesis import strategies as st

from holdfast.execution.level_set.slab import layers

SHAPES = st.one_of(
    st.tuples(st.integers(2, 300)),
    st.tuples(st.integers(2, 90), st.integers(2, 150)),
    st.tuples(st.integers(2, 40), st.integers(2, 9), st.integers(2, 9)),
)


@given(SHAPES, st.integers(1, 3), st.booleans(), st.integers(1, 50), st.integers(1, 3))
def test_every_node_belongs_to_one_part_which_holds_all_that_its_stages_read(
    shape, ghosts, around, count, stages
):
    of = layers(shape, ghosts, "periodic" if around else "limited")
    if around and of.nodes % of.thick:
        return  # refused
    parts = of.parts(count, stages)
    assert len(parts) == min(count, of.count)
    own = [k for p in parts for k in range(of.nodes)[p.planes.own_nodes]]
    assert own == list(range(shape[0]))
    for p in parts:
        assert p.nodes[p.planes.own].tolist() == list(range(of.nodes))[p.planes.own_nodes]
        if p.last - p.first == p.of.count:
            continue
        reach = ghosts * stages
        first, last = p.planes.own_nodes.start - reach, p.planes.own_nodes.stop + reach
        read = {
            k % of.nodes if around else min(max(k, 0), of.nodes - 1) for k in range(first, last)
        }
        assert read <= set(p.nodes.tolist())
        handed = {k for place, which in p.wanted(parts) for k in which if place is not None}
        assert set(p.layers.tolist()) - set(range(p.first, p.last)) <= handed
