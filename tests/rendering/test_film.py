"""Trajectories, strips and films of robots; films need a machine with OpenGL."""

from __future__ import annotations

import dataclasses
import json
import shutil
from pathlib import Path

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest
from PIL import Image

from ear_jax.cli.main import main
from ear_jax.config import Config
from ear_jax.embeddings.trajectory import Trajectory, follow
from ear_jax.envs import Family, make_family
from ear_jax.errors import RunError, UsageError
from ear_jax.figures import video
from ear_jax.figures.strip import DPI, draw_strip
from ear_jax.physics.models import load_model
from ear_jax.physics.sawyer import load_arm
from ear_jax.rendering import scene
from ear_jax.rendering.film import Strip, arrange, film, photograph
from ear_jax.rendering.scene import Canvas, camera_without_perspective, limbs, project
from ear_jax.runs.training import Program
from tests.helpers.cheetah import running
from tests.helpers.obedient import CODES, obedient
from tests.helpers.probe import SLIDER, Slider


@pytest.fixture(scope="module")
def gl() -> None:
    """Skips a test on a machine without OpenGL."""
    try:
        with Canvas(mujoco.MjModel.from_xml_string(SLIDER), 8, 8):
            pass
    except RunError as error:
        pytest.skip(f"needs OpenGL: {error}")


