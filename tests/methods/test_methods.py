"""Properties that all agents share, and those that set each apart: the reach of a gradient, sizes, codes."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from typing import Any, Literal

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from ear_jax.agents.tanh_gaussian import Gaussian
from ear_jax.embeddings.adapt import adapt
from ear_jax.embeddings.evaluate import evaluate
from ear_jax.embeddings.interpolate import play_blends, trained_ends
from ear_jax.embeddings.search import Search
from ear_jax.learning import losses
from ear_jax.learning.batch import Batches
from ear_jax.learning.pearl import CONTEXT
from ear_jax.methods import METHODS, Sizes, make_agent
from ear_jax.presets import preset_config
from ear_jax.runs.trained import Trained
from ear_jax.runs.training import Program, TrainState
from ear_jax.tasks import task_set
from tests.helpers.bandit import bandit_program, begin, one_update, parts, played, train_on, uncompiled

SLOWLY = {"ear-rnn"}  # to save time: test_recurrent.py asks it for more, and ear has codes as it has


@pytest.fixture(
    scope="module", params=[pytest.param(one, marks=[pytest.mark.slow] * (one in SLOWLY)) for one in METHODS]
)
def solved(request: pytest.FixtureRequest) -> Trained:
    """The bandit after 1,000 updates, which is enough for each agent but PEARL, which has to infer its code first.

    An epoch of MAML is one update.
    """
    program = bandit_program(request.param)
    state = train_on(program, begin(program), {"pearl": 60, "maml": 60}.get(request.param, 20))
    return Trained(request.param, program, jax.tree.map(lambda leaf: leaf[None], state.learner.policy), 20)


def test_each_agent_solves_the_bandit_as_well_as_what_it_sees_allows(solved):
    """The best action is the task's own target, or the mean of both, 0, for an agent that cannot tell tasks apart.

    MAML's is as far off as one gradient step on 512 random rewards is.
    """
    episodes = played(solved.program, jax.tree.map(lambda leaf: leaf[0], solved.policies), 4)
    best = [[0.0] * 4] * 2 if solved.name == "onehot-blind" else [[-0.5] * 4, [0.5] * 4]
    np.testing.assert_allclose(episodes.late["action"], best, atol=0.25 if solved.name == "maml" else 0.1)


def test_an_evaluation_of_tuned_codes_tells_what_tuning_gained(solved):
    """One action for both of the bandit's tasks returns at most −0.25."""
    (seed,) = evaluate(solved, episodes=4, seed=0)["seeds"]
    assert ("untuned_return" in seed) is solved.program.agent.tuned
    if solved.program.agent.tuned:
        assert seed["untuned_return"] <= -0.25
        assert seed["mean_return"] > -0.1


def test_search_over_codes_goes_as_far_as_codes_go(solved):
    """Between two LTEs or one-hots lies a code for 0.2, between the two trained actions; of heads there are only two.

    Actions are drawn next to the mean here, so that a search of few episodes is not misled by a lucky one. MAML takes
    the one gradient step that it is trained for. Nobody asks for a map of the sphere, so LSEs are left out.
    """
    program, agent = solved.program, solved.program.agent

    def certain(policy: Any, code: jax.Array, obs: jax.Array) -> Gaussian:
        return replace(agent.distribution(policy, code, obs), log_std=jnp.full(1, -9.0))

    sure = replace(solved, program=replace(program, agent=replace(agent, distribution=certain, embed=None)))
    tasks = task_set([program.family.parse_task("0.2")])
    found = adapt(sure, tasks, Search(epochs=4, elites=4, samples=10), episodes=1, seed=0)["tasks"][0]
    best, within = {
        "multihead": (-((0.5 - 0.2) ** 2), 0.07),
        "onehot-blind": (-(0.2**2), 0.05),
        "maml": (-0.09, 0.09),  # its advantages are standardised, so that it steps about as far as to the nearer task
        "pearl": (-0.06, 0.06),  # two tasks teach it little of others: hardly worse than the nearer of them, −0.09
    }.get(solved.name, (0.0, 0.002))
    assert found["epochs"][0 if agent.tuned else -1]["reevaluated"] == pytest.approx(best, abs=within)
    assert found["lte"] is None if agent.tuned else len(found["lte"]) == agent.code_size


