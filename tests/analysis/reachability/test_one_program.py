"""What a set needs once is made once, however many marches it takes: the Hamiltonian, its program.

A set of high order is marched twice, and the second march has the rate of a monotone step, too: its
program is another one.
"""

import pytest

import holdfast as hf
from holdfast.analysis.reachability import solve
from holdfast.execution.level_set import march, stage_leaf
from tests.carts import BOX, WALLS, cart
from tests.divided_marches import Here, basin, same

PLAIN, FILTERED = 1, 2


@pytest.fixture
def made(monkeypatch):
    """The Hamiltonians that are derived, the programs that are lowered, the marches."""
    made = {"derived": 0, "lowered": 0, "marches": 0}
    march._march_leaves.cache_clear()

    def counted(name, of, what):
        original = getattr(of, what)

        def call(*arguments, **options):
            made[name] += 1
            return original(*arguments, **options)

        monkeypatch.setattr(of, what, call)

    counted("derived", solve, "hamiltonian_of")
    counted("lowered", stage_leaf.Schedule, "add")
    counted("marches", march.March, "__init__")
    return made


def kernel(nodes=17, **options):
    system = cart()
    over = hf.grid(system, BOX, nodes)
    return hf.discriminating_kernel(system, WALLS, over, 0.3, **options)


@pytest.mark.parametrize(
    ("options", "programs", "marches"),
    [
        ({"scheme": "upwind"}, PLAIN, 1),
        ({"scheme": "upwind", "estimate_error": "order", "nodes": 33}, PLAIN, 3),
        ({"scheme": "upwind", "refine": 4}, PLAIN, 3),
        ({"scheme": "eno2"}, FILTERED, 2),
        ({"scheme": "eno2", "estimate_error": True, "check_outside": True}, FILTERED, 7),
    ],
    ids=str,
)
def test_a_kernel_has_one_hamiltonian_one_program_of_a_rate_and_one_march_of_each_grid(
    options, programs, marches, made
):
    kernel(**options)
    assert made == {"derived": 1, "lowered": programs, "marches": marches}


def test_a_program_is_another_for_other_numbers_of_the_bounds(made):
    """Of a Hamiltonian that is equal, but for what the disturbance may do."""
    for most in (0.2, 0.4):
        system = cart(most)
        over = hf.grid(system, BOX, 17)
        hf.discriminating_kernel(system, WALLS, over, 0.3, scheme="upwind")
    assert made["lowered"] == 2


def test_the_parts_of_a_divided_march_have_a_march_each_and_whoever_asks_them_one(made):
    same(basin(), basin(cluster=Here(3)), "computed_share")
    assert made["marches"] == 2 * 1 + 2 * (3 + 1)
