"""Maps as map_server of ROS writes them: a YAML file beside an image, PGM, PNG or another.

    shade   mean of the colours of a pixel, 0 black to 1 white
    p       1 - shade, or shade with negate: how sure the cell is occupied

    trinary   occupied from occupied_thresh on, free below free_thresh, else unknown
    scale     the same; a pixel that is not opaque is unknown
    raw       the number of a pixel is the occupancy in percent; above 100 it is unknown

Maps of `scale` and `raw` differ from those of `trinary` only in what lies between the thresholds,
and that is not known to be free: it is unknown here.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from PIL import Image, UnidentifiedImageError

from holdfast.errors import DefinitionError, ScenarioError
from holdfast.execution.arrays import Array
from holdfast.host.files import read_small_text

NUMBERS = ("resolution", "occupied_thresh", "free_thresh", "negate")
KEYS = ("image", "origin", *NUMBERS)
MODES = ("trinary", "scale", "raw")
LARGEST = 2**20
"""The largest size of the text in bytes."""
MOST = 10**8
"""The most cells."""


def read_map(path: str | Path) -> tuple[Array, dict[str, Any]]:
    """The occupancy of the cells in percent, -1 unknown, the first row at the smallest y; and the
    arguments of `OccupancyMap` beside it.

    Raises `DefinitionError` for a file that cannot be read, a key that lacks, a number that is
    none, and an image whose transparency has no meaning.
    """
    about = _read_text(path)
    mode = about.get("mode", "trinary")
    if mode not in MODES:
        raise DefinitionError(f"{path}: mode is {mode!r}"[:200], expected=" or ".join(MODES))
    numbers = {name: _number(path, name, about[name]) for name in NUMBERS}
    negate = numbers.pop("negate")
    if negate not in (0, 1):
        raise DefinitionError(f"{path}: negate is {negate:g}", expected="0 or 1")
    origin = about["origin"]
    if not isinstance(origin, list) or len(origin) != 3:
        raise DefinitionError(f"{path}: origin is {origin!r}"[:200], expected="[x, y, yaw]")
    corner = tuple(_number(path, "origin", value) for value in origin)
    image = Path(path).parent / str(about["image"])
    shade, top, opaque = _read_image(image, alpha=mode == "scale")
    if mode == "raw" and top != 255:
        raise DefinitionError(f"{image} has 16 bits", expected="8 bits, for the mode raw")
    if mode == "raw":
        occupancy = np.where(shade <= 100, shade, -1.0)
    else:
        share = shade / top
        occupancy = np.where(opaque, 100.0 * (share if negate else 1.0 - share), -1.0)
    return occupancy[::-1], {**numbers, "origin": corner}


def _read_text(path: str | Path) -> dict[str, Any]:
    try:
        about = yaml.safe_load(read_small_text(path, LARGEST))
    except ScenarioError as error:
        raise DefinitionError(error.cause, expected=error.expected) from None
    except (yaml.YAMLError, RecursionError):
        about = None
    if not isinstance(about, dict):
        raise DefinitionError(f"{path} is no YAML file of a map", expected=", ".join(KEYS))
    if missing := [name for name in KEYS if name not in about]:
        raise DefinitionError(f"{path} lacks '{missing[0]}'", expected=", ".join(KEYS))
    return about


def _number(path: str | Path, name: str, value: object) -> float:
    if not isinstance(value, int | float) or not math.isfinite(value):
        raise DefinitionError(f"{path}: {name} is {value!r}"[:200], expected="a number")
    return float(value)


def _read_image(path: Path, *, alpha: bool) -> tuple[Array, int, Array]:
    """The mean of the colours of every pixel, the number of white, and which pixels are opaque;
    shapes (rows, columns). alpha: whether pixels may be transparent."""
    try:
        with Image.open(path) as file:
            columns, rows = file.size
            if rows * columns > MOST:
                raise DefinitionError(
                    f"{path} has {columns} x {rows} pixels", expected=f"up to {MOST:,}"
                )
            image: Image.Image = file
            if "transparency" in file.info or file.mode == "PA":
                image = file.convert("RGBA")
            elif file.mode in ("1", "P"):
                image = file.convert("RGB")
            mode, pixels = image.mode, np.asarray(image, dtype=np.float64)
    except FileNotFoundError:
        raise DefinitionError(f"there is no image {path}") from None
    except Image.DecompressionBombError:
        raise DefinitionError(f"{path} has too many pixels", expected=f"up to {MOST:,}") from None
    except (OSError, UnidentifiedImageError, ValueError, SyntaxError):
        raise DefinitionError(f"{path} is no image", expected="a PGM or a PNG") from None
    colours = {"L": 1, "RGB": 3, "LA": 1, "RGBA": 3, "I": 1, "I;16": 1}.get(mode)
    if colours is None:
        raise DefinitionError(f"the pixels of {path} are '{mode}'", expected="grey, or colours")
    pixels = pixels.reshape(rows, columns, -1)
    opaque = np.ones((rows, columns), dtype=bool)
    if pixels.shape[2] > colours:
        opaque = pixels[:, :, -1] == 255
        if not alpha:
            raise DefinitionError(
                f"{path} has an alpha channel, which map servers mix with the shade",
                expected="an image without one, or mode: scale",
            )
    return pixels[:, :, :colours].mean(axis=2), 65535 if mode.startswith("I") else 255, opaque
