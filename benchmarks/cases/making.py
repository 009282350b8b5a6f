"""What all diagnosis cases share: settings that fit a cause, excitation, scaling to the output's range."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from cases.case import FloatArray, Record
from cases.loop import Controller, Sensor, Upsets, performance, run
from cases.plant import log_uniform
from cases.setting import DiagnosisCase, Loop, fitted, scaled, settling_s
from cases.signals import Valve, steps
from retuner.schedule.gains import PidGains

MOST_SAMPLES, FEWEST_SAMPLES = 1600, 200
OK_MS, OK_J = 1.8, 1.3
AGGRESSIVE_MS, AGGRESSIVE_GM, MOST_MS = 2.3, 2.2, 8.0
SLUGGISH_MS, SLUGGISH_J = 1.6, 2.2
SLOW_MS, SLOW_GM = 2.2, 4.0


def fits(loop: Loop, gains: PidGains, cause: str) -> bool:
    """Whether these settings on the true process are a clear case of the cause; between the causes lies a grey zone.

    ok: Ms <= 1.8 (1.05 of SIMC's own where that is more), J <= 1.3. aggressive: 2.3 <= Ms <= 8, GM <= 2.2. sluggish:
    Ms <= 1.6, J >= 2.2. slow_integrating: 2.2 <= Ms <= 8 with GM >= 4. Left out: Ms between, J between 1.3 and 2.2.
    """
    found = loop.margins(gains)
    if not found.stable or found.ms > MOST_MS:
        return False
    if cause == "aggressive":
        return found.ms >= AGGRESSIVE_MS and found.gm <= AGGRESSIVE_GM
    if cause == "slow_integrating":
        return found.ms >= SLOW_MS and found.gm >= SLOW_GM
    j = performance(loop.process, gains, loop.best, loop.theta_s, loop.dt_s)
    if cause == "sluggish":
        return found.ms <= SLUGGISH_MS and j >= SLUGGISH_J
    return found.ms <= max(OK_MS, 1.05 * loop.margins(loop.best).ms) and j <= OK_J


class NotClear(Exception):  # noqa: N818  it is no error of the program
    """What was drawn is no clear case: draw again."""


def settings(rng: np.random.Generator, loop: Loop, cause: str) -> PidGains:
    """PI settings drawn for a cause. Raises NotClear."""
    kc, tau_i = {
        "ok": (log_uniform(rng, 0.8, 1.1), log_uniform(rng, 0.9, 1.2)),
        "aggressive": (log_uniform(rng, 1.3, 3.0), log_uniform(rng, 0.4, 1.5)),
        "sluggish": (1 / log_uniform(rng, 2.5, 8.0), log_uniform(rng, 0.8, 4.0)),
        "slow_integrating": (1 / log_uniform(rng, 2.0, 20.0), 1 / log_uniform(rng, 1.0, 6.0)),
    }[cause]
    gains = scaled(loop.best, kc, tau_i)
    if not fits(loop, gains, cause):
        raise NotClear
    return gains


def own_period_s(loop: Loop, gains: PidGains) -> float:
    """Period at which the loop amplifies most: where |S| has its maximum."""
    w = np.geomspace(0.01, 10.0, 600) / loop.theta_s
    delayed = loop.process.response(w) * np.exp(-0.5j * w * loop.dt_s)
    s = 1 / np.abs(1 + (gains.kp + gains.ki / (1j * w)) * delayed)
    return float(2 * np.pi / w[int(np.argmax(s))])


def event_steps(rng: np.random.Generator, n: int, first: float, count: int, alternate: bool = True) -> FloatArray:
    """Steps of about one, the first at `first`, the others evenly later with some scatter; to and fro, or anywhere."""
    gap = (n - first) / count
    places = [first + gap * (i + (float(rng.uniform(-0.15, 0.15)) if i else 0.0)) for i in range(count)]
    sign = float(rng.choice([-1.0, 1.0]))
    sizes, level = [], 0.0
    for _ in range(count):
        size = float(rng.uniform(0.6, 1.0)) * (-np.sign(level) if alternate and level else sign)
        sizes.append(size)
        level += size
    return steps(n, [float(np.floor(p)) for p in places], sizes)


@dataclass(frozen=True, slots=True)
class Plan:
    """What a record is made of: upsets in relative size, and what stands between loop and record.

    noise : standard deviation relative to pv's response without noise. lead_in : samples run before the record begins.
    """

    sp: FloatArray
    load: FloatArray
    out: FloatArray
    noise: float
    lead_in: int = 0
    quantum: float = 0.0


def scaled_record(rng: np.random.Generator, loop: Loop, gains: PidGains, plan: Plan) -> Record:
    """The loop under the plan, scaled so that the output stays inside its range."""
    clean = run(loop.process, Controller(gains), loop.dt_s, Upsets(plan.sp, plan.load, plan.out))
    response = float(np.ptp(clean.pv[plan.lead_in :]))
    travel = float(np.max(np.abs(clean.co))) + 3.5 * abs(gains.kp) * plan.noise * response
    size = loop.room / travel * log_uniform(rng, 0.15, 0.9)
    pv0 = float(rng.uniform(-20, 20)) * response * size
    noise = plan.noise * response * size * rng.standard_normal(len(plan.sp))
    upsets = Upsets(pv0 + size * plan.sp, size * plan.load, size * plan.out, noise)
    sensor = quantiser(plan.quantum * response * size)
    return tail(loop.run(gains, upsets, pv0=pv0, sensor=sensor), plan.lead_in)


def valve_record(
    rng: np.random.Generator, loop: Loop, gains: PidGains, plan: Plan, valve: Callable[[float], Valve], response: float
) -> Record:
    """The same with a valve, made from its resting position; upsets are in true units, noise is a share of response."""
    pv0 = float(rng.uniform(-20, 20)) * response
    noise = plan.noise * response * rng.standard_normal(len(plan.sp))
    upsets = Upsets(pv0 + plan.sp, plan.load, plan.out, noise)
    sensor = quantiser(plan.quantum * response)
    return tail(loop.run(gains, upsets, pv0=pv0, valve=valve(loop.co0), sensor=sensor), plan.lead_in)


def quantiser(quantum: float) -> Sensor | None:
    """A sensor that reads multiples of a quantum; none for 0."""
    return (lambda pv: round(pv / quantum) * quantum) if quantum else None


def tail(record: Record, lead_in: int) -> Record:
    """Without the first samples; time from 0."""
    t = record.t[lead_in:]
    return Record(t - t[0], record.sp[lead_in:], record.pv[lead_in:], record.co[lead_in:])


def labelled(
    loop: Loop, gains: PidGains, record: Record, group: str, right: set[str], hidden: str, **note: float
) -> DiagnosisCase:
    """The case, seed and index still to be filled in."""
    return DiagnosisCase(group, loop, record, gains, frozenset(right), hidden, note)


def record_length(rng: np.random.Generator, loop: Loop, gains: PidGains, events: int) -> tuple[Loop, int, float]:
    """Sampling, samples and place of the first event for that many responses, each given time to settle or nearly."""
    settle = settling_s(loop, gains)
    before = float(rng.uniform(1, 6)) * loop.theta_s
    length_s = before + events * settle * float(rng.uniform(0.7, 1.4))
    loop, n = fitted(loop, length_s, FEWEST_SAMPLES, MOST_SAMPLES)
    return loop, n, min(before / loop.dt_s, 0.3 * n)
