"""The page beside a run: a process of its own, started with a socket that listens already, ended with the run.

The address is told at once, whoever asks waits until the server is up; the run waits for nothing.
"""

import importlib.util
import secrets
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from retuner.errors import UserError
from retuner.serve.address import ServeOptions, lines, listening

NEEDED = ("starlette", "uvicorn")
MISSING = 'the page needs starlette and uvicorn; pip install "retuner[page]"'
ENDS_WITHIN_S = 3.0  # Time after which a server that was told to end is ended


def require_page() -> None:
    """Refuse to serve where what it takes is not installed. Raises UserError: it is not."""
    if not all(importlib.util.find_spec(name) for name in NEEDED):
        raise UserError(MISSING)


@contextmanager
def served_beside(folder: Path, say: Callable[[str], None]) -> Iterator[Callable[[], None]]:
    """While inside, the page of a session's folder is served; say : is told where. What it gives keeps the page up when
    the run is over, until Ctrl-C.
    """
    options, token = ServeOptions(), secrets.token_urlsafe(24)
    with listening(options) as ours:
        for line in lines(options, int(ours.getsockname()[1]), token):
            say(line)
        # the server, in a session of its own: what ends the run does not end it before the run says so
        socket_number = ours.fileno()
        command = [sys.executable, "-P", "-m", "retuner", "serve", str(folder), "--inherited", str(socket_number)]
        server = subprocess.Popen(  # noqa: S603  this program itself
            command,
            stdin=subprocess.PIPE,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            pass_fds=(socket_number,),
            start_new_session=True,
        )
        assert server.stdin is not None
        with suppress(OSError):  # it is gone already: the run goes on without it
            server.stdin.write(f"{token}\n".encode())
            server.stdin.flush()

    def stay() -> None:
        if server.poll() is None:
            say("the page stays up; Ctrl-C ends it")
            with suppress(KeyboardInterrupt):
                server.wait()

    try:
        yield stay
    finally:
        # end the server: it is told so by the end of its input, and is not waited for long
        with suppress(OSError, subprocess.TimeoutExpired):
            server.communicate(timeout=ENDS_WITHIN_S)
        server.kill()
        server.wait()
