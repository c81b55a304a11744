"""The kernel of a cart in a file, to be kept and published."""

import holdfast as hf
from holdfast.analysis.kernel_store import Store, entry_of
from tests.carts import BOX, WALLS, cart


def saved_cart(folder):
    """A value function, and its file."""
    grid = hf.grid(cart(), BOX, 21)
    value = hf.discriminating_kernel(cart(), WALLS, grid, 0.2, scheme="upwind")
    return value, value.save(folder / "cart.nc")


def kept_cart(value, path):
    """The store of the user, with this kernel in it."""
    found = Store()
    found.add(path, entry_of(path, value, "cart", "CC-BY-4.0", "Doe 2026"))
    return found
