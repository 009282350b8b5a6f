"""Do no harm: what is changed where nothing should be.

Four kinds of loops, drawn from the families of benchmarks/cases with gains of either sign and outputs of many ranges:

quiet       one hour with nothing but measurement noise (white, or coloured over up to an effective dead time), in every
            second one a load that wanders, in every fourth a quantised sensor. Gains in spec in three hours of five,
            sluggish (a third) in one, aggressive (1.6 times) in one: at rest there is nothing to learn from either way.
stiction    a valve that sticks (Kano 2004, He 2007) and makes a limit cycle; gains in spec.
external    an oscillation from outside, at 0.35 to 8 times the loop's own period, in the load or on pv; gains in spec.
saturation  setpoint and load steps of which every second one is beyond what the output can do; gains in spec.

In every second loop of the last three there are setpoint steps as well. An hour is a real hour of a loop sampled every
1 to 10 s (every factor alike), with 5 to 40 samples to an effective dead time: 360 to 3,600 samples, 1,400 in the mean,
9 to 720 effective dead times. The other kinds run 40 cycles, or 24 steps, with at most MOST_SAMPLES.

A change of gains is worse where it raises Ms above its limit, or raises J without lowering an Ms that was above its
limit, on the true process without valve and disturbance (judge.py).
"""

from collections import Counter
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import asdict, dataclass

import numpy as np
from cases.case import FloatArray
from cases.cycling import LONGEST_PERIOD, limit_cycle, sticking
from cases.making import NotClear, own_period_s, quantiser
from cases.plant import FAMILIES, INTEGRATING, log_uniform
from cases.setting import Loop, draw_loop, resampled, scaled, slowed
from cases.signals import Valve, coloured, oscillation, random_walk

from online.judge import Judge, at_most
from online.runner import Task
from online.session import Row, Session, effects
from retuner.schedule.gains import PidGains

KINDS = ("quiet", "stiction", "external", "saturation")
HOUR_S = 3600.0
SAMPLE_TIMES_S = (1.0, 10.0)
MOST_SAMPLES = 12000
CYCLES, STEPS = 40, 24
SELF_REGULATING = tuple(x for x in FAMILIES if x not in INTEGRATING)
TRIES = 200
SPAN_OVER_SWING = 20.0  # Range of pv over the size of what happens in a loop


@dataclass(slots=True)
class Scene:
    """What happens in a loop: loads and additions to pv a sample, setpoint steps as (first sample, sp)."""

    loop: Loop
    gains: PidGains
    load: FloatArray
    out: FloatArray
    sps: list[tuple[int, float]]
    pv_span: float
    valve: Valve | None = None
    quantum: float = 0.0
    bounded: bool = False


def run(task: Task) -> Row:
    """One loop; keys of session.Session.row, and effects (one a change), samples, hours, causes, said."""
    rng = np.random.default_rng([task.seed, task.index, KINDS.index(task.kind), 28])
    scene = scene_of(task.kind, rng)
    loop = scene.loop
    low, high = (loop.low, loop.high) if scene.bounded else (-1e15, 1e15)
    judge = Judge(loop.process, loop.dt_s, (loop.best, loop.theta_s))
    session = Session(
        task, judge, scene.gains, None, scene.pv_span, co0=loop.co0, low=low, high=high, valve=scene.valve,
        sensor=quantiser(scene.quantum), lost=1e4 * scene.pv_span,
    )  # fmt: skip

    def upsets() -> Iterator[None]:
        for (first, sp), (end, _) in zip(scene.sps, [*scene.sps[1:], (len(scene.load), 0.0)], strict=True):
            session.loop.run(sp, scene.load[first:end].tolist(), scene.out[first:end].tolist())
            yield None

    session.run(upsets())
    return session.row(
        "harm",
        loop.family,
        dt_s=loop.dt_s,
        samples=session.loop.i,
        hours=session.loop.t_s / HOUR_S,
        effects=[asdict(x) | {"worse": x.worse} for x in effects(judge, session.watching)],
        causes=dict(Counter(str(d.diagnosis.cause) if d.diagnosis else "none" for d in session.watching.decisions)),
        said=[d.reason for d in session.watching.writes],
    )


def scene_of(kind: str, rng: np.random.Generator) -> Scene:
    """The first draw that can be had."""
    for _ in range(TRIES):
        with suppress(NotClear):
            return MAKERS[kind](rng)
    raise RuntimeError(f"no loop fits {kind} in {TRIES} draws")


