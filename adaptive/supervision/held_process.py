"""Before a change lets it go: do the gains in force hold a process that runs away by itself?

What shows that is in diagnosis/runaway_process.py.
"""

import math

from retuner.adaptive.diagnosis.cause import Cause, Diagnosis
from retuner.adaptive.diagnosis.runaway_process import Runaway, runaway_process, worse_on
from retuner.adaptive.loop.sampled import SampledLaw
from retuner.adaptive.signals.sample import LoopMode, Window
from retuner.adaptive.supervision.pipeline_types import Findings, ResponseRecord

BEFORE = 5
"""Samples before a setpoint step that are looked at with it."""
FEWEST = 3
"""Samples of a window."""


def runaway(found: Findings) -> None:
    """Does the process run away by itself, and would the proved change hold it worse?

    The last setpoint step under these gains shows it. What settings follow from has no such pole, and on an integrator
    in its place less gain looks safer.
    """
    record, verdict, settings = found.record, found.verdict, found.settings
    if verdict is None or verdict.gains is None or found.steps is not None or record.pattern is None:
        return
    window = _last_step(record)
    if window is None:
        return
    law = SampledLaw(record.in_force, settings.sample_time_s, settings.setpoint_weight, settings.filter_s)
    shown = runaway_process(window, law)
    if shown is None:
        return
    after = record.table.with_gains(record.region, verdict.gains).at(record.region, *record.at)
    worse = worse_on(shown, law, after, len(window.pv), settings.cause.ms_high)
    if worse is not None:
        found.doubted(_told(shown, *worse))


def _last_step(record: ResponseRecord) -> Window | None:
    """From the last setpoint step under these gains to the end of its response, or to the load that came next; None
    where none is kept, or co did not follow its law.
    """
    response, revision = record.response, record.samples[-1].revision
    end_s = response.t_end_s if response.sp_changed else response.t_start_s
    kept = [s for s in record.samples if s.t_s <= end_s and s.revision == revision and s.t_s >= record.entered_s]
    at = next((i for i in range(len(kept) - 1, 0, -1) if kept[i].sp != kept[i - 1].sp), 0)
    own = kept[max(at - BEFORE, 0) :]
    followed = all(sample.mode == LoopMode.AUTO and not sample.limited for sample in own)
    return Window.of(own) if at and followed and len(own) >= FEWEST else None


def _told(shown: Runaway, before: float, after: float) -> Diagnosis:
    """Why nothing changes. before, after : Ms on it."""
    then = f"Ms {before:.2f} -> {after:.2f}" if math.isfinite(after) else f"Ms {before:.2f} now"
    what = "make it less robust" if math.isfinite(after) else "not hold it"
    reason = (
        f"the process runs away by itself, by a factor of 2.7 in {shown.grows_s:.3g} s; the gains hold it. "
        f"What the rule gives would {what} ({then}); there is no rule for such a process"
    )
    evidence = {"runs_away_s": shown.grows_s, "ms": before}
    return Diagnosis(Cause.UNKNOWN, 0.5, evidence, reason)
