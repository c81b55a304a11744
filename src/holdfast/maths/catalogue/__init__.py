"""Catalogue of systems, laws, regions and fields; an entry is a function and its name in `ALL`."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach(
    __name__, submodules=["fields", "laws", "regions", "systems"]
)
