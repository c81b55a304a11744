"""The command line in a process of its own."""

import atexit
import contextlib
import io
import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path

import pytest

from holdfast.commands.main import main

FAST = ["--set", "run.horizon=4", "--runs", "4"]


def holdfast(*arguments, cwd=None, **changes):
    """The command in a process of its own; one with the environment of the tests is forked."""
    if not changes:
        return forked(arguments, cwd)
    environment = os.environ | {"PYTHONWARNINGS": "default"} | changes
    return subprocess.run(
        [sys.executable, "-m", "holdfast", *arguments],
        cwd=cwd,
        text=True,
        capture_output=True,
        env=environment,
        timeout=120,
    )


FORKS = """
import importlib, json, os, pkgutil, signal, sys

import holdfast.commands
from holdfast.__main__ import main

for module in pkgutil.iter_modules(holdfast.commands.__path__):
    importlib.import_module("holdfast.commands." + module.name)
for name in (
    "holdfast.scenario.load", "holdfast.scenario.kinds.closed_loop", "holdfast.scenario.kinds.kernel",
    "holdfast.analysis.simulation.simulate", "holdfast.analysis.reachability.solve",
    "holdfast.presentation.figures.paths", "holdfast.presentation.figures.histories",
    "llvmlite.binding", "netCDF4", "matplotlib.pyplot", "matplotlib.backends.backend_svg",
):
    importlib.import_module(name)
for line in sys.stdin:
    asked = json.loads(line)
    child = os.fork()
    if child == 0:
        for number, (path, mode) in enumerate(
            ((os.devnull, os.O_RDONLY), *((p, os.O_WRONLY) for p in asked["out"]))
        ):
            opened = os.open(path, mode)
            os.dup2(opened, number)
            os.close(opened)
        os.chdir(asked["cwd"])
        os.environ.clear()
        os.environ.update(asked["environment"])
        sys.argv = ["holdfast", *asked["arguments"]]
        main()
    _, status = os.waitpid(child, 0)
    print(os.waitstatus_to_exitcode(status), flush=True)
"""
"""A process that has imported what commands need, and forks one for each line that it reads."""

_server: list[subprocess.Popen] = []


def forked(arguments, cwd):
    """What `subprocess.run` gives, without the time that importing takes."""
    environment = os.environ | {"PYTHONWARNINGS": "default"}
    if not _server or _server[0].poll() is not None:
        _server[:] = [
            subprocess.Popen(
                [sys.executable, "-c", FORKS], env=environment, text=True,
                stdin=subprocess.PIPE, stdout=subprocess.PIPE,
            )
        ]  # fmt: skip
        atexit.register(ended, _server[0])
    with tempfile.TemporaryDirectory() as folder:
        out = [Path(folder) / name for name in ("out", "err")]
        for path in out:
            path.touch()
        asked = {"arguments": list(map(str, arguments)), "cwd": str(cwd or os.getcwd())}
        asked |= {"out": list(map(str, out)), "environment": environment}
        _server[0].stdin.write(json.dumps(asked) + "\n")
        _server[0].stdin.flush()
        status = int(_server[0].stdout.readline())
        said = [path.read_text() for path in out]
    return subprocess.CompletedProcess(["holdfast", *arguments], status, *said)


def ended(server):
    server.stdin.close()
    server.wait()
    server.stdout.close()


def started(code, *arguments):
    return subprocess.Popen(
        [sys.executable, "-c", code, *map(str, arguments)],
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
    )  # fmt: skip


def called(*arguments, cwd=".", stdin=os.devnull, stdout=None):
    """The same in this process; standard output may be a stream of the caller's."""
    out, err = stdout or io.StringIO(), io.StringIO()
    with contextlib.ExitStack() as stack:
        stack.enter_context(contextlib.chdir(cwd))
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
empirical = "numbers"
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
