"""`python -m experiments report`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from ear_jax.cli.arguments import parse
from ear_jax.errors import RunError, UsageError
from ear_jax.presets import preset_config
from experiments.paper import CHEETAH
from experiments.report import markdown, page, readme
from experiments.report.blocks import Block
from experiments.report.comparison import comparison
from experiments.report.run_index import RunIndex
from experiments.report.sections import all_runs, all_sections

TITLE = "Emergent action representations: the paper's tables and figures, and ours"


@dataclass(frozen=True)
class ReportCommand:
    """The paper's tables and figures beside ours, as a page and as Markdown, from the records alone."""

    out: Path = Path("runs/report")
    """Where index.html, tables.md and figures/ go."""
    preset: str = "fast"
    """The preset of the runs."""
    docs: bool = False
    """Only put the results into README.md and docs/results.md."""


def report(words: list[str]) -> None:
    """Runs the command.

    Raises:
      UsageError: no such preset, or a file where the directory would be.
      RunError: a record that cannot be read, or a place that cannot be written.
    """
    command = parse(ReportCommand, words, "report", program="python -m experiments")
    preset_config(CHEETAH, command.preset)
    found = RunIndex(command.preset)
    for path in readme.rewrite(found) if command.docs else write(found, command.out):
        print(path)


def write(found: RunIndex, out: Path) -> Sequence[Path]:
    """Writes the page with its figures, and the Markdown; returns the paths of the two.

    Raises:
      UsageError, RunError: as `report`.
    """
    if any(path.exists() and not path.is_dir() for path in (out, *out.parents)):
        raise UsageError(f"--out {out} is no directory, and cannot be made one")
    try:
        out.mkdir(parents=True, exist_ok=True)
        sections = [comparison(found), *all_sections(found, out), all_runs(found)]
        paths = out / "index.html", out / "tables.md"
        for path, render in zip(paths, (page.page, markdown.document), strict=True):
            path.write_text(render(TITLE, lead(found), sections), encoding="utf-8")
    except OSError as error:
        raise RunError(f"cannot write the report to {out}: {error.strerror}") from None
    return paths


def lead(found: RunIndex) -> list[Block]:
    """How to read the report."""
    return [
        f"Ours are the runs of the preset `{found.preset}` that `experiments/records` holds; nothing is trained or "
        "played to make this page. The paper is Simple Emergent Action Representations from Multi-Task Policy Training "
        "(arXiv 2210.09566), its numbers as `experiments/paper.json` has them.",
        "± is the sample standard deviation over seeds. IQM is the interquartile mean of all seeds' task returns: of n "
        "the lowest and the highest ⌊n / 4⌋ are left out. Brackets are 95 % intervals by bootstrap, seeds drawn anew "
        "for each task; one seed gives none. P(EAR better) is how often a seed of EAR-SAC beats one of that method on "
        "the same task, ties counting one half. — is what is not there.",
        f"Made by `python -m experiments report --preset {found.preset}`.",
    ]
