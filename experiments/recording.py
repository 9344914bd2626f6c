"""Draws `docs/images/explore.gif`, README's first picture, and `explore.png`: the live page while it is used.

    ear explore --all
    python -m experiments.recording

Needs Chromium. The page's time advances by one picture at a time, so that a slow machine records the same film.
"""

from __future__ import annotations

import io
import json
import sys
import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
from PIL import Image

from ear_jax.cli.exits import exit_code
from ear_jax.errors import RunError
from ear_jax.figures.video import write_gif
from experiments.browser import Browser, chromium

PAGE = Path("runs") / "explore.html"
IMAGES = Path(__file__).parents[1] / "docs" / "images"
WIDTH, HEIGHT = 1280, 800  # of the page
FILM_WIDTH = 720  # pixels
COLOURS = 160
SECONDS = 0.1  # from one picture to the next
# For each robot: seconds to settle, then the tasks passed on the way, and the seconds of that way.
SCENES = (("halfcheetah-vel", 3.0, (1, 3, 5, 8), 3.6), ("ant-dir", 2.0, (6, 9, 12, 15), 2.6))
DRAWN = "new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done)))"


def record(page: Path) -> Iterator[np.ndarray]:
    """Yields the pictures [height, width, 3] of a film of the gallery's page."""
    with Browser(WIDTH, HEIGHT) as browser:
        browser.open(page, "window.ear && ear.ready")
        for name, settling, tasks, seconds in SCENES:
            browser.run(f"ear.ready = 0, ear.open(ear.robots.indexOf({json.dumps(name)}))")
            browser.wait("ear.ready")
            browser.run(f"ear.reader.byHand = true, ear.go({tasks[0]})")
            for _ in range(round(settling / SECONDS)):
                browser.run(f"ear.advance({SECONDS})")
            count = round(seconds / SECONDS)
            for moment in range(count + 8):
                browser.run(
                    f"ear.show.steering.choose({json.dumps(_on_the_way(browser, tasks, min(1, moment / count)))})"
                )
                browser.run(f"ear.advance({SECONDS}), {DRAWN}")
                yield _picture(browser)


def _on_the_way(browser: Browser, tasks: Sequence[int], share: float) -> list[float]:
    """Returns the blend of two neighbouring tasks that is a share of the way along several, eased at both ends."""
    eased = (3 - 2 * share) * share**2 * (len(tasks) - 1)
    first = min(int(eased), len(tasks) - 2)
    ends = [np.array(browser.run(f"ear.show.tasks[{tasks[index]}].lte")) for index in (first, first + 1)]
    mixed = ends[0] + (eased - first) * (ends[1] - ends[0])
    return (mixed / np.linalg.norm(mixed)).tolist()


def _picture(browser: Browser) -> np.ndarray:
    with tempfile.TemporaryDirectory() as folder:
        image = Image.open(io.BytesIO(browser.picture(Path(folder) / "page.png").read_bytes())).convert("RGB")
    return np.asarray(image.resize((FILM_WIDTH, round(FILM_WIDTH * HEIGHT / WIDTH)), Image.Resampling.LANCZOS))


def main(page: Path = PAGE, images: Path = IMAGES) -> None:
    if chromium() is None:
        raise RunError("the recording needs Chromium, which is not installed")
    if not page.is_file():
        raise RunError(f"no page {page}: run `ear explore --all` first")
    print(write_gif(images / "explore.gif", list(record(page)), SECONDS, COLOURS))
    with Browser(WIDTH, HEIGHT) as browser:
        browser.open(page, "window.ear && ear.ready")
        browser.run("ear.reader.byHand = true, Array.from({ length: 80 }, () => ear.advance(0.1)).length")
        browser.run(DRAWN)
        print(browser.picture(images / "explore.png"))


if __name__ == "__main__":
    sys.exit(exit_code("experiments.recording", main))
