"""Generated parts of our documents, each between two HTML comments as markers."""

from __future__ import annotations

from pathlib import Path

from ear_jax.errors import RunError
from ear_jax.files.replacing import write_text


def put(path: Path, name: str, content: str) -> None:
    """Replaces the text between `<!-- name -->` and `<!-- /name -->`, and nothing else.

    Raises:
      RunError: the document lacks the markers, or cannot be read or written.
    """
    try:
        before, _, after = _split(path, name)
    except OSError as error:
        raise RunError(f"cannot read {path}: {error.strerror}") from None
    write_text(path, f"{before}\n\n{content.strip()}\n\n{after}")


def read(path: Path, name: str) -> str:
    """Returns the text between the markers; raises RunError if the document lacks them."""
    return _split(path, name)[1].strip()


def _split(path: Path, name: str) -> tuple[str, str, str]:
    """Returns the text before, between and after the markers; the markers belong to the outer parts."""
    opening, closing = f"<!-- {name} -->", f"<!-- /{name} -->"
    before, found, rest = path.read_text("utf-8").partition(opening)
    between, ended, after = rest.partition(closing)
    if not (found and ended):
        raise RunError(f"{path} lacks the markers {opening} and {closing} for the generated {name}")
    return before + opening, between, closing + after
