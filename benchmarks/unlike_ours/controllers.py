"""A loop's controller with retuner beside it, by public names only, as docs/how-to-python.md tells it.

Two ways, as a library user has two. `ByController`: retuner.PidController does all. `ByOwnLoop`: a controller of
another make (its own form, filter, limits, rounding), watched by retuner.Retuner.
"""

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from time import perf_counter
from typing import Any

import retuner
from retuner import (
    Action,
    Decision,
    GainTable,
    LoopSample,
    PidController,
    PidGains,
    Retuner,
    RetunerSettings,
    TrialEvent,
)


@dataclass(frozen=True)
class Options:
    """Options of a controller of another make.

    form : parallel, ideal or series, in which `digits` digits of each number are kept. b : setpoint weight. tau_f :
    filter of the derivative, s. on_error : the derivative acts on the error. rate : of the output, per second.
    dead_band : of the error, pv units, within which the integral stands still. co_step : to which co is rounded.
    """

    form: str = "parallel"
    digits: int = 12
    b: float = 1.0
    tau_f: float = 0.0
    on_error: bool = False
    rate: float = math.inf
    dead_band: float = 0.0
    co_step: float = 0.0


@dataclass(frozen=True)
class Setup:
    """What a library user knows of the loop. start : setpoint and pv, and the output that holds them."""

    dt: float
    pv_range: tuple[float, float]
    co_range: tuple[float, float]
    table: GainTable
    start: tuple[float, float]
    options: Options = field(default_factory=Options)


@dataclass(frozen=True)
class Kept:
    """One decision at a setpoint, with the gains that ran before and after it. seconds : that it took."""

    t: float
    sp: float
    decision: Decision
    before: PidGains
    after: PidGains
    seconds: float


class Session:
    """What both ways have in common: decisions are kept, and can be stored."""

    def __init__(self, setup: Setup) -> None:
        self.setup = setup
        self.kept: list[Kept] = []
        self.sp = setup.start[0]

    def keep(self, t: float, decision: Decision, gains: tuple[PidGains, PidGains], seconds: float) -> None:
        """Note it, and everything that a ledger and a person would ask of it. gains : before and after."""
        json.dumps(decision.to_dict(), allow_nan=False)
        assert decision.canonical()
        assert str(decision)
        self.kept.append(Kept(t, self.sp, decision, *gains, seconds))


class ByController(Session):
    """PidController in mode auto."""

    def __init__(self, setup: Setup) -> None:
        super().__init__(setup)
        self.pid = self._made(None)
        sp, co = setup.start
        self.pid.step(sp, sp, manual_co=co)

    def _made(self, memory: Mapping[str, Any] | None) -> PidController:
        setup, o = self.setup, self.setup.options
        rate = None if math.isinf(o.rate) else o.rate
        more = {"b": o.b, "tau_f_s": o.tau_f, "co_rate_per_s": rate, "memory": memory}
        return PidController(
            setup.table, dt_s=setup.dt, pv_range=setup.pv_range, co_range=setup.co_range, mode="auto", **more
        )

    @property
    def gains(self) -> PidGains:
        """That run."""
        return self.pid.gains

    def step(self, t: float, sp: float, pv: float, dt: float, manual: float | None) -> float:
        """One sample; the output."""
        self.sp = sp
        before, began = self.pid.gains, perf_counter()
        co = self.pid.step(sp, pv, dt, manual_co=manual)
        self._keep(t, self.pid.decision, before, perf_counter() - began)
        return co

    def _keep(self, t: float, decision: Decision | None, before: PidGains, seconds: float = 0.0) -> None:
        if decision is not None:
            self.keep(t, decision, (before, self.pid.gains), seconds)

    def edit(self, t: float, gains: PidGains) -> None:
        """A person sets gains."""
        before = self.pid.gains
        self._keep(t, self.pid.set_gains(gains), before)

    def restart(self, t: float) -> None:
        """The process ends and begins again from its memory."""
        before = self.pid.gains
        self.pid = self._made(json.loads(json.dumps(self.pid.memory())))
        self._keep(t, self.pid.last_decision, before)

    def end(self, t: float) -> None:
        """Nobody watches any more."""
        before = self.pid.gains
        self._keep(t, self.pid.close(), before)


