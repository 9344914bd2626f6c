"""Pages of the site that are made from other files: README, CONTRIBUTING, CHANGELOG and the command line itself."""

from __future__ import annotations

import re
import sys
from pathlib import Path
from typing import Any

from mkdocs.structure.files import File, Files

ROOT = Path(__file__).parents[2]
sys.path[:0] = [str(ROOT), str(Path(__file__).parent)]

import cli_reference  # noqa: E402

PAGES = {"index.md": "README.md", "contributing.md": "CONTRIBUTING.md", "changelog.md": "CHANGELOG.md"}
COPIES = ("benchmarks/results/benchmarks.png",)  # pictures that pages show from elsewhere in the repository
LINK = re.compile(r"(\]\(|src=\")([^)\"#:]+)(#[^)\"]*)?([)\"])")

ELSEWHERE = re.compile(r"\[([^\]]+)\]\((?:\.\./)?((?:experiments|ear_jax|tests)/[^)]*)\)")


def on_files(files: Files, config: Any) -> Files:
    """Adds the generated pages."""
    for page, source in PAGES.items():
        files.append(File.generated(config, page, content=relinked((ROOT / source).read_text(encoding="utf-8"))))
    files.append(File.generated(config, "reference/cli.md", content=cli_reference.page()))
    for copy in COPIES:
        files.append(File.generated(config, f"images/{Path(copy).name}", abs_src_path=str(ROOT / copy)))
    return files


def on_page_markdown(markdown: str, page: Any, **_: Any) -> str:
    """Names what a page links to outside of the documents, as the site has no copy of it."""
    return ELSEWHERE.sub(r"\1 (`\2` in the repository)", markdown)


def relinked(text: str) -> str:
    """Points the links of a file in the repository's root to pages of the site."""
    pages = {source: page for page, source in PAGES.items()}

    def moved(match: re.Match[str]) -> str:
        opening, target, anchor, closing = match.groups()
        target = pages.get(target, target.removeprefix("docs/"))
        if target in COPIES:
            target = f"images/{Path(target).name}"
        return f"{opening}{target}{anchor or ''}{closing}"

    text = LINK.sub(moved, text)
    text = re.sub(r"<!--.*?-->\n*", "", text)
    return ELSEWHERE.sub(r"\1 (`\2` in the repository)", text)
