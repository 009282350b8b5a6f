"""What the scheduling variables of a loop are, and where on the bus those come from that are other signals there.

A signal is one of one message of a DBC.

The DBC is any; without a file it is plant.dbc, which describes what the virtual device publishes beside its protocol.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path
from typing import TYPE_CHECKING

from cantools.database.can.message import Message as Layout
from cantools.errors import Error as CantoolsError

from retuner.drivers.protocol.codec import DbcError, read_dbc
from retuner.schedule.axis import CAN, VARIABLES

if TYPE_CHECKING:  # python-can is slow to load, and a configuration names signals without it
    import can

PLANT_DBC = "plant.dbc"
NAMES_SHOWN = 8
DECODING_ERRORS = (CantoolsError, ValueError, LookupError, TypeError, ArithmeticError)
"""What cantools raises on bytes that are not the message's."""


@dataclass(frozen=True, slots=True)
class SignalSource:
    """One signal.

    layout : its message. signal : its name. stale_after_s : age in the controller's time at which it is not known.
    frame_id : of the message, where it is not the DBC's (the virtual device's own, by node).

    Raises
    ------
    ValueError
        stale_after_s is not a positive finite number.
    """

    layout: Layout
    signal: str
    stale_after_s: float
    frame_id: int

    def __post_init__(self) -> None:
        if not 0 < self.stale_after_s < math.inf:
            raise ValueError(f"stale_after_s = {self.stale_after_s}; give a positive number of seconds")

    def is_in(self, message: "can.Message") -> bool:
        """Whether a frame carries it."""
        return (
            message.arbitration_id == self.frame_id
            and message.is_extended_id == self.layout.is_extended_frame
            and not (message.is_remote_frame or message.is_error_frame)
        )

    def value(self, message: "can.Message") -> float:
        """The value in a frame that carries it; NaN when the frame is damaged, multiplexed or out of range."""
        try:
            found = self.layout.decode(bytes(message.data), decode_choices=False)
            if not isinstance(found, Mapping):  # a container of messages
                return math.nan
            value = float(str(found[self.signal]))
        except DECODING_ERRORS:
            return math.nan
        signal = self.layout.get_signal_by_name(self.signal)
        low, high = signal.minimum, signal.maximum
        inside = (low is None or low <= value) and (high is None or value <= high)
        return value if inside and math.isfinite(value) else math.nan


@dataclass(frozen=True, slots=True)
class ScheduleInputs:
    """What goes into LoopSample.x and x2.

    variable, variable2 : "sp", "pv", "co" or "can"; variable2 "" for none. signals : where those that are "can" come
    from, in this order; None for the others.

    Raises
    ------
    ValueError
        No such variable, a "can" without its signal, or a signal without its "can".
    """

    variable: str = "sp"
    variable2: str = ""
    signals: tuple[SignalSource | None, ...] = ()

    def __post_init__(self) -> None:
        for i, name in enumerate((self.variable, self.variable2)):
            if name not in VARIABLES and (name or not i):
                raise ValueError(f'variable = "{name}"; give "sp", "pv", "co" or "can"')
            if (name == CAN) != (i < len(self.signals) and self.signals[i] is not None):
                raise ValueError(f'variable = "{name}": give a signal with "can", and only with it')

    @classmethod
    def of(cls, variable: "str | ScheduleInputs") -> "ScheduleInputs":
        """The inputs themselves, or those of one variable by its name; errors as the class."""
        return cls(variable) if isinstance(variable, str) else variable


def find_signal(dbc: str, message: str, signal: str, stale_after_s: float, node: int = 1) -> SignalSource:
    """The source of a signal.

    Parameters
    ----------
    dbc : file, or "" for what the virtual device publishes. message, signal : names in it. node : of the virtual
        device, whose message has an id of its own.

    Raises
    ------
    DbcError
        The file cannot be read, is no DBC, or has no such message or signal; the line names what it has.
    """
    database = read_dbc(_text(dbc), dbc or PLANT_DBC)
    layouts = [layout for layout in database.messages if layout.name == message]
    if not layouts:
        raise DbcError(f"{dbc or PLANT_DBC}: no message {message!r}; {_there([m.name for m in database.messages])}")
    layout = layouts[0]
    names = [found.name for found in layout.signals]
    if signal not in names:
        raise DbcError(f"{dbc or PLANT_DBC}: message {message!r} has no signal {signal!r}; {_there(names)}")
    return SignalSource(layout, signal, stale_after_s, layout.frame_id + (0 if dbc else node - 1))


def _text(dbc: str) -> str:
    """Text of a DBC file, or of the virtual device's; DBC files are Latin-1 as often as not, names are ASCII."""
    if not dbc:
        return files("retuner.drivers").joinpath(PLANT_DBC).read_text(encoding="ascii")
    try:
        return Path(dbc).read_text(encoding="latin-1")
    except (OSError, ValueError) as error:
        reason = error.strerror if isinstance(error, OSError) else error
        raise DbcError(f"{dbc}: cannot be read: {reason}; give the DBC file that describes the signal") from None


def _there(names: Sequence[str]) -> str:
    shown = ", ".join(names[:NAMES_SHOWN]) + (", ..." if len(names) > NAMES_SHOWN else "")
    return f"there is {shown}" if names else "there is none"


def plant_message(node: int, aux: float) -> "can.Message":
    """The frame in which the virtual device of a node publishes its second measurement."""
    import can  # noqa: PLC0415  see above

    layout = find_signal("", "PLANT", "aux", 1.0).layout
    data = layout.encode({"aux": aux})
    return can.Message(arbitration_id=layout.frame_id + node - 1, is_extended_id=True, data=data)
