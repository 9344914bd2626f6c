"""The processes of a run as the command line and a scheduler name them, and mistakes in it."""

from __future__ import annotations

import contextlib
import socket
import threading
from collections.abc import Callable, Iterator

import pytest

from ear_jax.cli.main import main
from ear_jax.errors import RunError, UsageError
from ear_jax.process import hosts
from ear_jax.process.relay import Relay
from ear_jax.runs.seeds import check_seeds

SLURM = {"JOB_ID": "4096", "STEP_NODELIST": "node[07-09],other", "NTASKS": "4", "PROCID": "2", "LOCALID": "1"}


@pytest.mark.parametrize(
    ("words", "complaint"),
    [
        ("--hosts.count 2", "need --hosts.coordinator HOST:PORT"),
        ("--hosts.coordinator node1 --hosts.count 2 --hosts.index 0", "node1 is neither HOST:PORT, as in node1:4321"),
        ("--hosts.coordinator node1:70000 --hosts.count 2 --hosts.index 0", "neither HOST:PORT"),
        ("--hosts.coordinator node1:4321", "needs --hosts.count and --hosts.index"),
        ("--hosts.coordinator node1:4321 --hosts.count 0 --hosts.index 0", "--hosts.count 0 is too small"),
        ("--hosts.coordinator node1:4321 --hosts.count 2 --hosts.index 2", "it must be from 0 to 1"),
        ("--hosts.coordinator auto", "finds neither SLURM (start with srun) nor Open MPI (mpirun) here"),
        ("--hosts.coordinator auto --dry-run", "--dry-run estimates a run on one host"),
        ("--hosts.cont 2", "did you mean --hosts.count?"),
    ],
)
def test_a_mistake_is_told_in_one_line(words, complaint, capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert main(["train", "hopper-vel", *words.split()]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert complaint in line
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(("tasks", "devices"), [("2(x2)", [1]), ("1(x4)", None), ("1", None), ("", [1])])
def test_slurm_names_the_processes(tasks, devices, monkeypatch):
    for name, value in {**SLURM, "STEP_TASKS_PER_NODE": tasks}.items():
        monkeypatch.setenv(f"SLURM_{name}", value)
    assert hosts._scheduled() == (("node07", 65535 - 4095), 4, 2, devices)


def test_a_port_in_use_is_told_in_one_line(monkeypatch):
    monkeypatch.setattr(hosts, "_joined", None)
    with socket.create_server(("", 0)) as taken:
        named = hosts.Hosts(f"localhost:{taken.getsockname()[1]}", 2, 0)
        with pytest.raises(
            RunError, match=r"the 2 processes did not meet at localhost:\d+: .*[Aa]ddress already in use"
        ):
            hosts.join(named)
    assert hosts.count() == 1


def test_seeds_are_spread_evenly_over_hosts(monkeypatch):
    monkeypatch.setattr(hosts, "_joined", hosts._Joined(0, 3, Relay(pytest.fail), iter(())))
    check_seeds(6)
    with pytest.raises(UsageError, match="4 seeds cannot be spread evenly over 3 hosts; their number must be a mult"):
        check_seeds(4)


def test_on_one_host_all_is_decided_there():
    assert (hosts.count(), hosts.index(), hosts.gather([1])) == (1, 0, [[1]])
    assert hosts.agree(lambda: (1, None)) == (1, None)
    with pytest.raises(RunError, match="full"):
        hosts.agree(lambda: (_ for _ in ()).throw(RunError("full")))


@contextlib.contextmanager
def served(ended: Callable[[str], None]) -> Iterator[tuple[tuple[str, int], socket.socket]]:
    """Yields the address of the relay of process 0, and the socket to which it forwards."""
    with socket.create_server(("127.0.0.1", 0)) as service, socket.create_server(("127.0.0.1", 0)) as listening:
        Relay(ended).serve(listening, service.getsockname()[:2])
        yield listening.getsockname()[:2], service


def test_relays_forward_both_ways():
    with served(lambda _: None) as (address, service):
        client = Relay(lambda _: None)
        near = socket.create_connection(client.dial(address, "process 1 on node2", 5))
        inside, _ = service.accept()
        with near, inside:
            for one, other in ((near, inside), (inside, near)):
                one.sendall(b"hello")
                assert other.recv(5) == b"hello"


def test_the_end_of_a_greeted_connection_is_that_of_its_process():
    ended: list[str] = []
    told = threading.Event()
    with served(lambda name: (ended.append(name), told.set())) as (address, service):  # type: ignore[func-returns-value]
        with socket.create_connection(address) as stranger:
            stranger.sendall(b"GET / HTTP/1.1" + b" " * 50)
            assert stranger.recv(1) == b"", "it is turned away"
        with socket.create_connection(address) as far:
            far.sendall(b"ear_jax process 1 on node2".ljust(64))
            inside, _ = service.accept()
        with inside:
            assert told.wait(10)
    assert ended == ["process 1 on node2"]
