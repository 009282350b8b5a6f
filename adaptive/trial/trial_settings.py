"""Settings of trial and undo."""

import math

from retuner.schedule.late_dataclass import dataclass


@dataclass(frozen=True, slots=True)
class TrialSettings:
    """Settings.

    responses : responses that must keep the promise; 1 to 10, default 1.
    level : standard deviations of noise that a number must lie beyond the promise to speak against it; 2 to 6,
        default 3 (one false alarm in 700 by noise alone).
    decay_slack : and by this much in the ratio of successive peaks; 0 to 0.5, default 0.15 (a model is never exact).
    iae_slack : and by this factor in IAE; 1 to 4, default 1.5.
    harmless_decay : a ratio of successive peaks up to this is never called worse; 0.1 to 0.5, default 0.25.
    harmless_ms : an Ms up to this on the models that a trial leaves allowed is never called worse; 1.2 to 5, default
        2.1 (as the guard's for the worst model).
    seen_bands : noise bands that the largest peak must have to be judged; 2 to 20, default 4.
    seen_wanders : standard deviations of the error before the change, while nothing happened, that the largest peak
        must have to be judged; half as many begin a half cycle that may be a runaway; 2 to 10, default 6.
    rest_share : share of a setpoint step that may be left of the upset before it; 0 to 0.1, default 0.05.
    cool_down_s : no change for this long after an abort, s; None takes cool_down_tau_i times tau_I of the restored set.
    cool_down_tau_i : default 20. cool_down_most : most doublings of it by undos; default 6.
    lock_out_after : undos in a row after which a region is locked; 1 to 20, default 3.
    inconclusive : responses that may say nothing for or against before the trial is over; 1 to 100, default 5. What
        nothing speaks against stays then.
    settles : where a person has the next word, a trial that no response decides waits for him after so many promised
        settling times; 1 to 10000, default 50. Without one it goes on: time alone says nothing of a set.
    edit_hold_s : gains that a person has set are held for this long, s; 0 to 1e8, default 28800 (a shift), twice as
        long after each further time that he took ours away.
    grows : ratio of successive peaks from which two in a row are a runaway; above 1, default 1.05.
    stays : and from which `stays_for` in a row are one; defaults 0.95 and 5.
    limited_settles : the output may stand at a limit for so many promised settling times; 1 to 20, default 2.
    limit_swings : the output's way from one limit to the other, so many times in one upset, is a runaway; default 2.

    Raises ValueError: a setting is outside its range.
    """

    responses: int = 1
    level: float = 3.0
    decay_slack: float = 0.15
    iae_slack: float = 1.5
    harmless_decay: float = 0.25
    harmless_ms: float = 2.1
    seen_bands: float = 4.0
    seen_wanders: float = 6.0
    rest_share: float = 0.05
    cool_down_s: float | None = None
    cool_down_tau_i: float = 20.0
    cool_down_most: int = 6
    lock_out_after: int = 3
    inconclusive: int = 5
    settles: float = 50.0
    edit_hold_s: float = 28800.0
    grows: float = 1.05
    stays: float = 0.95
    stays_for: int = 5
    limited_settles: float = 2.0
    limit_swings: int = 2

    def __post_init__(self) -> None:
        ranges = (
            ("responses", 1, 10),
            ("level", 2, 6),
            ("decay_slack", 0, 0.5),
            ("iae_slack", 1, 4),
            ("harmless_decay", 0.1, 0.5),
            ("harmless_ms", 1.2, 5),
            ("seen_bands", 2, 20),
            ("seen_wanders", 2, 10),
            ("rest_share", 0, 0.1),
            ("cool_down_tau_i", 1, 1000),
            ("cool_down_most", 0, 20),
            ("lock_out_after", 1, 20),
            ("inconclusive", 1, 100),
            ("settles", 1, 10000),
            ("edit_hold_s", 0, 1e8),
            ("grows", 1, 2),
            ("stays", 0.8, 1),
            ("stays_for", 3, 20),
            ("limited_settles", 1, 20),
            ("limit_swings", 2, 10),
        )
        for name, low, high in ranges:
            value = getattr(self, name)
            if not low <= value <= high:
                raise ValueError(f"{name} = {value} is outside {low:g} to {high:g}")
        if self.cool_down_s is not None and not 0 <= self.cool_down_s < math.inf:
            raise ValueError(f"cool_down_s = {self.cool_down_s} must be a finite time, 0 or more")
