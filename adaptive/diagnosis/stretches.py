"""A long record in stretches: what happens in it is looked at closely, and told over time.

A fit condenses a record to some hundred samples. Where that would leave fewer than twelve of them in a cycle, the
oscillation's shape would be lost (a clean limit cycle of 290 rounds came out as noise), so stretches of fifteen cycles
are diagnosed instead: at the beginning, at the largest setpoint change or in the middle, and at the end.
"""

from collections import Counter
from dataclasses import replace

import numpy as np

from retuner.adaptive.diagnosis.cause import Cause, Diagnosis
from retuner.adaptive.diagnosis.tuning_verdict import Found
from retuner.adaptive.signals.sample import Window

SAMPLES_A_CYCLE = 12
CYCLES = 15.0
"""Length of a stretch: ten to twenty show a cause, and drift little."""


def stretches(window: Window, period_s: float | None, most_samples: int) -> list[Window]:
    """The stretches of a record that is too long to be condensed; none where it is not.

    period_s : of its oscillation, None where it has none. most_samples : that a fit takes.
    """
    n = len(window.t_s)
    if period_s is None or n <= most_samples:
        return []
    span_s = float(window.t_s[-1] - window.t_s[0])
    length = round(n * CYCLES * period_s / span_s)
    if most_samples * period_s / span_s >= SAMPLES_A_CYCLE or 3 * length > n:
        return []
    changes = np.abs(np.diff(window.sp))
    middle = int(np.argmax(changes)) if np.any(changes) else n // 2
    firsts = [0, min(max(middle - length // 3, length), n - 2 * length), n - length]
    return [window.part(slice(first, first + length)) for first in firsts]


def over_time(parts: list[Window], found: list[Found]) -> Found:
    """The verdict of a long record from those of its stretches; two of them must agree."""
    causes = [f.diagnosis.cause for f in found]
    told = ", ".join(f"{c} from {p.t_s[0]:.5g} to {p.t_s[-1]:.5g} s" for c, p in zip(causes, parts, strict=True))
    cause, count = Counter(causes).most_common(1)[0]
    if count == 1:
        reason = f"the record changes over time: {told}"
        return Found(Diagnosis(Cause.UNKNOWN, 0.5, found[-1].diagnosis.evidence, reason))
    agreeing = [f for f in found if f.diagnosis.cause == cause]
    best = max(agreeing, key=lambda f: (f.tuning is not None, f.diagnosis.confidence))
    verdict = replace(best.diagnosis, reason=f"{best.diagnosis.reason} ({told})")
    return replace(best, diagnosis=verdict, fits={})
