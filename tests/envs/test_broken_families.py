"""Faults of a user's own family, each refused in one line before anything is compiled."""

from __future__ import annotations

import itertools
import random
import re
import sys

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest

from ear_jax.envs import FAMILIES, Family, make_family
from ear_jax.errors import UsageError
from ear_jax.physics import Physics
from ear_jax.runs import on_host
from ear_jax.runs.loop import train_run
from ear_jax.tasks import Task, TaskSet, task_set
from tests.helpers.probe import SLIDER, Bandit
from tests.helpers.runs import tiny_config


def tasks_of(*params: dict[str, object]):
    """Returns a method that makes tasks of these parameters."""
    return lambda *_: task_set([Task(f"task-{index}", 0.0, each) for index, each in enumerate(params)])


def start_of(**fields: object):
    return lambda self, key: Bandit.initial(self, key).replace(**fields)


CLOCK = itertools.count()
WITHOUT_NOISE = "gives something else when it is called again, but JAX calls it only once"


def at_the_start(physics: Physics) -> jax.Array:
    """Returns whether a state is a start of the bandit: its mass does not move yet."""
    return physics.qvel[0] == 0


def slider(mass: float) -> mujoco.MjModel:
    return mujoco.MjModel.from_xml_string(SLIDER.replace('mass="1"', f'mass="{mass}"'))


def never(*_):
    raise ValueError("never\nagain")


