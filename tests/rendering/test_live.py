"""The live page without a browser: programs made of JAX functions, MuJoCo's WebAssembly, the model, the command."""

from __future__ import annotations

import base64
import dataclasses
import gzip
import hashlib
import io
import json
import re
import shutil
import subprocess
import tarfile
from pathlib import Path

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest

from ear_jax.cli.main import main
from ear_jax.embeddings.codes import fibonacci_sphere
from ear_jax.envs import Family, make_family
from ear_jax.errors import RunError, UsageError
from ear_jax.presets import preset_config
from ear_jax.rendering.live import page, wasm
from ear_jax.rendering.live.ground import octahedron
from ear_jax.rendering.live.model import portable
from ear_jax.rendering.live.programs import ELEMENTWISE, REDUCTIONS, Constants, translate
from ear_jax.rendering.live.robot import translate_all, view
from ear_jax.rendering.live.shapes import shapes
from ear_jax.runs.trained import load, policy_of
from ear_jax.runs.training import make_program

RUNNER = """
import { readFileSync } from "fs";
const { programs, constants, cases } = JSON.parse(readFileSync(0, "utf8"));
const held = new Float32Array(Uint8Array.from(Buffer.from(constants, "base64")).buffer);
console.log(JSON.stringify(programs.map((program, index) => {
  const run = build(program, held);
  return cases[index].map((inputs) => run(...inputs).map((output) => Array.from(output, String)));
})));
"""
needs_node = pytest.mark.skipif(shutil.which("node") is None, reason="node is not installed")


