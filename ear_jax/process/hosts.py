"""One run over several hosts: a process on each of them, which trains seeds of its own.

No program waits for another host: seeds are independent, and a global mesh only says which process has which. Between
blocks processes exchange small JSON documents through JAX's coordination service. Process 0 does all writing and
deciding. On one host none of this has any effect.

Imports JAX in functions only: a process joins the others before JAX looks for devices.
"""

from __future__ import annotations

import atexit
import contextlib
import json
import logging
import os
import re
import socket
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from itertools import count as counter
from typing import Annotated, Any

import tyro

from ear_jax.errors import RunError, UsageError
from ear_jax.process.relay import Address, Relay
from ear_jax.process.stopping import SHOW_CURSOR, Stopped
from ear_jax.process.terminal import console

PATIENCE = 300  # seconds until all processes have joined
FOREVER = 7 * 24 * 3_600_000  # ms; the relay ends this process should the one it waits for end
AUTO = "auto"


def _given(metavar: str) -> Any:
    return tyro.conf.arg(metavar=metavar, help_behavior_hint="(default: one host)")


@dataclass(frozen=True)
class Hosts:
    """The processes of a run over several hosts; start the same command once on each."""

    coordinator: Annotated[str | None, _given("HOST:PORT")] = None
    """A free port of the host of process 0, or auto: SLURM or Open MPI names it, count and index."""
    count: Annotated[int | None, _given("INT")] = None
    """The number of processes."""
    index: Annotated[int | None, _given("INT")] = None
    """The index of this process, from 0."""


@dataclass(frozen=True)
class _Joined:
    """This process among the others."""

    index: int
    count: int
    relay: Relay
    numbers: Iterator[int]  # of exchanges
    told: list[str] = field(default_factory=list)  # keys of what process 0 has told since the last `gather`


_joined: _Joined | None = None


def index() -> int:
    """Returns the index of this process; 0 in a run on one host."""
    return _joined.index if _joined else 0


def count() -> int:
    """Returns the number of processes; 1 in a run on one host."""
    return _joined.count if _joined else 1


def join(hosts: Hosts) -> None:
    """Joins the other processes, unless the run is on one host; JAX then has the devices of all.

    Raises:
      UsageError: the processes are not named as they should be.
      RunError: the others did not come.
    """
    global _joined
    if hosts.coordinator is None:
        if (hosts.count, hosts.index) != (None, None):
            raise UsageError("--hosts.count and --hosts.index need --hosts.coordinator HOST:PORT")
        return
    address, number, own, devices = _scheduled() if hosts.coordinator == AUTO else _named(hosts)
    if number == 1:
        return
    import jax

    relay = Relay(_leave_too)
    name = f"process {own} on {socket.gethostname()}"
    try:
        near = _serve(relay, address) if own == 0 else relay.dial(address, name, PATIENCE)
        os.environ.setdefault("no_grpc_proxy", "127.0.0.1")  # the relay is in this process,
        logging.getLogger("jax._src.distributed").setLevel(logging.ERROR)  # so JAX need not warn of proxies
        here = "{}:{}".format(*near)
        jax.distributed.initialize(here, number, own, devices, "deactivate", PATIENCE, coordinator_bind_address=here)
    except (OSError, RuntimeError) as error:
        reason = (str(error).splitlines() or [type(error).__name__])[0]
        raise RunError(f"the {number} processes did not meet at {address[0]}:{address[1]}: {reason}") from None
    _joined = _Joined(own, number, relay, counter())
    console.quiet = own > 0  # process 0 tells how the run goes; each tells its own end
    atexit.register(_leave, 1)


def _serve(relay: Relay, address: Address) -> Address:
    """Listens at the coordinator's address; returns a free one for the service behind it."""
    dual = socket.has_dualstack_ipv6()
    family = socket.AF_INET6 if dual else socket.AF_INET
    listening = socket.create_server(("", address[1]), family=family, dualstack_ipv6=dual, backlog=1024)
    with socket.create_server(("127.0.0.1", 0)) as free:
        service = free.getsockname()
    relay.serve(listening, service)
    return service


def _named(hosts: Hosts) -> tuple[Address, int, int, None]:
    """Checks what the command line says about the processes."""
    match = re.fullmatch(r"(\[.+\]|[^:\s]+):(\d{1,5})", hosts.coordinator or "")
    if match is None or not 0 < int(match[2]) < 65536:
        raise UsageError(f"--hosts.coordinator {hosts.coordinator} is neither HOST:PORT, as in node1:4321, nor auto")
    if hosts.count is None or hosts.index is None:
        raise UsageError("--hosts.coordinator HOST:PORT needs --hosts.count and --hosts.index")
    if hosts.count < 1:
        raise UsageError(f"--hosts.count {hosts.count} is too small; it must be at least 1")
    if not 0 <= hosts.index < hosts.count:
        raise UsageError(f"--hosts.index {hosts.index} is out of range; it must be from 0 to {hosts.count - 1}")
    return (match[1].strip("[]"), int(match[2])), hosts.count, hosts.index, None


