"""Programs of a vehicle, its controller and its filter, each for a process of its own."""

import holdfast as hf


def pd(state):
    """The controller of docs/own_controller.md."""
    x, y, psi, u, _, r = state
    return [4 * (-0.5 - x) - 6 * u, -0.6 * psi - 1.2 * y - 0.4 * r]


def camera_filter(**settings):
    inside = {"edge_low": 0.02, "edge_high": 0.02, "too_near": 0.01, "too_far": 0.03}
    vehicle, view = hf.systems.marine_vehicle(), hf.regions.camera_view()
    return hf.SafetyFilter(vehicle, view, gains=(1.5, 8), margins=inside, **settings)


COMMON = """
import sys, threading
import holdfast as hf
from holdfast.interop.ros2 import *
from tests.interop.ros2_programs import camera_filter, pd
address, *rest = sys.argv[1:]
net = Network(domain=5, connect=(address,), listen=("tcp/127.0.0.1:0",))
vehicle = hf.systems.marine_vehicle()

def together(nodes):
    def end(node):
        with node:
            node.loop.run(node.step)
    for node in nodes[1:]:
        threading.Thread(target=end, args=(node,), daemon=True).start()
    with nodes[0]:
        nodes[0].run()
"""
PLACED = """
starts = {n: list(map(float, s.split(","))) for n, s in (r.split("=") for r in rest)}
boats = [VehicleNode(hf.Plant(vehicle, [*s, 0, 0, 0]), namespace=n, network=net)
         for n, s in starts.items()]
"""
CONTROLLED = """
pds = [ControllerNode(pd, Interface(vehicle), namespace=n, network=net)
       for n in (r.partition("=")[0] for r in rest)]
"""
FILTER = (
    f"{COMMON}\ntogether([FilterNode(camera_filter(), namespace=n, network=net) for n in rest])"
)
VEHICLE = f"{COMMON}{PLACED}together(boats)"
CONTROLLER = f"{COMMON}{CONTROLLED}together(pds)"
BOTH = f"{COMMON}{PLACED}{CONTROLLED}together(boats + pds)"
"""Their arguments: the address of the router, and namespaces, or NAMESPACE=x,y,psi."""
