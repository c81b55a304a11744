"""What tests of messages share."""

import pytest


@pytest.fixture
def hub():
    """The address of a router that runs."""
    from holdfast.interop.ros2 import router
    from tests.interop.ros2_network import free_address

    address = free_address()
    with router(address):
        yield address
