"""The PID law: one pure step, everything it needs as arguments, time among them.

    co = kp (b sp - pv) + I - kd r                          limited in range and rate
    r  = (tau_f r' + pv - pv') / (tau_f + dt)               filtered slope of pv (' = one sample ago)
    I' = I + ki (sp - pv) dt                                for the next sample

This is the textbook discretisation of Wittenmark, Astrom, Arzen, "Computer Control: An Overview" (2002) section 8,
as DiscretePIDs.jl has it: the integral by forward difference, so that co does not depend on ki at the instant at which
ki changes; the derivative by backward difference, which is stable for every dt (the pole tau_f/(tau_f + dt) lies in
[0, 1), whereas forward difference is unstable for dt > 2 tau_f and Tustin rings at z = -1). The derivative acts on pv
only: a setpoint step gives no kick. I is kept in units of co, so a change of ki alone needs no action at all.

Anti-windup is conditional integration (Astrom & Hagglund 2006, section 3.5), without a setting and without an integral
time, which a controller without integral does not have: while range or rate limits co, the integral does not grow in
the direction in which co cannot follow, and it never carries the wish past the end of the range. Tried and rejected:
back-calculation with the tracking time kp/ki. It lets the integral run to the limit while P holds co there; a setpoint
step through a rate limit then overshoots by 3 to 8 %, against 1 % at most (and 20 to 110 % without anti-windup).

Change of gains, bumpless: I+ = I + P - P+ + D - D+, see `change`.

Speed: law is a slotted frozen dataclass, a state is a bare tuple in the order of PidState. On CPython 3.11 a NamedTuple
costs 75 ns more to build and 13 to 28 more to unpack than a bare tuple, and a step has no more than 250 ns in all
(benchmarks/per_sample.py). `PidState(*state)` reads it by name.
"""

import math
from typing import NamedTuple, NoReturn

from retuner.schedule.gains import PidGains
from retuner.schedule.late_dataclass import dataclass, replace

StateTuple = tuple[float, float, float, float, int]
"""A state as `step` and `track` return it: the fields of PidState in their order."""


class PidState(NamedTuple):
    """What the law remembers from one sample to the next.

    integral : I of the next sample, co units.
    pv : pv of the last sample.
    pv_rate : filtered slope of pv, pv units per second.
    co : controller output of the last sample.
    limited : -1 when co stands at co_min, +1 at co_max, 0 between (also while only the rate limits it).
    """

    integral: float
    pv: float
    pv_rate: float
    co: float
    limited: int


LIMITED = PidState._fields.index("limited")  # where `limited` stands in a state
PV = PidState._fields.index("pv")  # where pv stands in a state


@dataclass(frozen=True, slots=True)
class PidLaw:
    """Settings of the law; `law` makes one from gains.

    kp, ki, kd : parallel gains, as in PidGains: co units per pv unit, per second, times seconds.
    b : setpoint weight of P, 0 to 1, default 1 (smaller: less overshoot after setpoint steps, same load response).
    tau_f_s : time constant of the derivative's filter in seconds, at least 0, default 0 (none).
    co_min, co_max : range of co in co units (percent of the output range), co_min < co_max, default 0 and 100.
    co_rate_per_s : largest rate of change of co, co units per second, more than 0; default None (no limit).

    Raises ValueError: a setting is not finite or outside the range given here; the gains as PidGains says.
    """

    kp: float
    ki: float
    kd: float
    b: float = 1.0
    tau_f_s: float = 0.0
    co_min: float = 0.0
    co_max: float = 100.0
    co_rate_per_s: float | None = None

    def __post_init__(self) -> None:
        PidGains(self.kp, self.ki, self.kd)
        if not 0.0 <= self.b <= 1.0:
            raise ValueError(f"b = {self.b}: the setpoint weight must lie in 0 to 1")
        if not 0.0 <= self.tau_f_s < math.inf:
            raise ValueError(f"tau_f_s = {self.tau_f_s} must be a finite number, 0 or more")
        if not -math.inf < self.co_min < self.co_max < math.inf:
            raise ValueError(f"co_min = {self.co_min}, co_max = {self.co_max} must be finite with co_min < co_max")
        if self.co_rate_per_s is not None and not 0.0 < self.co_rate_per_s < math.inf:
            raise ValueError(f"co_rate_per_s = {self.co_rate_per_s} must be positive and finite; None for no limit")

    @property
    def gains(self) -> PidGains:
        """The gains alone."""
        return PidGains(self.kp, self.ki, self.kd)

    def with_gains(self, gains: PidGains) -> "PidLaw":
        """The settings with other gains; `change` takes the state across."""
        return replace(self, kp=gains.kp, ki=gains.ki, kd=gains.kd)


