"""The live page in Chromium: pages of agents that ship, measured against `ear evaluate` and JAX."""

from __future__ import annotations

import itertools
import json
import math
import time
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest
from matplotlib.projections.geo import MollweideAxes

from ear_jax import pretrained
from ear_jax.cli.main import main
from ear_jax.rendering.live import wasm
from ear_jax.runs import training
from ear_jax.runs.trained import load, policy_of
from experiments.browser import Browser, chromium

FOUND = wasm.cached()  # of the machine, before tests get a cache of their own
pytestmark = [
    pytest.mark.skipif(chromium() is None, reason="Chromium is not installed"),
    pytest.mark.skipif(FOUND is None, reason="MuJoCo's WebAssembly is not in the cache; `ear explore RUN` fetches it"),
]
READY = "window.ear && ear.ready"
# Plays a task as `ear evaluate` does; the robot then keeps as many outcomes as its evaluation averages.
EVALUATE = """(() => {
  const { robot, tasks, description } = ear.show, found = [];
  robot.kept = description.quantities[0].period ? 200 : 100;
  const began = performance.now(); let seconds = 0;
  for (const task of tasks) {
    let met = [];
    for (let episode = 0; episode < EPISODES; episode++) {
      robot.reset();
      for (let step = 0; step < 200 * description.substeps && !robot.fell; step++) robot.step(task.lte);
      if (!robot.fell) met.push(robot.means());
      seconds += robot.steps * robot.dt; robot.steps = 0;
    }
    found.push(met);
  }
  robot.reset();
  return { found, factor: 1000 * seconds / (performance.now() - began) };
})()"""


@pytest.fixture(scope="module")
def make(tmp_path_factory: pytest.TempPathFactory) -> Any:
    """Makes the page of an agent once, with the sphere coloured by few roll-outs."""
    pages: dict[str, Path] = {}

    def page(name: str) -> Path:
        if name not in pages:
            folder = tmp_path_factory.mktemp(name)
            with pytest.MonkeyPatch.context() as patch:
                patch.chdir(folder)
                patch.setattr(wasm, "find", lambda: FOUND)
                assert main(["explore", f"pretrained:{name}", "--places", "10"]) == 0
            (pages[name],) = folder.rglob("*.html")
        return pages[name]

    return page


@pytest.fixture(scope="module")
def browser() -> Iterator[Browser]:
    with Browser() as opened:
        yield opened


def check_tasks(browser: Browser, name: str, limit: float, episodes: int) -> float:
    """Compares what the robot does under each trained task with its card, and returns the speed of its physics."""
    measured = browser.run(EVALUATE.replace("EPISODES", str(episodes)))
    quantity = browser.run("ear.show.description.quantities[0]")
    missed, tasks = {}, pretrained.card(name)["tasks"]
    lasting = achieved_where_it_lasts(name) if any(task["failures"] for task in tasks) else {}
    for task, found in zip(tasks, measured["found"], strict=True):
        if task["target"] is None:
            continue
        assert found, f"{task['name']}: the robot fell in every episode"
        expected = lasting[task["name"]] if task["failures"] else task["achieved"]
        away = [one[quantity["name"]] - expected for one in found]
        if quantity["period"]:
            away = [math.remainder(one, quantity["period"]) for one in away]
        if abs(np.mean(away)) > limit:
            missed[task["name"]] = round(float(np.mean(away)), 3)
    assert not missed, f"off from what `ear evaluate` found, in {quantity['unit']}"
    return measured["factor"]


def achieved_where_it_lasts(name: str) -> dict[str, float]:
    """Plays 20 episodes a task here; the card's means also hold episodes that were cut short."""
    trained = load(Path(f"pretrained:{name}"))
    program = trained.program
    played = jax.jit(partial(training.evaluate, program, episodes=20))(policy_of(trained, 0), key=jax.random.key(1))
    whole = played.lengths == program.family.episode_length
    means = jax.tree.map(
        lambda leaf: jnp.sum(leaf * whole, axis=1) / jnp.sum(whole, axis=1), (played.late, played.whole)
    )
    achieved = np.asarray(program.family.achieved(*means), float).tolist()
    return dict(zip((task.name for task in program.tasks.tasks), achieved, strict=True))


STEPS = """(() => {
  const { robot, tasks, description } = ear.show, { data, model } = robot, found = [];
  const look = () => [data.qpos, data.qvel, data.qacc_warmstart, data.ctrl, model.nmocap ? data.mocap_pos : []]
    .map((leaf) => [...leaf]);
  robot.reset();
  for (let step = 0; step <= 100; step++) {
    found.push(look());
    for (let substep = 0; substep < description.substeps; substep++) robot.step(tasks[3].lte);
  }
  robot.reset();
  return found;
})()"""


