"""Rewards as expressions: known values, and one line for every mistake."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from ear_jax.envs.asked import asked, reward_functions
from ear_jax.envs.expression import FUNCTIONS, parse_expression
from ear_jax.errors import UsageError
from tests.helpers.probe import Bandit

NAMES = ("velocity", "squared_action", "height")
AT = {"velocity": jnp.float32(2.5), "squared_action": jnp.float32(0.5), "height": jnp.float32(-1)}


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("velocity", 2.5),
        ("1 + 2 * 3", 7),
        ("(1 + 2) * 3", 9),
        ("2 ** 3 ** 2", 512),
        ("-2 ** 2", -4),
        ("2 ** -1", 0.5),
        ("7 - 2 - 1", 4),
        ("8 / 4 / 2", 1),
        ("velocity > 2", 1),
        ("2 < velocity < 2.2", 0),
        ("2 < velocity <= 2.5 != 3", 1),
        ("not velocity > 2 and height > 0", 0),
        ("not (velocity > 2 and height > 0)", 1),
        ("height > 0 or velocity > 2 and squared_action == 0.5", 1),
        ("velocity and height", 1),
        ("height - 0.1*squared_action if velocity < -1 else -1", -1),
        ("height - 0.1*squared_action if velocity > -1 else -1", -1.05),
        ("1 if 2 < velocity < 3 else 2 if velocity < 2 else 3", 1),
        ("3 * (velocity > 2) - 1", 2),
        ("(velocity > 1) + (velocity > 2)", 2),
        ("-(velocity > 2)", -1),
        ("(velocity > 3) - (velocity > 2)", -1),
        ("sign(velocity > 2) + abs(not height)", 1),
        ("abs(height) + max(1, velocity, 3) + min(velocity, height)", 3),
        ("clip(velocity, 0, 1) + sign(height)", 0),
        ("sqrt(4) + exp(0) + log(1) + cos(0) + sin(0) + tanh(0)", 4),
        ("  1e-3\n * 1000 ", 1),
        ("+velocity", 2.5),
    ],
)
def test_values(text, value):
    assert float(parse_expression(text, NAMES)(AT)) == pytest.approx(value, abs=1e-6)


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        ("", "a reward is empty"),
        ("velocty", "column 1 .*unknown outcome 'velocty'; did you mean 'velocity'.*height, squared_action, velocity"),
        ("  1 + heigth", "column 7 .*did you mean 'height'"),
        ("mx(1, 2)", "column 1 .*unknown function 'mx'; did you mean 'max'"),
        ("abs(1, 2)", "abs takes 1 value, not 2"),
        ("max(1)", "max takes at least 2 values, not 1"),
        ("max(velocity, *velocity)", r"max takes values only, as in max\(x, y\)"),
        ("velocity % 2", "column 1 .*: % is not allowed in a reward"),
        ("clip(1, x=2)", "clip takes values only"),
        ("max(*velocity)", "max takes values only"),
        ("velocity.real", "column 1 .*an attribute is not allowed"),
        ("height + velocity.__class__", "column 10 .*an attribute is not allowed"),
        ("velocity[0]", "an index is not allowed"),
        ("().__class__.__bases__", "an attribute is not allowed"),
        ("velocity.item()", "only these can be called: abs, clip"),
        ("(lambda: 1)()", "only these can be called"),
        ("__import__('os')", "unknown function '__import__'"),
        ("eval('1')", "unknown function 'eval'"),
        ("'a' * 3", "a text is not allowed"),
        ("True", "column 1 .*True is not allowed"),
        ("1j", "not allowed"),
        ("[1, 2]", "a Python List is not allowed"),
        ("velocity in height", "in and is are not allowed"),
        ("velocity if 1", "column 1 .*expected 'else'"),
        ("1 +", "column 4 "),
        ("velocity = 3", "column"),
        ("velocity % 2", "not allowed"),
        ("(velocity", "column 1 .*was never closed"),
        ("(x := 1)", "not allowed"),
        ("1e999", "column 1 .*a number is too large"),
        ("9" * 400, "a number is too large"),
        ("9" * 999, "a number is too large"),
        ("-" * 900 + "1", "nested too deeply"),
        ("+".join("1" * 200), "nested too deeply"),
        ("(" * 400 + "1" + ")" * 400, "nested|column"),
        ("1 + " * 300, "a reward has 1200 letters; 1000 are allowed"),
        ("velocity\0", "column|cannot be read"),
        ("é + 1", "column 1 .*unknown outcome 'é'"),
        ("1 + 'é' + velocty", "column 5 .*a text is not allowed"),
    ],
)
def test_a_mistake_is_one_line(text, complaint):
    with pytest.raises(UsageError, match=complaint) as raised:
        parse_expression(text, NAMES)
    assert "\n" not in str(raised.value)


def test_a_column_counts_letters_not_bytes():
    with pytest.raises(UsageError, match=r"column 10 .*unknown outcome 'é'"):
        parse_expression("height + é", NAMES)


def test_sides_of_chained_comparisons_are_computed_once():
    text = "velocity"
    for _ in range(12):
        text = f"1 < ({text}) < 1"
    read = []

    class Outcome(dict):
        def __getitem__(self, name: str) -> float:
            read.append(name)
            return 0.5

    parse_expression(text, NAMES)(Outcome())
    assert read == ["velocity"]


def test_an_expression_is_compiled_for_many_outcomes_at_once():
    expression = parse_expression("sqrt(velocity) if velocity > 0 else exp(height)", NAMES)
    many = {name: jnp.linspace(-1, 1, 5) for name in NAMES}
    values = jax.jit(jax.vmap(expression))(many)
    x = np.linspace(-1, 1, 5)
    np.testing.assert_allclose(values, np.where(x > 0, np.sqrt(np.abs(x)), np.exp(x)), rtol=1e-6)
    assert set(FUNCTIONS) == {"abs", "clip", "cos", "exp", "log", "max", "min", "sign", "sin", "sqrt", "tanh"}


def test_a_family_scores_the_rewards_it_is_asked_for():
    def cost(outcome):
        return -(outcome["action"] ** 2)

    family, tasks = asked(Bandit("native"), reward_functions(Bandit("native"), ["3 * action", cost]))
    assert tasks.names == ["3 * action", "cost"]
    outcome = {"action": jnp.float32(0.5)}
    rewards = jax.vmap(family.reward, in_axes=(None, 0))(outcome, tasks.params)
    np.testing.assert_allclose(rewards, [1.5, -0.25])
    with pytest.raises(UsageError, match=r"reward cost must be a scalar, not an array of shape \(2,\)"):
        reward_functions(family, [vectors()])
    with pytest.raises(UsageError, match="reward 'action' is given twice"):
        reward_functions(family, ["action", "action"])
    forward = lambda outcome: outcome["action"]  # noqa: E731
    two = reward_functions(family, [forward, lambda outcome: -outcome["action"]])
    assert asked(family, two)[1].names == ["<lambda> 1", "<lambda> 2"]
    with pytest.raises(UsageError, match="reward '<lambda>' is given twice"):
        reward_functions(family, [forward, forward])


def vectors():
    def cost(outcome):
        return jnp.ones(2)

    return cost


@pytest.mark.parametrize(
    ("rewards", "complaint"),
    [
        ([lambda outcome: outcome["actoin"]], r"reward <lambda> of the outcomes .*action.* fails: KeyError: 'actoin'"),
        ([lambda outcome: 1 if outcome["action"] > 0 else 0], r"use jnp\.where for `if`"),
        ([], "give a list of at least one reward"),
        (lambda outcome: outcome["action"], "give a list of at least one reward"),
    ],
)
def test_functions_that_are_no_rewards_are_refused(rewards, complaint):
    with pytest.raises(UsageError, match=complaint):
        reward_functions(Bandit("native"), rewards)
