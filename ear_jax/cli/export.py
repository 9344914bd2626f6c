"""`ear export RUN FILE`."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import tyro

from ear_jax import pretrained
from ear_jax.cli.arguments import option, parse
from ear_jax.cli.on_run import load_run
from ear_jax.cli.results import check_writable
from ear_jax.errors import RunError, UsageError
from ear_jax.files.replacing import write_text
from ear_jax.pretrained import SUFFIX
from ear_jax.process.terminal import say
from ear_jax.runs import records
from ear_jax.runs.onnx import SUFFIX as ONNX

if TYPE_CHECKING:
    from ear_jax.runs.trained import Trained

CARD = "README.md"  # where model hubs look for it


@dataclass(frozen=True)
class ExportCommand:
    """Write a run's newest policy to one file, without its replay.

    A .safetensors file takes the place of a run in every command that plays a policy. An .onnx file runs where there is
    no JAX: it takes LTEs and observations, and returns actions.

    Example: ear export pretrained:hopper-vel hopper.onnx --card
    """

    run: tyro.conf.Positional[Annotated[Path, tyro.conf.arg(metavar="RUN")]]
    """The run directory, an exported file, or pretrained:NAME."""
    file: tyro.conf.Positional[Annotated[Path, tyro.conf.arg(metavar="FILE")]]
    """The new file, which must end in .safetensors or .onnx (pip install 'ear-jax[onnx]')."""
    policy: Annotated[int | None, option("INT", "those of all seeds")] = None
    """The policy to write of a run with several seeds; 0 is the first seed's. An .onnx file holds one."""
    card: bool = False
    """Write a model card too, README.md beside the file, with the front matter that model hubs read."""
    family: Annotated[str | None, option("FAMILY", "the run's")] = None
    """The run's family, as for `ear train`; required for a family of your own."""
    json: bool = False
    """Print one JSON document and nothing else."""


def main(words: list[str]) -> None:
    command = parse(ExportCommand, words, "export")
    if command.file.suffix not in (SUFFIX, ONNX):
        raise UsageError(f"{command.file} must end in {SUFFIX} or {ONNX}")
    card_file = command.file.with_name(CARD)
    for file in (command.file, card_file) if command.card else (command.file,):
        if file.exists():
            raise UsageError(f"{file} already exists; name another file")
    if command.file.suffix == ONNX:
        from ear_jax.runs.onnx import import_onnx

        import_onnx()
    check_writable(command.file.parent)
    trained = load_run(command.run, command.family, "auto")  # no physics is stepped, so that any engine will do
    from ear_jax.runs.trained import describe, pick, save

    if command.policy is not None:
        trained = pick(trained, command.policy)
    seeds = trained.program.config.seeds
    if seeds > 1 and (command.card or command.file.suffix == ONNX):
        raise UsageError(f"{command.run} has {seeds} policies; choose one with --policy 0 to {seeds - 1}")
    rows = records.read_rows(command.run / "metrics.jsonl", say, records.METRICS)
    model_card = _model_card(command, trained, rows) if command.card else None
    written: dict[str, Any] = {"file": str(command.file), "epoch": trained.epoch}
    if command.file.suffix == ONNX:
        written |= {"card": describe(trained, rows), "largest_difference": _write_onnx(command.file, trained)}
    else:
        written["card"] = save(command.file, trained, rows)
    written["bytes"] = command.file.stat().st_size
    if model_card is not None:
        write_text(card_file, model_card)
        written["model_card"] = str(card_file)
    _print(written, command.json)


def _print(written: dict[str, Any], as_json: bool) -> None:
    if as_json:
        print(json.dumps(written))
        return
    print(f"{written['card']}\n\n{written['file']}: {written['bytes']:,} bytes")
    if "largest_difference" in written:
        print(f"onnxruntime against JAX: actions differ by at most {written['largest_difference']:.1e}")
    if "model_card" in written:
        print(f"{written['model_card']}: the model card")


def _write_onnx(file: Path, trained: Trained) -> float:
    """Writes the policy of a single seed as ONNX if it agrees with JAX; returns the largest difference of actions.

    Raises:
      RunError: the policy cannot be written, or onnxruntime and JAX differ by more than `TOLERANCE`.
    """
    import jax
    import jax.numpy as jnp
    import numpy as np

    from ear_jax.rendering.live.programs import Constants, translate
    from ear_jax.runs.onnx import TOLERANCE, run_onnx, to_onnx, write_onnx
    from ear_jax.runs.trained import policy_of

    program, policy = trained.program, policy_of(trained, 0)
    agent, family = program.agent, program.family

    def act(lte: jax.Array, obs: jax.Array) -> tuple[jax.Array, jax.Array, jax.Array]:
        distribution = agent.distribution(policy, lte, obs)
        return jnp.tanh(distribution.mean), distribution.mean, distribution.log_std

    constants = Constants()
    try:
        translated = translate(act, constants, jnp.zeros(agent.code_size), jnp.zeros(family.observation_size))
    except UsageError as error:
        raise RunError(f"this policy cannot be written as ONNX: {error}") from None
    ltes = np.asarray(agent.codes(policy))
    metadata = {
        "family": family.name,
        "commanded": family.quantity,
        "ltes": dict(zip(program.tasks.names, ltes.tolist(), strict=True)),
        "about": {name: value for name, value in trained.about.items() if name != "leaves"},
    }
    model = to_onnx(translated, np.concatenate(constants.arrays), metadata)
    obs = np.random.default_rng(0).normal(size=(1000, family.observation_size)).astype(np.float32)
    codes = ltes[np.arange(len(obs)) % len(ltes)]
    expected = jax.vmap(act)(jnp.asarray(codes), jnp.asarray(obs))[0]
    difference = float(np.abs(run_onnx(model, codes, obs)[0] - expected).max())
    if not difference <= TOLERANCE:
        raise RunError(f"{file} is not written: actions of onnxruntime and JAX differ by {difference:.1e}")
    write_onnx(file, model)
    return difference


def _model_card(command: ExportCommand, trained: Trained, rows: list[dict[str, Any]]) -> str:
    """Returns the model card: of an agent that ships from its own card, of others from their records."""
    from ear_jax.runs.card import command_line, make_card
    from ear_jax.runs.model_card import to_markdown

    name = str(command.run)
    if name.startswith(pretrained.PREFIX):
        card = pretrained.card(name.removeprefix(pretrained.PREFIX))
    else:
        path = command.run / "evaluation.json"
        evaluation = records.read_json(path) if path.is_file() else None
        updates = trained.epoch * trained.program.config.sac.updates
        if evaluation and evaluation.get("updates") != updates:
            evaluation = None  # of an earlier policy
        config = trained.program.config
        card = make_card(command.run.stem, trained, command_line(config), rows, evaluation)
    return to_markdown(card, command.file.name)
