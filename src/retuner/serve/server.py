"""The server of the page: its socket, its address, and how long it is up."""

import asyncio
import contextlib
import errno
import ipaddress
import resource
import socket
import sys
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import uvicorn
from uvicorn.protocols.http.h11_impl import H11Protocol

from retuner.errors import UserError
from retuner.serve.access import Access
from retuner.serve.application import Page
from retuner.serve.hub import Hub
from retuner.serve.runs import Runs

SILENT_S = 10.0
"""A connection that asks for nothing is closed after this."""
MOST_CONNECTIONS = 4000


@dataclass(frozen=True, slots=True)
class ServeOptions:
    """Where and how.

    host, port : to listen at; port 0 for any that is free. names : host names beside the address under which browsers
    may ask. certificate, key : files for TLS. read_only : nobody may act. until_closed : end when stdin is closed.
    """

    host: str = "127.0.0.1"
    port: int = 8017
    names: tuple[str, ...] = ()
    certificate: Path | None = None
    key: Path | None = None
    read_only: bool = False
    until_closed: bool = False


class PatientProtocol(H11Protocol):
    """HTTP that lets go of connections on which nothing is asked for: a thousand idle ones take nobody's place."""

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """A browser connects."""
        assert isinstance(transport, asyncio.Transport)
        super().connection_made(transport)
        self.loop.call_later(SILENT_S, self._still_silent)

    def _still_silent(self) -> None:
        asked = getattr(self, "cycle", None) is not None
        if not asked and not self.transport.is_closing():
            self.transport.close()


def listening(options: ServeOptions) -> socket.socket:
    """A socket that listens.

    Raises
    ------
    UserError
        The port is taken, or the address is not of this machine.
    """
    family = socket.AF_INET6 if ":" in options.host else socket.AF_INET
    ours = socket.socket(family, socket.SOCK_STREAM)
    ours.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    try:
        ours.bind((options.host, options.port))
    except (OSError, OverflowError) as error:
        ours.close()
        taken = isinstance(error, OSError) and error.errno == errno.EADDRINUSE
        what = "is taken by another program; give another one" if taken else f"cannot be listened at: {error}"
        raise UserError(f"--port {options.port} at {options.host}: {what}") from None
    ours.listen(1024)
    return ours


def our_names(options: ServeOptions, port: int) -> list[str]:
    """Values of the Host header that are ours."""
    host = f"[{options.host}]" if ":" in options.host else options.host
    names = ["127.0.0.1", "localhost", "[::1]", host, *options.names]
    if not is_local(options.host):
        names.append(socket.gethostname())
    return [f"{name}:{port}" for name in names] + [name for name in names if port in {80, 443}]


def is_local(host: str) -> bool:
    """Whether only this machine reaches an address."""
    if host == "localhost":
        return True
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False


def serve(root: Path, options: ServeOptions, say: Callable[[str], None]) -> None:
    """Serve the page until somebody ends it. say : is told the address, and the one under which a person may act.

    Raises
    ------
    UserError
        There is no session, the port is taken, or the TLS files cannot be used.
    """
    if (options.certificate is None) != (options.key is None):
        raise UserError("--certificate and --key: TLS needs both files")
    runs = Runs(root)
    ours = listening(options)
    port = int(ours.getsockname()[1])
    secure = options.certificate is not None
    access = Access(our_names(options, port), time.monotonic, secure=secure, read_only=options.read_only, port=port)
    address = f"{'https' if secure else 'http'}://{_shown(options.host)}:{port}/"
    say(f"watch: {address}")
    if not options.read_only:
        say(f"act:   {address}#token={access.token}")
    if not is_local(options.host) and not secure:
        say(f"WARNING: {options.host} can be reached from the network, and without TLS everybody there can read along")
    _enough_files()
    application = Page(Hub(runs), access).application()
    config = uvicorn.Config(
        application,
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
        if options.until_closed:
            threading.Thread(target=_until_closed, args=(server,), daemon=True).start()
        server.run(sockets=[ours])
    finally:
        ours.close()
        runs.close()


def _shown(host: str) -> str:
    """The address as a browser takes it; one that stands for all of them, as this machine's own."""
    try:
        address = ipaddress.ip_address(host)
    except ValueError:
        return host
    if address.is_unspecified:
        return "127.0.0.1"
    return f"[{address}]" if address.version == 6 else str(address)


def _until_closed(server: uvicorn.Server) -> None:
    """End the server when whoever started it is gone."""
    sys.stdin.read()
    server.should_exit = True


def _enough_files() -> None:
    """As many open files as this process may have: every connection is one."""
    with contextlib.suppress(OSError, ValueError):
        _, most = resource.getrlimit(resource.RLIMIT_NOFILE)
        wanted = MOST_CONNECTIONS + 500 if most == resource.RLIM_INFINITY else min(MOST_CONNECTIONS + 500, most)
        resource.setrlimit(resource.RLIMIT_NOFILE, (wanted, most))