def test_a_blend_lies_between_but_of_two_heads_is_one_of_them(solved):
    actions = play_blends(solved, [tuple(trained_ends(solved))], (0.9, 0.6, 0.4, 0.1), episodes=1, seed=0)[0, 0]
    if solved.name == "multihead":
        np.testing.assert_array_equal(actions[[0, 3]], actions[[1, 2]])
        assert actions[0] < actions[3], "two heads, not one"
    elif solved.name == "onehot-blind":
        np.testing.assert_array_equal(actions, actions[0], "no code changes what it does")
    else:
        assert (np.diff(actions) > 0.01).all(), "the second task's action is the larger"


@pytest.mark.parametrize("name", METHODS)
def test_codes_are_where_projection_leaves_them(name):
    config = preset_config("bandit", "smoke", name)
    agent = make_agent(Sizes(3 * config.network.history, 2, 4), config)
    project = jax.vmap(agent.project)
    anywhere = jax.random.normal(jax.random.key(1), (20, agent.code_size))

    @jax.jit
    def projections(key: jax.Array) -> tuple[jax.Array, ...]:
        table, elsewhere = agent.codes(agent.init_policy(key)), project(anywhere)
        return table, project(table), elsewhere, project(elsewhere)

    table, table_again, elsewhere, elsewhere_again = projections(jax.random.key(0))
    assert table.shape == (4, agent.code_size)
    np.testing.assert_allclose(table_again, table, atol=1e-6)
    np.testing.assert_allclose(elsewhere_again, elsewhere, atol=1e-6)
    norm = 1.0 if agent.on_sphere else {"multihead": 1.0, "onehot-blind": 0.0}.get(name)
    if norm is None:
        np.testing.assert_array_equal(elsewhere, anywhere)
    else:
        np.testing.assert_allclose(np.linalg.norm(elsewhere, axis=1), norm, atol=1e-5)


@pytest.mark.parametrize("name", ["ear", "ear-rnn"])
@pytest.mark.parametrize("task_layers", [0, 1])
def test_ltes_begin_spread_or_gathered(name, task_layers):
    def codes(start: Literal["spread", "gathered"], *seeds: int) -> jax.Array:
        config = preset_config("ant-dir", "fast", name)
        network = replace(config.network, task_layers=task_layers, lte_start=start)
        agent = make_agent(Sizes(27 * network.history, 8, 24), replace(config, network=network))
        keys = jax.vmap(jax.random.key)(jnp.array(seeds))
        return jax.jit(jax.vmap(lambda key: agent.codes(agent.init_policy(key))))(keys)

    (spread,), (here, there) = codes("spread", 0), codes("gathered", 0, 1)
    assert (spread @ spread.T).min() < np.cos(np.radians(60))
    for table in (here, there):
        assert (table @ table.T).min() > np.cos(np.radians(10))
    assert here[0] @ there[0] < np.cos(np.radians(10)), "the point where they begin is drawn"


HIDDEN = (400 + 1) * 400
EAR_POLICY = (18 * 400 + HIDDEN + 401 * 16) + 11 * 3 + (20 * 400 + 3 * HIDDEN + 401 * 12)
ONEHOT = (28 * 400 + 3 * HIDDEN + 401 * 12, 34 * 400 + 3 * HIDDEN + 401)
CONTEXT_ENCODER = 25 * 200 + 2 * 201 * 200 + 201 * 10


