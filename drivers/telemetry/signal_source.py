"""What the scheduling variables of a loop are, and where on the bus those come from that are other signals there.

A signal is one of one message of a DBC.

The DBC is any; without a file it is plant.dbc, which describes what the virtual device publishes beside its protocol.
"""

import math
from collections.abc import Mapping, Sequence
from importlib.resources import files
from pathlib import Path

import can
from cantools.database.can.message import Message as Layout
from cantools.errors import Error as CantoolsError

from retuner.adaptive.signals.sample import LoopSample
from retuner.drivers.device import VariableChanged
from retuner.drivers.protocol.codec import DbcError, read_dbc
from retuner.schedule.late_dataclass import dataclass
from retuner.schedule.regions import CAN, VARIABLES

PLANT_DBC = "plant.dbc"
NAMES_SHOWN = 8
DECODING_ERRORS = (CantoolsError, ValueError, LookupError, TypeError, ArithmeticError)
"""What cantools raises on bytes that are not the message's."""


@dataclass(frozen=True, slots=True)
class SignalSource:
    """One signal.

    layout : its message. signal : its name. stale_after_s : age in the controller's time at which it is not known.
    frame_id : of the message, where it is not the DBC's (the virtual device's own, by node).

    Raises ValueError: stale_after_s is not a positive finite number.
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

    Raises ValueError: no such variable, a "can" without its signal, or a signal without its "can".
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

    dbc : file, or "" for what the virtual device publishes. message, signal : names in it. node : of the virtual
        device, whose message has an id of its own.

    Raises DbcError: the file cannot be read, is no DBC, or has no such message or signal; the line names what it has.
    """
    try:  # DBC files are Latin-1 as often as not, names are ASCII
        path = Path(dbc) if dbc else files("retuner.drivers").joinpath(PLANT_DBC)
        text = path.read_text(encoding="latin-1")
    except (OSError, ValueError) as error:
        reason = error.strerror if isinstance(error, OSError) else error
        raise DbcError(f"{dbc}: cannot be read: {reason}; give the DBC file that describes the signal") from None
    database = read_dbc(text, dbc or PLANT_DBC)
    layouts = [layout for layout in database.messages if layout.name == message]
    if not layouts:
        raise DbcError(f"{dbc or PLANT_DBC}: no message {message!r}; {_there([m.name for m in database.messages])}")
    layout = layouts[0]
    names = [found.name for found in layout.signals]
    if signal not in names:
        raise DbcError(f"{dbc or PLANT_DBC}: message {message!r} has no signal {signal!r}; {_there(names)}")
    return SignalSource(layout, signal, stale_after_s, layout.frame_id + (0 if dbc else node - 1))


def _there(names: Sequence[str]) -> str:
    shown = ", ".join(names[:NAMES_SHOWN]) + (", ..." if len(names) > NAMES_SHOWN else "")
    return f"there is {shown}" if names else "there is none"


def plant_message(node: int, aux: float) -> "can.Message":
    """The frame in which the virtual device of a node publishes its second measurement."""
    layout = find_signal("", "PLANT", "aux", 1.0).layout
    return can.Message(arbitration_id=layout.frame_id + node - 1, is_extended_id=True, data=layout.encode({"aux": aux}))


# ---- Scheduling variables that are other signals on the bus: the last value of each, and how old it is.
#
# Ages are told in the controller's own time, from sample to sample, not by a clock: a frame counts from the next
# sample on. So the same frames in the same order give the same values, live or from a log. A value that is too old,
# and one that never came, is NaN: the region stays then, and nothing is learned.


class SignalTap:
    """The signals of up to two axes.

    sources : of x and x2; None where the variable comes with the sample.
    """

    def __init__(self, sources: Sequence[SignalSource | None] = ()) -> None:
        self._latest = [None if source is None else _Latest(source) for source in sources]
        self._is_idle = not any(self._latest)

    def take(self, message: can.Message) -> bool:
        """Note a frame; whether it carries one of the signals."""
        if self._is_idle:
            return False
        tapped = [latest.take(message) for latest in self._latest if latest is not None]
        return any(tapped)

    def fill(self, sample: LoopSample) -> LoopSample:
        """The sample with the values of this instant, NaN where they are not known."""
        if self._is_idle:
            return sample
        xs = [sample.x, sample.x2]
        for i, latest in enumerate(self._latest):
            if latest is not None:
                xs[i] = latest.at(sample.t_s)
        return sample._replace(x=xs[0], x2=xs[1])

    def news(self) -> list[VariableChanged]:
        """Signals that have become unknown, or known again, since the last call."""
        if self._is_idle:
            return []
        return [change for latest in self._latest if latest is not None for change in latest.news()]


class _Latest:
    def __init__(self, source: SignalSource) -> None:
        self._source = source
        self._value, self._came = math.nan, False
        self._heard_s: float | None = None
        self._since_s: float | None = None  # first sample ever: until then nothing can be late
        self._known = True
        self._news: list[VariableChanged] = []

    def take(self, message: can.Message) -> bool:
        """Note a frame, if it is one of the signal's."""
        if not self._source.is_in(message):
            return False
        value = self._source.value(message)
        if math.isfinite(value):
            self._value, self._came = value, True
        return True

    def at(self, t_s: float) -> float:
        """The value at a sample, NaN when it is not known."""
        if self._came:
            self._heard_s, self._came = t_s, False
        if self._since_s is None:
            self._since_s = t_s
        fresh = t_s - (self._since_s if self._heard_s is None else self._heard_s) <= self._source.stale_after_s
        if fresh != self._known:
            self._known, source = fresh, self._source
            since = f"{'never heard' if self._heard_s is None else 'silent'} for more than {source.stale_after_s:g} s"
            reason = "heard again" if fresh else f"{since}; the region stays, and its model is not updated until then"
            self._news.append(VariableChanged(f"{source.layout.name}.{source.signal}", fresh, reason))
        return self._value if fresh else math.nan

    def news(self) -> list[VariableChanged]:
        told, self._news = self._news, []
        return told
