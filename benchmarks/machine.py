"""What this machine can do at most: bytes moved and numbers multiplied, by every core at once."""

from __future__ import annotations

import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor

import numpy as np
from numba import njit

CHAIN = 16


@njit(nogil=True)
def triad(a, b, c):  # type: ignore[no-untyped-def]
    """a = b + 3 c, as in J. D. McCalpin's STREAM."""
    for i in range(len(a)):
        a[i] = b[i] + 3.0 * c[i]


def multiply_add(numbers: int) -> Callable[..., None]:
    """`times` x `CHAIN` fused multiplications and additions of so many numbers, in registers."""

    @njit(nogil=True, fastmath={"contract"})
    def repeated(x, factor, term, times):  # type: ignore[no-untyped-def]
        for _ in range(times):
            for j in range(numbers):
                v = x[j]
                for _ in range(CHAIN):
                    v = v * factor + term
                x[j] = v

    return repeated


def together(work: Callable[[int], None], threads: int, repetitions: int) -> float:
    """The least seconds in which every thread has done its work."""
    with ThreadPoolExecutor(threads) as pool:
        list(pool.map(work, range(threads)))  # compiled
        least = np.inf
        for _ in range(repetitions):
            began = time.perf_counter()
            list(pool.map(work, range(threads)))
            least = min(least, time.perf_counter() - began)
    return float(least)


def bytes_per_second(numbers: int, precision: str, threads: int) -> float:
    """By a triad over three arrays of so many numbers in all, in the caches if they fit there."""
    size = numbers // threads
    again = max(1, 20_000_000 // numbers)
    arrays = [np.ones((3, size), dtype=precision) for _ in range(threads)]

    def work(k: int) -> None:
        for _ in range(again):
            triad(*arrays[k])

    moved = 3 * size * arrays[0].itemsize * threads * again
    return moved / together(work, threads, 7)


def operations_per_second(precision: str, threads: int) -> float:
    """Additions and multiplications, fused, of eight registers."""
    times, count = 100_000, 256 // np.dtype(precision).itemsize
    numbers = [np.ones(count, dtype=precision) for _ in range(threads)]
    factor, term = np.array([0.999, 0.001], dtype=precision)
    repeated = multiply_add(count)

    def work(k: int) -> None:
        repeated(numbers[k], factor, term, times)

    return 2.0 * count * CHAIN * times * threads / together(work, threads, 7)


if __name__ == "__main__":
    for precision in ("float64", "float32"):
        speed = operations_per_second(precision, 2)
        print(f"{precision}, 2 threads: {speed / 1e9:.0f} GFlop/s")
    for threads in (1, 2):
        for numbers in (30_000, 130_000, 1_000_000, 20_000_000):
            speed = bytes_per_second(numbers, "float64", threads)
            print(f"{threads} threads, three arrays of {numbers} numbers: {speed / 1e9:.0f} GB/s")
