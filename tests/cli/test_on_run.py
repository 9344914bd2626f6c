"""Mistakes about a trained run: each is one line, before anything is compiled or played."""

from __future__ import annotations

import functools
from pathlib import Path

import pytest

from ear_jax.cli.main import main
from ear_jax.embeddings import ltes
from ear_jax.runs import trained

load = functools.cache(trained.load)
HOPPER, JUMPER = "pretrained:hopper-vel", "pretrained:halfcheetah-run-jump"


@pytest.fixture
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A working directory in which an LTE is saved for the hopper's policy, and two that do not fit it."""
    monkeypatch.setattr(trained, "load", load)
    monkeypatch.chdir(tmp_path)
    run = Path("runs/pretrained-hopper-vel")
    policy = load(Path(HOPPER), None, None).fingerprint
    ltes.save(run, "trot", "vel-2", [[0.6, 0.8, 0.0]], policy)
    ltes.save(run, "old", "vel-2", [[0.6, 0.8, 0.0]], "before")
    ltes.save(run, "long", "vel-2", [[0.6, 0.8, 0.0, 0.0]], policy)
    return tmp_path


@pytest.mark.parametrize(
    ("words", "complaint"),
    [
        ("evaluate HOPPER --family ant-dir", "was trained on family hopper-vel, not ant-dir"),
        ("evaluate HOPPER --lte tort", "unknown LTE 'tort'; did you mean 'trot'?"),
        ("evaluate HOPPER --lte old", "'old' was found for another policy"),
        ("evaluate HOPPER --lte long", "'long' was found for another run: its codes are not 1 of 3 numbers"),
        ("evaluate HOPPER --lte 1 0", "--lte has 2 numbers; this run's LTEs have 3"),
        ("evaluate JUMPER --lte trot", "unknown LTE 'trot': runs/pretrained-halfcheetah-run-jump has none"),
        ("interpolate HOPPER", "give either --between A B or --all-pairs"),
        ("interpolate HOPPER --all-pairs --between 1 2", "give either --between A B or --all-pairs"),
        ("interpolate HOPPER --all-pairs --target 1", "--target goes only with --between A B, and without --beta"),
        ("interpolate HOPPER --between trot trot", "--between trot trot names one task twice"),
        ("interpolate HOPPER --between 1.8 vel-1.8", "--between 1.8 vel-1.8 names one task twice"),
        ("interpolate JUMPER --between back-1 jump-5", "'jump-5' has no target velocity to meet between; blend such"),
        ("compose HOPPER --between 2 2", "--between 2 2 names one task twice"),
        ("compose HOPPER --between 2 nowhere", "'nowhere'"),
        ("adapt JUMPER", "no adaptation tasks of its own; name some with --target"),
        ("adapt JUMPER --target jump-5 --zero-shot", "--zero-shot needs tasks with a target"),
        ("adapt HOPPER --target 1.7 2 --save x", "--save x saves the LTE of one task; name one task with --target"),
        ("adapt HOPPER --target 1.7 --save 2x", "'2x' cannot name an LTE: begin with a letter"),
        ("adapt HOPPER --target 1.7 --save checksum", "'checksum' cannot name an LTE: ltes.json uses that name"),
        ("adapt HOPPER --target 1.7 --save vel-2", "--save vel-2 would hide the task vel-2; choose another name"),
        ("adapt HOPPER --target 1.7 --zero-shot --elites 4", "--elites sets up a search, which --zero-shot leaves out"),
        ("adapt HOPPER --target 1.7 --sigma 0", "--sigma 0 is too small; it must be above 0"),
        ("evaluate hopper-vel", "hopper-vel is not a run directory; did you mean pretrained:hopper-vel?"),
        ("plot HOPPER", "pretrained:hopper-vel has no metrics: it ships without its run; name a run directory"),
        ("interpolate HOPPER --between 1 2 --beta 1e30", "--beta 1e+30 is out of range; it must be from -1000 to 1000"),
        ("imagine HOPPER --updates 10000000000", "--updates 10000000000 is too large; it must be at most 1000000000"),
        ("follow HOPPER --profile 0:1,3:1.5 --every 1e-9", "--every 1e-09 is out of range; it must be from 0.008 to 3"),
        ("config", "name a family first, as in `ear config halfcheetah-vel`"),
        ("sweep hopper-vel --vary lr 1e-3 1e-4", "unknown setting 'lr'; did you mean 'sac.lr'?"),
        ("train hopper-vel --minutes 0", "--minutes 0 is too small; it must be above 0"),
        ("lse HOPPER --task 99", "unknown task 'vel-99'"),
        ("render HOPPER --interpolate trot trot", "--interpolate trot trot names one task twice"),
        ("render HOPPER --interpolate trot nowhere", "'nowhere'"),
        ("render HOPPER --interpolate 2 vel-2", "--interpolate 2 vel-2 names one task twice"),
        ("map HOPPER --seed 3000000000", "--seed 3000000000 is out of range"),
        ("export HOPPER x.safetensors --policy -1", "--policy -1 is out of range: this run has 1 policy, number 0"),
        ("export HOPPER x.pickle", "x.pickle must end in .safetensors or .onnx"),
        ("demo --pretrained --out x", "--out applies only to training; --pretrained writes to runs/pretrained-NAME"),
    ],
)
def test_a_mistake_is_one_line_and_writes_nothing(words, complaint, here, capsys):
    before = sorted(here.rglob("*"))
    assert main(words.replace("HOPPER", HOPPER).replace("JUMPER", JUMPER).split()) == 2
    streams = capsys.readouterr()
    assert complaint in streams.err
    assert (streams.err.count("\n"), streams.out) == (1, "")
    assert sorted(here.rglob("*")) == before