def check_steps(browser: Browser, name: str) -> None:
    """Compares each of 100 steps with MuJoCo's here, from the same state and under the same control."""
    family = load(Path(f"pretrained:{name}")).program.family
    data, states = mujoco.MjData(family.model), browser.run(STEPS)
    for before, after in itertools.pairwise(states):
        data.qpos[:], data.qvel[:], data.qacc_warmstart[:] = before[:3]
        data.ctrl[:] = after[3]
        data.mocap_pos[:] = np.reshape(after[4], data.mocap_pos.shape)
        mujoco.mj_step(family.model, data, family.substeps)
        np.testing.assert_allclose(data.qpos, after[0], atol=1e-9)


def test_the_cheetah_obeys_in_the_browser(make, browser):
    """The first picture, tasks, dragging, a push, and neither complaints nor requests; all in one page."""
    browser.open(make("halfcheetah-vel"), READY)
    assert browser.run("document.getElementById('tasks').children.length") == 10
    # Neither embeddings nor the robot's path jump while the pointer drags on the globe.
    browser.run(DRAG_BEGIN)
    box = browser.run("(({ x, y, width, height }) => [x, y, width, height])(ear.box('globe'))")
    x, y = box[0] + box[2] / 2, box[1] + box[3] / 2
    browser.mouse("mousePressed", x, y)
    for step in range(60):
        browser.mouse("mouseMoved", x + step - 30, y + 0.7 * step - 20)
    browser.mouse("mouseReleased", x + 30, y + 22)
    codes, jumps = browser.run("[window.codes.size, window.jumps]")
    assert codes >= 55
    assert 0 < jumps[0] <= 15 * jumps[1], "no jump larger than a step at 15 m/s"
    assert browser.run("ear.show.steering.task") is None
    # A drag from the dot of 3 m/s to that of 7 m/s blends the two.
    one, other = (on_map(browser, index) for index in (2, 6))
    browser.mouse("mousePressed", *one)
    assert browser.run("ear.show.steering.task.name") == "vel-3"
    for step in range(1, 31):
        browser.mouse("mouseMoved", *(one + (other - one) * step / 30))
    assert browser.run("[ear.show.steering.pair, ear.show.steering.share]") == [[2, 6], pytest.approx(1, abs=0.02)]
    browser.mouse("mouseReleased", *other)
    # A push that slows it by 1 m/s if it stood freely.
    before, after = browser.run(PUSH)
    assert abs(before - 5) < 0.3
    assert abs(after - before) <= 0.3
    assert browser.complaints() == []
    assert browser.requests() == []


def on_map(browser: Browser, task: int) -> np.ndarray:
    """Returns the place of a task's dot on the page's flat map, in pixels."""
    box = browser.run("(({ x, y, width, height }) => [x, y, width, height])(ear.box('map'))")
    lte = browser.run(f"ear.show.tasks[{task}].lte")
    at = MollweideAxes.MollweideTransform(60).transform([[math.atan2(lte[1], lte[0]), math.asin(lte[2])]])[0]
    left, top, width, height = box
    return np.array([left + width / 2 * (1 + at[0] / 8**0.5), top + height / 2 * (1 - at[1] / 2**0.5)])


DRAG_BEGIN = """(() => {
  window.codes = new Set(); window.jumps = [0, 0];
  const step = ear.show.robot.step, { robot } = ear.show;
  robot.step = (code) => {
    codes.add(code.join());
    const x = robot.now.xpos[3];
    step(code);
    jumps[0] = Math.max(jumps[0], Math.abs(robot.now.xpos[3] - x)); jumps[1] = robot.model.opt.timestep;
  };
  const { steering } = ear.show, choose = steering.choose;
  steering.choose = (code) => { choose(code); codes.add(steering.code.join()); };
})()"""
PUSH = """(() => {
  ear.go(4);
  const { robot, steering } = ear.show, run = (seconds) => {
    for (let i = 0; i < seconds / robot.model.opt.timestep; i++) robot.step(steering.code);
    return robot.means().velocity;
  };
  robot.reset();
  const before = run(5);
  robot.shove([-robot.mass, 0, 0]);
  return [before, run(3)];
})()"""