@pytest.mark.parametrize(
    ("name", "policy", "critic"),
    [
        ("ear", EAR_POLICY, ONEHOT[1]),
        ("ear-rnn", EAR_POLICY + 2 * 400 * 400, ONEHOT[1]),
        ("onehot", *ONEHOT),
        ("onehot-blind", *ONEHOT),
        ("multihead", 18 * 400 + 2 * HIDDEN + 401 * 120, 24 * 400 + 2 * HIDDEN + 401 * 10),
        ("pearl", CONTEXT_ENCODER + 23 * 300 + 2 * 301 * 300 + 301 * 12, 29 * 300 + 2 * 301 * 300 + 301),
        ("maml", 18 * 64 + 65 * 64 + 65 * 6 + 6, 0),
    ],
)
def test_parameter_counts_are_the_papers(name, policy, critic):
    """Each layer of the published settings has (inputs + 1) · outputs, summed by hand."""
    config = preset_config("halfcheetah-vel", "paper", name)
    agent = make_agent(Sizes(17 * config.network.history, action=6, tasks=10), config)
    assert agent.parameter_counts == {"policy": policy, "critic": critic}


def moved(before: Any, after: Any) -> Any:
    return jax.tree.map(lambda old, new: np.asarray(old) != np.asarray(new), before, after)


@pytest.fixture
def one_task(monkeypatch: pytest.MonkeyPatch) -> None:
    """Makes every item of a batch teach the second of the bandit's two tasks."""
    monkeypatch.setattr(Batches, "item_tasks", lambda self: jnp.ones(self.config.sac.batch_size, jnp.int32))


@pytest.mark.usefixtures("one_task")
def test_a_task_moves_its_own_lte_and_what_all_share():
    program = uncompiled(bandit_program("ear"))
    before, after, _ = one_update(program, begin(bandit_program("ear")))
    policy = moved(before.policy, after.policy)["networks"]
    np.testing.assert_array_equal(policy["task_encoder"]["params"]["Dense_0"]["kernel"], [[False] * 3, [True] * 3])
    assert all(leaf.any() for leaf in jax.tree.leaves((policy, moved(before.critics, after.critics))))
    assert moved(before.log_temperature, after.log_temperature)


@pytest.mark.usefixtures("one_task")
def test_a_task_moves_its_own_input_of_a_onehot_policy():
    program = uncompiled(bandit_program("onehot"))
    before, after, _ = one_update(program, begin(bandit_program("onehot")))
    rows = moved(before.policy, after.policy)["networks"]["params"]["Dense_0"]["kernel"].any(axis=1)
    np.testing.assert_array_equal(rows, [True, False, True])  # the observation, and a row for each task


@pytest.mark.usefixtures("one_task")
def test_a_task_moves_its_own_heads_and_temperature_and_the_body():
    program = uncompiled(bandit_program("multihead"))
    before, after, _ = one_update(program, begin(bandit_program("multihead")))
    policy, critics = (
        moved(before.policy, after.policy)["networks"]["params"],
        moved(before.critics, after.critics)["params"],
    )
    np.testing.assert_array_equal(policy["Dense_1"]["kernel"].any(axis=0), [False, False, True, True])
    np.testing.assert_array_equal(policy["Dense_1"]["bias"], [False, False, True, True])
    np.testing.assert_array_equal(critics["Dense_1"]["kernel"].any(axis=1), [[False, True]] * 2)
    np.testing.assert_array_equal(moved(before.log_temperature, after.log_temperature), [False, True])
    assert all(leaf.any() for leaf in jax.tree.leaves((policy, critics)))


@pytest.fixture(scope="module")
def inferring() -> tuple[Program, TrainState]:
    program = bandit_program("pearl")
    return program, begin(program)


