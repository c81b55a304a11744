"""Entry point of `python -m holdfast` and of the command `holdfast`."""

import gc
import os
import signal
from typing import NoReturn


def main() -> NoReturn:
    """Run the command line and exit; an interruption also ends it during the imports."""
    gc.set_threshold(50_000)  # expressions live to the end: they were visited again and again
    os.environ["MPLBACKEND"] = "Agg"  # figures are files: no window is opened, and none is needed
    os.environ.setdefault("SYMPY_CACHE_SIZE", "50000")  # a search composes its system many times
    try:
        from holdfast.host.interruption import listening

        try:
            with listening():
                from holdfast.commands.main import main as run

                run()
        finally:
            signal.signal(signal.SIGINT, signal.SIG_IGN)  # finished, status known
    except KeyboardInterrupt:
        os._exit(130)


if __name__ == "__main__":
    main()
