"""One demand of robustness: every Ms limit of a retuner follows from the two that a person sets.

    limit = default x nominal / 1.75     of what is asked of the process as it is known: cause, rule, choice, book
    limit = default x worst / 2.1        of what is asked of all that is plausible: rule, border, trial

The defaults are those of the single rooms, made for the guard's own defaults; there nothing changes. A border's limit
that a person has set himself stays.
"""

from dataclasses import replace
from typing import TYPE_CHECKING

from retuner.adaptive.guard import GuardSettings

if TYPE_CHECKING:
    from retuner.adaptive.supervision.settings import RetunerSettings


def demanded(settings: "RetunerSettings") -> "RetunerSettings":
    """Settings whose every Ms limit follows from the guard's two."""
    usual, guard = GuardSettings(), settings.guard
    nominal, worst = guard.ms_nominal / usual.ms_nominal, guard.ms_worst / usual.ms_worst
    if nominal == worst == 1.0:
        return settings
    cause, robust, book = settings.cause, settings.robust, settings.book
    border = guard.ms_worst if guard.ms_border == usual.ms_border else guard.ms_border
    high = nominal * settings.diagnosis.cause.ms_high
    return replace(
        settings,
        guard=replace(guard, ms_border=border),
        cause=replace(cause, ms_high=nominal * cause.ms_high),
        diagnosis=replace(settings.diagnosis, cause=replace(settings.diagnosis.cause, ms_high=high)),
        robust=replace(
            robust,
            ms_nominal=nominal * robust.ms_nominal,
            ms_worst=worst * robust.ms_worst,
            ms_third=nominal * robust.ms_third,
        ),
        choice=replace(settings.choice, ms_limit=nominal * settings.choice.ms_limit),
        trial=replace(settings.trial, harmless_ms=worst * settings.trial.harmless_ms),
        book=replace(
            book,
            ms_high=nominal * book.ms_high,
            ms_good=nominal * book.ms_good,
            ms_bad=nominal * book.ms_bad,
            ms_calm=nominal * book.ms_calm,
        ),
    )
