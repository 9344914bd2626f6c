"""Model cards: Markdown with the front matter that model hubs read, made from a policy's JSON card. Imports no JAX."""

from __future__ import annotations

import json
import re
import shlex
from statistics import pstdev
from typing import Any

from ear_jax.config import env_flags
from ear_jax.names import FAMILIES
from ear_jax.runs import onnx

LIBRARY = "ear-jax"


def to_markdown(card: dict[str, Any], file: str) -> str:
    """Writes a policy's card as a model card.

    Args:
      card: the document that `runs.card.make_card` returns.
      file: the name of the policy's file beside it.
    """
    parts = (
        ["---", *_front_matter(card), "---"],
        [f"# {_text(card['name'])}"],
        _about(card),
        _use(file, card["family"]),
        _results(card),
    )
    return "\n\n".join("\n".join(part) for part in parts) + "\n"


def _front_matter(card: dict[str, Any]) -> list[str]:
    """Returns the front matter in YAML, whose strings are written as JSON's."""
    metric = f"{card['mean_return']:.2f} +/- {pstdev(task['return'] for task in card['tasks']):.2f}"
    shipped = ["license: mit"] if "record" in card else []  # the owner of another policy chooses its licence
    return [
        *shipped,
        f"library_name: {LIBRARY}",
        "pipeline_tag: reinforcement-learning",
        "tags:",
        *(f"- {json.dumps(tag)}" for tag in (*TAGS, card["family"], card["agent"])),
        "model-index:",
        f"- name: {json.dumps(card['name'])}",
        "  results:",
        "  - task:",
        "      type: reinforcement-learning",
        "      name: multi-task reinforcement learning",
        "    dataset:",
        f"      name: {json.dumps(card['family'])}",
        f"      type: {json.dumps(card['family'])}",
        "    metrics:",
        "    - type: mean_reward",
        f"      value: {json.dumps(metric)}",
        "      name: mean return over tasks, and its standard deviation over tasks",
        "      verified: false",
    ]


TAGS = ("reinforcement-learning", "multi-task", "robotics", "mujoco", "jax", "emergent-action-representations")


def _about(card: dict[str, Any]) -> list[str]:
    together = f", one of {card['side_by_side']} trained side by side" if card["side_by_side"] > 1 else ""
    return [
        "One policy for many tasks. A task embedding (LTE) says which: those of the training tasks are in the file; "
        "blends of them or others found by search make the robot do what it was not trained on.",
        "",
        "| | |",
        "|---|---|",
        f"| family | {_text(card['family'])} |",
        f"| method | {card['agent']}, preset {card['preset']} |",
        f"| trained by | {_code(card['command'])} (seed {card['seed']}{together}) |",
        f"| training | {card['env_steps']:,} env steps, {card['updates']:,} updates, {card['minutes']:g} minutes |",
        *([f"| refined | {_refinement(card['refined'])} |"] if "refined" in card else []),
        *(
            [f"| chosen among | {card['seeds']} seeds, mean return {card['mean_of_seeds']:.1f} |"]
            if "seeds" in card
            else []
        ),
        f"| engine | {card['engine']} |",
        f"| machine | {card['machine'].get('processor')}, {card['machine'].get('cores')} cores |",
        f"| versions | {', '.join(f'{name} {version}' for name, version in card['versions'].items() if version)} |",
        f"| commit | {card['commit']} |",
    ]


def _refinement(refined: dict[str, Any]) -> str:
    ((before, after),) = refined["mean_returns"]
    return (
        f"by `ear refine{env_flags(refined.get('options', {}))}`, with {refined['env_steps']:,} of the env steps and "
        f"{refined['updates']:,} gradient steps: mean return {before:.1f} before, {after:.1f} after"
    )


def _use(file: str, family: str) -> list[str]:
    if file.endswith(onnx.SUFFIX):
        lines = [
            "import json",
            "import numpy as np",
            "import onnxruntime",
            "",
            f"session = onnxruntime.InferenceSession({json.dumps(file)})",
            'ltes = json.loads(session.get_modelmeta().custom_metadata_map["ltes"])  # task → LTE',
            "lte = np.array([next(iter(ltes.values()))], np.float32)  # [1, code]",
            "obs = np.zeros((1, session.get_inputs()[1].shape[1]), np.float32)  # [1, obs]",
            '(action,) = session.run(["action"], {"lte": lte, "obs": obs})  # in [-1, 1]',
        ]
        return ["## Use", "", "```python", *lines, "```"]
    own = family not in FAMILIES
    words = shlex.quote(file) + f" --family {shlex.quote(family)}" * own
    needed = ["", "The family's code is not in the file and has to be there."] * own
    return ["## Use", "", "```", f"ear evaluate {words}", f"ear explore {words}", "```", *needed]


def _results(card: dict[str, Any]) -> list[str]:
    rows = ["| task | target | achieved | return | met |", "|---|---|---|---|---|"]
    for task in card["tasks"]:
        met = {True: "yes", False: "no", None: "–"}[task.get("met")]
        cells = (_number(task.get("target")), _number(task.get("achieved")), _number(task["return"], 1), met)
        rows.append(f"| {_text(task['name'])} | {' | '.join(cells)} |")
    return [
        "## Results and limits",
        "",
        f"{_text(card['limits'])} The mean return is {card['mean_return']:.1f}, from {card['returns_from']} with "
        f"{card['episodes']} episodes of each task.",
        "",
        *rows,
    ]


def _text(words: str) -> str:
    """Returns words as Markdown shows them as they are, also in a cell of a table."""
    return re.sub(r"[\\`*_{}\[\]<>|$&~]", r"\\\g<0>", words)


def _code(words: str) -> str:
    """Returns words as Markdown shows them as code, also in a cell of a table."""
    longest = max(map(len, re.findall("`+", words)), default=0)
    fence = "`" * (longest + 1)
    inner = f" {words} " if longest else words
    return fence + inner.replace("|", "\\|") + fence


def _number(value: float | None, digits: int = 2) -> str:
    return "–" if value is None else f"{value:.{digits}f}"
