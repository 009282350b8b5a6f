"""Scheduling variables that are other signals on the bus: the last value of each, and how old it is.

Ages are told in the controller's own time, from sample to sample, not by a clock: a frame counts from the next sample
on. So the same frames in the same order give the same values, live or from a log. A value that is too old, and one that
never came, is NaN: the region stays then, and nothing is learned.
"""

import math
from collections.abc import Sequence

import can

from retuner.adaptive.signals.sample import LoopSample
from retuner.drivers.device import VariableChanged
from retuner.drivers.telemetry.signal_source import SignalSource


class SignalTap:
    """The signals of up to two axes.

    Parameters
    ----------
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
    """The last value of one signal."""

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
        last_s = self._since_s if self._heard_s is None else self._heard_s
        fresh = t_s - last_s <= self._source.stale_after_s
        if fresh != self._known:
            self._known = fresh
            self._news.append(self._change())
        return self._value if fresh else math.nan

    def _change(self) -> VariableChanged:
        source = self._source
        name = f"{source.layout.name}.{source.signal}"
        if self._known:
            return VariableChanged(name, known=True, reason="heard again")
        for_s = f"for more than {source.stale_after_s:g} s"
        reason = f"never heard {for_s}" if self._heard_s is None else f"silent {for_s}"
        return VariableChanged(
            name, known=False, reason=f"{reason}; the region stays, and its model is not updated until then"
        )

    def news(self) -> list[VariableChanged]:
        """Changes since the last call."""
        told, self._news = self._news, []
        return told
