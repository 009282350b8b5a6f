"""What identify and schedule ask diagnose: is something else than the tuning behind the records, and if no process is
known from them, do settings follow from the odds of all?
"""

from collections.abc import Sequence

from retuner.adaptive.diagnosis.cause import TUNING_CAUSES, Cause, Diagnosis
from retuner.adaptive.signals.sample import Window
from retuner.decision_page.decision_words import settings_text
from retuner.diagnosing import RecordDiagnosis, diagnose_windows, parts_of
from retuner.schedule.gains import PidGains


def diagnosed(
    windows: Sequence[Window], gains: PidGains | None, limits: tuple[float | None, float | None], *, cause_only: bool
) -> RecordDiagnosis:
    """What diagnose says of the same records; cause_only : see diagnose_windows."""
    parts = parts_of(windows, gains, *limits)
    return diagnose_windows(parts, gains=gains, co_min=limits[0], co_max=limits[1], cause_only=cause_only)


def other_cause(told: Diagnosis) -> Diagnosis | None:
    """The diagnosis, where it does not call it a matter of tuning."""
    return None if told.cause in {Cause.OK, *TUNING_CAUSES} else told


def weighed(found: RecordDiagnosis) -> list[str]:
    """What diagnose says of a record that identifies no process; empty where it cannot name a cause either."""
    told = found.diagnosis
    if told.cause is Cause.UNKNOWN:
        return []
    name = str(told.cause).replace("_", " ").upper()
    lines = [f"retuner diagnose, which weighs all processes and loads: {name} ({told.confidence:.0%}): {told.reason}"]
    if found.recommended is not None:
        lines.append(f"  recommended  {settings_text(found.recommended)}")
    return lines


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
