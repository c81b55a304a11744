"""Runs cases of all kinds in processes of their own, within time and memory, and counts."""

from __future__ import annotations

import json
import multiprocessing
import os
import resource
import signal
import sys
import time
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from importlib import import_module
from multiprocessing.connection import Connection, wait
from pathlib import Path
from typing import Any

from attacks.case import Fault, Kind, Outcome

MODULES = (
    "kernels", "filters", "certificates", "forgeries", "sure_sets", "identification",
    "scenario_files", "games", "sight",
)  # fmt: skip
"""Every kind of attack is the `KIND` of one of them."""
MEMORY = 6 * 2**30
"""Bytes of address space of a process that tries cases."""
PATIENCE = 4.0
"""Wall time of a case in CPU times of its limit: others may be using the processors."""


def kinds() -> tuple[Kind, ...]:
    return tuple(import_module(f"attacks.{name}").KIND for name in MODULES)


@dataclass
class Tally:
    """What came of the cases of a kind."""

    kind: Kind
    cases: int = 0
    judged: int = 0
    cpu: float = 0.0
    refused: Counter[str] = field(default_factory=Counter)
    first_refused: dict[str, int] = field(default_factory=dict)
    faults: Counter[str] = field(default_factory=Counter)
    first: dict[str, tuple[int, Fault]] = field(default_factory=dict)
    """The first case of each signature."""
    counts: Counter[str] = field(default_factory=Counter)
    notes: list[Any] = field(default_factory=list)

    def add(self, number: int, outcome: Outcome, cpu: float) -> None:
        self.cases += 1
        self.judged += outcome.judged
        self.cpu += cpu
        self.counts.update(outcome.counts)
        self.notes += outcome.notes
        if outcome.refused:
            self.refused[outcome.refused] += 1
            self.first_refused.setdefault(outcome.refused, number)
        for fault in outcome.faults:
            self.faults[fault.signature] += 1
            self.first.setdefault(fault.signature, (number, fault))

    def add_plain(self, told: dict[str, Any]) -> None:
        """What came of other cases, as `plain` has said it."""
        for name in ("cases", "judged"):
            setattr(self, name, getattr(self, name) + told[name])
        self.cpu += told["cpu_s"]
        self.counts.update(told["counts"])
        self.refused.update(told["refused_by"])
        self.first_refused = told["first_refused"] | self.first_refused
        self.faults.update(told["faults"])
        for signature, number in told["first"].items():
            self.first.setdefault(signature, (number, Fault(signature, "")))

    def conclude(self) -> None:
        """Faults that only all cases show."""
        for fault in self.kind.conclude(self.notes):
            self.faults[fault.signature] += 1
            self.first.setdefault(fault.signature, (-1, fault))

    @property
    def share_refused(self) -> float:
        return sum(self.refused.values()) / max(self.cases, 1)

    def plain(self) -> dict[str, Any]:
        return {
            "kind": self.kind.name,
            "cases": self.cases,
            "judged": self.judged,
            "refused": sum(self.refused.values()),
            "refused_by": dict(self.refused.most_common()),
            "first_refused": self.first_refused,
            "faults": dict(self.faults),
            "counts": dict(self.counts),
            "cpu_s": round(self.cpu, 1),
            "first": {s: n for s, (n, _) in self.first.items()},
        }


# -- processes --------------------------------------------------------------------------------