# Each family's difference from the bandit, and the message about it.
BROKEN = [
    ({"symmetry": "mirror"}, "symmetry must be a Symmetry or None, but is a value of type str"),
    ({"symmetry": property(never)}, "symmetry fails: ValueError: never"),
    ({"portrait": lambda self: 3}, r"portrait\(\) must return a mujoco\.MjModel, but returns a value of type int"),
    ({"asks": lambda self, task: 3}, r"asks\(\) must return the name of an outcome and its unit, but returns 3"),
    ({"goal": lambda self, task: 3}, r"goal\(\) must return three coordinates or None, but returns 3"),
    ({"options": ("gain",)}, "options names 'gain', which has no default; define it in the class"),
    ({"observe": lambda self, physics: jnp.zeros(0)}, r"observe\(\) must be a vector, but has shape \(0,\)"),
    ({"load": never}, r"its constructor fails: ValueError: never \(test_broken_families\.py, line \d+, in never\)$"),
    ({"load": lambda self: None}, r"load\(\) must return a mujoco\.MjModel, not a NoneType"),
    ({"load": Family.load, "model_file": "hoper.xml"}, r"unknown model 'hoper\.xml'; did you mean 'hopper\.xml'"),
    (
        {
            "load": lambda self: mujoco.MjModel.from_xml_string(
                re.sub("<actuator>.*</actuator>", "", SLIDER, flags=re.S)
            )
        },
        r"the model has no actuators",
    ),
    ({"bodies": ("foot",)}, r"unknown body 'foot'.* \(there are: .*world\)"),
    ({"feet": {"left": "foot"}}, r"feet: unknown body 'foot'.* \(there are: .*world\)"),
    ({"plane": ("action", "speed")}, r"plane: unknown outcome 'speed' \(there are: action"),
    ({"asks": lambda self, task: ("speed", "m/s")}, r"asks\(\): unknown outcome 'speed' \(there are: action"),
    ({"difference": lambda self, one, other: None}, r"difference\(\) must return a number, but returns None"),
    ({"training_tasks": never}, r"training_tasks\(\) fails: ValueError: never"),
    ({"training_tasks": lambda self: []}, r"training_tasks\(\) must return a task_set\(…\), but returns .* list"),
    ({"training_tasks": lambda self: TaskSet(())}, r"a task set needs at least one task"),
    ({"training_tasks": lambda self: task_set([1.0])}, r"training_tasks\(\) fails: AttributeError"),
    (
        {"training_tasks": tasks_of({"action": 1.0}, {"speed": 1.0})},
        r"training_tasks\(\): tasks 'task-0' and 'task-1' have different",
    ),
    ({"training_tasks": tasks_of({"action": 1.0}, {})}, r"training_tasks\(\): the params of task 'task-1' must be"),
    (
        {"training_tasks": tasks_of({"action": jnp.inf})},
        r"training_tasks\(\): the params .* must be numbers below 1e\+10 by name",
    ),
    (
        {"training_tasks": tasks_of({"action": [1.0, 2.0]}, {"action": [1.0]})},
        r"training_tasks\(\): the params of task",
    ),
    (
        {"training_tasks": lambda self: task_set([Task("", 0.0, {"action": 0.0})])},
        r"training_tasks\(\): a task needs a name",
    ),
    (
        {"training_tasks": lambda self: task_set([Task("a", jnp.nan, {"action": 0.0})])},
        r"training_tasks\(\): a task needs .* below 1e\+10",
    ),
    ({"adaptation_tasks": never}, r"adaptation_tasks\(\) fails: ValueError: never"),
    ({"adaptation_tasks": tasks_of({"speed": 1.0})}, r"adaptation_tasks\(\): tasks '-0\.5' and 'task-0' have"),
    ({"initial": lambda self, key: jnp.zeros(1)}, r"initial\(\) must return a Physics, but returns .* ArrayImpl"),
    ({"initial": start_of(qvel=jnp.zeros(2))}, r"initial\(\)\.qvel must be of shape \(1,\), but has shape \(2,\)"),
    ({"initial": start_of(qpos=jnp.zeros(1, int))}, r"initial\(\)\.qpos must be float32, but is int32"),
    ({"initial": start_of(warmstart=None)}, r"initial\(\)\.warmstart must be of shape \(1,\), but is None"),
    ({"initial": lambda self, key: sys.exit()}, r"initial\(\) fails: SystemExit"),
    ({"observe": lambda self, physics: jnp.ones((1, 1))}, r"observe\(\) must be a vector, but has shape \(1, 1\)"),
    ({"observe": lambda self, physics: physics.qpos / 0 - jnp.inf}, r"observe\(\)\[0\] is nan at a fresh start"),
    ({"observe": lambda self, physics: np.tanh(physics.qpos)}, r"observe\(\) fails: JAX traces it.* use jnp\.where"),
    ({"terminated": lambda self, physics: physics.qpos > 0}, r"terminated\(\) must be a scalar, but has shape \(1,\)"),
    ({"terminated": lambda self, physics: physics.qpos[0]}, r"terminated\(\) must be bool, but is float32"),
    (
        {"terminated": lambda self, physics: physics.qpos[0] > 0 and physics.qpos[0] < 1},
        r"terminated\(\) fails: JAX traces it.* jnp\.where for `if`.* "
        r"\(test_broken_families\.py, line \d+, in <lambda>\)$",
    ),
    (
        {"actuate": lambda self, physics, action: action},
        r"actuate\(\) must return a Physics and a control, but returns",
    ),
    (
        {"actuate": lambda self, physics, action: (physics, action[:0])},
        r"the control that actuate\(\) returns must be of shape \(1,\), but has shape \(0,\)",
    ),
    ({"outcome": lambda self, motion: motion.action[0]}, r"outcome\(\) must return a dictionary of named scalars"),
    ({"outcome": lambda self, motion: {"action": motion.action}}, r"outcome\(\)\['action'\] must be a scalar, but has"),
    (
        {"outcome": lambda self, motion: {"action": {}}},
        r"outcome\(\)\['action'\] must be a scalar, but is a value of type dict",
    ),
    ({"outcome": lambda self, motion: {"action": jnp.log(-1.0)}}, r"outcome\(\)\['action'\] is nan at a fresh start"),
    ({"outcome": lambda self, motion: {"return": motion.action[0]}}, r"outcome\(\) must not contain 'return'"),
    ({"commanded": "acton"}, r"commanded: unknown outcome 'acton'; did you mean 'action'"),
    ({"reward": lambda self, outcome, task: outcome["speed"]}, r"reward\(\) fails: KeyError: 'speed'"),
    ({"reward": lambda self, outcome: 0.0}, r"reward\(\) fails: TypeError: .* positional argument"),
    ({"reward": lambda self, outcome, task: float(task["action"])}, r"reward\(\) fails: JAX traces it.* float\(\)"),
    (
        {"reward": lambda self, outcome, task: jnp.ones(2)},
        r"reward\(\) of task '-0\.5' must be a scalar, but has shape",
    ),
    ({"reward": lambda self, outcome, task: jnp.sqrt(-task["action"])}, r"reward\(\) of task '0\.5' is nan at a fresh"),
    # Impure: NumPy's random numbers, Python's, a counter, a model and tasks drawn anew.
    (
        {"initial": lambda self, key: Bandit.initial(self, key).replace(qpos=jnp.array(np.random.rand(1), "float32"))},
        rf"initial\(\) {WITHOUT_NOISE}.*jax\.random from the key",
    ),
    ({"observe": lambda self, physics: physics.qpos + random.random()}, rf"observe\(\) {WITHOUT_NOISE}"),
    ({"reward": lambda self, outcome, task: jnp.float32(next(CLOCK))}, rf"reward\(\) {WITHOUT_NOISE}"),
    (
        {"outcome": lambda self, motion: {"action": motion.action[0] * np.random.rand()}},
        rf"outcome\(\) {WITHOUT_NOISE}",
    ),
    (
        {"training_tasks": lambda self: task_set([self.parse_task(str(random.random()))])},
        r"training_tasks\(\) gives other tasks when it is called again",
    ),
    (
        {"adaptation_tasks": lambda self, seed: task_set([self.parse_task(str(next(CLOCK)))])},
        r"adaptation_tasks\(\) gives other tasks when it is called again",
    ),
    (
        {"load": lambda self: slider(1 + next(CLOCK))},
        r"load\(\) gives another model when it is called again: \w+ differs",
    ),
    # Not finite, but at the start.
    (
        {
            "reward": lambda self, outcome, task: jnp.where(outcome["speed"] == 0, 0.0, jnp.nan),
            "outcome": lambda self, motion: {"action": motion.action[0], "speed": motion.after.qvel[0]},
        },
        r"reward\(\) of task '-0\.5' is nan after 1 step of random actions; it must be finite",
    ),
    (
        {"outcome": lambda self, motion: {"action": jnp.where(at_the_start(motion.after), 0.0, jnp.inf)}},
        r"outcome\(\)\['action'\] is inf after 1 step of random actions",
    ),
    (
        {
            "observe": lambda self, physics: jnp.log(1.3 - jnp.abs(physics.qpos)),
            "initial": start_of(qpos=jnp.zeros(1)),
            "actuate": lambda self, physics, action: (physics.replace(qpos=physics.qpos + 0.5), action),
            "terminated": lambda self, physics: False,
        },
        r"observe\(\)\[0\] is nan after 3 steps of random actions",
    ),
    ({"achieved": lambda self, late, whole: late}, r"achieved\(\) must be a scalar, but is a value of type dict"),
]


