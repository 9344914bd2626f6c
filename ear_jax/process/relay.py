"""The connections between the processes of one run, by which each learns at once that another has ended.

JAX's processes talk to a service in process 0. If a process dies, JAX ends the others with a log and SIGABRT, some of
them only after missed heartbeats. So their connections go through relays: a client's relay leads to that of process 0,
which leads to the service. The end of a connection between two relays is the end of a process. A host that is gone
without a word counts as ended after `SILENCE`.
"""

from __future__ import annotations

import contextlib
import socket
import threading
import time
from collections.abc import Callable

Address = tuple[str, int]
Ended = Callable[[str], None]

SILENCE = 20  # seconds
GREETING = b"ear_jax "  # what a relay sends first, followed by the name of its process in 56 bytes
LENGTH = 64


class Relay:
    """Forwards connections in threads of its own for as long as the process lives.

    Args:
      ended: called in one of these threads with the name of a process that ended, unless `armed` is False.
    """

    def __init__(self, ended: Ended):
        self._ended = ended
        self.armed = True

    def serve(self, listening: socket.socket, service: Address) -> None:
        """Forwards what greets at a listening socket to the service; other connections are closed."""

        def accept(far: socket.socket) -> None:
            greeting = _receive(far, LENGTH)
            if not greeting.startswith(GREETING):  # of a scanner of ports
                far.close()
                return
            self._join(far, _dial(service, SILENCE), greeting[len(GREETING) :].decode(errors="replace").strip())

        _each(listening, accept)

    def dial(self, coordinator: Address, name: str, patience: float) -> Address:
        """Opens a way to the relay of process 0 and returns the address at which it begins.

        Args:
          coordinator: the address of that relay.
          name: of this process.
          patience: seconds to wait for it.

        Raises:
          OSError: nobody listens there.
        """
        ready = [self._greet(_dial(coordinator, patience), name)]
        listening = socket.create_server(("127.0.0.1", 0))

        def accept(near: socket.socket) -> None:
            far = ready.pop() if ready else self._greet(_dial(coordinator, SILENCE), name)
            self._join(far, near, "process 0")

        _each(listening, accept)
        return listening.getsockname()[:2]

    def _greet(self, far: socket.socket, name: str) -> socket.socket:
        far.sendall((GREETING + name.encode()[: LENGTH - len(GREETING)]).ljust(LENGTH))
        return far

    def _join(self, far: socket.socket, near: socket.socket, name: str) -> None:
        """Forwards between another process and this one until one of them ends the connection."""
        _notice_silence(far)

        def outwards() -> None:
            _pump(near, far)
            with contextlib.suppress(OSError):
                far.shutdown(socket.SHUT_WR)

        with far, near:
            threading.Thread(target=outwards, daemon=True).start()
            _pump(far, near)
            if self.armed:
                self._ended(name)


def _each(listening: socket.socket, accept: Callable[[socket.socket], None]) -> None:
    """Calls a function in a thread of its own for every connection made to a listening socket."""

    def accept_all() -> None:
        while True:
            connection, _ = listening.accept()
            threading.Thread(target=accept, args=(connection,), daemon=True).start()

    threading.Thread(target=accept_all, daemon=True).start()


def _dial(address: Address, patience: float) -> socket.socket:
    """Connects to an address, and tries again for some seconds; raises OSError if that fails."""
    until = time.monotonic() + patience
    while True:
        try:
            return socket.create_connection(address, timeout=None)
        except OSError:
            if time.monotonic() > until:
                raise
            time.sleep(0.1)


def _receive(source: socket.socket, count: int) -> bytes:
    """Returns the first bytes from a connection, or fewer if it ends."""
    received = b""
    with contextlib.suppress(OSError):
        while len(received) < count and (part := source.recv(count - len(received))):
            received += part
    return received


def _pump(source: socket.socket, sink: socket.socket) -> None:
    """Forwards bytes until either connection ends."""
    with contextlib.suppress(OSError):
        while data := source.recv(1 << 16):
            sink.sendall(data)


def _notice_silence(far: socket.socket) -> None:
    """Ends a connection whose other host has not answered for some seconds; the kernel asks it now and then."""
    far.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
    far.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    for name, seconds in (("TCP_KEEPIDLE", SILENCE // 4), ("TCP_KEEPINTVL", SILENCE // 4), ("TCP_KEEPCNT", 3)):
        if option := getattr(socket, name, None):
            far.setsockopt(socket.IPPROTO_TCP, option, seconds)
    if option := getattr(socket, "TCP_USER_TIMEOUT", None):
        far.setsockopt(socket.IPPROTO_TCP, option, 1000 * SILENCE)
