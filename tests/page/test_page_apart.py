"""The session does not depend on its page: hung, killed or flooded, the same samples and the same decisions.

Shown with the head of the ledger, which covers every row, and with the trend's bytes.
"""

import contextlib
import hashlib
import os
import signal
import socket
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
from stepped import Server, Stepped, serving, stepped

pytestmark = [pytest.mark.slow, pytest.mark.uncounted]

BEFORE, AFTER = 400, 1200  # Turns before and after the page is treated badly: two decisions lie in the second part


def outcome(session: Stepped) -> tuple[str, str, int]:
    loop = session.session.loops[0]
    trend = hashlib.sha256(repr(list(loop.trend.rows)).encode()).hexdigest()
    return session.ledger.head(), trend, len(loop.decisions)


@contextlib.contextmanager
def hung(server: Server) -> Iterator[None]:
    os.kill(server.process.pid, signal.SIGSTOP)
    yield
    os.kill(server.process.pid, signal.SIGCONT)


@contextlib.contextmanager
def killed(server: Server) -> Iterator[None]:
    server.process.kill()
    yield


@contextlib.contextmanager
def flooded(server: Server) -> Iterator[None]:
    """As many requests as go, from a thread, and connections that say nothing."""
    over = threading.Event()
    ask = f"GET /api/overview HTTP/1.1\r\nHost: 127.0.0.1:{server.port}\r\nConnection: close\r\n\r\n".encode()

    def flood() -> None:
        while not over.is_set():
            with contextlib.suppress(OSError), socket.create_connection(("127.0.0.1", server.port), timeout=5) as one:
                one.sendall(ask)
                one.recv(100)

    thread = threading.Thread(target=flood)
    thread.start()
    try:
        yield
    finally:
        over.set()
        thread.join()


@pytest.fixture(scope="module")
def alone(tmp_path_factory: pytest.TempPathFactory) -> tuple[str, str, int]:
    with stepped(tmp_path_factory.mktemp("alone") / "demo") as session:
        session.step(BEFORE + AFTER)
        return outcome(session)


@pytest.mark.parametrize("treated", [hung, killed, flooded])
def test_the_session_is_the_same_whatever_becomes_of_its_page(treated, alone, tmp_path):
    with stepped(tmp_path / "demo") as session:
        session.step(BEFORE)
        server = serving(session.folder)
        try:
            with treated(server):
                session.step(AFTER)
        finally:
            server.end()
        assert outcome(session) == alone
    assert alone[2] >= 2


def test_a_thousand_idle_connections_keep_nobody_out(tmp_path: Path) -> None:
    with stepped(tmp_path / "demo") as session, contextlib.ExitStack() as stack:
        session.step(50)
        server = serving(session.folder)
        stack.callback(server.end)
        idle = [
            stack.enter_context(socket.create_connection(("127.0.0.1", server.port), timeout=30)) for _ in range(1000)
        ]
        ask = f"GET /api/who HTTP/1.1\r\nHost: 127.0.0.1:{server.port}\r\nConnection: close\r\n\r\n".encode()
        one = stack.enter_context(socket.create_connection(("127.0.0.1", server.port), timeout=30))
        one.sendall(ask)
        assert one.recv(1000).startswith(b"HTTP/1.1 200")
        begun = time.monotonic()
        assert all(connection.recv(1) == b"" for connection in idle)  # let go of, each after its time
        assert time.monotonic() - begun < 60
