"""Opening a bus or its log, with every way to fail told in one line: what, where, and what to do."""

import errno
import logging
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import can

from retuner.drivers.device import BusError

BUS_ERRORS = (can.CanError, OSError, ValueError, TypeError, NotImplementedError, ImportError)
SOCKETCAN, UDP_MULTICAST = "socketcan", "udp_multicast"

# python-can warns about half-opened buses on stderr; what matters is in the BusError.
logging.getLogger("can").addHandler(logging.NullHandler())


def open_bus(interface: str, channel: str, hop_limit: int, options: Mapping[str, Any]) -> can.BusABC:
    """Open a python-can bus.

    Raises
    ------
    BusError
        It cannot be opened; the line says why and what to do.
    """
    try:
        if interface == UDP_MULTICAST:
            return open_group(channel, hop_limit=hop_limit, **options)
        return can.Bus(interface=interface, channel=channel, **options)
    except BUS_ERRORS as error:
        raise BusError(
            f"bus {interface} {channel}: cannot open it: {error}; {_advice(interface, channel, error)}"
        ) from error


def open_group(channel: str, **options: Any) -> can.BusABC:
    """A multicast group as a bus of this machine."""
    from retuner.drivers.bus.multicast import GroupBus  # noqa: PLC0415  only who uses it needs its package

    return GroupBus(channel, **options)


def known_interfaces() -> list[str]:
    """Names of python-can's interfaces, in alphabetical order."""
    return sorted(can.VALID_INTERFACES)


def _advice(interface: str, channel: str, error: BaseException) -> str:
    if interface not in can.VALID_INTERFACES:
        return f"interfaces of python-can: {', '.join(known_interfaces())}"
    if "msgpack" in str(error):
        return 'install it with: pip install "retuner[udp]"'
    if interface == UDP_MULTICAST:
        return f"give a multicast group such as 239.74.163.2 and have a route to it (ip route add {channel} dev lo)"
    number = error.errno if isinstance(error, OSError) else None
    if number == errno.EAFNOSUPPORT:
        return "this kernel has no CAN; use --interface udp_multicast, or virtual within one process"
    if number == errno.ENODEV:
        return f"make it with: ip link add dev {channel} type vcan && ip link set {channel} up"
    return "see python-can's documentation of this interface for what it needs"


def open_log(path: Path) -> can.io.generic.MessageWriter:
    """Open a log of bus traffic; the suffix chooses the format.

    Raises
    ------
    BusError
        The file cannot be made, or no format has this suffix.
    """
    try:
        return can.Logger(path)
    except BUS_ERRORS as error:
        raise BusError(
            f"{path}: cannot log frames here: {error}; name a .blf or .asc file in a folder that exists"
        ) from error
