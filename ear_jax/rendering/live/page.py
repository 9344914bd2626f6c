"""The live page as one HTML file: its own sources, MuJoCo's WebAssembly and the robots."""

from __future__ import annotations

import html
import json
import re
from collections.abc import Sequence
from importlib.metadata import PackageNotFoundError, files
from pathlib import Path
from typing import Any

from ear_jax.files.replacing import write_text
from ear_jax.rendering.live.programs import pack
from ear_jax.rendering.live.wasm import Wasm

SOURCES = Path(__file__).with_name("page")
# In an order in which each uses only those before it.
MODULES = (
    *("blobs", "program", "physics", "colours", "sphere", "camera", "robot", "trace"),
    *("steering", "keeping", "main"),
)
LICENSED = ("mujoco", "gymnasium", "metaworld")  # packages of which a page holds parts: physics and robots


def write_live_page(path: Path, robots: Sequence[tuple[dict[str, Any], str]], wasm: Wasm) -> Path:
    """Writes the page.

    Args:
      path: the file to write.
      robots: for each robot its description and its constants, from `robot.describe`.
      wasm: MuJoCo's WebAssembly.
    """
    blobs = {"mujoco-module": pack(wasm.module), "mujoco-binary": pack(wasm.binary)}
    blobs |= {f"constants-{index}": constants for index, (_, constants) in enumerate(robots)}
    data = json.dumps({"robots": [robot for robot, _ in robots]}, separators=(",", ":"))
    parts = {
        "style": (SOURCES / "page.css").read_text(encoding="utf-8"),
        "script": script(),
        "licences": html.escape(licences()),
        "data": data.replace("<", "\\u003c"),  # so that no name can end the script
        "blobs": "\n".join(f'<script type="text/plain" id="{name}">{text}</script>' for name, text in blobs.items()),
    }
    template = (SOURCES / "page.html").read_text(encoding="utf-8")
    write_text(path, re.sub(r"\{\{(\w+)\}\}", lambda found: parts[found[1]], template))
    return path


def script() -> str:
    """Joins the modules into one, without their imports from each other."""
    texts = [(SOURCES / f"{name}.js").read_text(encoding="utf-8") for name in MODULES]
    joined = "\n".join(texts)
    joined = re.sub(r'^import \{[^}]*\} from "\./\w+\.js";\n', "", joined, flags=re.MULTILINE)
    return re.sub(r"^export ", "", joined, flags=re.MULTILINE)


def licences() -> str:
    """Returns the licences of the packages of which a page holds parts, as far as they are installed."""
    texts = []
    for package in LICENSED:
        try:
            texts += [f"{package}\n\n{file.read_text()}" for file in files(package) or [] if file.name == "LICENSE"]
        except PackageNotFoundError:
            continue
    return "\n\n".join(texts)
