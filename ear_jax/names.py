"""Names of the families, methods and engines, known without importing them, so that a mistyped one costs no time.

A name is its file's in `envs/` or `methods/`, with dashes for underscores; a new one needs its file and a line here.
"""

from __future__ import annotations

import ast
import os
from importlib.metadata import EntryPoint, entry_points
from pathlib import Path

from ear_jax.errors import UsageError, known_name

FAMILY_FILES = (  # each defines FAMILY
    "halfcheetah_vel",
    "ant_dir",
    "hopper_vel",
    "walker_vel",
    "halfcheetah_run_jump",
    "reach",
)
METHOD_FILES = (  # each defines METHOD
    "ear",
    "ear_rnn",
    "onehot",
    "onehot_blind",
    "multihead",
    "pearl",
    "maml",
)
ENGINES = ("native", "mjx", "mjx-fixed", "warp")
ENTRY_POINTS = "ear_jax.families"  # entry-point group of families in installed packages


def name_of(file: str) -> str:
    """Returns the name that users give to what a file defines."""
    return file.replace("_", "-")


FAMILIES = tuple(map(name_of, FAMILY_FILES))
METHODS = tuple(map(name_of, METHOD_FILES))


def family_name(word: str) -> str:
    """Returns the name of the family that a user's word means.

    Returns:
      The name of a family that ships or that an installed package offers, or path/to/file.py:ClassName.

    Raises:
      UsageError: there is no such family or file, or only a file is named.
    """
    path, colon, class_name = os.path.expanduser(word).rpartition(":")
    if colon:
        if not os.path.isfile(path):
            raise UsageError(f"no file {path}; name your own family as path/to/file.py:ClassName")
        return f"{path}:{class_name}"
    if word.endswith(".py") or os.path.isfile(class_name):
        raise UsageError(f"{word} names no class; name your own family as {word}:{_first_class(class_name)}")
    return word if word in FAMILIES else known_name("family", word, (*FAMILIES, *offered_families()))


def offered_families() -> dict[str, EntryPoint]:
    """Returns the entry points of families in installed packages, by name."""
    return {point.name: point for point in entry_points(group=ENTRY_POINTS)}


def _first_class(file: str) -> str:
    """Returns the name of the first class in a file that derives from another, read without running the file."""
    try:
        body = ast.parse(Path(file).read_bytes()).body
    except (OSError, SyntaxError, ValueError):
        return "ClassName"
    return next((node.name for node in body if isinstance(node, ast.ClassDef) and node.bases), "ClassName")