class Foreign:
    """A PID controller of another make: velocity form, so that it has no integral to hand over."""

    def __init__(self, setup: Setup) -> None:
        sp, self.co = setup.start
        self.o, self.range = setup.options, setup.co_range
        self._p, self._shown = self.o.b * sp - sp, 0.0 if self.o.on_error else -sp
        self._rate = self._error = 0.0
        self.gains = self.write(setup.table.gains[0])

    def write(self, gains: PidGains) -> PidGains:
        """Take gains as the panel keeps them; what runs then."""
        if self.o.form == "parallel":
            self.gains = PidGains(*(self._kept(v) for v in (gains.kp, gains.ki, gains.kd)))
        elif self.o.form == "ideal":
            kc, ti, td = (self._kept(v) for v in (gains.kp, gains.kp / gains.ki, gains.kd / gains.kp))
            self.gains = PidGains(kc, kc / ti, kc * td)
        else:
            s = retuner.to_series(gains)
            kc, ti, td = (self._kept(v) for v in (s.kc, s.tau_i_s or math.inf, s.tau_d_s))
            self.gains = PidGains(kc * (1 + td / ti), kc / ti, kc * td)
        return self.gains

    def _kept(self, value: float) -> float:
        return float(f"{value:.{self.o.digits}g}")

    def step(self, sp: float, pv: float, dt: float, manual: float | None) -> tuple[float, int]:
        """One sample: the output, and at which limit it stands."""
        o, g, (low, high) = self.o, self.gains, self.range
        p, shown = o.b * sp - pv, (sp - pv) if o.on_error else -pv
        rate = (o.tau_f * self._rate + shown - self._shown) / (o.tau_f + dt)
        if manual is None:
            moved = g.kp * (p - self._p) + g.ki * self._error * dt + g.kd * (rate - self._rate)
            self.co = min(max(self.co + min(max(moved, -o.rate * dt), o.rate * dt), low), high)
        else:
            self.co = manual
        self._p, self._shown, self._rate = p, shown, rate
        self._error = 0.0 if abs(sp - pv) < o.dead_band else sp - pv
        applied = round(self.co / o.co_step) * o.co_step if o.co_step else self.co
        return min(max(applied, low), high), -1 if self.co <= low else int(self.co >= high)


class ByOwnLoop(Session):
    """A foreign controller, and a Retuner beside it."""

    def __init__(self, setup: Setup) -> None:
        super().__init__(setup)
        o, (low, high) = setup.options, setup.pv_range
        self.settings = RetunerSettings(
            setup.dt, high - low, retuner.Mode.AUTO, setpoint_weight=o.b, filter_s=o.tau_f, pv_range=setup.pv_range
        )
        self.pid = Foreign(setup)
        self.retuner = Retuner(setup.table.with_gains(0, self.pid.gains), self.settings)

    @property
    def gains(self) -> PidGains:
        """That run."""
        return self.pid.gains

    def step(self, t: float, sp: float, pv: float, dt: float, manual: float | None) -> float:
        """One sample; the output."""
        self.sp = sp
        co, limited = self.pid.step(sp, pv, dt, manual)
        began = perf_counter()
        decision = self.retuner.observe(LoopSample(t, sp, pv, co, int(manual is None), limited, x=sp))
        self._obey(t, decision, perf_counter() - began)
        return co

    def _obey(self, t: float, decision: Decision | None, seconds: float = 0.0) -> None:
        if decision is None:
            return
        before, region = self.pid.gains, self.retuner.region
        if decision.action is Action.WRITE and decision.gains_after is not None:
            now = decision.gains_after if decision.later else self.pid.write(decision.gains_after)
            self.retuner.committed(self.retuner.table.index(decision.region), now)
        elif decision.action is Action.RESTORE and region is not None:
            self.pid.write(self.retuner.table.at(region, *self.retuner.scheduled))
            self.retuner.restored()
        self.keep(t, decision, (before, self.pid.gains), seconds)

    def edit(self, t: float, gains: PidGains) -> None:
        """A person sets gains."""
        self._obey(t, self.retuner.edited(self.pid.write(gains)))

    def restart(self, t: float) -> None:
        """The process ends and begins again from its memory."""
        self.retuner = retuner.restore(json.loads(json.dumps(retuner.remember(self.retuner))), self.settings)
        self._obey(t, retuner.found_running(self.retuner, self.pid.gains))

    def end(self, t: float) -> None:
        """Nobody watches any more."""
        self._obey(t, self.retuner.abort(TrialEvent.STOPPED))
