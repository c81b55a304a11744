"""Random numbers that depend on a counter and a seed only: no run depends on how many there are."""

from __future__ import annotations

import math

from holdfast.execution.arithmetic.exponential import logarithm
from holdfast.execution.arithmetic.steps import WHOLE, Steps, Value, bits, from_bits, root
from holdfast.execution.arithmetic.trigonometric import sine_and_cosine

UNIFORM, START, NORMAL, VARIED = 1, 2, 3, 4
"""Purposes of random numbers, so that no two uses share a counter."""

_TWO_52 = 2.0**52
_BITS_OF_TWO_52 = 0x4330000000000000
_WORD = 0xFFFFFFFF


def whole(x: Value) -> Value:
    """A float that is an integer of 0 to 2^52 - 1, as an integer."""
    return bits(x + _TWO_52) ^ _BITS_OF_TWO_52


def number(x: Value) -> Value:
    """An integer of 0 to 2^52 - 1 as a float."""
    return from_bits(x ^ _BITS_OF_TWO_52) - _TWO_52


def philox(counter: tuple[Value, ...], key: tuple[Value, Value]) -> tuple[Value, ...]:
    """Philox4x32-10 (J. Salmon et al., SC'11): four 32-bit words from a counter and a key."""
    x0, x1, x2, x3 = counter
    a, b = key
    for _ in range(10):
        first, second = x0 * 0xD2511F53, x2 * 0xCD9E8D57
        x0, x1, x2, x3 = (
            (second >> 32) ^ x1 ^ a, second & _WORD, (first >> 32) ^ x3 ^ b, first & _WORD
        )  # fmt: skip
        a, b = (a + 0x9E3779B9) & _WORD, (b + 0xBB67AE85) & _WORD
    return x0, x1, x2, x3


def two_uniforms(
    seed: tuple[Value, Value], run: Value, sample: Value, channel: int, purpose: int
) -> tuple[Value, Value]:
    """Two numbers in (0, 1) that depend on these only; seed: its lower and upper 32 bits.

    seed, run and sample are floats that are integers; 32 bits of each count.
    """
    steps: Steps = run.steps
    w = philox(
        (
            whole(sample) & _WORD, whole(run) & _WORD,
            steps.constant(channel, WHOLE), steps.constant(purpose, WHOLE),
        ),
        (whole(seed[0]), whole(seed[1])),
    )  # fmt: skip

    def uniform(high: Value, low: Value) -> Value:
        return (number(high >> 5) * 67108864.0 + number(low >> 6) + 0.5) * 2.0**-53

    return uniform(w[0], w[1]), uniform(w[2], w[3])


def normal(a: Value, b: Value) -> Value:
    """A normal number of mean 0 and variance 1, from two uniform ones (Box and Muller)."""
    found: Value = root(-2.0 * logarithm(a)) * sine_and_cosine(2.0 * math.pi * b)[1]
    return found
