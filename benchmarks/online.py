"""How often does on-line retuning end in spec? Gains off by 4 or 1/4, setpoint and load steps in turn, noise.

    python benchmarks/online.py [--seed 1] [--runs 40] [--noise 0.01]

Processes are drawn from families P1 to P6 of the Astrom-Hagglund batch with time constants drawn anew (not the list's
own), so nobody can have tuned on them. "In spec": on the true process Ms <= max(1.8, 1.03 x Ms of SIMC with perfect
knowledge) and J <= 1.25 J of that SIMC, with J the mean of the IAE ratios of a setpoint and a load step.
"""

import argparse
import math
import random
import sys
from collections import Counter

from retuner.adaptive.decision import Action, Mode
from retuner.adaptive.margins import sensitivity_peak
from retuner.adaptive.process import LinearProcess, ProcessModel
from retuner.adaptive.reduction import half_rule
from retuner.adaptive.retuner import Retuner
from retuner.adaptive.retuner_settings import RetunerSettings
from retuner.adaptive.rules.simc import simc
from retuner.adaptive.sample import LoopMode, LoopSample
from retuner.drivers.linear_plant import LinearPlant
from retuner.schedule.gains import PidGains
from retuner.schedule.pid import change, law, start, step
from retuner.schedule.regions import Regions
from retuner.schedule.table import GainTable

SAMPLES_PER_THETA = 8
DISTURBANCES = 6


def draw(rng: random.Random) -> LinearProcess:
    """A process of one of the families, with k of either sign and a time scale over four decades."""
    family, scale = rng.randint(1, 6), 10 ** rng.uniform(-1, 3)
    k = rng.choice([-1, 1]) * 10 ** rng.uniform(-1, 1)
    t = 10 ** rng.uniform(-1, 2)
    lags, theta, integrators = {
        1: ((t,), 1.0, 0), 2: ((t, t), 1.0, 0), 3: ((1.0, t, t), 0.0, 0), 4: ((1.0,) * rng.randint(3, 8), 0.0, 0),
        5: (tuple(rng.uniform(0.2, 0.9) ** i for i in range(4)), 0.0, 0),
        6: ((1 - (length := rng.uniform(0.05, 0.95)),), length, 1),
    }[family]  # fmt: skip
    return LinearProcess(k, tuple(x * scale for x in lags), (), theta * scale, integrators)


def iae(process: LinearProcess, gains: PidGains, dt: float, sp: float, load: float, n: int = 600) -> float:
    """Integrated error of one step in setpoint or load, without noise."""
    plant = LinearPlant(process, start_co=0.0, co_min=-1e9, co_max=1e9)
    rules = law(gains, co_min=-1e9, co_max=1e9)
    state, total = start(rules, 0.0, 0.0, 0.0), 0.0
    co = 0.0
    for _ in range(n):
        pv = plant.step(co, load, dt)
        state, co = step(rules, state, sp, pv, dt)
        total += abs(sp - pv) * dt
        if not abs(pv) < 1e6:
            return math.inf
    return total


def in_spec(process: LinearProcess, gains: PidGains, best: PidGains, dt: float) -> bool:
    """Whether these gains meet both limits on the true process (with half a sample of dead time)."""
    sampled = LinearProcess(process.k, process.lags_s, (), process.theta_s + dt / 2, process.integrators)
    if sensitivity_peak(sampled, gains) > max(1.8, 1.03 * sensitivity_peak(sampled, best)):
        return False
    ratios = [iae(process, gains, dt, *upset) / iae(process, best, dt, *upset) for upset in ((1.0, 0.0), (0.0, 1.0))]
    return sum(ratios) / 2 <= 1.25


def one(process: LinearProcess, factors: tuple[float, float], noise: float, seed: int) -> tuple[list[bool], int]:
    """In spec after each disturbance, and the number of changes."""
    model = half_rule(process)
    dt = model.theta_s / SAMPLES_PER_THETA
    sampled = ProcessModel(model.type, model.k, model.tau1_s, 0.0, model.theta_s + dt / 2)
    best = simc(sampled).gains
    gains = PidGains(best.kp * factors[0], best.ki * factors[0] / factors[1])
    table = GainTable("loop", Regions("sp", "-", ("all",), -100.0, (), 100.0), (gains,))
    retuner = Retuner(table, RetunerSettings(dt, 10.0, Mode.AUTO))
    plant = LinearPlant(process, start_co=0.0, noise=noise, seed=seed, co_min=-1e9, co_max=1e9)
    rules = law(gains, co_min=-1e9, co_max=1e9)
    state = start(rules, 0.0, 0.0, 0.0)
    load_size = 2.0 * best.kp  # a load that the controller answers about as strongly as a setpoint step of one
    length = int(60 * SAMPLES_PER_THETA * max(1.0, 1 / factors[0]))
    spec, t, co, changes = [], 0.0, 0.0, 0
    sp = load = 0.0
    for i in range(DISTURBANCES + 1):
        if i:
            sp, load = (1.0 - sp, load) if i % 2 else (sp, load_size - load)
        for _ in range(length if i else 60):
            pv = plant.step(co, load, dt)
            state, co = step(rules, state, sp, pv, dt)
            t += dt
            decision = retuner.observe(LoopSample(t, sp, pv, co, LoopMode.AUTO, 0, sp))
            if decision is not None and decision.action == Action.COMMIT and decision.gains_after is not None:
                new = law(decision.gains_after, co_min=-1e9, co_max=1e9)
                state, rules = change(rules, new, state, sp, pv, dt), new
                retuner.committed(0, decision.gains_after)
                changes += 1
            if not abs(pv) < 1e4:
                return [*spec, *[False] * (DISTURBANCES - len(spec))], changes
        if i:
            spec.append(in_spec(process, retuner.table.gains_of(0), best, dt))
    return spec, changes


def main() -> None:
    """Run the batch and print the counts."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--runs", type=int, default=40)
    parser.add_argument("--noise", type=float, default=0.01, help="share of a setpoint step")
    parser.add_argument("--verbose", action="store_true")
    options = parser.parse_args()
    rng = random.Random(options.seed)
    met: Counter[int] = Counter()
    changes_total = 0
    for run in range(options.runs):
        process = draw(rng)
        factors = (rng.choice([0.25, 4.0]), rng.choice([0.25, 1.0, 4.0]))
        spec, changes = one(process, factors, options.noise, run)
        changes_total += changes
        met.update(i for i, ok in enumerate(spec, 1) if ok)
        if options.verbose and not spec[-1]:
            sys.stdout.write(f"not in spec at the end: {process} kc x{factors[0]} tau_i x{factors[1]} {spec}\n")
    sys.stdout.write(f"seed {options.seed}, {options.runs} runs, noise {options.noise:g}; "
                     f"{changes_total / options.runs:.1f} changes a run\n")  # fmt: skip
    for i in range(1, DISTURBANCES + 1):
        share = met[i] / options.runs
        sys.stdout.write(f"  in spec after {i} disturbances: {met[i]} of {options.runs} ({share:.0%})\n")


if __name__ == "__main__":
    main()
