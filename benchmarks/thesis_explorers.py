"""The pages to which the report on the thesis links: how many, how large, how long they take.

`python benchmarks/thesis_explorers.py FOLDER` writes them anew for the claims that `holdfast
reproduce --out FOLDER` has judged, in as many processes as there are cores.
"""

from __future__ import annotations

import argparse
import shutil
import time
from pathlib import Path

from holdfast.studies.thesis.report import FOLDER, write_explorers
from holdfast.studies.thesis.reproduce import reproduce

KERNEL = 300_000
"""Bytes above which a page has the table of a kernel."""


def main() -> None:
    reader = argparse.ArgumentParser(description=__doc__)
    reader.add_argument("folder", type=Path)
    folder = reader.parse_args().folder
    judged = reproduce(folder)
    shutil.rmtree(folder / FOLDER, ignore_errors=True)
    begun = time.perf_counter()
    found = write_explorers(judged, folder)
    took = time.perf_counter() - begun
    sizes = sorted(e.page.stat().st_size for e in found.values() if e.page is not None)
    loops = [s for s in sizes if s < KERNEL]
    print(f"{len(found)} trials, {len(sizes)} pages, {sum(sizes) / 2**20:.1f} MiB, {took:.0f} s")
    print(f"{len(loops)} without a kernel, {sum(loops) / len(loops) / 2**20:.2f} MiB on average")
    print(f"the largest has {sizes[-1] / 2**20:.1f} MiB")
    print(*sorted({e.refusal for e in found.values() if e.refusal}), sep="\n")


if __name__ == "__main__":
    main()
