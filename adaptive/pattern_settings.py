"""Settings of the pattern rule: see pattern_rule.py."""

import math
from dataclasses import dataclass, fields


@dataclass(frozen=True, slots=True)
class PatternSettings:
    """Settings. Where no source is named, the value did best on the batch's first seeds (benchmarks/online).

    overshoot_target, damping_target : 0.05 to 0.5, defaults 0.15; both below the 0.3 that Astrom & Hagglund (1995) give
        for EXACT's typical aims, because at 0.3 the batch's loops end at Ms above 2.
    dead_zone : distance from the targets within which nothing moves; 0.02 to 0.2, default 0.05.
    gain : g of the rule, ln of a factor per unit of margin; 0.5 to 3, default 1.5.
    step_up, step_down : largest factor per response towards more and towards less action; 1.05 to 2, defaults 1.3, 1.5.
    urgent_step : factor at once when the swing grows; 1.05 to 4, default 2.
    careful : factor per response without a second peak, at most step_up; 1.02 to 2, default 1.2.
    co_enough : overshoot of co from which a response without a second peak is fast enough; 0 to 0.3, default 0.05.
    fast_ratio, slow_ratio : T/tau_I below which a swing is the gain's doing, and above which it is the integral's;
        defaults 1.5 and 4 (the integral's lag is 13 and 32 degrees there).
    long_ratio : T/tau_I below which tau_I is long; default 1.2 (tau_I = 0.83 T, Ziegler & Nichols 1942 for PI).
    long_tail : return over rise of a load response above which tau_I is too long; default 8 (SIMC's is 4 to 5).
    slow_periods : T over the time of the first tenth above which a swing is slow; default 20 (SIMC's is 7 to 12; two
        equal lags under too much gain have 14 to 17).
    slow_decays : and its overshoot at most; default 0.6.
    riding : damping above overshoot by this: the swing rides on a slow return, so the gain gives way; default 0.1.
    least_bands : least height of a response in noise bands; 3 to 20, default 6 (an overshoot of a sixth shows then).
    gap : damping and overshoot further apart belong to no ordinary response; default 0.35.
    uneven : ratio of the times between the peaks of a load response above which they are two upsets; default 2.5.
    limited : largest share of the upset with co at a limit; 0.01 to 0.5, default 0.1.
    pulse : share of its own travel that co must end away from where it began after a load; default 0.4.
    undying : damping above which a swing may be a valve's or another loop's; default 0.85.
    alone : nothing else looks for such causes: act on an undying swing, too; default no. For comparisons.

    Raises
    ------
    ValueError
        A number is not finite and positive, or a factor is below 1.
    """

    overshoot_target: float = 0.15
    damping_target: float = 0.15
    dead_zone: float = 0.05
    gain: float = 1.5
    step_up: float = 1.3
    step_down: float = 1.5
    urgent_step: float = 2.0
    careful: float = 1.2
    co_enough: float = 0.05
    fast_ratio: float = 1.5
    slow_ratio: float = 4.0
    long_ratio: float = 1.2
    long_tail: float = 8.0
    slow_periods: float = 20.0
    slow_decays: float = 0.6
    riding: float = 0.1
    least_bands: float = 6.0
    gap: float = 0.35
    uneven: float = 2.5
    limited: float = 0.1
    pulse: float = 0.4
    undying: float = 0.85
    alone: bool = False

    @property
    def least_up(self) -> float:
        """Factor of a careful step, within step_up."""
        return min(self.careful, self.step_up)

    def __post_init__(self) -> None:
        for field in fields(self):
            value = getattr(self, field.name)
            if field.name != "alone" and not 0 < value < math.inf:
                raise ValueError(f"{field.name} = {value} must be positive and finite")
        for name in ("step_up", "step_down", "urgent_step", "careful"):
            if getattr(self, name) < 1:
                raise ValueError(f"{name} = {getattr(self, name)} is a factor of at least 1")
