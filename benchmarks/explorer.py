"""Pages in which scenarios run: their weight, and how soon they answer, in a real browser.

`python benchmarks/explorer.py` writes a page for each scenario, opens it in the system's Chromium
(without a window, drawn by the processor), and prints its weight, the time until it runs, the time
of one run after a change, the time of a frame while the start is dragged, the time of 200 starts,
and how much memory grows in minutes of changes (`--minutes 10`). The page of the same content by
Plotly, with the paths and histories of one `holdfast run` and nothing that moves, is beside it.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import os
import platform
import resource
import tempfile
from pathlib import Path
from typing import Any

import plotly.graph_objects as go
from plotly.offline import get_plotlyjs
from tests.browser import browser, opened

import holdfast as hf

SCENARIOS = (
    "inspection",
    "inspection-current",
    "ch6-corridor",
    "seen-target",
    "ch7-discriminating",
    "ch7-six-states",
)

DRAG = """async () => {
  const took = [], frames = [];
  let last = performance.now(), goes = true;
  (function beat(now) {
    frames.push(now - last);
    last = now;
    if (goes) requestAnimationFrame(beat);
  })(last);
  for (let k = 0; k < 60; k++) {
    const before = performance.now();
    state.start[planeX] += (k % 2 ? 1 : -1) * 1e-3;
    changed();
    await new Promise(requestAnimationFrame);
    while (running || stale) await new Promise((r) => setTimeout(r, 0));
    took.push(performance.now() - before);
  }
  goes = false;
  const of = (list, share) =>
    [...list].sort((a, b) => a - b)[Math.floor(share * (list.length - 1))];
  return { run_ms: of(took, 0.5), run_95_ms: of(took, 0.95),
    frame_ms: of(frames, 0.5), frame_95_ms: of(frames, 0.95) };
}"""


CHANGES = """async (time) => {
  const end = performance.now() + time;
  for (let k = 0; performance.now() < end; k++) {
    state.start[planeX] += (k % 2 ? 1 : -1) * 1e-3;
    changed();
    await new Promise((r) => setTimeout(r, 200));
  }
}"""


def held(page: Any) -> dict[str, float]:
    """Memory in MiB: objects of the page after a collection, and all processes of the browser."""
    tools = page.context.new_cdp_session(page)
    tools.send("HeapProfiler.collectGarbage")
    heap = tools.send("Runtime.getHeapUsage")["usedSize"]
    pages = sum(int((p / "statm").read_text().split()[1]) for p in descendants(os.getpid()))
    return {"heap_mib": heap / 2**20, "browser_mib": pages * resource.getpagesize() / 2**20}


def descendants(process: int) -> list[Path]:
    """The folders of the processes that this one has begun, and those that they have."""
    children: dict[int, list[Path]] = {}
    for path in Path("/proc").glob("[0-9]*"):
        with contextlib.suppress(OSError):  # ended meanwhile
            parent = int((path / "stat").read_text().rpartition(")")[2].split()[1])
            children.setdefault(parent, []).append(path)
    found = list(children.get(process, ()))
    for path in found:
        found += children.get(int(path.name), ())
    return found


def measured(found: Any, name: str, folder: Path, minutes: float) -> dict[str, float]:
    path = folder / f"{name}.html"
    path.write_text(hf.explore(name), "utf-8")
    with opened(found, path) as one:
        page = one.page
        ready = page.evaluate("performance.now()")
        row = {"mib": path.stat().st_size / 2**20, "ready_ms": ready}
        if not page.evaluate("still"):
            page.wait_for_selector("#outcomes li", timeout=60_000)
            page.wait_for_timeout(500)
            row["fan_s"] = float(page.get_attribute("#outcomes", "data-seconds") or "nan")
        page.evaluate("byId('fan').checked = false")
        row |= page.evaluate(DRAG)
        if minutes:
            page.evaluate("byId('fan').checked = true")
            page.evaluate(CHANGES, 60_000 * minutes / 10)  # what is compiled and kept at first
            before = held(page)
            page.evaluate(CHANGES, 60_000 * minutes)
            row |= {f"grown_{k}": v - before[k] for k, v in held(page).items()}
    return row


def by_plotly(name: str, folder: Path) -> float:
    """The weight of a page of the same paths and histories that nothing moves [MiB]."""
    arrays = (
        hf.load_scenario(name, runs=200 if name.startswith("inspection") else None).run().arrays
    )
    state, time = arrays["state"].values, arrays["time"].values
    traces = [go.Scatter(x=run[:, 0], y=run[:, 1], mode="lines") for run in state]
    for quantity in ("constraint", "input"):
        traces += [go.Scatter(x=time, y=row) for row in arrays[quantity].values[0].T]
    text = go.Figure(traces).to_json() + get_plotlyjs()
    return len(text.encode()) / 2**20


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("scenarios", nargs="*", default=SCENARIOS)
    parser.add_argument("--minutes", type=float, default=0.0, help="of changes, for the memory")
    parser.add_argument("--write", action="store_true", help="keep the numbers in explorer.json")
    asked = parser.parse_args()
    rows = {}
    with browser() as found, tempfile.TemporaryDirectory() as folder:
        for name in asked.scenarios:
            rows[name] = measured(found, name, Path(folder), asked.minutes)
            if name.startswith(("inspection", "ch6")):
                rows[name]["plotly_mib"] = by_plotly(name, Path(folder))
            print(name, {k: round(v, 2) for k, v in rows[name].items()}, flush=True)
    if asked.write:
        record = Path(__file__).with_suffix(".json")
        machine = {"python": platform.python_version(), "cores": hf_cores()}
        kept = json.loads(record.read_text("utf-8")) | {"machine": machine} | rows
        record.write_text(json.dumps(kept, indent=1) + "\n", "utf-8")


def hf_cores() -> int:
    from holdfast.execution.resources import available_cores

    return available_cores()


if __name__ == "__main__":
    main()
