"""What would keep a session from its bus and can be seen without opening it: the interface's name, the key file."""

from collections.abc import Iterator
from pathlib import Path

from retuner.config.model import Config
from retuner.config.setting import Problem
from retuner.drivers.bus_opening import known_interfaces
from retuner.drivers.key_file import KeyFileError, read_key


def bus_problems(config: Config) -> Iterator[Problem]:
    """What is wrong with the bus that a configuration names, on this machine."""
    bus, known = config.bus, known_interfaces()
    if bus.interface not in known:
        message = f'= "{bus.interface}" is no interface of python-can; choose from {", ".join(known)}'
        yield Problem(("bus", "interface"), message)
    if bus.key_file:
        try:
            read_key(Path(bus.key_file))
        except KeyFileError as error:
            yield Problem(("bus", "key_file"), f"is refused: {error}")
