"""How often does a trial undo gains that are right? The judge and the watch alone, on drawn loops.

Every loop runs the PI settings that the Ms limit allows, on trial; the promise is made on a model whose gain, dead time
and lags are off by up to `--error` (log-uniform), half of the runs coming from a quarter of the right gain and half
from gains that are as good. One upset follows, of a kind that the promise speaks of or not; noise is 1 % of a setpoint
step.

Example: OMP_NUM_THREADS=1 python benchmarks/trial.py --seed 1 --loops 60
"""

import argparse
import sys
from collections import Counter
from dataclasses import replace

import numpy as np
from cases.plant import HeldPlant
from cases.processes import FAMILIES, log_uniform
from cases.setting import Loop, draw_loop, scaled
from online.counting import counted
from online.judge import Judge
from online.loop import FixedGains, LostLoop, WatchedLoop
from online.supervisors import one_region

from retuner.adaptive.identification.plausible import Plausible
from retuner.adaptive.process.model import ProcessModel
from retuner.adaptive.process.reduction import half_rule
from retuner.adaptive.signals.sample import LoopSample
from retuner.adaptive.supervision.response_finder import Completed, ResponseFinder
from retuner.adaptive.supervision.settings import RetunerSettings
from retuner.adaptive.trial.expectation import promise
from retuner.adaptive.trial.judge import JudgedResponse
from retuner.adaptive.trial.phase import TrialPhase
from retuner.adaptive.trial.settings import TrialSettings
from retuner.adaptive.trial.supervisor import TrialSupervisor

UPSETS = ("setpoint", "load", "pulse", "ramp", "two loads", "lagged load", "from motion")
NOISE = 0.01
LENGTH_THETA = 120
SAMPLES_PER_THETA = 8


class Tried(FixedGains):
    """Good gains on trial: watched and judged, nothing is learned."""

    def __init__(self, loop: Loop, rng: np.random.Generator, error: float) -> None:
        self.table = one_region(loop.best)
        self.finder = ResponseFinder(self.table.regions, self.table.at, RetunerSettings(loop.dt_s, 10.0))
        self.trials = TrialSupervisor(TrialSettings(responses=10), loop.dt_s, {}.__setitem__)
        model = _off(half_rule(loop.process), rng, error)
        old = scaled(loop.best, 0.25, 1.0) if rng.random() < 0.5 else loop.best
        promised = promise([Plausible(model, 0.0)], old, loop.best, loop.dt_s)
        self.trials.begin(0, old, loop.best, promised, 0.0)
        self.trials.written(0, loop.best, 0.0)
        self.findings: Counter[str] = Counter()

    def observe(self, sample: LoopSample) -> None:
        """As the retuner does, without its pipeline."""
        seen = self.finder.step(sample)
        ended = self.trials.look(sample, self.finder.region, self.finder.band, 0.0, 1.0, blended=False)
        if ended:
            self.findings[ended[0].name.lower()] += 1
        elif isinstance(seen, Completed) and self.trials.phase(0) is TrialPhase.TRIAL:
            looked_at = JudgedResponse(seen.response, self.finder.window(seen.response))
            found = self.trials.judge(0, looked_at, self.table.gains_of(0), sample.t_s, ask=False)
            if found is not None:
                self.findings[found.finding.name.lower()] += 1


def _off(model: ProcessModel, rng: np.random.Generator, error: float) -> ProcessModel:
    """The model with every parameter off by its own factor."""
    k, theta, tau1, tau2 = (log_uniform(rng, 1 / (1 + error), 1 + error) for _ in range(4))
    tau1_s = model.tau1_s * tau1
    return replace(
        model,
        k=model.k * k,
        theta_s=model.theta_s * theta,
        tau1_s=tau1_s,
        tau2_s=min(model.tau2_s * tau2, tau1_s) if tau1_s else model.tau2_s * tau2,
    )


def course(kind: str, size: float, n: int, rng: np.random.Generator) -> tuple[list[float], list[float]]:
    """Setpoint and load, a value a sample; loads are worth as much as a setpoint step."""
    k = np.arange(n)
    at = n // 3
    later = (k >= at).astype(float)
    tau = rng.uniform(0.5, 8.0) * SAMPLES_PER_THETA
    gone = at + int(rng.uniform(1, 12) * SAMPLES_PER_THETA)
    loads = {
        "load": later,
        "pulse": later * (k < gone),
        "ramp": np.clip((k - at) / (rng.uniform(5, 40) * SAMPLES_PER_THETA), 0, 1),
        "two loads": later + rng.uniform(-1.5, 1.5) * (k >= gone),
        "lagged load": later * -np.expm1(-np.maximum(k - at, 0) / tau),
        "from motion": (k >= at - int(rng.uniform(1, 12) * SAMPLES_PER_THETA)).astype(float),
    }
    sp = later if kind in {"setpoint", "from motion"} else np.zeros(n)
    return sp.tolist(), (size * loads.get(kind, np.zeros(n))).tolist()


def run(kind: str, seed: int, index: int, error: float) -> Counter[str]:
    """Findings on one loop."""
    rng = np.random.default_rng([seed, index, UPSETS.index(kind), 77])
    family = str(rng.choice([x for x in FAMILIES if x != "oscillatory"]))
    loop = draw_loop(rng, family, (SAMPLES_PER_THETA, SAMPLES_PER_THETA + 1e-9))
    judge = Judge(loop.process, loop.dt_s, (loop.best, loop.theta_s))
    tried = Tried(loop, rng, error)
    watched = WatchedLoop(HeldPlant(loop.process, loop.dt_s), one_region(loop.best), loop.dt_s, tried)
    n = LENGTH_THETA * SAMPLES_PER_THETA
    noise = (NOISE * rng.standard_normal(n)).tolist()
    sp, load = course(kind, judge.load_like_setpoint(), n, rng)
    try:
        for i in range(n):
            watched.run(sp[i], load[i], noise[i : i + 1])
    except LostLoop:
        tried.findings["lost"] += 1
    return tried.findings


def main() -> int:
    """Print a line a kind of upset."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--loops", type=int, default=60)
    parser.add_argument("--error", type=float, default=0.2)
    options = parser.parse_args()
    lines = [f"false undos, seed {options.seed}, {options.loops} loops a kind, models off by up to {options.error:.0%}"]
    for kind in UPSETS:
        found = [run(kind, options.seed, index, options.error) for index in range(options.loops)]
        undone = sum(bool(one.keys() & {"worse", "runaway", "saturated"}) for one in found)
        decided = sum(bool(one.keys() & {"better", "as_promised"}) for one in found)
        every = sum(found, Counter())
        told = ", ".join(f"{name} {every[name]}" for name in sorted(every))
        lines.append(f"{kind:<12} undone {counted(undone, options.loops)}  kept a promise {decided:>4}   {told}")
    sys.stdout.write("\n".join(lines) + "\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