def in_spec_gains(rng: np.random.Generator, loop: Loop) -> PidGains:
    """Settings near the best that are in spec, as the judge sees it. Raises NotClear."""
    gains = scaled(loop.best, log_uniform(rng, 0.8, 1.1), log_uniform(rng, 0.9, 1.2))
    judge = Judge(loop.process, loop.dt_s, (loop.best, loop.theta_s))
    if not judge.of(gains).in_spec:
        raise NotClear
    return gains


def quiet(rng: np.random.Generator) -> Scene:
    """An hour at rest."""
    loop = draw_loop(rng, str(rng.choice(FAMILIES)))
    dt_s = log_uniform(rng, *SAMPLE_TIMES_S)
    loop = resampled(slowed(loop, dt_s / loop.dt_s), dt_s)
    state = rng.uniform()
    gains = in_spec_gains(rng, loop) if state < 0.6 else scaled(loop.best, 1 / 3 if state < 0.8 else 1.6, 1.0)
    if not loop.margins(gains).stable:
        raise NotClear
    n = int(HOUR_S / loop.dt_s)
    shaped = rng.standard_normal(n)
    if rng.uniform() < 0.5:
        shaped = coloured(rng, n, log_uniform(rng, 0.5, 1.0 * loop.theta_s / loop.dt_s))
    noise = log_uniform(rng, 0.0005, 0.01)
    load = np.zeros(n)
    if rng.uniform() < 0.5:  # a wandering load that moves pv, uncontrolled, by about ten times the noise in the hour
        load = random_walk(rng, n) / np.sqrt(n) * 10 * noise / judge_gain(loop)
    quantum = noise * log_uniform(rng, 0.5, 5.0) if rng.uniform() < 0.25 else 0.0
    return Scene(loop, gains, load, noise * shaped, [(0, 0.0)], 1.0, None, quantum)


def judge_gain(loop: Loop) -> float:
    """pv per unit of load after an effective dead time or lag, whichever says more."""
    lag = max((*loop.process.lags_s, loop.theta_s))
    return abs(loop.process.k) * (lag if loop.process.integrators else 1.0)


def stuck(rng: np.random.Generator) -> Scene:
    """A limit cycle by a valve that sticks."""
    loop = draw_loop(rng, str(rng.choice(SELF_REGULATING)), (5.0, 20.0))
    gains = in_spec_gains(rng, loop)
    size = loop.room * log_uniform(rng, 0.03, 0.25)
    make, jump = sticking(rng, str(rng.choice(["kano", "he", "irregular"])), size)
    found = limit_cycle(loop, gains, make, 2 * size)
    if found is None or found[1] < 0.02 * abs(loop.process.k) * jump or found[0] > LONGEST_PERIOD * loop.dt_s:
        raise NotClear
    period, swing = found
    n = int(min(CYCLES * period / loop.dt_s, MOST_SAMPLES))
    noise = min(log_uniform(rng, 0.003, 0.04) * swing, 0.1 * size / abs(gains.kp))
    load = np.zeros(n)
    load[: int(period / loop.dt_s)] = 2 * size
    sps = steps_of(rng, n, swing * float(rng.uniform(0.5, 3.0)))
    span = SPAN_OVER_SWING * swing
    return Scene(loop, gains, load, noise * rng.standard_normal(n), sps, span, make(loop.co0), bounded=True)


def steps_of(rng: np.random.Generator, n: int, size: float) -> list[tuple[int, float]]:
    """Setpoint steps to and fro at random times in every second loop, else none."""
    if rng.uniform() < 0.5:
        return [(0, 0.0)]
    places = sorted(int(x) for x in rng.uniform(0.1, 0.95, int(rng.integers(2, 7))) * n)
    return [(0, 0.0), *((place, size * ((i + 1) % 2)) for i, place in enumerate(places))]


def toned(rng: np.random.Generator) -> Scene:
    """An oscillation from outside."""
    loop = draw_loop(rng, str(rng.choice(FAMILIES)), (5.0, 20.0))
    gains = in_spec_gains(rng, loop)
    period = log_uniform(rng, 0.35, 8.0) * own_period_s(loop, gains)
    if not 6 < period / loop.dt_s < LONGEST_PERIOD:
        raise NotClear
    n = int(min(CYCLES * period / loop.dt_s, MOST_SAMPLES))
    load, out = tone(rng, loop, n, period / loop.dt_s)
    return Scene(loop, gains, load, out, steps_of(rng, n, float(rng.uniform(0.5, 5.0))), SPAN_OVER_SWING)


