"""The guard: proof before change. See proof.py."""

from retuner.adaptive.guard.both_sides_of_boundary import borders_of
from retuner.adaptive.guard.guard_settings import GuardSettings
from retuner.adaptive.guard.model_set import allowed
from retuner.adaptive.guard.proof import prove
from retuner.adaptive.guard.request import (
    KC_ONLY,
    NO_DERIVATIVE,
    NO_LOCKS,
    ChangeRequest,
    Evidence,
    Locks,
    NeighbourBorder,
    Support,
)
from retuner.adaptive.guard.ruling import Check, Proof, Ruling
from retuner.adaptive.guard.step_size import SAME_GAINS, change_factor, within_limits

__all__ = [
    "KC_ONLY",
    "NO_DERIVATIVE",
    "NO_LOCKS",
    "SAME_GAINS",
    "ChangeRequest",
    "Check",
    "Evidence",
    "GuardSettings",
    "Locks",
    "NeighbourBorder",
    "Proof",
    "Ruling",
    "Support",
    "allowed",
    "borders_of",
    "change_factor",
    "prove",
    "within_limits",
]  # fmt: skip
