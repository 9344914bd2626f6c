"""Films as files: GIF by Pillow, and MP4 if ffmpeg is installed."""

from __future__ import annotations

import shutil
import subprocess
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib import font_manager
from PIL import Image, ImageDraw, ImageFont

from ear_jax.errors import RunError
from ear_jax.files.replacing import replace_file

GIF_BYTES = 3_000_000  # a larger GIF is written again with every other picture, each shown twice as long
GIF_COLOURS = 64
INK = (40, 44, 52)


def caption(picture: np.ndarray, text: str) -> np.ndarray:
    """Returns the picture [height, width, 3] with a line of text at the top left."""
    image = Image.fromarray(np.ascontiguousarray(picture))
    font = ImageFont.truetype(font_manager.findfont("DejaVu Sans"), 13)
    ImageDraw.Draw(image).text((8, 5), text, INK, font)
    return np.asarray(image)


def write_gif(path: Path, pictures: Sequence[np.ndarray], seconds: float, colours: int = GIF_COLOURS) -> Path:
    """Writes pictures [height, width, 3], each shown for `seconds`, which GIF rounds to hundredths."""
    several = Image.fromarray(np.concatenate(pictures[:: -(-len(pictures) // 4)]))
    # Rare colours are kept, such as that of a small mark.
    palette = several.quantize(colours, method=Image.Quantize.MAXCOVERAGE, kmeans=2)
    # One palette and no dithering: pixels that do not change are then not stored again.
    first, *others = (
        Image.fromarray(picture).quantize(palette=palette, dither=Image.Dither.NONE) for picture in pictures
    )
    options = {"append_images": others, "duration": 10 * round(100 * seconds), "loop": 0, "optimize": False}
    with replace_file(path) as scratch:
        first.save(scratch, "GIF", save_all=True, **options)
        small = scratch.stat().st_size <= GIF_BYTES
    return path if small or len(pictures) <= 2 else write_gif(path, pictures[::2], 2 * seconds, colours)


def write_mp4(path: Path, pictures: Sequence[np.ndarray], seconds: float) -> Path | None:
    """Writes the same as MP4 if ffmpeg is on the PATH, else returns None; raises RunError if ffmpeg fails."""
    program = shutil.which("ffmpeg")
    if program is None:
        return None
    height, width, _ = pictures[0].shape
    source = ["-f", "rawvideo", "-pix_fmt", "rgb24", "-s", f"{width}x{height}", "-r", f"{1 / seconds:g}", "-i", "-"]
    frames = np.stack(pictures).tobytes()
    with replace_file(path) as scratch:
        target = ["-pix_fmt", "yuv420p", "-f", "mp4", f"file:{scratch}"]
        command = [program, "-y", "-loglevel", "error", *source, *target]
        done = subprocess.run(command, input=frames, capture_output=True)
        if done.returncode:
            reason = done.stderr.decode(errors="replace").strip().rpartition("\n")[2]
            raise RunError(f"ffmpeg cannot write {path}: {reason}")
    return path
