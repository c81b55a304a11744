"""Sets of admissible inputs and disturbances: box, ball, linear image, product of sets.

Two thrusters in [-F, F] are the `LinearImage` of a `Box`; a current of bounded speed is a
velocity in a `Ball`. So plants stay affine in every input.
"""

from holdfast.maths.definitions.sets.ball import Ball
from holdfast.maths.definitions.sets.base import Bounds, Box, section
from holdfast.maths.definitions.sets.linear_image import AllocatedImage, LinearImage
from holdfast.maths.definitions.sets.product import Product, product

__all__ = [
    "AllocatedImage",
    "Ball",
    "Bounds",
    "Box",
    "LinearImage",
    "Product",
    "product",
    "section",
]