def computed(programs: list[dict], constants: Constants, cases: list[list[list]]) -> list:
    """Runs programs under node; returns for each of them and each of its cases the outputs."""
    script = (page.SOURCES / "program.js").read_text() + RUNNER
    numbers = gzip.decompress(base64.b64decode(constants.packed()))
    held = base64.b64encode(numbers).decode()
    document = json.dumps({"programs": programs, "constants": held, "cases": cases})
    words = ["node", "--input-type=module", "-e", script]
    done = subprocess.run(words, input=document, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr[-1000:]
    programs_of_cases = json.loads(done.stdout)  # as text, because JSON lacks NaN
    return [[[np.array(leaf, float) for leaf in leaves] for leaves in cases] for cases in programs_of_cases]


def looped(x):
    return jax.lax.scan(lambda carry, item: (carry * 0.5 + item, jnp.tanh(carry)), jnp.zeros(3), x.reshape(4, 3))


FUNCTIONS = [
    lambda x: jnp.sin(x) * 2 + 1,
    lambda x: (x[::-1], x[2:5], jnp.roll(x, 3), jnp.concatenate([x[:2], jnp.ones(3), x])),
    lambda x: x.reshape(3, 4) @ jnp.arange(20.0).reshape(4, 5),
    lambda x: jnp.outer(x[:3], x[3:6]) @ x[:3] + x.reshape(4, 3).T @ jnp.arange(4.0),
    lambda x: jax.nn.softmax(x.reshape(2, 6), axis=0).sum(1),
    lambda x: jnp.where(x > 0, jnp.sqrt(jnp.abs(x)), jnp.clip(x, -0.3, 0)),
    lambda x: (jnp.all(x < 9), jnp.any(jnp.isnan(x)), jnp.max(x), jnp.prod(x[:3]), ~(x[0] > x[1])),
    lambda x: jnp.linalg.norm(x) * jax.nn.relu(x) + jax.nn.gelu(x),
    lambda x: x[jnp.array([3, 1, 1])] + jnp.pad(x[:1], (1, 1)),
    lambda x: (jnp.round(2 * x) / 2, jnp.round(jnp.round(4 * x) / 2), jax.lax.round(jnp.round(4 * x) / 2)),
    lambda x: ((9 * x).astype(int) // 2, jax.lax.div((9 * x).astype(int), 4), (9 * x).astype(int) % 3),
    lambda x: jnp.arctan2(x[0], x[1]) % 360 + jnp.floor(5 * x[2]).astype(int) + x[3].astype(jnp.bfloat16),
    looped,
    jax.jit(lambda x: jax.lax.stop_gradient(x) ** 3 - x[:, None].squeeze()),
]


@needs_node
def test_programs_compute_what_jax_does():
    draws = np.random.default_rng(0).normal(size=(5, 12)).astype(np.float32)
    constants = Constants()
    programs = [translate(function, constants, jnp.zeros(12)) for function in FUNCTIONS]
    results = computed(programs, constants, [[[draw.tolist()] for draw in draws] for _ in FUNCTIONS])
    for function, cases in zip(FUNCTIONS, results, strict=True):
        for draw, outputs in zip(draws, cases, strict=True):
            expected = [np.asarray(leaf, float).ravel() for leaf in jax.tree.leaves(function(jnp.asarray(draw)))]
            assert len(outputs) == len(expected)
            for output, leaf in zip(outputs, expected, strict=True):
                np.testing.assert_allclose(output, leaf, rtol=1e-5, atol=1e-6)


def test_the_page_has_every_operation_that_programs_use():
    text = (page.SOURCES / "program.js").read_text()
    (table,) = re.findall(r"const ELEMENTWISE = \{(.*?)\n\};", text, re.DOTALL)
    assert set(re.findall(r"(\w+): ?(?=[(M1-9a-z])", table)) >= ELEMENTWISE | {"trunc", "bfloat16"}
    assert all(f"{name}: [" in text for name in REDUCTIONS)


def test_what_the_page_cannot_compute_is_named():
    for function, words in (
        (jnp.linalg.inv, "JAX's operation '"),
        (lambda x: x[0, x[1, 0].astype(int)], "at a place that varies"),
        (lambda x: jnp.einsum("bi,bi->b", x, x + 1), "products of batches of matrices"),
        (lambda x: jnp.take(x, jnp.array([9]), mode="fill", fill_value=0.5), "from outside an array"),
        (lambda x: x.at[jnp.array([9])].get(mode="fill"), "from outside an array"),
        (lambda x: x.astype(int) & 3, "JAX's operation 'and' of integers"),
    ):
        with pytest.raises(UsageError, match=words):
            translate(function, Constants(), jnp.eye(3))


@needs_node
def test_a_policy_and_its_family_act_in_the_page_as_in_jax():
    """The cheetah that ships, on 1,000 random observations."""
    trained = load(Path("pretrained:halfcheetah-vel"))
    program, params, constants = trained.program, policy_of(trained, 0), Constants()
    programs = translate_all(program.family, program.agent, params, constants)
    draw = np.random.default_rng(0).normal
    obs, codes = 3 * draw(size=(1000, 17)).astype(np.float32), draw(size=(1000, 3)).astype(np.float32)
    codes /= np.linalg.norm(codes, axis=1, keepdims=True)
    cases = [[one.tolist(), code.tolist()] for one, code in zip(obs, codes, strict=True)]
    (results,) = computed([programs["act"]], constants, [cases])
    expected = jnp.tanh(jax.vmap(lambda o, c: program.agent.distribution(params, c, o).mean)(obs, codes))
    np.testing.assert_allclose(np.array(results)[:, 0], expected, atol=2e-5)
    assert np.std(expected) > 0.3


def archive(folder: Path) -> bytes:
    """Returns an archive like npm's, with a small module and a small binary."""
    file = io.BytesIO()
    with tarfile.open(fileobj=file, mode="w:gz") as tar:
        for name, content in (("mujoco.js", b"module"), ("mujoco.wasm", b"binary")):
            member = tarfile.TarInfo(f"package/{name}")
            member.size = len(content)
            tar.addfile(member, io.BytesIO(content))
    (folder / "delivered.tgz").write_bytes(file.getvalue())
    return file.getvalue()


@pytest.fixture
def npm(tmp_path, monkeypatch) -> Path:
    """Puts an npm on the path that delivers a small archive, whose hash is the pinned one, and counts its calls."""
    monkeypatch.setenv("EAR_JAX_CACHE", str(tmp_path / "cache"))
    content = archive(tmp_path)
    monkeypatch.setattr(wasm, "INTEGRITY", wasm._integrity(content))
    program = tmp_path / "bin" / "npm"
    program.parent.mkdir()
    program.write_text(
        f'#!/bin/sh\necho called >> {tmp_path}/calls\nwhile [ "$1" != --pack-destination ]; do shift; done\n'
        f'cp {tmp_path}/delivered.tgz "$2/mujoco-mujoco.tgz"\n'
    )
    program.chmod(0o755)
    monkeypatch.setenv("PATH", f"{program.parent}:/usr/bin:/bin")
    return tmp_path


def calls(folder: Path) -> int:
    return len((folder / "calls").read_text().splitlines()) if (folder / "calls").exists() else 0


def test_mujoco_is_fetched_once(npm, monkeypatch):
    assert wasm.cached() is None
    assert wasm.find() == wasm.find() == wasm.Wasm(b"module", b"binary")
    assert calls(npm) == 1
    monkeypatch.setenv("PATH", "/nowhere")
    assert wasm.find().module == b"module", "no npm and no network is needed any more"


def test_another_archive_is_refused_and_not_kept(npm):
    (npm / "delivered.tgz").write_bytes(b"something else")
    with pytest.raises(RunError, match="its SHA-512 differs"):
        wasm.find()
    assert not list((npm / "cache").rglob("*"))


def test_a_damaged_archive_in_the_cache_is_fetched_again(npm):
    wasm.find()
    wasm.archive_path().write_bytes(b"damaged")
    assert wasm.find().binary == b"binary"
    assert calls(npm) == 2


def test_an_npm_that_fails_or_is_missing_is_one_line(npm, monkeypatch):
    (npm / "bin" / "npm").write_text("#!/bin/sh\nexec /bin/sleep 60\n")
    with monkeypatch.context() as patch:
        patch.setattr(wasm, "SECONDS", 0.1)
        with pytest.raises(RunError, match=r"npm gave no answer in 0\.1 seconds"):
            wasm.find()
    (npm / "bin" / "npm").write_text("#!/bin/sh\necho 'npm error network' >&2\nexit 1\n")
    with pytest.raises(RunError, match=r"npm could not fetch @mujoco/mujoco 3.14.0 \(npm error network\)"):
        wasm.find()
    monkeypatch.setenv("PATH", "/nowhere")
    with pytest.raises(RunError, match="is not installed"):
        wasm.find()


class Own(Family):
    """A family with a model of its own, made from text."""

    name, substeps, mjx_solver, commanded, unit = "own", 1, (4, 8), "x", "m"
    text = (
        "<mujoco><worldbody><body><joint name='j' type='slide' axis='1 0 0'/><geom size='.1' mass='1' margin='.01'/>"
        "</body></worldbody><actuator><motor joint='j'/></actuator></mujoco>"
    )
    training_tasks = parse_task = initial = observe = outcome = reward = lambda *_: None

    def load(self):
        return mujoco.MjModel.from_xml_string(self.text)


CHANGES = [
    lambda model: model.body_mass.fill(2),
    lambda model: setattr(model.opt, "density", 1000),
    lambda model: model.geom_contype.fill(0),
    lambda model: setattr(model.opt, "disableflags", mujoco.mjtDisableBit.mjDSBL_GRAVITY),
    lambda model: model.jnt_limited.fill(1),
]


def test_models_are_handed_to_the_page_as_they_are():
    own = portable(Own("native"))
    assert own["margins"] == [0.01]
    model = mujoco.MjModel.from_xml_string(own["xml"])
    assert (model.nq, model.nu, model.body_mass[1]) == (1, 1, 1)


def test_what_is_only_seen_may_differ():
    class Shown(Own):
        def source(self):
            seen = "<custom><numeric name='n' data='1'/></custom><asset><texture name='t' type='2d' builtin='flat'"
            seen += " width='8' height='8'/><material name='m' texture='t' rgba='1 0 0 1'/></asset>"
            seen += "<worldbody><light/><camera/>"
            return self.text.replace("<worldbody>", seen).replace("<geom ", "<geom material='m' group='1' user='3' ")

    assert "material" in portable(Shown("native"))["xml"]


@pytest.mark.parametrize("change", CHANGES)
def test_a_model_that_moves_otherwise_is_refused(change):
    family = Own("native")
    change(family.model)
    with pytest.raises(UsageError, match="cannot rebuild the family's model"):
        portable(family)


def test_the_documents_own_family_can_be_live(tmp_path):
    """The family of `docs/your-own-family.md`, with a policy that nothing has trained."""
    guide = Path(__file__).parents[2] / "docs" / "your-own-family.md"
    (code,) = re.findall(r"^```python\n(.*?)^```$", guide.read_text(), re.MULTILINE | re.DOTALL)
    file = tmp_path / "own.py"
    file.write_text(code)
    config = preset_config("halfcheetah-vel", "smoke")
    config = dataclasses.replace(config, family=f"{file}:BalanceAt", engine="native", tasks=("-0.3", "0.3"))
    program = make_program(config)
    params = program.agent.init_policy(jax.random.key(0))
    programs = translate_all(program.family, program.agent, params, Constants())
    assert [step[0] for step in programs["terminated"]["steps"]] == ["take", "abs", "gt"]
    assert portable(program.family)["xml"].startswith("<mujoco")
    assert len(view(program.family)["shapes"]) == 3, "the rail, the cart and the pole"


def test_shapes_are_fixed_to_bodies():
    model = make_family("halfcheetah-vel", "native").model
    drawn = shapes(model, model)
    assert len(drawn) == model.ngeom - 1, "all but the floor"
    assert all(shape["body"] and len(shape["ends"]) == 2 for shape in drawn)
    spec = mujoco.MjSpec.from_string(
        "<mujoco><worldbody><body><freejoint/><geom type='box' size='.1 .2 .3' mass='1'/>"
        "<geom type='cylinder' size='.1 .3' mass='1'/><geom type='ellipsoid' size='.1 .2 .3' mass='1'/></body>"
        "</worldbody></mujoco>"
    )
    model = spec.compile()
    for shape in shapes(model, model):
        faces, vertices = np.array(shape["faces"]), np.array(shape["vertices"])
        a, b, c = np.moveaxis(vertices[faces], 1, 0)
        outward = np.sum(np.cross(b - a, c - a) * (a + b + c), axis=1)
        assert (outward > 0).all(), "every face is seen from outside"
        edges = np.sort(faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
        assert (np.unique(edges, axis=0, return_counts=True)[1] == 2).all(), "closed"


def test_the_octahedron_covers_the_sphere_evenly():
    points = octahedron(64)
    np.testing.assert_allclose(np.linalg.norm(points, axis=1), 1)
    nearest = (fibonacci_sphere(500) @ points.T).max(axis=1)
    assert np.degrees(np.arccos(nearest.min())) < 3


def test_scripts_are_joined_without_a_network_and_with_each_name_once():
    text = page.script()
    assert "import {" not in text
    assert "export " not in text
    names = re.findall(r"^(?:const|let|function|async function) (\w+)", text, re.MULTILINE)
    assert len(names) == len(set(names))
    every = text + (page.SOURCES / "page.html").read_text() + (page.SOURCES / "page.css").read_text()
    assert re.findall(r"https?://[^\"' )]+", every) == []
    assert not re.search(r"innerHTML|outerHTML|insertAdjacentHTML|document\.write", text), "names are never markup"


def test_a_page_holds_names_as_text(tmp_path):
    robot = {"name": "</script><b>bold", "tasks": [{"name": "{{script}}"}]}
    path = page.write_live_page(tmp_path / "page.html", [(robot, "AAAA")], wasm.Wasm(b"module", b"binary"))
    text = path.read_text()
    assert "<b>bold" not in text
    (data,) = re.findall(r'<script type="application/json" id="data">(.*?)</script>', text)
    assert json.loads(data) == {"robots": [robot]}
    again = page.write_live_page(tmp_path / "again.html", [(robot, "AAAA")], wasm.Wasm(b"module", b"binary"))
    digest = hashlib.sha256(path.read_bytes()).hexdigest()
    assert hashlib.sha256(again.read_bytes()).hexdigest() == digest, "equal inputs, equal bytes"


def test_without_npm_the_command_replays_and_says_why(finished, monkeypatch, tmp_path, capsys):
    monkeypatch.setenv("EAR_JAX_CACHE", str(tmp_path / "cache"))
    monkeypatch.setenv("PATH", "/nowhere")
    assert main(["explore", str(finished), "--places", "12", "--steps", "40"]) == 0
    out, err = capsys.readouterr()
    assert "The page replays roll-outs, as npm, which fetches MuJoCo's WebAssembly" in " ".join(err.split())
    path = finished / "explore_seed0_places-12_steps-40.html"
    assert out.strip() == f"{path}: {path.as_uri()}"


@pytest.mark.parametrize("words", [[], ["RUN", "--all"]])
def test_a_run_or_all_is_named(words, capsys):
    assert main(["explore", *words]) == 2
    assert capsys.readouterr().err.startswith("ear: name a run, as in `ear explore pretrained:halfcheetah-vel`")
