"""A long record in stretches: what happens in it is looked at closely, and told over time.

A fit condenses a record to some hundred samples. Where that would leave fewer than twelve of them in a cycle, the
oscillation's shape would be lost (a clean limit cycle of 290 rounds came out as noise), so stretches of fifteen cycles
are diagnosed instead: at the beginning, at the largest setpoint change or in the middle, and at the end.

Without one that is so quick, what happens in a long record are its setpoint changes. Stretches of three of them are
diagnosed, each from the middle of the plateau before to that of the plateau after, so that no response is cut whatever
the sampling. (Two days of a real sticking valve, named in 21 of its 23 pieces, came out as unknown when condensed.)
"""

from collections import Counter
from dataclasses import replace
from itertools import groupby
from operator import itemgetter

import numpy as np

from retuner.adaptive.diagnosis.cause import TUNING_CAUSES, Cause, Diagnosis
from retuner.adaptive.diagnosis.tuning_verdict import RecordVerdict
from retuner.adaptive.fit.record import setpoint_changes
from retuner.adaptive.signals.sample import Window

SAMPLES_A_CYCLE = 12
CYCLES = 15.0  # Length of a stretch: ten to twenty show a cause, and drift little
CONDENSED = 2  # how many samples would become one before setpoint changes part a record
CHANGES = 3  # setpoint changes of a stretch
MOST_STRETCHES = 5
FEWEST_SAMPLES = 100


def stretches(window: Window, period_s: float | None, most_samples: int) -> list[Window]:
    """The stretches of a record that is too long to be condensed; none where it is not.

    period_s : of its oscillation, None where it has none. most_samples : that a fit takes.
    """
    n = len(window.t_s)
    if n <= most_samples:
        return []
    span_s = float(window.t_s[-1] - window.t_s[0])
    if period_s is None or most_samples * period_s / span_s >= SAMPLES_A_CYCLE:
        return _by_changes(window) if n > CONDENSED * most_samples else []
    length = round(n * CYCLES * period_s / span_s)
    if 3 * length > n:
        return []
    changes = np.abs(np.diff(window.sp))
    middle = int(np.argmax(changes)) if np.any(changes) else n // 2
    firsts = [0, min(max(middle - length // 3, length), n - 2 * length), n - length]
    return [window.part(slice(first, first + length)) for first in firsts]


def _by_changes(window: Window) -> list[Window]:
    """Stretches of CHANGES setpoint changes each, spread over the record; none where there are too few."""
    changed = np.searchsorted(window.t_s - window.t_s[0], setpoint_changes(window))
    groups = len(changed) // CHANGES
    if groups < 2:
        return []
    firsts, lasts = changed[: groups * CHANGES : CHANGES], changed[CHANGES - 1 : groups * CHANGES : CHANGES]
    edges = [0, *((lasts[:-1] + firsts[1:]) // 2).tolist(), len(window.t_s)]
    chosen = sorted({round(i) for i in np.linspace(0, groups - 1, min(groups, MOST_STRETCHES)).tolist()})
    parts = [slice(edges[i], edges[i + 1]) for i in chosen if edges[i + 1] - edges[i] >= FEWEST_SAMPLES]
    return [window.part(part) for part in parts] if len(parts) > 1 else []


def over_time(parts: list[Window], found: list[RecordVerdict]) -> RecordVerdict:
    """The verdict of a long record from those of its stretches; two of them must agree.

    A fault that two stretches show is told, whatever the others leave open; gains are changed only where no stretch
    names another cause.
    """
    causes = [f.diagnosis.cause for f in found]
    # The causes with their times, neighbours of one cause together
    runs = [(cause, [p for _, p in some]) for cause, some in groupby(zip(causes, parts, strict=True), itemgetter(0))]
    told = ", ".join(f"{cause} from {some[0].t_s[0]:.7g} to {some[-1].t_s[-1]:.7g} s" for cause, some in runs)
    named = Counter(c for c in causes if c not in OPEN)
    cause, count = (named or Counter(causes)).most_common(1)[0]
    if count == 1:
        cause, count = Counter(causes).most_common(1)[0]
    if count == 1 or (cause in TUNING_CAUSES and len(named) > 1):
        reason = f"the behaviour changes over the record: {told}"
        return RecordVerdict(Diagnosis(Cause.UNKNOWN, 0.5, found[-1].diagnosis.evidence, reason))
    agreeing = [f for f in found if f.diagnosis.cause == cause]
    best = max(agreeing, key=lambda f: (f.tuning is not None, f.diagnosis.confidence))
    nothing_new = set(causes) == {Cause.UNKNOWN}
    verdict = best.diagnosis if nothing_new else replace(best.diagnosis, reason=f"{best.diagnosis.reason} ({told})")
    return replace(best, diagnosis=verdict, fits={})


OPEN = frozenset({Cause.UNKNOWN, Cause.NOISE})  # answers that leave open what the loop does when something happens
