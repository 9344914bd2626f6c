"""A page on which a reader steers the robot by pointing at the sphere of codes. It needs no network."""

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
from ear_jax.runs.records import write_text

SHADES = 64  # colours of the map's scale


@dataclass(frozen=True)
class Loop:
    """A piece of a roll-out, picture by picture, made to repeat: its last picture leads to its first."""

    limbs: np.ndarray  # [pictures, limbs, 2, 2] metres to the right and up, from the ground below the robot
    way: np.ndarray  # [pictures + 1, 2] metres: where that is in the world, at last where the next round begins
    fell: bool  # so that it does not repeat, but begins anew


def write_page(path: Path, document: dict[str, Any], loops: Sequence[Loop]) -> Path:
    """Writes the page, all in one file, a few megabytes at most for 800 codes.

    Args:
      path: where to.
      document: `commanded`, `ltes` and `achieved` as a map's document has them, and `trained`; beside these `title`,
        `elevation` (radians from which the robot is seen), `seconds` a picture, and `radii` of the limbs in metres.
      loops: one a code.
    """
    shades, scale = colours(document["achieved"], document["commanded"])
    data = {
        **document,
        "shades": [to_hex(shades(share)) for share in np.linspace(0, 1, SHADES)],
        "scale": [scale.vmin, scale.vmax],
        "fell": [loop.fell for loop in loops],
        "pictures": [len(loop.limbs) for loop in loops],
        "limbs": _millimetres([loop.limbs for loop in loops]),
        "way": _millimetres([loop.way - loop.way[0] for loop in loops]),
    }
    page = Path(__file__).with_name("explore.html").read_text(encoding="utf-8")
    write_text(path, page.replace("{{data}}", json.dumps(data).replace("<", "\\u003c")))  # no name can end the script
    return path


def _millimetres(arrays: Sequence[np.ndarray]) -> str:
    """All numbers one after another as 16 bits each, in base 64; 32 m are the most."""
    whole = np.concatenate([array.reshape(-1) for array in arrays])
    return base64.b64encode(np.clip(np.rint(1000 * whole), -32768, 32767).astype("<i2").tobytes()).decode()
