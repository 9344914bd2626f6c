"""`ear config FAMILY`."""

from __future__ import annotations

import dataclasses
import json

from ear_jax.cli.arguments import HELP
from ear_jax.cli.train import read
from ear_jax.config_files import to_toml
from ear_jax.errors import UsageError

USAGE = """usage: ear config FAMILY [OPTIONS OF ear train] [--json]

Print every setting that `ear train` would train with, as TOML or, with --json, as JSON. Saved to a file, these are
settings for `ear train --config FILE`.

Example: ear config halfcheetah-vel --sac.lr 3e-4"""


def main(words: list[str]) -> None:
    if set(HELP) & set(words):
        print(USAGE)
        return
    if not words:
        raise UsageError("name a family first, as in `ear config halfcheetah-vel` (`ear families` lists them)")
    config = read([word for word in words if word != "--json"]).config
    print(json.dumps(dataclasses.asdict(config)) if "--json" in words else to_toml(config), end="")
