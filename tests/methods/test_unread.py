"""Settings that an agent does not read are refused, and no others: its traced programs show which it reads."""

from __future__ import annotations

import re
from dataclasses import replace
from fnmatch import fnmatch
from functools import partial

import jax
import pytest

from ear_jax.cli.main import main
from ear_jax.config import Config, MamlConfig, flat, from_dict
from ear_jax.errors import UsageError
from ear_jax.methods import METHODS
from ear_jax.presets import check_effect, preset_config
from ear_jax.runs import training
from tests.helpers.runs import tiny_config

# Settings that are not the learner's (length, place, logging), and those that need another family or size.
ELSEWHERE = ("family", "preset", "agent", "engine", "seed", "seeds", "epochs", "minutes", "task*", "env.*", "log.*")
OF_PARTS = ("collect.pretrain_epochs", "collect.overlap", "network.history", "network.equivariant", "replay.symmetry")
NOT_TRIED = (*ELSEWHERE, "checkpoint.*", *OF_PARTS)


def other_value(name: str, value: object) -> object:
    """Returns another valid value of a setting; that of one not given is 1."""
    if value is None:
        return 1
    if isinstance(value, bool):
        return not value
    if isinstance(value, int):
        return value + 2 if name in ("sac.batch_size", "collect.steps", "replay.capacity") else value + 1
    if isinstance(value, float):
        return 0.5 * value or 0.25
    others = {"authors": "fan_in", "fan_in": "authors", "float32": "bfloat16", "spread": "gathered", "onehot": "lte"}
    return others[value]


def with_setting(config: Config, name: str, value: object) -> Config:
    group, _, setting = name.rpartition(".")
    if not group:
        return replace(config, **{setting: value})
    return replace(config, **{group: replace(getattr(config, group), **{setting: value})})


def traced(config: Config) -> str:
    """Returns a fresh run, its collection and its updates as JAX traces them.

    A learner that is on-policy starts its own environments, so a run's own play no part.
    """
    program, key = training.make_program(config), jax.random.key(0)
    begin = program.learner.init if program.learner.on_policy else partial(training.init, program)
    state = jax.eval_shape(lambda key: training.init(program, key), key)
    parts = (
        jax.make_jaxpr(begin)(key),
        jax.make_jaxpr(lambda state: training.collect(program, state))(state),
        jax.make_jaxpr(lambda state: training.learn(program, state))(state),
    )
    return re.sub(r"0x[0-9a-f]+", "", "\n".join(map(str, parts)))


def accepts(config: Config) -> bool:
    """Returns whether a method can work with a configuration at all."""
    try:
        METHODS[config.agent].check(config)
    except UsageError:
        return False
    return True


@pytest.mark.slow
@pytest.mark.parametrize("agent", METHODS)
def test_what_an_agent_does_not_read_is_what_changes_nothing_of_its_programs(agent):
    network = replace(preset_config("halfcheetah-vel", "smoke", agent).network, width=8, task_width=8, task_layers=1)
    tiny = tiny_config(agent=agent, network=network)
    tiny = replace(tiny, replay=replace(tiny.replay, own_share=0.5), sac=replace(tiny.sac, lr_decay=9))
    on_policy = METHODS[agent].learner.on_policy
    if on_policy:
        tiny = replace(tiny, sac=replace(tiny.sac, updates=1), collect=replace(tiny.collect, steps=6))
    scaled = replace(tiny, sac=replace(tiny.sac, return_scale=1.0))  # which critic_bins needs
    before = {tiny: traced(tiny)}
    assert traced(tiny) == before[tiny]
    for name, value in flat(tiny).items():
        if any(fnmatch(name, pattern) for pattern in NOT_TRIED) or (on_policy and name == "sac.updates"):
            continue
        config = scaled if name == "network.critic_bins" and accepts(scaled) else tiny
        before[config] = before.get(config) or traced(config)
        try:
            after = traced(with_setting(config, name, other_value(name, value)))
        except UsageError:
            after = "refused"
        assert (after == before[config]) is not METHODS[agent].reads(name), name


def test_they_are_refused_and_others_are_not():
    for agent in METHODS:
        config = preset_config("halfcheetah-vel", "fast", agent)
        check_effect(config)
        check_effect(replace(config, epochs=3, network=replace(config.network, width=8)))
    with pytest.raises(UsageError, match=r"--maml.inner-lr 3.0 would change nothing: agent 'onehot' has no use for it"):
        check_effect(replace(preset_config("ant-dir", "fast", "onehot"), maml=MamlConfig(inner_lr=3.0)))


@pytest.mark.parametrize(
    ("words", "complaint"),
    [
        ("halfcheetah-vel --agent multihead --network.lse-size 8", "--network.lse-size 8 would change nothing"),
        ("halfcheetah-vel --agent maml --sac.discount 0.9", "agent 'maml' has no use for it"),
        ("halfcheetah-vel --agent ear --meta-batch 5", "agent 'ear' has no use for it"),
        ("halfcheetah-vel --tasks 1 2 --task-count 5", "--task-count 5 would change nothing: the tasks are named"),
        ("halfcheetah-run-jump --task-count 5", "has no range to spread 5 tasks over; name them with --tasks"),
        ("halfcheetah-vel --task-count 1001", "--task-count 1001 is too large; it must be at most 1000"),
        ("halfcheetah-vel --agent pearl --meta-batch 7", "cannot be split evenly over 7 tasks; try 476 or 483"),
        ("halfcheetah-vel --replay.symmetry True", "halfcheetah-vel has no symmetry"),
        ("halfcheetah-vel --agent ear-rnn --network.encoder-layers 0", "whose first layer is its RNN"),
        ("halfcheetah-vel --agent pearl --sac.return-scale 10", "does not go with pearl"),
    ],
)
def test_the_command_line_says_so_in_one_line(words, complaint, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert main(["train", *words.split()]) == 2
    err = capsys.readouterr().err
    assert complaint in err
    assert err.count("\n") == 1


def test_every_agent_and_pattern_is_real():
    names = flat(from_dict({"family": "x"}))
    patterns = {pattern for method in METHODS.values() for pattern in method.unread}
    assert all(any(fnmatch(name, pattern) for name in names) for pattern in patterns)
