"""Numbers that are not in the unit they are taken for: times that are dates, outputs in mA, raw counts of a converter.

    days            a spreadsheet's date, days since 1900, the time as a fraction: 20,000 to 80,000, steps under an hour
    milliseconds    since 1970: over 1e11 (a year 5138 in seconds)
    digits          YYYYMMDDhhmmss as one number
    mA              co stays within 4 to 20 and uses most of it
    counts          pv in whole numbers over a thousand, up to the end of a converter's range

They are told, not converted: only the owner of the record knows. Time constants, and gains that hang on them, are wrong
by the same factor.
"""

import numpy as np

from retuner.adaptive.signals.sample import Window, median

DAYS = (20000.0, 80000.0)
LONGEST_STEP_DAYS = 1 / 24
LEAST_MILLISECONDS = 1e11
DIGITS = (1.9e13, 2.2e13)
MILLIAMPERES = (3.6, 21.0)
LEAST_SPAN = 8.0  # co must use half of 4 to 20 to be taken for it
FEWEST_COUNTS = 1000.0
MOST_COUNTS = 65535.0  # Most counts: those of the widest converter in use, 16 bits


def doubtful_units(window: Window) -> tuple[str, ...]:
    """What does not look like seconds, percent or engineering units, a sentence each."""
    t, co, pv, told = window.t_s, window.co, window.pv, []
    if DIGITS[0] < t[0] and t[-1] < DIGITS[1]:
        told.append(
            "the times look like dates written as one number (YYYYMMDDhhmmss): give them as text, or in seconds"
        )
    elif t[0] > LEAST_MILLISECONDS:
        told += ["the times look like milliseconds since 1970: time constants come out a thousand times too long"]
    elif DAYS[0] < t[0] and t[-1] < DAYS[1] and median(np.diff(t)) < LONGEST_STEP_DAYS:
        told.append(
            "the times look like a spreadsheet's dates, in days: time constants come out 86,400 times too short"
        )
    if MILLIAMPERES[0] <= np.min(co) and np.max(co) <= MILLIAMPERES[1] and np.ptp(co) >= LEAST_SPAN:
        told.append(
            "co stays between 4 and 20, which looks like mA: gains are then per mA, 6.25 times those per percent"
        )
    counts = np.min(pv) >= 0 and np.ptp(pv) > FEWEST_COUNTS and np.max(pv) <= MOST_COUNTS
    if counts and np.all(pv == np.round(pv)):
        told += ["pv comes in whole numbers, which look like raw counts of a converter: gains are then per count"]
    return tuple(told)
