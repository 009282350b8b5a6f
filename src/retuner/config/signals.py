"""The signals on the bus that a configuration names: found in their DBC files, or by line and key what is wrong."""

from collections.abc import Iterator

from retuner.config.model import Config
from retuner.config.schedule import AxisConfig
from retuner.config.setting import Problem
from retuner.drivers.dbc_reading import DbcError
from retuner.drivers.signal_source import SignalSource, find_signal
from retuner.schedule.axis import CAN


def signal_source(axis: AxisConfig, node: int) -> SignalSource | None:
    """Where an axis' variable comes from; None when it comes with the samples.

    Raises
    ------
    DbcError
        The DBC cannot be read, or has no such message or signal.
    """
    if axis.variable != CAN:
        return None
    return find_signal(axis.dbc, axis.message, axis.signal, axis.stale_after_s, node)


def signal_problems(config: Config) -> Iterator[Problem]:
    """What is wrong with the signals that a configuration names."""
    for i, axis in enumerate(config.schedule.axis):
        try:
            signal_source(axis, config.bus.node)
        except DbcError as error:
            key = "signal" if "has no signal" in str(error) else "message" if "no message" in str(error) else "dbc"
            yield Problem(("schedule", "axis", i, key), f": {error}")
