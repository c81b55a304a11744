"""Free spaces: the corner of the thesis, rings and boxes."""

import math

import numpy as np

WEST = [[-6, -0.8], [-0.2, -0.8], [-0.2, 0.8], [-6, 0.8]]
SOUTH = [[-0.2, -5.2], [1.4, -5.2], [1.4, 0.8], [-0.2, 0.8]]
CORNER = {"west": WEST, "south": SOUTH}


def ring(count=8, inner=2.4, outer=4.2):
    angles = 2 * math.pi * np.arange(count + 1) / count
    near, far = (
        [[round(r * math.cos(a), 9), round(r * math.sin(a), 9)] for a in angles]
        for r in (inner, outer)
    )
    near[-1], far[-1] = near[0], far[0]
    return {f"ring_{k}": [near[k], far[k], far[k + 1], near[k + 1]] for k in range(count)}


def box(x0, y0, x1, y1):
    return [[x0, y0], [x1, y0], [x1, y1], [x0, y1]]
