"""The page of `ear explore`, on which one steers the robot by pointing at the LTE sphere; it needs no network."""

from __future__ import annotations

import base64
import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.colors import to_hex

from ear_jax.figures.map import colours
from ear_jax.files.replacing import write_text

SHADES = 64  # colours on the scale of the map


@dataclass(frozen=True)
class Loop:
    """A segment of a roll-out that repeats: its first picture follows its last."""

    limbs: np.ndarray  # [pictures, limbs, 2, 2] metres to the right and up from the ground below the robot
    path: np.ndarray  # [pictures + 1, 2] metres: that ground point in the world; the last begins the next repetition
    fell: bool  # the robot fell: the segment starts again from its first pose


def write_page(path: Path, document: dict[str, Any], loops: Sequence[Loop]) -> Path:
    """Writes the page as one file, a few megabytes at most for 800 LTEs.

    Args:
      path: the file to write.
      document: `commanded`, `ltes`, `achieved` and `trained` as in the document of `ear map`, and also `title`,
        `elevation` (of the camera, radians), `seconds` (per picture), and `radii` (of the limbs, metres).
      loops: one per LTE.
    """
    shades, scale = colours(document["achieved"], document["commanded"])
    data = {
        **document,
        "shades": [to_hex(shades(share)) for share in np.linspace(0, 1, SHADES)],
        "scale": [scale.vmin, scale.vmax],
        "fell": [loop.fell for loop in loops],
        "pictures": [len(loop.limbs) for loop in loops],
        "limbs": _millimetres([loop.limbs for loop in loops]),
        "path": _millimetres([loop.path - loop.path[0] for loop in loops]),
    }
    page = Path(__file__).with_name("explore.html").read_text(encoding="utf-8")
    text = json.dumps(data).replace("<", "\\u003c")  # so that no name can end the script
    write_text(path, page.replace("{{data}}", text))
    return path


def _millimetres(arrays: Sequence[np.ndarray]) -> str:
    """Packs all numbers as 16-bit millimetres in base 64; clips at ±32 m."""
    whole = np.concatenate([array.reshape(-1) for array in arrays])
    return base64.b64encode(np.clip(np.rint(1000 * whole), -32768, 32767).astype("<i2").tobytes()).decode()