def law(
    gains: PidGains,
    *,
    b: float = 1.0,
    tau_f_s: float = 0.0,
    co_min: float = 0.0,
    co_max: float = 100.0,
    co_rate_per_s: float | None = None,
) -> PidLaw:
    """The law with these gains; settings and errors as PidLaw says."""
    return PidLaw(gains.kp, gains.ki, gains.kd, b, tau_f_s, co_min, co_max, co_rate_per_s)


def start(law: PidLaw, sp: float, pv: float, co: float) -> PidState:
    """State of a controller that takes over a loop at rest without a bump: the first step with sp and pv gives co.

    sp, pv : setpoint and process value in pv units. co : output in force, co units; limited to the range.

    Raises ValueError: a number is not finite.
    """
    other = law.kp * (law.b * sp - pv)
    if not math.isfinite(co + other):
        _refuse(sp=sp, pv=pv, co=co)
    co = _in_range(law, co)
    return PidState(co - other, pv, 0.0, co, _standing(law, co))


def step(law: PidLaw, state: StateTuple, sp: float, pv: float, dt_s: float) -> tuple[StateTuple, float]:
    """One sample in automatic: the new state and the co to apply until the next sample.

    sp, pv : setpoint and process value in pv units. dt_s : time since the last sample in seconds.

    Raises ValueError: a number is not finite, dt_s is not positive, or the result is too large for a number. The state
    given is unchanged, as always: go on with it at the next good sample.
    """
    if dt_s <= 0.0:
        _refuse(dt_s=dt_s)
    integral, pv_last, pv_rate, co, _ = state
    tau_f = law.tau_f_s
    pv_rate = (tau_f * pv_rate + pv - pv_last) / (tau_f + dt_s)
    wish = law.kp * (law.b * sp - pv) + integral - law.kd * pv_rate
    more = law.ki * (sp - pv) * dt_s
    ahead = wish + more
    rate = law.co_rate_per_s
    # NaN and infinity fail these comparisons as well: the quiet path needs no test of its own.
    if (
        law.co_min < wish < law.co_max
        and law.co_min <= ahead <= law.co_max
        and (rate is None or -(reach := rate * dt_s) <= wish - co <= reach)
    ):
        return (integral + more, pv, pv_rate, wish, 0), wish
    if ahead - ahead != 0.0:
        _refuse(sp=sp, pv=pv, dt_s=dt_s)
    co, limited, more = _hold(law, wish if rate is None else _reachable(wish, co, rate * dt_s), wish, more)
    return (integral + more, pv, pv_rate, co, limited), co


def track(law: PidLaw, state: StateTuple, sp: float, pv: float, co: float, dt_s: float) -> tuple[StateTuple, float]:
    """One sample in manual: co is given, the integral follows it, so that automatic goes on from there.

    co : output wanted, co units; the range and the rate limit hold for it as well, since they protect the equipment.
    Returns the new state and the co to apply. Other arguments and errors as `step`.
    """
    if dt_s <= 0.0:
        _refuse(dt_s=dt_s)
    _, pv_last, pv_rate, co_last, _ = state
    pv_rate = (law.tau_f_s * pv_rate + pv - pv_last) / (law.tau_f_s + dt_s)
    other = law.kp * (law.b * sp - pv) - law.kd * pv_rate
    if not math.isfinite(co + other + dt_s * 0.0):
        _refuse(sp=sp, pv=pv, co=co, dt_s=dt_s)
    rate = law.co_rate_per_s
    co = _in_range(law, co if rate is None else _reachable(co, co_last, rate * dt_s))
    return (co - other, pv, pv_rate, co, _standing(law, co)), co


