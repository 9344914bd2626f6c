"""A sitting at an accelerator: what fits, how long it takes and what comes back."""

from __future__ import annotations

import dataclasses

import pytest

from ear_jax.errors import UsageError
from ear_jax.presets import preset_config
from ear_jax.runs import records
from experiments.__main__ import main
from experiments.inventory import Job
from experiments.paper import EVALUATION
from experiments.sitting import ANALYSIS, plan_sitting, script, seconds_of, timed_runs
from tests.helpers.fake_records import record

pytestmark = pytest.mark.usefixtures("place")


def timed(seconds: float, family: str = "halfcheetah-vel", agent: str = "ear", **settings: int) -> None:
    """Records a run whose 400 epochs took as long on an accelerator."""
    directory = record(family, agent, **settings)
    about, rows = records.read_run(directory), records.read_rows(directory / "metrics.jsonl")
    records.write_json(directory / "config.json", {**about, "machine": {**about["machine"], "accelerator": "TPU v9"}})
    (directory / "metrics.jsonl").unlink()
    rows = [{**row, "seconds": seconds * row["epoch"] / 400} for row in rows]
    records.append_rows(directory / "metrics.jsonl", rows)


def job(family: str, agent: str = "ear", seed: int = 0, seeds: int = 1, epochs: int = 200) -> Job:
    config = preset_config(family, "fast", agent)
    return Job(dataclasses.replace(config, seed=seed, seeds=seeds, epochs=epochs), (EVALUATION,))


def test_a_run_takes_as_long_as_the_most_similar_one_that_was_timed():
    record("walker-vel")  # on a processor
    timed(400, "halfcheetah-vel", "ear", seeds=3)
    timed(1200, "halfcheetah-vel", "onehot")
    timed(2400, "hopper-vel", "onehot")
    runs = timed_runs()
    assert len(runs) == 3
    assert seconds_of(job("halfcheetah-vel", "ear", 7), runs) == 200 + ANALYSIS
    assert seconds_of(job("halfcheetah-vel", "ear", 7, seeds=5), runs) == pytest.approx(200 * 1.1 + ANALYSIS)
    assert seconds_of(job("halfcheetah-vel", "pearl"), runs) == 600 + ANALYSIS, "the slowest of the family"
    assert seconds_of(job("ant-dir"), runs) == 1200 + ANALYSIS, "the slowest of all"
    assert seconds_of(job("halfcheetah-vel", "maml"), runs) is None, "an epoch of it is one update"


def test_what_costs_least_for_a_seed_comes_first_and_what_is_there_not_at_all():
    timed(1200, "halfcheetah-vel")
    done, alone = job("halfcheetah-vel", epochs=400), job("halfcheetah-vel", "onehot", epochs=100)
    together, maml = job("halfcheetah-vel", "pearl", seeds=3), job("halfcheetah-vel", "maml")
    done = dataclasses.replace(done, analyses=())
    sitting = plan_sitting([done, alone, together, maml], 13, timed_runs())
    assert [one.name for one, _ in sitting.fits] == [together.name]
    assert [one.name for one, _ in sitting.left] == [alone.name, maml.name]
    assert sitting.seconds == pytest.approx(600 * 1.1 + ANALYSIS)
    both = plan_sitting([alone, together], 20, timed_runs())
    assert [one.name for one, _ in both.fits] == [together.name, alone.name]
    with pytest.raises(UsageError, match=r"--minutes 5 is too short; the shortest run takes about 5\.7"):
        plan_sitting([alone, together], 5, timed_runs())
    with pytest.raises(UsageError, match="there is nothing to plan"):
        plan_sitting([done, maml], 20, timed_runs())


def test_records_come_back_in_files_that_are_small_enough():
    timed(4, "halfcheetah-vel")
    wanted = [job(family, "onehot", seeds=5) for family in ("halfcheetah-vel", "hopper-vel", "walker-vel")]
    lines = script(plan_sitting(wanted, 30, timed_runs()), ["python", "x"], timed_runs())
    assert "of 30 minutes, as long as such runs took on TPU v9." in lines[0]
    assert lines[1].startswith("python x --only halfcheetah-vel-onehot-fast-seeds0-4  # about 0.7 minutes")
    names = [f"{family}-vel-onehot-fast-seeds0-4" for family in ("halfcheetah", "hopper", "walker")]
    assert lines[4:] == [
        f"tar czf records-{number}.tar.gz -C experiments/records {name}  # at most 15 MiB"
        for number, name in enumerate(names, 1)
    ]


def test_a_plan_is_a_script_of_runs_of_a_table(capsys):
    assert main(["reproduce", "figure-7", "--plan"]) == 2
    assert "--plan needs --minutes, the length of the sitting" in capsys.readouterr().err
    timed(400, "halfcheetah-vel", seed=9)
    assert main(["reproduce", "figure-7", "--plan", "--minutes", "30", "--seeds", "2"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[1].startswith(
        "python -m experiments reproduce figure-7 --preset fast --together --seeds 2 "
        "--only halfcheetah-vel-ear-fast-seeds0-1  # about 7."
    )
    assert lines[2].startswith("tar czf records-1.tar.gz -C experiments/records halfcheetah-vel-ear-fast-seeds0-1")
