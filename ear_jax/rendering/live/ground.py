"""The colours of the page's sphere: what the robot does under LTEs all over it, smoothed from roll-outs."""

from __future__ import annotations

import base64
from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np
from matplotlib.colors import to_hex

from ear_jax.agents.networks import Params
from ear_jax.embeddings.codes import spread_codes
from ear_jax.embeddings.evaluate import play_codes
from ear_jax.embeddings.map import LteMap, estimate
from ear_jax.figures.map import colours
from ear_jax.learning.episodes import achieved
from ear_jax.process.runtime import compiler_options
from ear_jax.runs.rollouts import check_rollouts
from ear_jax.runs.trained import Trained

SIZE = 128  # points along a side of the map that is stored, an octahedron unfolded to a square
SHADES = 64


@dataclass(frozen=True)
class Ground:
    """Estimates at all points of an unfolded octahedron, row by row."""

    values: dict[str, np.ndarray]  # outcome → [SIZE²]
    fell: np.ndarray  # [SIZE²], the share of episodes that end early
    size: int = SIZE

    def scale(self, name: str, period: float | None) -> tuple[list[str], float, float]:
        """Returns the colours of a quantity, and the values of the first and of the last."""
        if period is not None:
            return [to_hex(colour) for colour in hues(SHADES)], 0.0, period
        values = np.quantile(self.values[name], (0.005, 0.995)).round(3).tolist()
        shades, _ = colours(values, {"period": None})
        low, high = values
        return [to_hex(shades(share)) for share in np.linspace(0, 1, SHADES)], low, high

    @staticmethod
    def packed(values: np.ndarray, low: float, high: float) -> str:
        """Packs values as bytes in base 64, 0 for `low` and 255 for `high`."""
        share = np.clip((values - low) / ((high - low) or 1), 0, 1)
        return base64.b64encode(np.rint(255 * share).astype(np.uint8).tobytes()).decode()


def colour_sphere(trained: Trained, params: Params, places: int, seed: int) -> Ground:
    """Plays one episode under each of `places` LTEs and estimates from them what happens between.

    Args:
      trained, params: the run, and one of its policies.
      places: number of LTEs.
      seed: seeds the starts.

    Raises:
      RunError: the episodes do not fit in memory.
    """
    program, family = trained.program, trained.program.family
    check_rollouts(program, places, family.episode_length)
    codes = spread_codes(places, 3)

    def play(params: Params, key: jax.Array):
        played = play_codes(program, params, jnp.asarray(codes), key, 1)
        return achieved(family, played), played.late, played.lengths

    reached, late, lengths = jax.device_get(
        jax.jit(play, compiler_options=compiler_options())(params, jax.random.key(seed))
    )
    late = {name: value[:, 0] for name, value in late.items()}
    lte_map = LteMap(codes, np.asarray(reached), late, lengths[:, 0])
    fell = (lengths[:, 0] < family.episode_length).astype(float)
    outcomes = {**late, family.commanded: lte_map.achieved}
    turns = outcomes[family.commanded] * (2 * np.pi / family.period) if family.period else np.zeros(places)
    columns = [*outcomes.values(), fell, np.cos(turns), np.sin(turns)]
    *found, share, cosine, sine = estimate(lte_map, family, octahedron(SIZE), np.stack(columns, axis=1)).T
    values = dict(zip(outcomes, found, strict=True))
    if family.period:
        values[family.commanded] = np.arctan2(sine, cosine) / (2 * np.pi) % 1 * family.period
    return Ground(values, share)


def hues(count: int) -> np.ndarray:
    """Returns a circle of colours [count, 3] of equal lightness, the first and the last alike, from OKLCH."""
    angle = np.linspace(0, 2 * np.pi, count) + 0.5
    lab = np.stack([np.full(count, 0.74), 0.125 * np.cos(angle), 0.125 * np.sin(angle)])
    cones = np.array([[1, 0.3963, 0.2158], [1, -0.1056, -0.0639], [1, -0.0895, -1.2915]]) @ lab
    mixed = np.array([[4.0767, -3.3077, 0.2310], [-1.2684, 2.6098, -0.3413], [-0.0042, -0.7034, 1.7076]]) @ cones**3
    linear = np.clip(mixed, 0, 1)
    return np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055).T


def octahedron(size: int) -> np.ndarray:
    """Returns the unit vectors [size², 3] of the points of a square onto which an octahedron is unfolded.

    The upper half of the octahedron is the diamond in the middle; the lower half is folded out to the corners.
    """
    side = (np.arange(size) + 0.5) / size * 2 - 1
    y, x = (axis.ravel() for axis in np.meshgrid(side, side, indexing="ij"))
    z = 1 - np.abs(x) - np.abs(y)
    folded = z < 0
    across, along = (1 - np.abs(y)) * np.where(x >= 0, 1, -1), (1 - np.abs(x)) * np.where(y >= 0, 1, -1)
    points = np.stack([np.where(folded, across, x), np.where(folded, along, y), z], axis=1)
    return points / np.linalg.norm(points, axis=1, keepdims=True)
