"""A loop run through time: controller, valve, process, sensor; and the two numbers that judge settings.

The process moves in steps of h_s, exactly; the controller acts at chosen steps and holds its output between.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from cases.case import FloatArray, Record
from cases.plant import HeldPlant
from retuner import LinearProcess, PidGains
from retuner.schedule.pid import law, start, step

FAR = 1e15  # Limits of an output that has none

Valve = Callable[[float], float]
Sensor = Callable[[float], float]


@dataclass(frozen=True, slots=True)
class Controller:
    """Gains, filter time of the derivative, and the range of the output."""

    gains: PidGains
    tau_f_s: float = 0.0
    co_min: float = -FAR
    co_max: float = FAR


@dataclass(frozen=True, slots=True)
class Upsets:
    """What happens to a loop, each of shape (n,), one value a step; zero where it is left out.

    sp : setpoint. load : added to the controller output. out : added to pv. noise : added to what the sensor reads.
    """

    sp: FloatArray
    load: FloatArray | None = None
    out: FloatArray | None = None
    noise: FloatArray | None = None

    def filled(self) -> tuple[list[float], list[float], list[float], list[float]]:
        """All four as lists of the same length."""
        zero = np.zeros(len(self.sp))
        return tuple((zero if x is None else x).tolist() for x in (self.sp, self.load, self.out, self.noise))


def run(
    process: LinearProcess,
    controller: Controller,
    h_s: float,
    upsets: Upsets,
    *,
    co0: float = 0.0,
    pv0: float = 0.0,
    acts: FloatArray | None = None,
    valve: Valve | None = None,
    sensor: Sensor | None = None,
) -> Record:
    """The loop from rest at (pv0, co0), in automatic; the record holds the steps at which the controller acts.

    acts : steps at which it acts, default all. upsets.sp is the setpoint itself, the others are deviations.
    """
    sp, load, out, noise = upsets.filled()
    n = len(sp)
    due = np.zeros(n, dtype=bool)
    due[slice(None) if acts is None else acts.astype(int)] = True
    plant = HeldPlant(process, h_s)
    rules = law(controller.gains, tau_f_s=controller.tau_f_s, co_min=controller.co_min, co_max=controller.co_max)
    state = start(rules, pv0, pv0, co0)
    co, moved, y, last = co0, 0.0, 0.0, -1
    pvs, cos = np.zeros(n), np.zeros(n)
    rest = valve(co0) if valve else co0
    for i, acting in enumerate(due.tolist()):
        pv = pv0 + y + out[i] + noise[i]
        pv = sensor(pv) if sensor else pv
        if acting:
            state, co = step(rules, state, sp[i], pv, (i - last) * h_s)
            last = i
            moved = (valve(co) if valve else co) - rest
        pvs[i], cos[i] = pv, co
        y = plant.move(moved + load[i])
        if not -FAR < y < FAR:
            raise OverflowError("the loop is unstable")
    return Record(np.arange(n)[due] * h_s, np.asarray(sp)[due], pvs[due], cos[due])


def run_manual(process: LinearProcess, h_s: float, co: FloatArray, upsets: Upsets, *, pv0: float = 0.0) -> Record:
    """The process alone under a given output, from rest."""
    sp, load, out, noise = upsets.filled()
    plant = HeldPlant(process, h_s)
    pvs, y = np.zeros(len(sp)), 0.0
    for i in range(len(sp)):
        pvs[i] = pv0 + y + out[i] + noise[i]
        y = plant.move(float(co[i] - co[0]) + load[i])
    return Record(np.arange(len(sp)) * h_s, np.asarray(sp), pvs, co)


def iae(process: LinearProcess, gains: PidGains, h_s: float, n: int, *, setpoint: bool) -> float:
    """Integrated absolute error of a unit step in setpoint or load, without noise and limits; inf when unstable."""
    step_on = np.ones(n)
    upsets = Upsets(step_on) if setpoint else Upsets(np.zeros(n), load=step_on)
    try:
        record = run(process, Controller(gains), h_s, upsets)
    except (OverflowError, ValueError):
        return math.inf
    error = np.abs(record.sp - record.pv)
    if np.max(error[-n // 10 :]) > 2 * np.max(error[: n // 2]):
        return math.inf
    return float(np.sum(error) * h_s)


MOST_STEPS = 8000


def performance(process: LinearProcess, gains: PidGains, reference: PidGains, theta_eff_s: float, dt_s: float) -> float:
    """J relative to the reference settings: mean of the ratios of IAE after a setpoint and after a load step.

    Simulated with the record's sampling, for long enough that the slower of the two settings is at rest.
    """
    h_s = min(dt_s, theta_eff_s / 5)
    slow = max(_reset(gains), _reset(reference), theta_eff_s)
    n = int(min(max(60 * theta_eff_s, 40 * theta_eff_s + 6 * slow) / h_s, MOST_STEPS))
    ratios = [
        iae(process, gains, h_s, n, setpoint=s) / iae(process, reference, h_s, n, setpoint=s) for s in (True, False)
    ]
    return 0.5 * sum(ratios)


def _reset(gains: PidGains) -> float:
    """Integral time; 0 without proportional or integral action."""
    return abs(gains.kp / gains.ki) if gains.ki else 0.0