@pytest.fixture
def no_gl(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("MUJOCO_GL", raising=False)
    monkeypatch.setattr(scene.sys, "platform", "linux")
    monkeypatch.setattr(scene.ctypes.util, "find_library", lambda name: None)


@pytest.fixture(scope="module")
def run(finished_once: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run that has hardly learnt anything, which is enough to draw."""
    return Path(shutil.copytree(finished_once, tmp_path_factory.mktemp("render") / "run"))


def program(family: Family, codes: jax.Array) -> Program:
    return Program(Config(family.name), family, family.training_tasks(), obedient(codes), None)  # type: ignore[arg-type]


def strip(cheetah: mujoco.MjModel, *speeds: float) -> Strip:
    return arrange(cheetah, [running(cheetah, speed) for speed in speeds], [str(speed) for speed in speeds], 0.05)


def test_what_stands_beside_a_robot_does_not_say_how_it_moves():
    """Gymnasium's reacher: an arm, and a target on slides of its own."""
    assert scene.locomotion_of(load_model("reacher.xml")) == "fixed"
    assert scene.locomotion_of(load_model("inverted_pendulum.xml")) == "runs"
    assert scene.locomotion_of(load_model("ant.xml")) == "roams"


def test_a_trajectory_is_the_roll_out_pose_by_pose_past_the_time_limit():
    """A mass of 1 kg pushed with a N stands at a dt² n (n + 1) / 2 after n steps of MuJoCo's semi-implicit Euler."""
    found = follow(program(Slider("native"), CODES), jnp.zeros(1), CODES, 30, jax.random.key(0))
    assert Slider.episode_length < 30
    step = np.arange(31)
    for trajectory, force in zip(found, (-0.5, 0.5), strict=True):
        assert not trajectory.fell
        assert trajectory.qpos[0] == found[0].qpos[0], "all start where the first does"
        moved = trajectory.qpos[:, 0] - trajectory.qpos[0, 0]
        np.testing.assert_allclose(moved, force * 1e-4 * step * (step + 1) / 2, atol=1e-5)
        assert trajectory.achieved == pytest.approx(force, abs=1e-5)


def test_a_trajectory_ends_where_the_robot_fails():
    """The slider fails past 2 m."""
    code = jnp.array([[0.99, 0.14, 0.0]])
    (trajectory,) = follow(program(Slider("native"), CODES), jnp.zeros(1), code, 250, jax.random.key(0))
    assert trajectory.fell
    assert 50 < len(trajectory.qpos) < 250
    assert 1.9 < trajectory.qpos[-1, 0] <= 2
    assert (np.diff(trajectory.qpos[:, 0]) > 0).all(), "and nothing of the next episode is in it"


def test_limbs_are_the_models_capsules(cheetah):
    """The cheetah's torso is a capsule from x = −0.5 to 0.5 m, 0.7 m high and 0.046 m thick."""
    seen = limbs(cheetah, running(cheetah, 1.0).qpos[[0, 20]])
    torso = np.sort(seen.ends[:, 0], axis=1)
    np.testing.assert_allclose(torso[0], [[-0.5, 0, 0.7], [0.5, 0, 0.7]], atol=1e-6)
    np.testing.assert_allclose(seen.ends[1] - seen.ends[0], np.broadcast_to([1.0, 0, 0], (8, 2, 3)), atol=1e-6)
    assert seen.radii[0] == pytest.approx(0.046)


def test_other_shapes_are_capsules_along_their_longest_side():
    """A box of 0.2 × 0.4 × 1.0 m, lying along x after a quarter turn about y, and a ball, both 2 m up."""
    model = mujoco.MjModel.from_xml_string(
        """<mujoco><worldbody><body pos="0 0 2"><freejoint/>
        <geom type="box" size="0.1 0.2 0.5" euler="0 90 0"/><geom type="sphere" size="0.3"/>
        </body></worldbody></mujoco>"""
    )
    seen = limbs(model, model.qpos0[None])
    np.testing.assert_allclose(seen.radii, [0.15, 0.3])
    box, ball = seen.ends[0]
    np.testing.assert_allclose(box[np.argsort(box[:, 0])], [[-0.35, 0, 2], [0.35, 0, 2]], atol=1e-9)
    np.testing.assert_allclose(ball, [[0, 0, 2], [0, 0, 2]], atol=1e-9)


def test_a_model_without_shapes_is_refused():
    arm = load_arm()
    with pytest.raises(UsageError, match=r"^there is nothing to draw"):
        limbs(arm, arm.qpos0[None])


def test_poses_of_a_strip_lie_evenly_back_from_the_end_within_what_is_seen(cheetah):
    found = strip(cheetah, 1, 2, 3)
    assert len(found.panels) == 3
    for poses, track, speed in zip(found.poses, found.tracks, (1, 2, 3), strict=True):
        assert len(poses) > 2
        assert poses[-1, 0] == pytest.approx(5 * speed), "5 s of running"
        np.testing.assert_allclose(np.diff(poses[:, 0]), speed * found.seconds, rtol=1e-6)
        across, up = track.limbs[..., 0], track.limbs[..., 1]
        assert (across > found.bounds.left).all()
        assert (across < found.bounds.right).all()
        assert (up > found.bounds.low).all()
        assert (up < found.bounds.high).all()
        assert track.flag[0] == pytest.approx(limbs(cheetah, poses[-1:]).centres[0, 0])
    assert found.bounds.left < 0, "a short way is shown whole"


@pytest.mark.parametrize("way", [1, -1])
def test_of_a_long_way_a_strip_shows_the_part_with_the_flags(cheetah, way):
    found = strip(cheetah, 8 * way, 9 * way)
    assert found.bounds.left < min(track.flag[0] for track in found.tracks) - 1
    assert found.bounds.right > max(track.flag[0] for track in found.tracks) + 1
    assert not found.bounds.left < 0 < found.bounds.right


def test_a_robot_that_stands_still_is_a_strip_too(cheetah):
    found = strip(cheetah, 0.0)
    assert [len(poses) for poses in found.poses] == [1]
    assert found.caption == "x (m), last pose of each"


@pytest.mark.parametrize("steps", [20, 60, 100, 400])
@pytest.mark.parametrize("speeds", [(0.02,), (0.3, 0.6), (1.0,), (1, 2, 3), (0, 0, 2), (0.2, 8)])
def test_no_pose_of_a_strip_covers_the_one_before_it(cheetah, speeds, steps):
    ways = [running(cheetah, speed, steps) for speed in speeds]
    found = arrange(cheetah, ways, [str(speed) for speed in speeds], 0.05)
    length = limbs(cheetah, ways[0].qpos[:1]).length
    for poses in found.poses:
        assert len(poses) >= 1
        assert (np.diff(poses[:, 0]) > 0.95 * length).all()


def test_robots_that_roam_share_a_panel():
    ant = load_model("ant.xml")
    ways = []
    for across, away in ((1, 0), (0, 1)):
        qpos = np.tile(ant.qpos0, (51, 1))
        qpos[:, 0], qpos[:, 1] = np.outer((across, away), np.linspace(0, 5, 51))
        ways.append(Trajectory(qpos, False, {}, 0.0))
    found = arrange(ant, ways, ["dir-0", "dir-90"], 0.05)
    (panel,) = found.panels
    east, north = (np.array(track.flag[:2]) for track in panel.tracks)
    np.testing.assert_allclose(east - north, [5, -5 * np.sin(np.radians(50))], atol=1e-6)


def test_robots_that_stand_stand_side_by_side_where_each_ended(tmp_path):
    """The arm as it is drawn: its gripper 0.1 m to its right, then to its left."""
    arm = make_family("reach", "native").portrait()
    poses = np.array(
        [[1.22, -0.5, 0.16, 0.65, -0.13, 1.41, 3.06, 0, 0], [1.37, -0.5, 0.44, 0.6, -0.38, 1.53, 3.36, 0, 0]]
    )
    ways = [Trajectory(np.stack([poses[1 - row], poses[row]]), False, {}, 0.0) for row in (0, 1)]
    found = arrange(arm, ways, ["goal-0", "goal-180"], 0.0125)
    tracks = [panel.tracks[0] for panel in found.panels]
    assert [track.flag for track in tracks] == [None, None]
    for shown, pose in zip(found.poses, poses, strict=True):
        np.testing.assert_array_equal(shown, [pose])
    right, left = (track.limbs[0].mean(axis=1) for track in tracks)  # of the robot, which faces the camera
    assert (left - right)[:, 0].max() == pytest.approx(0.2, abs=0.03), "fingers"
    assert found.caption == "across (m), last pose of each"
    path = draw_strip(tmp_path / "arms.png", found.panels, found.bounds, found.caption, found.beside)
    tall, wide, _ = np.asarray(Image.open(path).convert("RGB")).shape
    assert wide > 1.3 * tall, "one beside the other"


def test_a_strip_of_sticks_is_drawn_to_size(cheetah, tmp_path):
    found = strip(cheetah, 1, 2)
    path = draw_strip(tmp_path / "strip.png", found.panels, found.bounds, found.caption)
    picture = np.asarray(Image.open(path).convert("RGB"))
    assert picture.shape[1] == pytest.approx(DPI * (1.1 + found.bounds.inches[0] + 0.15), abs=2)
    red = (picture == (0xD5, 0x00, 0x0F)).all(-1)
    assert red.sum() > 200, "there are flags"
    assert list(tmp_path.iterdir()) == [path]


def test_a_gif_lasts_as_long_as_was_filmed_and_leaves_pictures_out_to_stay_small(tmp_path, monkeypatch):
    pictures = list(np.random.default_rng(0).integers(0, 255, (8, 40, 60, 3), dtype=np.uint8))
    sizes = []
    for limit, frames in ((10**9, 8), (15_000, 4)):
        monkeypatch.setattr(video, "GIF_BYTES", limit)
        path = video.write_gif(tmp_path / "film.gif", pictures, 0.04)
        with Image.open(path) as film:
            assert (film.n_frames, film.size) == (frames, (60, 40))
            durations = []
            for index in range(film.n_frames):
                film.seek(index)
                durations.append(film.info["duration"])
        assert sum(durations) == 320, "milliseconds"
        sizes.append(path.stat().st_size)
    assert sizes[1] <= 15_000 < sizes[0]
    assert list(tmp_path.iterdir()) == [path]


def test_an_mp4_needs_ffmpeg(tmp_path, monkeypatch):
    pictures = [np.full((40, 60, 3), shade, np.uint8) for shade in (0, 128, 255)]
    if shutil.which("ffmpeg"):
        path = video.write_mp4(tmp_path / "film.mp4", pictures, 0.04)
        assert path.read_bytes()[4:8] == b"ftyp"
        with pytest.raises(RunError, match="ffmpeg cannot write"):
            video.write_mp4(tmp_path / "nowhere" / "film.mp4", pictures, 0.04)
    monkeypatch.setenv("PATH", "")
    assert video.write_mp4(tmp_path / "other.mp4", pictures, 0.04) is None


@pytest.mark.usefixtures("gl")
@pytest.mark.parametrize("elevation", [0.2, 0.9])
def test_the_camera_sees_a_robot_where_it_is_projected(cheetah, elevation):
    bounds = dataclasses.replace(strip(cheetah, 1).bounds, left=1.0, right=5.0, low=-0.5, high=1.5)
    camera, pose = camera_without_perspective(bounds, elevation), running(cheetah, 2.0).qpos[[30]]
    with Canvas(cheetah, 400, 200) as canvas:
        there = canvas.draw(pose, camera, 2.0).astype(int)
        away = canvas.draw(pose + np.eye(9)[0] * 50, camera, 2.0).astype(int)
    rows, columns = np.nonzero(np.abs(there - away).max(-1) > 60)

    def nearest(point: np.ndarray) -> float:
        across, up = project(point, elevation)
        return np.hypot(rows - 100 * (1.5 - up), columns - 100 * (across - 1.0)).min()

    torso = limbs(cheetah, pose).ends[0, 0]
    assert max(nearest(point) for point in torso) < 3, "pixels, a hundred a metre"
    assert min(nearest(np.add(point, (0, 0, 0.6))) for point in torso) > 20


@pytest.mark.usefixtures("gl")
def test_a_film_keeps_the_robot_in_its_middle(cheetah):
    pictures, seconds = film(cheetah, [running(cheetah, 40.0, 3, fell=True)], ["vel-40"], 0.05)
    assert (len(pictures), seconds, pictures[0].shape) == (4, 0.05, (270, 480, 3))
    for picture in pictures:
        ochre = picture[:, 120:360].astype(int)
        assert (ochre[..., 0] - ochre[..., 2] > 60).sum() > 500, "its colour is nowhere on the stage"


@pytest.mark.usefixtures("gl")
def test_a_strip_is_photographed_in_as_many_pixels_as_it_is_drawn(cheetah):
    found = strip(cheetah, 1, 2)
    panels = photograph(found)
    assert [panel.picture.shape[:2] for panel in panels] == [found.bounds.pixels[::-1]] * 2


@pytest.mark.usefixtures("gl")
def test_render_writes_pictures_and_one_json_document(run, capsys):
    assert main(["render", str(run), "--interpolate", "1", "3m/s", "--beta", "0.5", "--steps", "3", "--json"]) == 0
    document = json.loads(capsys.readouterr().out)
    assert [scene["name"] for scene in document["scenes"]] == ["vel-1", "β = 0.5", "vel-3"]
    assert [scene["steps"] for scene in document["scenes"]] == [3] * 3
    first, middle, last = (np.array(scene["lte"]) for scene in document["scenes"])
    np.testing.assert_allclose(middle, (first + last) / np.linalg.norm(first + last), atol=1e-5)
    assert {"strip", "gif"} <= set(document["files"])
    for path in document["files"].values():
        assert Path(path).stat().st_size > 1000
    with Image.open(document["files"]["gif"]) as gif:
        assert gif.size == (480, 3 * 160)
    assert main(["render", str(run), "--task", "1", "--no-film", "--steps", "3", "--json"]) == 0
    assert list(json.loads(capsys.readouterr().out)["files"]) == ["strip"]


@pytest.mark.usefixtures("no_gl")
def test_without_opengl_one_line_says_what_to_install_and_the_strip_still_comes(run, capsys):
    assert main(["render", str(run), "--lte", "1", "0", "-1", "--steps", "3"]) == 1
    complaint = capsys.readouterr().err.splitlines()[-1]
    assert complaint.startswith("ear: pictures of the robot need OpenGL; install libegl1")
    assert (run / "figures" / "strip_LTE_1_0_-1_steps-3.png").is_file()
    assert not list((run / "videos").glob("LTE*"))


@pytest.mark.parametrize(
    ("words", "complaint"),
    [
        ("", "give one of --task X"),
        ("--task 1 --interpolate 1 3", "give one of --task X"),
        ("--task 2", "unknown task 'vel-2'; did you mean 'vel-"),
        ("--task fast", "name a speed in metres per second"),
        ("--interpolate 3 vel-3", "names one task twice"),
        ("--interpolate 1 3 --beta nan", "--beta nan is out of range; it must be finite"),
        ("--task 1 --beta 0.5", "--beta goes only with --interpolate A B"),
        ("--lte 1 0", "--lte has 2 numbers; this run's LTEs have 3"),
        ("--lte 0 0 0", "has no direction"),
        ("--task 1 --steps 0", "must be at least 1"),
        ("--task 1 --policy 2", "--policy 2 is out of range"),
    ],
)
def test_a_mistake_gets_one_clear_line_and_leaves_nothing(run, words, complaint, capsys):
    before = sorted(run.rglob("*"))  # other tests may have left files
    assert main(["render", str(run), *words.split()]) == 2
    streams = capsys.readouterr()
    assert complaint in streams.err
    assert (streams.err.count("\n"), streams.out) == (1, "")
    assert sorted(run.rglob("*")) == before


def test_without_a_library_for_opengl_one_line_says_so(monkeypatch):
    monkeypatch.delenv("MUJOCO_GL", raising=False)
    monkeypatch.setattr("ctypes.util.find_library", lambda name: None)
    with pytest.raises(RunError, match="neither EGL nor OSMesa is installed"):
        Canvas(load_model("hopper.xml"), 64, 64)
