"""The command line in a process of its own."""

import contextlib
import io
import os
import subprocess
import sys

import pytest

from holdfast.commands.main import main

HEARS = (  # also where the tests run in the background, whose processes ignore the signal
    "import signal; signal.signal(signal.SIGINT, signal.default_int_handler)\n"
)
FAST = ["--set", "run.horizon=4", "--runs", "4"]


def holdfast(*arguments, cwd=None, **changes):
    environment = os.environ | {"PYTHONWARNINGS": "default"} | changes
    return subprocess.run(
        [sys.executable, "-m", "holdfast", *arguments],
        cwd=cwd,
        text=True,
        capture_output=True,
        env=environment,
        timeout=120,
    )


def started(code, *arguments):
    return subprocess.Popen(
        [sys.executable, "-c", HEARS + code, *map(str, arguments)],
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
    )  # fmt: skip


def called(*arguments, stdin=os.devnull, stdout=None):
    """The same in this process; standard output may be a stream of the caller's."""
    out, err = stdout or io.StringIO(), io.StringIO()
    with contextlib.ExitStack() as stack:
        patch = stack.enter_context(pytest.MonkeyPatch.context())
        patch.setattr(sys, "argv", ["holdfast", *map(str, arguments)])
        patch.setattr(sys, "stdin", stack.enter_context(open(stdin, "rb")))
        stack.enter_context(contextlib.redirect_stdout(out))
        stack.enter_context(contextlib.redirect_stderr(err))
        left = stack.enter_context(pytest.raises(SystemExit))
        main()
    code = left.value.code
    return subprocess.CompletedProcess(arguments, code, out.getvalue(), err.getvalue())


ONE_STATE = """
[scenario]
title = "decay"
[system]
states = { T = { unit = "m" } }
inputs = { h = { unit = "m/s" } }
rates = { T = "h - T" }
[law]
outputs = { h = "0" }
[starts]
states = [{ T = 1 }]
[run]
horizon = 1
"""

PD = """
import json, sys

for line in sys.stdin:
    s = json.loads(line)
    push = 4 * (-0.5 - s["x"]) - 6 * s["u"]
    turn = -0.6 * s["psi"] - 1.2 * s["y"] - 0.4 * s["r"]
    print(json.dumps({"tau_u": push, "tau_r": turn}), flush=True)
"""
"""A controller of the marine vehicle, as a program."""
