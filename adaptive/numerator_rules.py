"""Numerator time constants set against denominator ones: rules T1 to T3 of Skogestad (2003), section 2.3.

    (T0 s + 1)/(tau0 s + 1)  ~  T0/tau0                               T0 >= tau0 >= theta           T1
                                T0/theta                              T0 >= theta >= tau0           T1a
                                1                                     theta >= T0 >= tau0           T1b
                                T0/tau0                               tau0 >= T0 >= 5 theta         T2
                                (t/tau0)/((t - T0) s + 1)             t = min(tau0, 5 theta) >= T0  T3

theta is the effective dead time that comes out in the end, so the caller iterates. tau0 is the closest larger lag, or
the closest smaller one when there is no larger one or when the smaller one is close: T0/small < large/T0 and
T0/small < 1.6. An integrator is a lag without bound: its gain is k' = k/tau0, so the limits of T2 and T3 are
k' T0 and k' 5 theta/((5 theta - T0) s + 1).
"""

import math
from typing import NamedTuple

CLOSE = 1.6
"""A smaller lag is close to a lead within this ratio (Skogestad 2003)."""
WITHIN = 5.0
"""Lags beyond this many dead times look like integrators to the closed loop (Skogestad 2003, rules T2 and T3)."""
ROUNDING = 1e-3
"""Ratios are compared with this relative slack: 0.08/0.05 is 1.6, not less, also when 0.05 is a polynomial's root."""


class Setting(NamedTuple):
    """A lead that has been set against a lag.

    rule : name of the rule. lead_s, against_s : what was set against what (infinite: an integrator).
    factor : on the gain; seconds where an integrator has gone. rest_s : lag that remains, 0 for none.
    """

    rule: str
    lead_s: float
    against_s: float
    factor: float
    rest_s: float

    def text(self) -> str:
        """The step in words."""
        against = "the integrator" if math.isinf(self.against_s) else f"lag {self.against_s:g} s"
        rest = f", lag {self.rest_s:g} s remains" if self.rest_s else ""
        return f"{self.rule}: lead {self.lead_s:g} s against {against}: gain x {self.factor:.6g}{rest}"


def against(lead_s: float, lags_s: list[float]) -> float:
    """The lag that a lead is set against; integrators are among lags_s as infinite ones.

    Raises
    ------
    ValueError
        There is no lag left.
    """
    larger = [lag for lag in lags_s if lag >= lead_s]
    smaller = [lag for lag in lags_s if lag < lead_s]
    if not lags_s:
        raise ValueError(f"a numerator time constant of {lead_s:g} s has no lag to be set against: more zeros than "
                         "poles; add the missing lags (sensor, actuator)")  # fmt: skip
    if not smaller:
        return min(larger)
    near = max(smaller)
    ratio = lead_s / near * (1 + ROUNDING)
    if not larger or (ratio < min(larger) / lead_s and ratio < CLOSE):
        return near
    return min(larger)


def set_against(lead_s: float, lag_s: float, theta_s: float) -> Setting:
    """Apply the rule that holds for a lead, a lag (infinite for an integrator) and an effective dead time, all in s."""
    if lead_s > lag_s:
        return Setting(_t1(lead_s, lag_s, theta_s), lead_s, lag_s, lead_s / min(max(theta_s, lag_s), lead_s), 0.0)
    unit = 1.0 if math.isinf(lag_s) else lag_s
    if lead_s >= WITHIN * theta_s:
        return Setting("T2", lead_s, lag_s, lead_s / unit, 0.0)
    reach = min(lag_s, WITHIN * theta_s)
    return Setting("T3", lead_s, lag_s, reach / unit, reach - lead_s)


def _t1(lead_s: float, lag_s: float, theta_s: float) -> str:
    """Which of the three rules for a lead longer than its lag."""
    if theta_s <= lag_s:
        return "T1"
    return "T1a" if theta_s <= lead_s else "T1b"
