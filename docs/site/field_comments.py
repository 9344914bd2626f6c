"""Comments beside the fields of a class, such as their shapes, as the fields' descriptions in the reference."""

from __future__ import annotations

import io
import tokenize
from typing import Any

import griffe


class FieldComments(griffe.Extension):
    """Gives an attribute without a docstring the comment at the end of its line."""

    def on_attribute(self, *, attr: griffe.Attribute, **_: Any) -> None:
        """Describes an attribute of a class; called by Griffe for each."""
        if attr.docstring or not attr.parent or not attr.parent.is_class or not attr.source:
            return
        if comment := comment_of(attr.source):
            attr.docstring = griffe.Docstring(comment[0].upper() + comment[1:] + ".", parent=attr)


def comment_of(source: str) -> str:
    """Returns the comment in the source of a field, without its sign; empty if there is none."""
    try:
        tokens = list(tokenize.generate_tokens(io.StringIO(source.strip() + "\n").readline))
    except (tokenize.TokenError, IndentationError):
        return ""
    return next((token.string.lstrip("# ") for token in tokens if token.type == tokenize.COMMENT), "")
