"""Write the simulated records of examples/records: the same to the last digit whenever it is run.

    python examples/make_records.py

A PID controller as retuner has it, on a simulated process with measurement noise. Nothing in these records was
measured; the records that were are named in examples/records/README.md.
"""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from retuner import PidGains
from retuner.schedule.pid import law, start, step

RECORDS = Path(__file__).resolve().parent / "records"
Curve = Callable[[float], float]


@dataclass(frozen=True)
class Loop:
    """A first-order process with dead time, under a PID controller.

    lag_s, dead_s : of the process, the dead time in whole samples of dt_s. curve : pv in the end, by co.
    co : at the start, at rest. gains : of the controller; None in manual, where co takes the places of the setpoints.
    setpoints : one for each `each_s` seconds. load, load_at_s : a step at the process input, percent. noise : of pv.
    """

    lag_s: float
    dead_s: int
    curve: Curve
    co: float
    gains: PidGains | None
    setpoints: tuple[float, ...]
    each_s: int
    load: float = 0.0
    load_at_s: int = 0
    noise: float = 0.05
    seed: int = 1
    dt_s: float = 1.0

    def record(self) -> np.ndarray:
        """Columns t, sp, pv, co."""
        rng = np.random.default_rng(self.seed)
        pv = self.curve(self.co)
        rules = law(self.gains) if self.gains else None
        state = start(rules, pv, pv, self.co) if rules else None
        under_way = [self.co] * (round(self.dead_s / self.dt_s) + 1)
        rows = np.zeros((round(len(self.setpoints) * self.each_s / self.dt_s), 4))
        for i in range(len(rows)):
            sp, seen = self.setpoints[int(i * self.dt_s) // self.each_s], pv + self.noise * float(rng.standard_normal())
            co = sp
            if rules and state:
                state, co = step(rules, state, sp, seen, self.dt_s)
            co = min(max(co, 0.0), 100.0)
            rows[i] = i * self.dt_s, sp, seen, co
            under_way.append(co)
            pushed = under_way.pop(0) + (self.load if i * self.dt_s >= self.load_at_s else 0.0)
            pv += (self.curve(pushed) - pv) * self.dt_s / self.lag_s
        return rows


def straight(gain: float) -> Curve:
    """The same gain everywhere: pv 50 at co 50."""
    return lambda co: 50.0 + gain * (co - 50.0)


def bent(co: float) -> float:
    """A gain of 0.5 up to pv 40, and of 1.5 above."""
    return 20.0 + 0.5 * (co - 20.0) if co < 60.0 else 40.0 + 1.5 * (co - 60.0)


def oven(co: float) -> float:
    """An oven whose gain falls from 3.2 K per percent when cold to 0.8 when hot: it radiates."""
    return 20.0 + 3.2 * co - 0.012 * co * co


DAY = (50.0, 60.0, 80.0, 90.0, 110.0, 120.0, 140.0, 150.0, 170.0, 180.0, 195.0, 180.0)
"""Setpoints of a day, two hours each."""

LOOPS = {
    # Twice the gain that it should have: SIMC's Kc is 2.5 to 3, tau_I 20 s. A load comes at 340 s.
    "loop.csv": Loop(20.0, 3, straight(1.0), 50.0, PidGains(6.0, 0.3), (50.0, 53.0, 50.0, 51.0), 150, 5.0, 340, seed=3),
    # One step of co in manual, from 50 to 60.
    "step.csv": Loop(40.0, 5, straight(2.0), 50.0, None, (50.0, 60.0, 60.0, 60.0), 100, noise=0.1),
    # Proportional control with a setpoint step that overshoots by a third: what the setpoint method wants.
    "setpoint.csv": Loop(40.0, 5, straight(2.0), 50.0, PidGains(2.5, 0.0), (50.0, 54.0), 200, noise=0.02),
    # Proportional control at the gain where a loop swings on.
    "swing.csv": Loop(30.0, 6, straight(2.0), 50.0, PidGains(3.5, 0.0), (50.0, 51.0), 400, noise=0.02),
    # A tank that answers three times as strongly above 40 as below.
    "level.csv": Loop(60.0, 5, bent, 20.0, PidGains(1.0, 0.02), (20.0, 24.0, 20.0, 32.0, 48.0, 52.0, 48.0), 500),
    # A day of an oven, from cold to hot, every 30 s.
    "day.csv": Loop(600.0, 60, oven, 9.738, PidGains(1.5, 0.0025), DAY, 7200, noise=0.1, dt_s=30.0),
}


def main() -> None:
    """Write every record."""
    for name, loop in LOOPS.items():
        np.savetxt(RECORDS / name, loop.record(), delimiter=",", header="t,sp,pv,co", comments="", fmt="%.6g")


if __name__ == "__main__":
    main()
