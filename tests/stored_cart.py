"""The kernel of a cart in a file, to be kept and published."""

import holdfast as hf
from tests.carts import BOX, WALLS, cart


def saved_cart(folder):
    """A value function, and its file."""
    grid = hf.grid(cart(), BOX, 21)
    value = hf.discriminating_kernel(cart(), WALLS, grid, 0.2, scheme="upwind")
    return value, value.save(folder / "cart.nc")
