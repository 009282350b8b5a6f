"""How good are settings from an experiment on demand, and is the loop always left as it was?

    python benchmarks/experiments.py [--seed 1] [--runs 20] [--noise 0.02]

Each run draws a process of families P1 to P6 of the Astrom-Hagglund batch, hangs it behind the virtual controller on a
virtual CAN bus, and conducts a step, a relay and a setpoint experiment on it, with noise as a share of what 10 % of
output move pv by within a dead time. Counted are experiments that ended by themselves, that left the old state behind,
that gave settings, and those settings that are in spec on the true process (online/judge.py says how). Ku and Pu are
compared with the true ones.
"""

import argparse
import math
import random
import statistics
from collections import Counter
from dataclasses import replace
from itertools import count

from online.judge import Judge

from retuner import LinearProcess, PidGains, ProcessModel
from retuner.adaptive.experiments.phases import Phase
from retuner.adaptive.experiments.plan import Experiment, Plan
from retuner.adaptive.loop.margins import ultimate
from retuner.adaptive.process.reduction import half_rule
from retuner.adaptive.rules.simc import simc
from retuner.adaptive.signals.sample import Window
from retuner.drivers.bus.bus import CanLink, LinkSettings
from retuner.drivers.clock import SimulatedClock
from retuner.drivers.controller.device_process import DeviceOnBus
from retuner.drivers.controller.firmware_settings import VirtualDeviceSettings
from retuner.drivers.controller.virtual_device import VirtualDevice
from retuner.drivers.host.can_device import CanDevice
from retuner.drivers.host.can_settings import CanDeviceSettings
from retuner.drivers.plants.linear_plant import LinearPlant
from retuner.experiment.findings import ExperimentFindings, ExperimentQuestion, evaluate
from retuner.experiment.runner import ExperimentRunner
from retuner.session.running import nothing

SAMPLES_PER_THETA = 8
AMPLITUDE = 10.0
OVERSHOOT_GAIN = 1.6  # kc0 over SIMC's Kc: about 30 % overshoot on first-order processes
CHANNELS = count()


def draw(rng: random.Random) -> LinearProcess:
    """A process of one of the families, with time constants drawn anew, k of either sign, a scale over four decades."""
    family, scale = rng.randint(1, 6), 10 ** rng.uniform(-1, 3)
    k = rng.choice([-1, 1]) * 10 ** rng.uniform(-1, 1)
    t = 10 ** rng.uniform(-1, 2)
    lags, theta, integrators = {
        1: ((t,), 1.0, 0),
        2: ((t, t), 1.0, 0),
        3: ((1.0, t, t), 0.0, 0),
        4: ((1.0,) * rng.randint(3, 8), 0.0, 0),
        5: (tuple(rng.uniform(0.2, 0.9) ** i for i in range(4)), 0.0, 0),
        6: ((1 - (length := rng.uniform(0.05, 0.95)),), length, 1),
    }[family]
    return LinearProcess(k, tuple(x * scale for x in lags), (), theta * scale, integrators)


class Job:
    """One process with its scales and its controller before the experiment."""

    def __init__(self, rng: random.Random, noise: float) -> None:
        self.process = draw(rng)
        model = half_rule(self.process)
        self.dt = model.theta_s / SAMPLES_PER_THETA
        sampled = ProcessModel(model.type, model.k, model.tau1_s, 0.0, model.theta_s + self.dt / 2)
        self.best = simc(sampled).gains
        self.size = abs(sampled.slope) * AMPLITUDE * min(model.theta_s, model.tau1_s or math.inf)
        self.noise = noise * self.size
        self.before = PidGains(0.5 * self.best.kp, 0.4 * self.best.ki)
        self.seed = rng.randrange(1 << 30)

    def plan(self, kind: Experiment) -> Plan:
        """The experiment as somebody would set it up who knows the scales."""
        band = 1e3 * self.size + abs(self.process.k) * 1e3
        amplitude = self.size if kind == Experiment.SETPOINT else AMPLITUDE
        time_s = 4000 * self.dt * max(1.0, (self.process.lags_s or (1.0,))[0] / (100 * self.dt))
        return Plan(
            kind,
            amplitude,
            -band,
            band,
            -100.0,
            200.0,
            time_s,
            60,
            600 * self.dt,
            bias=0.3,
            kc0=OVERSHOOT_GAIN * self.best.kp if kind == Experiment.SETPOINT else None,
        )


