"""Parts of our documents that are written from records, each between two markers."""

from __future__ import annotations

from pathlib import Path

from ear_jax.errors import RunError


def put(path: Path, name: str, content: str) -> None:
    """Writes what stands between `<!-- name -->` and `<!-- /name -->`, and nothing else.

    Raises:
      RunError: the document has not the two markers, or cannot be read or written.
    """
    try:
        before, _, after = _split(path, name)
        path.write_text(f"{before}\n\n{content.strip()}\n\n{after}", encoding="utf-8")
    except OSError as error:
        raise RunError(f"cannot write {path}: {error.strerror}") from None


def read(path: Path, name: str) -> str:
    """What stands there; raises RunError where the document has not the two markers."""
    return _split(path, name)[1].strip()


def _split(path: Path, name: str) -> tuple[str, str, str]:
    """What is before, between and after the markers; the first and the last part end and begin with one."""
    opening, closing = f"<!-- {name} -->", f"<!-- /{name} -->"
    before, found, rest = path.read_text("utf-8").partition(opening)
    between, ended, after = rest.partition(closing)
    if not (found and ended):
        raise RunError(f"{path} has no place for the {name}, between {opening} and {closing}")
    return before + opening, between, closing + after
