"""A proposal without a model: the slow-oscillation rule in its range, else the pattern rule, within what is locked.

    not identifiable -> slow-oscillation rule, where the swing is that of an integrating process
                     -> pattern rule, small clamped steps
                     -> nothing, with the reasons of both

Neither proves anything. The guard lets such a proposal through as a small step at the most, and the trial watches it.
"""

from retuner.adaptive.decision_numbers import NO_NUMBERS, Basis, Numbers
from retuner.adaptive.diagnosis.cause import Diagnosis
from retuner.adaptive.guard.request import NO_LOCKS, Locks
from retuner.adaptive.rules.rule import Tuning
from retuner.adaptive.signals.response import Response
from retuner.adaptive.signals.sample import Window
from retuner.adaptive.without_model.pattern_rule import PatternSettings, pattern_rule
from retuner.adaptive.without_model.slow_oscillation_step import SlowSettings, slow_oscillation_online
from retuner.schedule.gains import PidGains
from retuner.schedule.late_dataclass import dataclass, field, replace


@dataclass(frozen=True, slots=True)
class WithoutModelSettings:
    """Settings of both rules. allowed : whether gains may be moved without a model at all; default yes."""

    pattern: PatternSettings = field(default_factory=PatternSettings)
    slow: SlowSettings = field(default_factory=SlowSettings)
    allowed: bool = True


@dataclass(frozen=True, slots=True)
class Proposed:
    """What is proposed. tuning and basis : None where nothing is. code : name of the reading that decided.

    sentence : why or why not. numbers : what was weighed.
    """

    code: str
    sentence: str
    numbers: Numbers
    tuning: Tuning | None = None
    basis: Basis | None = None


def step_without_model(
    response: Response,
    window: Window,
    gains: PidGains,
    diagnosis: Diagnosis | None,
    settings: WithoutModelSettings,
    locks: Locks = NO_LOCKS,
) -> Proposed:
    """What to try after a response from which no process can be identified.

    response, window : what was recognised, and its samples with some time before.
    gains : in force during it. diagnosis : what is known of the cause; None where nobody looked.
    """
    if not settings.allowed:
        return Proposed("not_allowed", "changes without a model are switched off", NO_NUMBERS)
    slow = slow_oscillation_online(response, gains, diagnosis, settings.slow, locks)
    if slow.tuning is not None:
        return _locked(
            Proposed(slow.reading.name.lower(), slow.sentence, slow.numbers, slow.tuning, Basis.SLOW_OSCILLATION),
            gains,
            locks,
        )
    pattern = pattern_rule(response, window, gains, diagnosis, settings.pattern)
    found = Proposed(pattern.reading.name.lower(), pattern.sentence, pattern.numbers, pattern.tuning, Basis.PATTERN)
    return _locked(found, gains, locks) if pattern.tuning is not None else replace(found, basis=None)


def _locked(proposed: Proposed, in_force: PidGains, locks: Locks) -> Proposed:
    """The proposal within what is locked, and nothing where the locks leave nothing of it."""
    tuning = proposed.tuning
    assert tuning is not None
    kept = locks.keep(tuning.gains, in_force)
    if kept == in_force:
        return replace(proposed, tuning=None, basis=None, sentence=f"{proposed.sentence}; but that parameter is locked")
    return replace(proposed, tuning=replace(tuning, gains=kept))
