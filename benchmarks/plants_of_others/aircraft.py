"""Pitch hold of a Cessna 172 with gains scheduled over dynamic pressure, in JSBSim (PyPI jsbsim, LGPL-2.1).

Dynamic pressure grows 2.4-fold between 75 and 115 knots, and the best ki with it. Three regions along it begin with the
same gains; legs at three speeds, with setpoint steps of pitch, visit each of them twice or more. Wings are held level
and the speed is held by the throttle, by laws of our own that are not retuned. What is true is the aircraft's own
answer to 1 % of elevator at each speed (answered.py).
"""

import math
import sys
from argparse import Namespace
from typing import Any

import numpy as np

from plants_of_others.answered import Answered
from plants_of_others.loop import package
from retuner import Action, GainTable, PidController, PidGains, Regions

DT_S, FRAMES = 5 / 120, 5
SPEEDS_KT = (75.0, 95.0, 115.0)
NAMES = ("slow", "cruise", "fast")
HEIGHT_FT, THROTTLE, MIXTURE = 4000.0, 0.7, 0.87
STEP_DEG, HOLD_S, STEPS, CHANGE_S, NOISE_DEG = 2.0, 15.0, 4, 40.0, 0.02
ROUNDS, ANSWER_S, ANSWER_PCT = 2, 30.0, 1.0
STARTS = {"one set": 1.0, "low": 0.25, "high": 3.0}
"""Factors on the best gains of the middle speed, in all three regions."""


class Flight:
    """The aircraft, trimmed for level flight at a speed."""

    def __init__(self, speed_kt: float) -> None:
        jsbsim = package("jsbsim", "the aircraft")
        jsbsim.FGJSBBase().debug_lvl = 0
        self._fdm: Any = jsbsim.FGFDMExec(jsbsim.get_default_root_dir())
        self._fdm.set_debug_level(0)
        self._fdm.load_model("c172p")
        for name, value in (("ic/h-sl-ft", HEIGHT_FT), ("ic/vc-kts", speed_kt), ("ic/gamma-deg", 0.0)):
            self._fdm[name] = value
        self._fdm.run_ic()
        self._fdm["propulsion/set-running"] = -1
        self._fdm["fcs/mixture-cmd-norm"] = MIXTURE
        self._fdm["fcs/throttle-cmd-norm"] = THROTTLE
        self._fdm.do_trim(1)
        self._throttle, self.speed_kt = float(self._fdm["fcs/throttle-cmd-norm"]), speed_kt

    @property
    def pitch_deg(self) -> float:
        """Attitude."""
        return float(self._fdm["attitude/theta-deg"])

    @property
    def qbar_psf(self) -> float:
        """Dynamic pressure, pounds per square foot."""
        return float(self._fdm["aero/qbar-psf"])

    def step(self, co: float) -> None:
        """Hold the elevator for a sample; co : percent, nose up."""
        f = self._fdm
        f["fcs/elevator-cmd-norm"] = -co / 100.0
        f["fcs/aileron-cmd-norm"] = min(max(-0.03 * f["attitude/phi-deg"] - 0.5 * f["velocities/p-rad_sec"], -1), 1)
        ask = self._throttle + 0.05 * (self.speed_kt - f["velocities/vc-kts"])
        f["fcs/throttle-cmd-norm"] = min(max(ask, 0.0), 1.0)
        for _ in range(FRAMES):
            f.run()


def truth(speed_kt: float) -> tuple[Answered, float]:
    """What the aircraft truly is at a speed, and its dynamic pressure there."""
    found = []
    for sign in (1.0, -1.0):
        flight, seen = Flight(speed_kt), []
        for _ in range(int(ANSWER_S / DT_S)):
            seen.append(flight.pitch_deg)
            flight.step(sign * ANSWER_PCT)
        found.append((np.array(seen) - seen[0]) / (sign * ANSWER_PCT))
    return Answered((found[0] + found[1]) / 2, DT_S), Flight(speed_kt).qbar_psf


def fly(gains: list[PidGains], bounds: tuple[float, float], seed: int, mode: str) -> dict[str, Any]:
    """Legs at three speeds, twice; what became of the gains, and the mean error."""
    rng, flight = np.random.default_rng([seed, 172]), Flight(SPEEDS_KT[1])
    regions = Regions("can", "psf", NAMES, 5.0, bounds, 80.0, 1.0, signal="qbar")
    pid = PidController(
        GainTable("pitch", regions, tuple(gains)),
        dt_s=DT_S,
        pv_range=(-30.0, 30.0),
        co_range=(-100.0, 100.0),
        mode=mode,
    )
    sp, error, count, changes, restored, lost = flight.pitch_deg, 0.0, 0, 0, 0, False
    begun: dict[str, float] = {"manual_co": 0.0}
    for leg in [1, 0, 1, 2] * ROUNDS:
        flight.speed_kt = SPEEDS_KT[leg]
        for part, hold_s in [(0, CHANGE_S), *((i + 1, HOLD_S) for i in range(STEPS))]:
            sp += (STEP_DEG if part % 2 else -STEP_DEG) * (part > 0)
            for _ in range(int(hold_s / DT_S)):
                seen = flight.pitch_deg + NOISE_DEG * float(rng.standard_normal())
                flight.step(pid.step(sp, seen, x=flight.qbar_psf, **begun))
                begun = {}
                error, count = error + abs(sp - flight.pitch_deg), count + 1
                if (d := pid.decision) is not None:
                    changes += d.action is Action.WRITE
                    restored += d.action is Action.RESTORE
            lost |= not abs(flight.pitch_deg) < 30.0
    return {
        "gains": list(pid.table.gains),
        "error": error / count,
        "changes": changes,
        "restored": restored,
        "lost": lost,
    }


def measure(options: Namespace) -> int:
    truths, qbars = zip(*(truth(speed) for speed in SPEEDS_KT), strict=True)
    bounds = (math.sqrt(qbars[0] * qbars[1]), math.sqrt(qbars[1] * qbars[2]))
    middle = truths[1].best
    for name, judge, q in zip(NAMES, truths, qbars, strict=True):
        told = judge.of(middle)
        best = judge.best
        sys.stdout.write(
            f"{name:<7} qbar {q:5.1f} psf: best kp {best.kp:.3g} ki {best.ki:.3g} (Ms {judge.ms_best:.2f}); "
            f"cruise's {told.ms:.2f}/{told.j:.2f}\n"
        )
    for start, factor in STARTS.items():
        if options.start not in {"all", start}:
            continue
        for seed in range(options.seed, options.seed + options.sessions):
            gains = [PidGains(factor * middle.kp, factor * middle.ki, 0.0)] * 3
            rows = {mode: fly(gains, bounds, seed, mode) for mode in ("off", "auto")}
            shown = []
            for judge, old, new in zip(truths, gains, rows["auto"]["gains"], strict=True):
                a, b = judge.of(old), judge.of(new)
                shown.append(f"{a.ms:.2f}/{a.j:.2f} -> {b.ms:.2f}/{b.j:.2f}{'+' if b.in_spec else '-'}")
            auto = rows["auto"]
            ratio = auto["error"] / rows["off"]["error"]
            sys.stdout.write(
                f"{start:<8}{seed:>5}  Ms/J {', '.join(shown)}; mean error x {ratio:.2f}; "
                f"changes {auto['changes']} restored {auto['restored']}{' LOST' if auto['lost'] else ''}\n"
            )
            sys.stdout.flush()
    return 0
