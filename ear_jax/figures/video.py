"""Films as files: GIF by Pillow, and MP4 if ffmpeg is installed."""

from __future__ import annotations

import os
import shutil
import subprocess
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib import font_manager
from PIL import Image, ImageDraw, ImageFont

from ear_jax.errors import RunError

GIF_BYTES = 3_000_000  # a larger GIF is written again with every other picture, each shown twice as long
GIF_COLOURS = 64
INK = (40, 44, 52)


def caption(picture: np.ndarray, text: str) -> np.ndarray:
    """Returns the picture [height, width, 3] with a line of text at the top left."""
    image = Image.fromarray(np.ascontiguousarray(picture))
    font = ImageFont.truetype(font_manager.findfont("DejaVu Sans"), 13)
    ImageDraw.Draw(image).text((8, 5), text, INK, font)
    return np.asarray(image)


def write_gif(path: Path, pictures: Sequence[np.ndarray], seconds: float) -> Path:
    """Writes pictures [height, width, 3], each shown for `seconds`, which GIF rounds to hundredths."""
    palette = Image.fromarray(pictures[len(pictures) // 2]).quantize(GIF_COLOURS)
    # One palette and no dithering: pixels that do not change are then not stored again.
    first, *others = (
        Image.fromarray(picture).quantize(palette=palette, dither=Image.Dither.NONE) for picture in pictures
    )
    scratch, hundredths = path.with_name(path.name + ".part"), round(100 * seconds)
    first.save(scratch, "GIF", save_all=True, append_images=others, duration=10 * hundredths, loop=0, optimize=False)
    if scratch.stat().st_size > GIF_BYTES and len(pictures) > 2:
        return write_gif(path, pictures[::2], 2 * seconds)
    os.replace(scratch, path)
    return path


def write_mp4(path: Path, pictures: Sequence[np.ndarray], seconds: float) -> Path | None:
    """Writes the same as MP4 if ffmpeg is on the PATH, else returns None; raises RunError if ffmpeg fails."""
    program = shutil.which("ffmpeg")
    if program is None:
        return None
    height, width, _ = pictures[0].shape
    scratch = path.with_name(path.name + ".part")
    source = ["-f", "rawvideo", "-pix_fmt", "rgb24", "-s", f"{width}x{height}", "-r", f"{1 / seconds:g}", "-i", "-"]
    target = ["-pix_fmt", "yuv420p", "-f", "mp4", str(scratch)]
    frames = np.stack(pictures).tobytes()
    done = subprocess.run([program, "-y", "-loglevel", "error", *source, *target], input=frames, capture_output=True)
    if done.returncode:
        scratch.unlink(missing_ok=True)
        raise RunError(f"ffmpeg cannot write {path}: {done.stderr.decode().strip().splitlines()[-1]}")
    os.replace(scratch, path)
    return path