def check_actions(browser: Browser, name: str) -> None:
    trained = load(Path(f"pretrained:{name}"))
    program, params = trained.program, policy_of(trained, 0)
    draw = np.random.default_rng(1).normal
    obs = (3 * draw(size=(1000, program.family.observation_size))).astype(np.float32)
    codes = draw(size=(1000, 3)).astype(np.float32)
    codes /= np.linalg.norm(codes, axis=1, keepdims=True)
    cases = json.dumps([obs.tolist(), codes.tolist()])
    acted = browser.run(f"(([obs, codes]) => obs.map((one, i) => ear.show.robot.act(one, codes[i])))({cases})")
    expected = jnp.tanh(jax.vmap(lambda o, c: program.agent.distribution(params, c, o).mean)(obs, codes))
    np.testing.assert_allclose(acted, expected, atol=2e-5)


@pytest.mark.slow
@pytest.mark.parametrize("name", pretrained.names())
def test_every_agent_does_in_the_browser_what_it_does_in_jax(name, make, browser):
    page = make(name)
    assert page.stat().st_size <= 6_000_000
    browser.events.clear()
    browser.open(page, READY)
    drawn, ready = browser.run("[ear.drawn, ear.ready]")
    assert drawn <= 1500
    assert ready <= 6000
    check_actions(browser, name)
    check_steps(browser, name)
    # The ant's direction differs by some degrees from start to start, also among the 5 episodes of its card.
    limit, episodes = {"ant-dir": (5, 10), "reach": (5, 1)}.get(name, (0.1, 3))
    factor = check_tasks(browser, name, limit, episodes)
    assert factor >= 2, "times real time"
    assert browser.complaints() == []
    assert browser.requests() == []


@pytest.mark.slow
@pytest.mark.parametrize("size", [(1280, 800), (390, 844)])
@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_the_page_fits_the_screen(size, scheme, make, browser):
    browser.resize(*size)
    browser.prefer(color_scheme=scheme)
    browser.open(make("halfcheetah-vel"), READY)
    width, height = browser.run("[document.documentElement.scrollWidth, document.documentElement.scrollHeight]")
    assert width <= size[0]
    assert height <= size[1] or size[0] < 500, "all above the fold"
    ground = browser.run("getComputedStyle(document.documentElement).backgroundColor")
    assert (ground == "rgb(255, 255, 255)") == (scheme == "light")
    browser.resize(1280, 800)
    browser.prefer(color_scheme="light")


@pytest.mark.slow
def test_keys_reduced_motion_and_keeping(make, browser):
    browser.prefer(reduced_motion="reduce")
    browser.open(make("halfcheetah-vel"), READY)
    assert browser.run("ear.show.robot.time") == 0
    assert browser.run("document.getElementById('notice').textContent") == "paused"
    browser.prefer(reduced_motion="no-preference")
    browser.run("document.body.focus()")
    browser.key("]")
    assert browser.run("ear.show.steering.task.name") == "vel-6"
    browser.key(" ")
    assert browser.run("ear.reader.playing")
    browser.run("document.getElementById('map').focus()")
    browser.key("ArrowLeft")
    assert browser.run("ear.show.steering.task") is None
    browser.run("document.getElementById('name').value = '<b>trot'; document.querySelector('#keep button').click()")
    assert browser.run("document.getElementById('kept').textContent") == "<b>trot×"
    words = browser.run("document.getElementById('lte').textContent").split()
    assert words[0] == "--lte"
    assert abs(np.linalg.norm(list(map(float, words[1:]))) - 1) < 1e-3


@pytest.mark.slow
def test_a_robot_that_falls_says_so_and_starts_again(make, browser):
    browser.open(make("hopper-vel"), READY)
    browser.run("ear.reader.byHand = true; ear.show.robot.shove([9 * ear.show.robot.mass, 0, 0])")
    browser.run("for (let i = 0; i < 500 && !ear.show.robot.fell; i++) ear.advance(.01)")
    assert browser.run("[ear.show.robot.resets, ear.show.fallen > 0]") == [1, True]
    deadline = time.monotonic() + 5
    while browser.run("document.getElementById('notice').textContent") != "fell · starts again":
        assert time.monotonic() < deadline
    browser.run("ear.advance(1.1); ear.advance(.3)")
    fell, waits, height = browser.run("[ear.show.robot.fell, ear.show.fallen, ear.show.robot.data.qpos[1]]")
    assert (fell, waits) == (False, 0)
    assert height > 1.2, "it stands"


@pytest.mark.slow
@pytest.mark.parametrize("name", pretrained.names())
def test_every_page_fits_a_phone_and_says_whose_work_it_holds(name, make, browser):
    browser.resize(390, 844)
    browser.open(make(name), READY)
    assert browser.run("document.documentElement.scrollWidth") <= 390
    assert "Apache License" in browser.run("document.querySelector('footer pre').textContent")
    browser.resize(1280, 800)
