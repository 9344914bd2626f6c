"""Wall time of six runs on a Ray cluster of two nodes with a core each, against the same six by hand, two at a time.

The runs are naps, so that only what Ray adds is measured: connecting, starting workers, noticing ends. Needs the extra
`cluster`. The cluster is up before the clock starts.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from benchmarks import common
from ear_jax.cli.exits import exit_code
from tests.helpers.raylets import two_nodes

RUNS, AT_ONCE = 6, 2
NAP = (
    "timeit",
    "-n",
    "1",
    "-r",
    "1",
    "-s",
    "import time",
)  # of the standard library, with the nap's statement to follow


def words(seconds: float) -> tuple[str, ...]:
    """Returns the words of a nap, after `python -m`."""
    return (*NAP, f"time.sleep({seconds})")


def by_hand(seconds: float) -> None:
    line = [sys.executable, "-m", *words(seconds)]
    with ThreadPoolExecutor(AT_ONCE) as pool:
        list(pool.map(lambda _: subprocess.run(line, check=True, stdout=subprocess.DEVNULL), range(RUNS)))


def on_ray(seconds: float) -> None:
    from ear_jax.runs.on_ray import Job, check, run_jobs

    with tempfile.TemporaryDirectory() as scratch:
        where = Path(scratch)
        jobs = [Job(f"run{index}", words(seconds), where / f"run{index}", 1) for index in range(RUNS)]
        check(run_jobs(jobs, where / "logs", cores=1), where / "logs")


def timed(run: Callable[[float], None], seconds: float) -> float:
    began = time.perf_counter()
    run(seconds)
    return time.perf_counter() - began


def main() -> None:
    options = common.arguments(__doc__)
    seconds, repeats = (2.0, 1) if options.quick else (60.0, 3)
    with two_nodes(os.environ) as (_, address):
        os.environ["RAY_ADDRESS"] = address
        hand, ray = [], []
        for _ in range(repeats):
            hand.append(timed(by_hand, seconds))
            ray.append(timed(on_ray, seconds))
        row = {"runs": RUNS, "at_once": AT_ONCE, "seconds_a_run": seconds, "repeats": repeats}
        row |= common.spread("by_hand_seconds", hand) | common.spread("on_ray_seconds", ray)
        row |= common.spread("ratio", common.ratios(ray, hand))
        common.write_row(options, "cluster", row)


if __name__ == "__main__":
    sys.exit(exit_code("cluster", main))
