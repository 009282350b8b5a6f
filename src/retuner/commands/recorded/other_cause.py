"""What identify and schedule ask diagnose: is something else than the tuning behind the records?"""

from collections.abc import Sequence

from retuner.adaptive.diagnosis.cause import TUNING_CAUSES, Cause, Diagnosis
from retuner.adaptive.indexes.days import days_of
from retuner.adaptive.signals.sample import Window
from retuner.diagnosing import diagnose_windows
from retuner.schedule.gains import PidGains


def other_cause(
    windows: Sequence[Window], gains: PidGains | None, co_min: float | None, co_max: float | None
) -> Diagnosis | None:
    """What diagnose says of the same records, where it does not call it a matter of tuning."""
    days = [day for window in windows for day in days_of(window)]
    told = diagnose_windows(days, gains=gains, co_min=co_min, co_max=co_max).diagnosis
    return None if told.cause in {Cause.OK, *TUNING_CAUSES} else told


def contradiction(other: Diagnosis | None) -> list[str]:
    """Words where diagnosis sees more in the record than a process, so that nobody takes the settings for a cure."""
    if other is None:
        return []
    if other.cause is Cause.UNKNOWN:
        return [
            f"but retuner diagnose cannot name the cause: {other.reason}",
            "  it may not be the tuning: look at the record before you use the settings",
        ]
    return [
        f"but retuner diagnose finds {str(other.cause).replace('_', ' ').upper()} in this record: {other.reason}",
        "  new settings only help tuning: fix this first",
    ]
