"""The explorers of the first page: written into the site when it is built."""

from pathlib import Path
from typing import Any

SCENARIOS = ("inspection", "inspection-current", "ch5-nominal")


def on_post_build(config: Any) -> None:
    import holdfast as hf

    folder = Path(config["site_dir"]) / "explorers"
    folder.mkdir(parents=True, exist_ok=True)
    for name in SCENARIOS:
        (folder / f"{name}.html").write_text(hf.explore(name), "utf-8")