@pytest.mark.parametrize(("parts", "complaint"), BROKEN, ids=["-".join(parts) for parts, _ in BROKEN])
def test_a_broken_family_is_refused_in_one_line(parts, complaint, monkeypatch):
    monkeypatch.setitem(FAMILIES, "broken", type("Broken", (Bandit,), {"__module__": __name__, **parts}))
    with pytest.raises(UsageError, match="^broken: " + complaint) as raised:
        make_family("broken", "native")
    assert "\n" not in str(raised.value)


def test_a_broken_family_is_refused_before_anything_is_compiled(monkeypatch, run_directory):
    monkeypatch.setitem(FAMILIES, "bandit", type("Broken", (Bandit,), {"reward": never}))
    monkeypatch.setattr(on_host, "compile_program", lambda *_: pytest.fail("it came to compiling"))
    with pytest.raises(UsageError, match=r"^bandit: reward\(\) fails"):
        train_run(tiny_config(family="bandit", tasks=()), run_directory)
    assert not run_directory.exists()


@pytest.mark.parametrize(
    ("parse_task", "complaint"),
    [
        (
            lambda self, text: float(text),
            r"^bandit: parse_task\('left'\) fails: ValueError: could not convert .*'left'",
        ),
        (lambda self, text: 1.0, r"^bandit: parse_task\('left'\): a task must be a Task, but is a value of type float"),
        (
            lambda self, text: Task(text, 1.0, {"speed": 1.0}),
            r"tasks 'task-0' and 'left' have different numbers",
        ),
    ],
)
def test_a_word_that_becomes_no_task(parse_task, complaint, monkeypatch, run_directory):
    parts = {"parse_task": parse_task, "training_tasks": tasks_of({"action": 0.5})}
    monkeypatch.setitem(FAMILIES, "bandit", type("Broken", (Bandit,), parts))
    with pytest.raises(UsageError, match=complaint):
        train_run(tiny_config(family="bandit", tasks=("left",)), run_directory)
    assert not run_directory.exists()


