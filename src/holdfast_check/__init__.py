"""A checker of certificates, in numbers of a maintained library; no code of holdfast is in it."""

import sys


def main() -> None:
    """The command `holdfast-check`."""
    try:
        from holdfast_check.checker import main as check
    except ImportError as error:
        if error.name != "flint":
            raise
        print("holdfast-check needs python-flint: pip install 'holdfast[check]'", file=sys.stderr)
        sys.exit(2)
    check()