def tone(rng: np.random.Generator, loop: Loop, n: int, period: float) -> tuple[FloatArray, FloatArray]:
    """n samples of load and of what is added to pv: noise, and an oscillation in one of them. period : in samples."""
    shape = "sine" if rng.uniform() < 0.7 else str(rng.choice(["triangle", "saw", "filtered-square", "pulses"]))
    wave = oscillation(rng, n, period, shape, float(rng.choice([0.0, 0.05])))
    out = log_uniform(rng, 0.01, 0.05) * rng.standard_normal(n)
    if rng.uniform() < 0.6:
        return wave * abs(loop.best.kp) * 2, out
    return np.zeros(n), out + wave


def limited(rng: np.random.Generator) -> Scene:
    """Steps beyond what the output can do, and steps that it can."""
    loop = draw_loop(rng, str(rng.choice(SELF_REGULATING)), (5.0, 20.0))
    gains = in_spec_gains(rng, loop)
    length = int(log_uniform(rng, 25.0, 80.0) * loop.theta_s / loop.dt_s)
    n = min(STEPS * length, MOST_SAMPLES)
    reach = loop.room * abs(loop.process.k)
    sps, load, high = [(0, 0.0)], np.zeros(n), False
    for first in range(length // 2, n, length):
        high = not high
        beyond = rng.uniform() < 0.5
        size = float(rng.uniform(1.1, 2.5) if beyond else rng.uniform(0.2, 0.7))
        if rng.uniform() < 0.7:
            sps.append((first, size * reach if high else 0.0))
        else:
            load[first : first + length // 2] = size * loop.room
    noise = log_uniform(rng, 0.003, 0.02) * reach
    return Scene(loop, gains, load, noise * rng.standard_normal(n), sps, 4 * reach, None, 0.0, bounded=True)


MAKERS = {"quiet": quiet, "stiction": stuck, "external": toned, "saturation": limited}


def line(row: Row) -> str:
    """A loop in which something was changed, for people."""
    if not row["effects"] and not row["lost"]:
        return ""
    told = "; ".join(
        f"t {x['t_s']:.4g} Ms {x['before']['ms']:.2f} -> {x['after']['ms']:.2f} J {x['before']['j']:.2f} -> "
        f"{x['after']['j']:.2f}{' WORSE' if x['worse'] else ''}{' (put back)' if x['restored'] else ''}: {said}"
        for x, said in zip(row["effects"], row["said"], strict=True)
    )
    return f"{row['kind']} {row['index']} {row['what']}{' LOST' if row['lost'] else ''}: {told}"


def table(rows: list[Row]) -> list[str]:
    """Changes and harm a kind, with the upper end of the exact 95 % interval of the share of loops harmed."""
    lines = [
        f"{'kind':<12}{'loops':>6}{'samples':>10}{'responses':>10}{'changes':>9}{'loops changed':>15}"
        f"{'worse Ms':>10}{'worse IAE':>11}{'left spec':>11}{'put back':>10}{'lost':>6}"
        "   loops harmed"
    ]
    for kind in KINDS:
        of = [row for row in rows if row["kind"] == kind]
        if not of:
            continue
        found = [x for row in of for x in row["effects"]]
        harmed = sum(any(x["worse"] for x in row["effects"]) for row in of)
        lines.append(
            f"{kind:<12}{len(of):>6}{sum(r['samples'] for r in of):>10}{sum(r['records'] for r in of):>10}"
            f"{len(found):>9}{sum(bool(r['effects']) for r in of):>15}{sum(x['ms_worse'] for x in found):>10}"
            f"{sum(x['iae_worse'] for x in found):>11}"
            f"{sum(x['before']['in_spec'] and not x['after']['in_spec'] for x in found):>11}"
            f"{sum(x['restored'] for x in found):>10}"
            f"{sum(r['lost'] for r in of):>6}   {harmed} of {len(of)}, at most {at_most(harmed, len(of)):.2%}"
        )
    causes: Counter[str] = Counter()
    for row in rows:
        causes.update(row["causes"])
    lines.append("causes named: " + ", ".join(f"{name} {number}" for name, number in causes.most_common()))
    return lines