def test_an_inferred_code_is_taught_by_the_critics_alone(inferring, monkeypatch):
    """The policy's loss does not reach the encoder, and no gradient reaches the table of codes."""
    program, state = inferring
    before, after, _ = one_update(program, state)
    changed = moved(before.policy, after.policy)
    assert all(leaf.any() for leaf in jax.tree.leaves((changed["networks"], moved(before.critics, after.critics))))
    assert not changed["codes"].any()
    monkeypatch.setattr(losses, "critic_loss", lambda losses: jnp.zeros(()))
    monkeypatch.setattr("ear_jax.learning.pearl.KL_WEIGHT", 0.0)
    before, after, _ = one_update(uncompiled(program), state)
    changed = moved(before.policy, after.policy)["networks"]
    assert not any(leaf.any() for leaf in jax.tree.leaves(changed["encoder"]))
    assert all(leaf.any() for leaf in jax.tree.leaves(changed["actor"]))


def test_a_code_is_inferred_from_the_newest_steps_of_its_own_task(inferring):
    """Another task's steps, and steps older than the newest, change nothing."""
    program, state = inferring
    for _ in range(4):
        state = parts(program).collect(state)
    learner, rings = program.learner, state.replay.rings
    newest = int(state.replay.added[0])
    assert newest > CONTEXT > program.config.collect.envs * program.config.collect.steps
    observe = jax.jit(learner.observe)

    def codes(action: jax.Array) -> np.ndarray:
        outcome = {"action": action}
        buffer = replace(state.replay, rings=replace(rings, action=action[..., None], outcome=outcome))
        return np.asarray(observe(state.learner.policy, buffer)["codes"])

    action = rings.outcome["action"]
    plain = codes(action)
    np.testing.assert_array_equal(codes(action.at[:, : newest - CONTEXT].set(0.9)), plain)
    other = codes(action.at[1].set(0.9))
    np.testing.assert_array_equal(other[0], plain[0])
    assert (other[1] != plain[1]).any()


def test_an_update_of_a_few_tasks_learns_nothing_from_the_others(inferring):
    """With a meta-batch of one of the two tasks, what the other's ring holds changes nothing."""
    whole, state = inferring
    learner = replace(whole.learner, config=replace(whole.config, meta_batch=1))
    draws = jax.jit(learner.draw, static_argnums=1)(jax.random.key(0), 20)
    drawn = draws.tasks[:, 0].tolist()
    assert set(drawn) == {0, 1}
    np.testing.assert_array_equal(draws.source, np.repeat(draws.tasks, 64, axis=1))
    update, rings = jax.jit(learner.update), state.replay.rings
    number = drawn.index(1)
    of_one = jax.tree.map(lambda leaf: leaf[number], draws)

    def updated(task: int) -> tuple[Any, dict[str, jax.Array]]:
        """Makes the update with the ring of a task spoilt."""
        action = rings.action.at[task].set(jnp.nan)
        return update(state.learner, replace(state.replay, rings=replace(rings, action=action)), of_one)

    after, metrics = updated(0)
    np.testing.assert_array_equal(metrics["finite"], [True, True])
    jax.tree.map(np.testing.assert_array_equal, after, update(state.learner, state.replay, of_one)[0])
    np.testing.assert_array_equal(updated(1)[1]["finite"], [True, False])


def test_collection_acts_under_drawn_codes_now_and_then_from_the_prior(inferring, monkeypatch):
    program, state = inferring
    policy = jax.jit(program.learner.observe)(state.learner.policy, state.replay)
    keys = jax.random.split(jax.random.key(0), 400)

    def draws(prior_share: float) -> np.ndarray:
        monkeypatch.setattr("ear_jax.learning.pearl.PRIOR_SHARE", prior_share)
        return np.asarray(jax.jit(jax.vmap(partial(program.learner.codes_to_act, policy, state.replay)))(keys))

    priors = draws(1.0)
    np.testing.assert_allclose(priors.std(axis=0), 1, atol=0.15)
    np.testing.assert_allclose(priors.mean(axis=0), 0, atol=0.2)
    posteriors = draws(0.0)
    np.testing.assert_allclose(posteriors.mean(axis=0), policy["codes"], atol=0.2)
    assert (posteriors.std(axis=0) < 0.5).all()
