"""The network of nodes that a test has to itself."""

import socket

from holdfast.interop.ros2 import Network


def free_address():
    with socket.socket() as made:
        made.bind(("127.0.0.1", 0))
        return f"tcp/127.0.0.1:{made.getsockname()[1]}"


def local(address, domain=5):
    return Network(domain=domain, connect=(address,), listen=("tcp/127.0.0.1:0",))