@pytest.mark.parametrize(
    ("spread", "complaint"),
    [
        (lambda self, count: 1 / 0, r"^bandit: spread_tasks\(3\) fails: ZeroDivisionError"),
        (lambda self, count: [1, 2, 3], r"^bandit: spread_tasks\(3\) must return a task_set\(…\) of 3 tasks"),
        (
            lambda self, count: task_set([Task(str(number), 1.0, {"speed": 1.0}) for number in range(count)]),
            r"^bandit: spread_tasks\(3\): tasks 'task-0' and '0' have different numbers",
        ),
    ],
)
def test_tasks_that_cannot_be_spread(spread, complaint, monkeypatch, run_directory):
    parts = {"spread_tasks": spread, "training_tasks": tasks_of({"action": 0.5})}
    monkeypatch.setitem(FAMILIES, "bandit", type("Broken", (Bandit,), parts))
    with pytest.raises(UsageError, match=complaint):
        train_run(tiny_config(family="bandit", tasks=(), task_count=3), run_directory)
    assert not run_directory.exists()


@pytest.mark.parametrize(
    ("actuator", "line"),
    [
        (
            '<motor name="push" joint="slide" ctrlrange="-0.4 0.4" ctrllimited="true"/>',
            "'push' takes controls from -0.4 to 0.4",
        ),
        (2 * '<motor joint="slide" ctrlrange="0 3" ctrllimited="true"/>', "0 and 1 more takes controls from 0 to 3"),
        ('<motor joint="slide"/>', None),
        ('<motor joint="slide" ctrlrange="-1 1" ctrllimited="true"/>', None),
    ],
)
def test_controls_of_other_ranges_than_actions_get_one_line(actuator, line, monkeypatch, capfd):
    text = re.sub(r"<motor[^>]*/>", actuator, SLIDER)
    parts = {"load": lambda self: mujoco.MjModel.from_xml_string(text)}
    monkeypatch.setitem(FAMILIES, "ranged", type("Ranged", (Bandit,), {"__module__": __name__, **parts}))
    for _ in range(2):
        make_family("ranged", "native")
    said = capfd.readouterr().err
    assert said.count("warning: ") == (line is not None)
    assert (line or "") in said


def test_a_family_that_scales_its_actions_gets_no_line(monkeypatch, capfd):
    text = SLIDER.replace('ctrlrange="-1 1"', 'ctrlrange="-7 7"')
    parts = {"load": lambda self: mujoco.MjModel.from_xml_string(text), "actuate": lambda self, p, a: (p, 7 * a)}
    monkeypatch.setitem(FAMILIES, "scaled", type("Scaled", (Bandit,), {"__module__": __name__, **parts}))
    make_family("scaled", "native")
    assert capfd.readouterr().err == ""


def test_constants_are_accepted(monkeypatch):
    """A Python bool or float is accepted as a scalar if it does not depend on the state."""
    parts = {"terminated": lambda self, physics: False, "reward": lambda self, outcome, task: 1.0}
    monkeypatch.setitem(FAMILIES, "bandit", type("Constant", (Bandit,), parts))
    family = make_family("bandit", "native")
    after = jax.jit(family.step)(family.reset(jax.random.key(0)), jnp.zeros(1))
    assert (float(after.done), float(after.reward)) == (0.0, 1.0)
