"""Finite-difference schemes: one file each, with its `SCHEME`; every file here is found by itself.

Sources: S. Osher, C.-W. Shu, SIAM J. Numer. Anal. 28, 1991 (essentially non-oscillatory, ENO);
G.-S. Jiang, D. Peng, SIAM J. Sci. Comput. 21, 2000 (fifth-order weighted, WENO5).
"""

from collections.abc import Mapping
from functools import cache
from importlib import import_module
from pathlib import Path
from pkgutil import iter_modules

from holdfast.execution.level_set.schemes.base import Scheme

__all__ = ["Scheme", "schemes"]


@cache
def schemes() -> Mapping[str, Scheme]:
    """Every scheme by its name, the one with the fewest ghosts first."""
    names = [m.name for m in iter_modules([str(Path(__file__).parent)]) if m.name != "base"]
    all_schemes: list[Scheme] = [import_module(f"{__name__}.{name}").SCHEME for name in names]
    return {s.name: s for s in sorted(all_schemes, key=lambda s: (s.ghosts, s.name))}
