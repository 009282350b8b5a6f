"""The server of the page: its socket, its address, and how long it is up."""

import asyncio
import contextlib
import resource
import socket
import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path

import uvicorn
from uvicorn.protocols.http.h11_impl import H11Protocol

from retuner.errors import UserError
from retuner.serve.address import ServeOptions, lines, listening, our_names
from retuner.serve.application import PageAnswers
from retuner.serve.hub import Hub
from retuner.serve.page_access import PageAccess
from retuner.serve.runs import RecordedRuns

SILENT_S = 10.0  # A connection that asks for nothing is closed after this
MOST_CONNECTIONS = 4000


class PatientProtocol(H11Protocol):
    """HTTP that lets go of connections on which nothing is asked for: a thousand idle ones take nobody's place."""

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """A browser connects."""
        assert isinstance(transport, asyncio.Transport)
        super().connection_made(transport)

        def let_go() -> None:
            if getattr(self, "cycle", None) is None and not transport.is_closing():
                transport.close()

        self.loop.call_later(SILENT_S, let_go)


def serve(
    root: Path, options: ServeOptions, say: Callable[[str], None], ours: socket.socket | None = None, token: str = ""
) -> None:
    """Serve the page until somebody ends it.

    say : is told the address, and the one under which a person may act. ours, token : of whoever started this server
        beside a run and has told them already.

    Raises UserError: there is no session, the port is taken, or the TLS files cannot be used.
    """
    if (options.certificate is None) != (options.key is None):
        raise UserError("--certificate and --key: TLS needs both files")
    runs = RecordedRuns(root)
    told = ours is not None
    ours = ours or listening(options)
    port = int(ours.getsockname()[1])
    secure = options.certificate is not None
    access = PageAccess(our_names(options, port), time.monotonic, secure=secure, read_only=options.read_only, port=port)
    access.token = token or access.token
    for line in () if told else lines(options, port, access.token):
        say(line)
    # as many open files as this process may have: every connection is one
    with contextlib.suppress(OSError, ValueError):
        _, most = resource.getrlimit(resource.RLIMIT_NOFILE)
        wanted = MOST_CONNECTIONS + 500 if most == resource.RLIM_INFINITY else min(MOST_CONNECTIONS + 500, most)
        resource.setrlimit(resource.RLIMIT_NOFILE, (wanted, most))
    config = uvicorn.Config(
        PageAnswers(Hub(runs), access).application(),
        http=PatientProtocol,
        ws="none",
        lifespan="on",
        log_config=None,
        access_log=False,
        server_header=False,
        date_header=False,
        limit_concurrency=MOST_CONNECTIONS,
        timeout_keep_alive=5,
        timeout_graceful_shutdown=1,
        h11_max_incomplete_event_size=16384,
        ssl_certfile=options.certificate,
        ssl_keyfile=options.key,
    )
    try:
        server = uvicorn.Server(config)
        if options.until_closed:  # the server ends when whoever started it is gone

            def until_closed() -> None:
                sys.stdin.read()
                server.should_exit = True

            threading.Thread(target=until_closed, daemon=True).start()
        server.run(sockets=[ours])
    finally:
        ours.close()
    runs.close()
