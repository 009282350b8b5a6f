"""`retuner.design_schedule`: a gain schedule from ordinary records of a loop, with what it rests on."""

from collections.abc import Mapping, Sequence

from retuner.adaptive.signals.sample import Window
from retuner.api import Numbers, window_of
from retuner.drivers.historian.loop_record import LoopRecord

Record = Window | LoopRecord
"""A stretch of samples of one loop, or a record of `retuner.read`."""


def windows_of(records: Record | Sequence[Record]) -> tuple[Window, ...]:
    """Records, one or several, as windows.

    Raises
    ------
    ValueError
        There is none, or one lacks a signal.
    """
    several = [records] if isinstance(records, Window | LoopRecord) else list(records)
    if not several:
        raise ValueError("no record; give at least one")
    return tuple(one if isinstance(one, Window) else window_of(one) for one in several)


SIGNATURE = """
def design_schedule(
    records: Record | Sequence[Record],      # one record or several of the same loop (Window or retuner.read)
    by: str | Sequence[str] = "auto",        # "sp", "pv", "co", a key of `values`, several of them, or "auto"
    *,
    values: Mapping[str, Sequence[Numbers]] = {},   # further candidates: one array a record, as long as the record
    low: float | None = None, high: float | None = None,   # range of the variable; default what the records visit
    co_min: float | None = None, co_max: float | None = None,
    ms_limit: float = 1.8,                   # everywhere, on the models the records allow
    j_limit: float = 1.25,                   # J over that of the place's own best settings
    lookup: str = "auto",                    # "hard", "interpolated" or "auto"
    name: str = "loop", unit: str = "",
    gains: GainTable | PidGains | None = None,             # in force, for the comparison before/after
    progress: Callable[[str, float], None] | None = None,  # stage, share done
) -> ScheduleDesign
    # .table GainTable | None (None where nothing can be known), .variable str, .places tuple[Place, ...] with
    # .x .model (ProcessModel) .ln_std .gains (in force by the table) .own (best there) .ms .j .known;
    # .model_at(x) .gains_at(x) (frozen: no hysteresis) .reason .to_dict()
"""
"""What `design_schedule` will look like; it comes with the next commits."""

__all__ = ["Mapping", "Numbers", "Record", "windows_of"]
