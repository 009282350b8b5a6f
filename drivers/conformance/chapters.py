"""The whole examination, in its order: chapter of docs/developers/protocol.md and what is tried of it."""

from retuner.drivers.conformance import frame_checks, set_checks
from retuner.drivers.conformance.examination import Check

CHAPTERS: tuple[tuple[str, Check], ...] = (
    ("Connecting", frame_checks.connecting),
    ("Frames", frame_checks.frames),
    ("Samples", frame_checks.samples),
    ("Who may command: the lease", frame_checks.leases),
    ("Changing gains", set_checks.staging),
    ("Changing gains", set_checks.committing),
    ("Changing gains", set_checks.swapping),
    ("Changing gains", set_checks.refusing),
    ("Changing gains", set_checks.fencing),
    ("Changing gains", set_checks.busy),
    ("Trial", set_checks.trial),
    ("Storing and restarting", set_checks.storing),
    ("Authentication of commits", set_checks.codes),
    ("Setpoint, mode, load", frame_checks.commands),
    ("Who may command: the lease", frame_checks.stamps),
    ("Storing and restarting", set_checks.restarting),
)


def chapters(trial_samples: int = 0) -> tuple[tuple[str, Check], ...]:
    """All chapters; with trial_samples also what happens when a set is not confirmed in so many samples."""
    return (*CHAPTERS, ("Trial", set_checks.reverting(trial_samples))) if trial_samples else CHAPTERS
