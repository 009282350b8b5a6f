"""In spec or not: settings judged on the true process, never on a model of it.

    Ms <= max(1.8, 1.03 x Ms of SIMC with perfect knowledge),   J <= 1.25 J of that SIMC
    J = mean of the IAE ratios to that SIMC after a setpoint and after a load step   (Grimholt & Skogestad 2012)

SIMC with perfect knowledge: half rule on the true process, half a sample of dead time more, tau_c = theta, PI.
"""

import math
from dataclasses import dataclass, replace

import numpy as np
from cases.loop import Controller, Upsets, iae, run
from cases.plant import robustness
from scipy.stats import beta

from retuner import LinearProcess, PidGains
from retuner.adaptive.process.reduction import half_rule
from retuner.adaptive.rules.simc import simc

MS_LIMIT, MS_OVER_BEST, J_LIMIT = 1.8, 1.03, 1.25
HORIZON_THETA, HORIZON_RESET = 60.0, 8.0
"""J is simulated for this many effective dead times and as many reset times (1/(k ki)) of the settings judged."""
MOST_STEPS = 8000


@dataclass(frozen=True, slots=True)
class Judgement:
    """ms : infinite when unstable. j : relative to SIMC with perfect knowledge. in_spec : both limits are met."""

    ms: float
    j: float
    in_spec: bool


class Judge:
    """Judge of one process sampled at dt_s. best : SIMC with perfect knowledge. ms_limit : what it allows.

    known : best settings and effective dead time from elsewhere, for processes that the half rule does not reduce.
    """

    def __init__(self, process: LinearProcess, dt_s: float, known: tuple[PidGains, float] | None = None) -> None:
        self.process, self.dt_s = process, dt_s
        self.best, self.theta_s = known or perfect(process, dt_s)
        self._sampled = replace(process, theta_s=process.theta_s + dt_s / 2)
        self.ms_best = robustness(self._sampled, self.best).ms
        self.ms_limit = max(MS_LIMIT, MS_OVER_BEST * self.ms_best)
        self._known: dict[PidGains, Judgement] = {}
        self._iae_best = self._iae(self.best)

    @staticmethod
    def theta(process: LinearProcess) -> float:
        """Effective dead time for PI, seconds: the scale of everything."""
        return half_rule(process).theta_s

    def of(self, gains: PidGains) -> Judgement:
        """Judge settings; the same settings are worked out once."""
        if gains not in self._known:
            ms = robustness(self._sampled, gains).ms
            j = math.inf
            if math.isfinite(ms):
                ratios = [x / best for x, best in zip(self._iae(gains), self._iae_best, strict=True)]
                j = sum(ratios) / 2
            self._known[gains] = Judgement(ms, j, ms <= self.ms_limit and j <= J_LIMIT)
        return self._known[gains]

    def load_like_setpoint(self) -> float:
        """Size of the load step that moves pv by one under SIMC with perfect knowledge."""
        # largest |pv| after a unit step in the load
        n = self._steps(self.best)
        record = run(self.process, Controller(self.best), self.dt_s, Upsets(np.zeros(n), load=np.ones(n)))
        return 1.0 / float(np.max(np.abs(record.pv)))

    def _steps(self, gains: PidGains) -> int:
        reset = 0.0 if not gains.ki else abs(gains.kp / gains.ki)
        if not self.process.integrators and gains.ki:
            reset += abs(1 / (self.process.k * gains.ki))
        return int(min((HORIZON_THETA * self.theta_s + HORIZON_RESET * reset) / self.dt_s, MOST_STEPS))

    def _iae(self, gains: PidGains) -> tuple[float, float]:
        n = self._steps(gains)
        setpoint, load = (iae(self.process, gains, self.dt_s, n, setpoint=which) for which in (True, False))
        return setpoint, load


def perfect(process: LinearProcess, dt_s: float) -> tuple[PidGains, float]:
    """SIMC with perfect knowledge, and the effective dead time in seconds."""
    model = half_rule(process)
    return simc(replace(model, theta_s=model.theta_s + dt_s / 2)).gains, model.theta_s


@dataclass(frozen=True, slots=True)
class Effect:
    """What a change did on the true process. ms_worse : Ms grew and is over its limit. iae_worse : J grew, and no
    Ms over its limit was lowered by it. restored : it put back what was there before.
    """

    t_s: float
    before: Judgement
    after: Judgement
    ms_worse: bool
    iae_worse: bool
    restored: bool

    @property
    def worse(self) -> bool:
        """Either."""
        return self.ms_worse or self.iae_worse


NOTICED = 1.01  # Growth by less than this factor is no harm


def effect(judge: Judge, t_s: float, before: PidGains, after: PidGains, *, restored: bool = False) -> Effect:
    """The effect of one change of gains."""
    old, new = judge.of(before), judge.of(after)
    ms_worse = new.ms > NOTICED * old.ms and new.ms > judge.ms_limit
    rescued = old.ms > judge.ms_limit and new.ms < old.ms
    return Effect(t_s, old, new, ms_worse, new.j > NOTICED * old.j and not rescued, restored)


# ---- Counts with their uncertainty

CONFIDENCE = 0.95


def at_most(events: int, n: int) -> float:
    """Upper end of the exact two-sided 95 % interval of a share (Clopper & Pearson 1934); 1 - 0.025^(1/n) for none."""
    return 1.0 if events >= n else float(beta.ppf(1 - (1 - CONFIDENCE) / 2, events + 1, n - events))
