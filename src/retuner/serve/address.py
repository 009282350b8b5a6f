"""Where the page is to be found: its socket, its names, the lines that a person is told."""

import errno
import ipaddress
import socket
from collections.abc import Iterator
from pathlib import Path

from retuner.errors import UserError
from retuner.schedule.late_dataclass import dataclass, replace

PORT = 8017  # where it listens unless told otherwise


@dataclass(frozen=True, slots=True)
class ServeOptions:
    """Where and how.

    host, port : to listen at; port 0 for any that is free, None for the usual one or any free one. names : host names
    beside the address under which browsers may ask. certificate, key : files for TLS.
    read_only : nobody may act. until_closed : end when stdin is closed.
    """

    host: str = "127.0.0.1"
    port: int | None = None
    names: tuple[str, ...] = ()
    certificate: Path | None = None
    key: Path | None = None
    read_only: bool = False
    until_closed: bool = False


def listening(options: ServeOptions) -> socket.socket:
    """A socket that listens. Raises UserError: the port is taken, or the address is not of this machine."""
    if options.port is None:
        try:
            return listening(replace(options, port=PORT))
        except UserError:  # taken: any other one will do
            return listening(replace(options, port=0))
    ours = socket.socket(socket.AF_INET6 if ":" in options.host else socket.AF_INET, socket.SOCK_STREAM)
    ours.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    try:
        ours.bind((options.host, options.port))
    except (OSError, OverflowError) as error:
        ours.close()
        if isinstance(error, OSError) and error.errno == errno.EADDRINUSE:
            raise UserError(f"Port {options.port} is in use; try --port {options.port + 1}.") from None
        raise UserError(f"--port {options.port} at {options.host}: cannot listen there: {error}") from None
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


def lines(options: ServeOptions, port: int, token: str) -> Iterator[str]:
    """What a person is told at the start: where to watch, and the address under which one may act."""
    secure = options.certificate is not None
    address = f"{'https' if secure else 'http'}://{_shown(options.host)}:{port}/"
    yield f"watch: {address}"
    if not options.read_only:
        yield f"act:   {address}#token={token}"
    if not is_local(options.host) and not secure:
        yield f"WARNING: {options.host} can be reached from the network; without TLS anyone there can read along"


def _shown(host: str) -> str:
    """The address as a browser takes it; one that stands for all of them, as this machine's own."""
    try:
        address = ipaddress.ip_address(host)
    except ValueError:
        return host
    if address.is_unspecified:
        return "127.0.0.1"
    return f"[{address}]" if address.version == 6 else str(address)