def change(old: PidLaw, new: PidLaw, state: StateTuple, sp: float, pv: float, dt_s: float = 0.0) -> PidState:
    """State that takes a loop from one law to another without a bump: with sp and pv both ask for the same co.

        I+ = I + P - P+ + D - D+        (P, D of the old law, P+, D+ of the new one)

    At a limit, co is what must stay, not the wish beyond it (US patent 6,317,637): I moves just so far that the new
    law's wish reaches the limit, or not at all when it is beyond it anyway. Carrying the excess over would wind up.
    When the new range does not contain co, co goes to its nearest end. A new law without integral keeps I as its bias.

    sp, pv : of the last sample, then dt_s = 0 (between samples); or of the sample about to be stepped, then dt_s is
        the dt_s of that step, and the step gives the co that the old law would have given.

    Raises ValueError: a number is not finite, dt_s is negative, or the result is too large for a number.
    """
    if not dt_s >= 0.0:
        _refuse(dt_s=dt_s)
    integral, pv_last, pv_rate, co, limited = state
    before = _wish(old, state, sp, pv, dt_s)
    after = _wish(new, state, sp, pv, dt_s)
    if not math.isfinite(before + after + dt_s * 0.0):
        _refuse(sp=sp, pv=pv, dt_s=dt_s)
    aim = _in_range(new, _in_range(old, before))
    stays = after >= aim if aim >= new.co_max else aim <= new.co_min and after <= aim
    return PidState(integral if stays else integral + (aim - after), pv_last, pv_rate, co, limited)


def _wish(law: PidLaw, state: StateTuple, sp: float, pv: float, dt_s: float) -> float:
    """co before its limits; dt_s = 0: the derivative as it stands."""
    integral, pv_last, pv_rate, _, _ = state
    if dt_s > 0.0:
        pv_rate = (law.tau_f_s * pv_rate + pv - pv_last) / (law.tau_f_s + dt_s)
    return law.kp * (law.b * sp - pv) + integral - law.kd * pv_rate


def _in_range(law: PidLaw, co: float) -> float:
    return min(max(co, law.co_min), law.co_max)


def _reachable(wish: float, co_last: float, reach: float) -> float:
    """The co nearest to the wish that the rate limit allows."""
    return min(max(wish, co_last - reach), co_last + reach)


def _hold(law: PidLaw, co: float, wish: float, more: float) -> tuple[float, int, float]:
    """The slow path of a step: co in its range, at which limit it stands, and how much the integral may grow.

    co : what the rate limit allows of the wish. more : growth of the integral without anti-windup (see above).
    """
    limited = 0
    if co >= law.co_max:
        co, limited = law.co_max, 1
    elif co <= law.co_min:
        co, limited = law.co_min, -1
    if more > 0.0:
        if wish > co:
            return co, limited, 0.0
        return co, limited, more if wish + more <= law.co_max else law.co_max - wish
    if wish < co:
        return co, limited, 0.0
    return co, limited, more if wish + more >= law.co_min else law.co_min - wish


def _standing(law: PidLaw, co: float) -> int:
    """-1 at the lower end of the range, +1 at the upper, 0 between."""
    if co >= law.co_max:
        return 1
    return -1 if co <= law.co_min else 0


def _refuse(**numbers: float) -> NoReturn:
    for name, value in numbers.items():
        if not math.isfinite(value):
            raise ValueError(f"{name} = {value} is not a finite number; the state is unchanged")
    if numbers.get("dt_s", 1.0) <= 0.0:
        raise ValueError(f"dt_s = {numbers['dt_s']} must be positive; the state is unchanged")
    raise ValueError(f"{numbers} give a result too large for a number; the state is unchanged")