def _serve(pipe: Connection, planted: str | None) -> None:
    """Try what comes through the pipe, until None does."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    resource.setrlimit(resource.RLIMIT_AS, (MEMORY, MEMORY))
    os.nice(5)
    sys.stdout = open(os.devnull, "w")  # noqa: SIM115 - for as long as the process lives
    if planted is not None:
        from attacks.planted import BREAKAGES

        BREAKAGES[planted].plant()
    by_name = {k.name: k for k in kinds()}
    while (task := pipe.recv()) is not None:
        kind, seed, number, fault = task
        began = time.process_time()
        try:
            if fault is None:
                answer: Any = by_name[kind].attempt(seed, number)
            else:
                by_name[kind].shrink(seed, number, fault)
                answer = fault
        except MemoryError:
            answer = Outcome(faults=[Fault("more memory than the limit", "MemoryError")])
        except Exception as error:  # of the engine itself: it is seen, and counts
            answer = Outcome(faults=[Fault(f"the engine: {type(error).__name__}", repr(error))])
            if fault is not None:
                answer = fault
        pipe.send((answer, time.process_time() - began))


class Worker:
    """A process that tries one case at a time."""

    def __init__(self, planted: str | None = None) -> None:
        self._planted = planted
        self._start()

    def _start(self) -> None:
        context = multiprocessing.get_context("spawn")
        self.pipe, far = context.Pipe()
        self.process = context.Process(target=_serve, args=(far, self._planted), daemon=True)
        self.process.start()
        far.close()
        self.task: tuple[str, int, int, Fault | None] | None = None
        self.deadline = 0.0

    def give(self, kind: Kind, seed: int, number: int, fault: Fault | None = None) -> None:
        self.task = (kind.name, seed, number, fault)
        self.deadline = time.monotonic() + PATIENCE * (kind.seconds + 60.0 * (fault is not None))
        self.pipe.send(self.task)

    def answer(self) -> tuple[Any, float]:
        """What came; a process that is gone, or over its time, is replaced."""
        try:
            got: tuple[Any, float] = self.pipe.recv()
        except EOFError:
            self.process.join()
            got = self._replaced(f"the process ended with status {self.process.exitcode}")
        self.task = None
        return got

    def end_if_late(self) -> tuple[Any, float] | None:
        if self.task is None or time.monotonic() < self.deadline:
            return None
        self.process.kill()
        self.process.join()
        return self._replaced("longer than its time limit")

    def _replaced(self, why: str) -> tuple[Any, float]:
        fault = self.task[3] if self.task else None
        self.pipe.close()
        self._start()
        return (fault or Outcome(faults=[Fault(why, why)])), 0.0

    def close(self) -> None:
        if self.process.is_alive():
            try:
                self.pipe.send(None)
                self.process.join(5)
            except OSError:
                pass
            if self.process.is_alive():
                self.process.kill()


def _numbers(
    chosen: Sequence[Kind],
    enough: Callable[[Tally], bool],
    tallies: dict[str, Tally],
    begun: Counter[str],
    first: int,
) -> Iterator[tuple[Kind, int]]:
    """Cases, the kind that has had least of its share of time next."""
    while left := [k for k in chosen if not enough(tallies[k.name])]:
        kind = min(left, key=lambda k: (tallies[k.name].cpu + 0.05 * begun[k.name]) / k.share)
        yield kind, first + begun[kind.name]
        begun[kind.name] += 1


def run(
    chosen: Sequence[Kind],
    seed: int,
    *,
    minutes: float | None = None,
    count: int | None = None,
    workers: int = 2,
    first: int = 0,
    planted: str | None = None,
    progress: bool = False,
    until: str | None = None,
) -> dict[str, Tally]:
    """Try cases for so many minutes, or so many of each kind.

    first: number of the first case. until: stop at the first fault whose signature has this in it.
    """
    tallies = {k.name: Tally(k) for k in chosen}
    end = time.monotonic() + 60.0 * minutes if minutes is not None else float("inf")
    begun: Counter[str] = Counter()

    def enough(t: Tally) -> bool:
        met = until is not None and any(until in s for s in t.faults)
        return met or time.monotonic() > end or (count is not None and begun[t.kind.name] >= count)

    cases = _numbers(chosen, enough, tallies, begun, first)
    crew = [Worker(planted) for _ in range(workers)]
    try:
        _work(crew, cases, seed, tallies, progress)
    except KeyboardInterrupt:
        print("interrupted: these are the cases so far", file=sys.stderr)
    finally:
        for worker in crew:
            worker.close()
    for t in tallies.values():
        t.conclude()
    return tallies


def _work(
    crew: list[Worker],
    cases: Iterator[tuple[Kind, int]],
    seed: int,
    tallies: dict[str, Tally],
    progress: bool,
) -> None:
    busy: dict[int, tuple[Kind, int]] = {}
    more = True
    shown = time.monotonic()
    while True:
        for k, worker in enumerate(crew):
            if more and k not in busy:
                case = next(cases, None)
                more = case is not None
                if case is not None:
                    busy[k] = case
                    worker.give(case[0], seed, case[1])
        if not busy:
            return
        ready = wait([crew[k].pipe for k in busy], timeout=1.0)
        for k in list(busy):
            got = crew[k].answer() if crew[k].pipe in ready else crew[k].end_if_late()
            if got is not None:
                kind, number = busy.pop(k)
                tallies[kind.name].add(number, *got)
        if progress and time.monotonic() - shown > 20:
            shown = time.monotonic()
            told = ", ".join(
                f"{t.kind.name} {t.cases} ({sum(t.faults.values())})" for t in tallies.values()
            )
            print(f"cases (faults): {told}", file=sys.stderr, flush=True)


def write_faults(tallies: dict[str, Tally], seed: int, folder: Path) -> list[Path]:
    """A file for each signature, shrunk from its first case."""
    written = []
    worker = Worker()
    try:
        for t in tallies.values():
            for k, (signature, (number, fault)) in enumerate(sorted(t.first.items())):
                if number < 0:
                    continue
                worker.give(t.kind, seed, number, fault)
                while not wait([worker.pipe], timeout=1.0):
                    if (late := worker.end_if_late()) is not None:
                        got = late[0]
                        break
                else:
                    got = worker.answer()[0]
                fault = got if isinstance(got, Fault) and got.text else fault
                text = (
                    fault.text
                    or f'"""{signature}\n\n{fault.message}\n\nseed {seed}, case {number}\n"""\n'
                )
                folder.mkdir(parents=True, exist_ok=True)
                path = folder / f"{t.kind.name.replace(' ', '_')}_{number}_{k}{_suffix(fault)}"
                path.write_text(text, "utf-8")
                written.append(path)
    finally:
        worker.close()
    return written


def _suffix(fault: Fault) -> str:
    return fault.suffix if fault.text else ".py"


def table(tallies: dict[str, Tally]) -> str:
    """What came of every kind, for a terminal and for a page."""
    lines = ["| kind | cases | judged | refused | faults | CPU s |", "|---|---|---|---|---|---|"]
    for t in tallies.values():
        judged = f"{t.judged:,}"
        shown = ", ".join(f"{t.counts[k]:,.0f} {k}" for k in t.kind.shown if t.counts[k])
        judged += f" ({shown})" if shown else ""
        lines.append(
            f"| {t.kind.name} | {t.cases:,} | {judged} | {100 * t.share_refused:.1f} % "
            f"| {sum(t.faults.values())} | {t.cpu:.0f} |"
        )
    for t in tallies.values():
        for reason, number in t.refused.most_common(8):
            lines.append(
                f"refused {number:5d}  {t.kind.name}: {reason} (first: case "
                f"{t.first_refused[reason]})"
            )
    for t in tallies.values():
        for signature, number in t.faults.most_common():
            lines.append(
                f"FAULT   {number:5d}  {t.kind.name}: {signature} "
                f"(first: case {t.first[signature][0]})"
            )
    return "\n".join(lines)


def summed(paths: Sequence[Path]) -> dict[str, Tally]:
    """What came of several runs, from their tables, kinds without a case left out."""
    tallies = {k.name: Tally(k) for k in kinds()}
    for path in paths:
        for told in json.loads(path.read_text("utf-8"))["kinds"]:
            tallies[told["kind"]].add_plain(told)
    return {name: t for name, t in tallies.items() if t.cases}


def as_json(tallies: dict[str, Tally], seed: int) -> str:
    return json.dumps({"seed": seed, "kinds": [t.plain() for t in tallies.values()]}, indent=1)
