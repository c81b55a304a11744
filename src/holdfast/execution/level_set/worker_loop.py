"""How threads carry out stages together: in compiled code, from one stage to the next.

All are scalar functions (`codegen/scalar_reader.py`). An order is the address of a function, and
then what that function takes (`scalar_llvm.py`, packed). The first thread leads the others:

    begun           (1,)                how many stages have begun
    ended           (others * LINE,)    of each of the others how many it has ended, and 1 where it
                                        does not look for the next; a line apart
    orders          (threads * pitch,)  an order for every thread
    order           (pitch,)            that of one
    taken           (slice_count,)      which slices are taken, as `stencils.py` says
    counts          (threads * LINE,)   of every thread: how many, how many, and the largest
    sums            (4,)                the same of all, and whether all have ended
"""

# ruff: noqa: F821
# mypy: ignore-errors

from __future__ import annotations

LINE = 8  # numbers of a line of the processor's cache, which one thread alone writes to


def serve(begun: Wholes, ended: Wholes, order: Wholes, reads: int):
    """Carries out its order in every stage, until none has begun within so many reads."""
    ended[1] = 0
    idle = 0
    while idle < reads:
        idle += 1
        if look(begun) > ended[0]:
            call(order[0], address(order, 1))
            take(ended)
            idle = 0
    ended[1] = 1


def lead(begun: Wholes, orders: Wholes, taken: Wholes, slice_count: int, counts: Floats, size: int):
    """Begins a stage, and carries out the first order. size: of `counts`."""
    for k in range(slice_count):
        taken[k] = 0
    for k in range(size):
        counts[k] = 0.0
    take(begun)
    call(orders[0], address(orders, 1))


def gather(
    begun: Wholes, ended: Wholes, others: int, counts: Floats, sums: Floats, reads: int,
):  # fmt: skip
    """Adds up what all have counted, once they have ended a stage, within so many reads."""
    k, idle = 0, 0
    while k < others and idle < reads:
        if look(ended[k * LINE :]) >= begun[0]:
            k += 1
        idle += 1
    sums[0], sums[1], sums[2], sums[3] = 0.0, 0.0, 0.0, 0.0
    if k < others:
        return
    for i in range(others + 1):
        sums[0] += counts[i * LINE]
        sums[1] += counts[i * LINE + 1]
        sums[2] = max(sums[2], counts[i * LINE + 2])
    sums[3] = 1.0