def conduct(job: Job, plan: Plan) -> tuple[ExperimentRunner, VirtualDevice]:
    """The experiment in simulated time."""
    plant = LinearPlant(job.process, start_co=50.0, noise=job.noise, seed=job.seed, co_min=-100.0, co_max=200.0)
    firmware = VirtualDeviceSettings(job.before, sample_time_s=job.dt, co_min=-100.0, co_max=200.0)
    device, clock = VirtualDevice(firmware, plant), SimulatedClock()
    link = LinkSettings(channel=f"experiments-{next(CHANNELS)}")
    with CanLink(link, clock) as far, CanLink(link, clock) as near:
        on_bus = DeviceOnBus(device, far)
        host = CanDevice(near, CanDeviceSettings(sample_time_s=job.dt))
        conductor = ExperimentRunner(host, plan, job.dt, host.settings.silent_s, nothing)
        while not conductor.phase.over:
            clock.advance(job.dt)
            on_bus.sample()
            conductor.poll(clock.now_s())
    return conductor, device


def evaluated(conductor: ExperimentRunner, kind: Experiment) -> ExperimentFindings:
    assert conductor.rest is not None
    assert conductor.before is not None
    kc = conductor.plan.kc0 if kind == Experiment.SETPOINT else None
    rest = conductor.rest
    return evaluate(
        Window.of(conductor.excited),
        ExperimentQuestion(kind, kc=kc, hysteresis=rest.hysteresis, rest=(rest.pv, rest.co)),
    )


def left_alone(job: Job, device: VirtualDevice, sp: float) -> bool:
    same = all(
        math.isclose(a, b, rel_tol=1e-6, abs_tol=1e-12)
        for a, b in (
            (device.running.gains.kp, job.before.kp),
            (device.running.gains.ki, job.before.ki),
            (device.sp, sp),
        )
    )
    return same and device.auto


def true_ultimate(process: LinearProcess, delay_s: float) -> tuple[float, float]:
    ku, pu = ultimate(replace(process, theta_s=process.theta_s + delay_s))
    return abs(ku), pu


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--runs", type=int, default=20)
    parser.add_argument("--noise", type=float, default=0.02)
    options = parser.parse_args()
    rng = random.Random(options.seed)
    counts: dict[Experiment, Counter[str]] = {kind: Counter() for kind in Experiment}
    ratios: dict[str, list[float]] = {"Kc step": [], "Kc relay": [], "Kc setpoint": [], "Ku": [], "Pu": []}
    for _ in range(options.runs):
        job = Job(rng, options.noise)
        for kind in Experiment:
            conductor, device = conduct(job, job.plan(kind))
            tally, sp = counts[kind], conductor.before.sp if conductor.before else 0.0
            tally["ended by itself"] += conductor.cause is None
            tally["old state verified"] += conductor.phase is Phase.RESTORED and left_alone(job, device, sp)
            if conductor.cause is not None:
                tally[f"  {conductor.cause.name.lower()}"] += 1
                continue
            found = evaluated(conductor, kind)
            if found.cycle is not None:
                ku, pu = true_ultimate(job.process, 1.5 * job.dt)
                ratios["Ku"].append(found.cycle.ku / ku)
                ratios["Pu"].append(found.cycle.pu_s / pu)
            if found.chosen is not None:
                gains = found.chosen.tuning.gains
                tally["gave settings"] += 1
                tally["in spec"] += Judge(job.process, job.dt).of(gains).in_spec
                ratios[f"Kc {kind}"].append(gains.kp / job.best.kp)
    print(f"{options.runs} processes, seed {options.seed}, noise {options.noise:.0%}")
    for kind, tally in counts.items():
        print(f"{kind}: " + ", ".join(f"{name.strip()} {number}" for name, number in tally.items()))
    for name, values in ratios.items():
        if values:
            low, *_, high = statistics.quantiles(values, n=20)
            print(
                f"{name} over the true one: median {statistics.median(values):.2f}, 90 % within {low:.2f} to {high:.2f}"
            )


if __name__ == "__main__":
    main()
