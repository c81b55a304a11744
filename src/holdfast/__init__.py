"""holdfast: viability control of nonholonomic systems.

One symbolic definition, every answer. A vehicle, its law, its constraints and its
disturbances are written once as expressions. Closed-loop simulation, safety filters (control
barrier functions) and viability kernels (Hamilton-Jacobi reachability) are derived from them.
All of holdfast is about one inequality:

    c_j(q) <= 0   for all j, for all time
"""

import lazy_loader

from holdfast._version import __version__ as __version__

_imported, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)


def __getattr__(name: str) -> object:
    if name in __all__:
        return _imported(name)
    from holdfast.errors import refused_attribute

    refused_attribute("holdfast", __all__)(name)
