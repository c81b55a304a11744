"""python -m holdfast, and the command `holdfast`: the command line from its first import on."""

import os
import signal
from typing import NoReturn


def main() -> NoReturn:
    """Run the command line and exit; an interruption while it is loaded ends it too."""
    try:
        from holdfast.host.interruption import listening

        try:
            with listening():
                from holdfast.commands.main import main as run

                run()
        finally:
            signal.signal(signal.SIGINT, signal.SIG_IGN)  # all is done, and its status known
    except KeyboardInterrupt:
        os._exit(130)


if __name__ == "__main__":
    main()