def _scheduled() -> tuple[Address, int, int, list[int] | None]:
    """Asks JAX what SLURM or Open MPI say about the processes.

    A process that is alone on its host has all its devices; of several, each has the one of its own number.
    """
    from jax._src.clusters import ClusterEnv  # what jax.distributed.initialize itself asks

    found = ClusterEnv.auto_detect_unset_distributed_params(None, None, None, None, None, PATIENCE)
    address, number, own, devices = found
    if address is None or number is None or own is None:
        raise UsageError(
            f"--hosts.coordinator {AUTO} finds neither SLURM (start with srun) nor Open MPI (mpirun) here; "
            "name HOST:PORT, --hosts.count and --hosts.index"
        )
    host, _, port = address.rpartition(":")
    on_host = os.environ.get("OMPI_COMM_WORLD_LOCAL_SIZE") or os.environ.get("SLURM_STEP_TASKS_PER_NODE", "")
    alone = re.fullmatch(r"1(\(x\d+\))?", on_host) is not None
    return (host.strip("[]"), int(port)), number, own, None if alone or devices is None else list(devices)


def gather(document: Any) -> list[Any]:
    """Returns the JSON documents of all processes, by index, in process 0; nothing in the others."""
    if _joined is None:
        return [document]
    number, client = next(_joined.numbers), _client()
    if _joined.index:
        client.key_value_set(f"ear_jax/{number}/{_joined.index}", json.dumps(document))
        return []
    keys = [f"ear_jax/{number}/{index}" for index in range(1, _joined.count)]
    texts = [client.blocking_key_value_get(key, FOREVER) for key in keys]
    for key in (*keys, *_joined.told):  # to come here, all have read what they were told
        client.key_value_delete(key)
    _joined.told.clear()
    return [document, *map(json.loads, texts)]


def agree(decide: Callable[[], Any]) -> Any:
    """Returns in every process the JSON document that a function returns in process 0.

    Raises:
      UsageError, RunError: the function raised it, or an OSError, in process 0; it is raised in every process.
    """
    if _joined is None:
        return decide()
    number, client = next(_joined.numbers), _client()
    key = f"ear_jax/{number}"
    if _joined.index:
        kind, result = json.loads(client.blocking_key_value_get(key, FOREVER))
        if kind == "document":
            return result
        gather(None)
        raise {"UsageError": UsageError, "RunError": RunError}[kind](result)
    try:
        document = decide()
    except (UsageError, RunError, OSError) as error:
        kind = "UsageError" if isinstance(error, UsageError) else "RunError"
        client.key_value_set(key, json.dumps([kind, getattr(error, "strerror", None) or str(error)]))
        gather(None)  # all have read it
        raise
    client.key_value_set(key, json.dumps(["document", document]))
    _joined.told.append(key)
    return document


def _client() -> Any:
    from jax._src import distributed  # JAX has no public name for it; Orbax takes it from here too

    return distributed.global_state.client


@contextlib.contextmanager
def parting() -> Iterator[None]:
    """A context at whose end all processes disconnect together; one that fails leaves the others."""
    try:
        yield
    except Stopped:
        _part()
        raise
    except (UsageError, RunError) as error:
        _fail(2 if isinstance(error, UsageError) else 1)
        raise
    except BaseException:
        settle()
        _fail(1)
        raise
    _part()


def settle() -> None:
    """Waits a second if there are other processes: one that has ended may be the reason of an error, and is told."""
    if _joined:
        time.sleep(1)


def _part() -> None:
    """Parts from the other processes once all are ready for it."""
    if _joined is None:
        return
    import jax

    _joined.relay.armed = False
    gather(None)
    agree(lambda: None)
    jax.distributed.shutdown()
    atexit.unregister(_leave)


def _fail(code: int) -> None:
    """Prepares the end of a process that failed: from now on it is its own error that is told."""
    if _joined:
        _joined.relay.armed = False
        atexit.unregister(_leave)
        atexit.register(_leave, code)


def _leave(code: int) -> None:
    """Ends a process that has not parted; JAX would wait for the others, which end because this one does."""
    for stream in (sys.stdout, sys.stderr):
        with contextlib.suppress(OSError, ValueError):
            stream.flush()
    os._exit(code)


def _leave_too(ended: str) -> None:
    """Ends this process because another one ended; called in a thread of the relay."""
    before = SHOW_CURSOR + b"\n" if os.isatty(2) else b""
    line = f"ear: {ended} has ended, and this process ends too; the same command continues the run\n"
    with contextlib.suppress(OSError):
        os.write(2, before + line.encode())
    os._exit(1)
