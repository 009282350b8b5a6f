"""Records of the eight causes, each a clear case by construction and by the margins of the true process."""

from collections.abc import Callable
from contextlib import suppress
from dataclasses import replace

import numpy as np

from cases.cycling import far_from_own, stiction_record, tone_record
from cases.loop import Upsets
from cases.making import NotClear, Plan, event_steps, labelled, record_length, scaled_record, settings, tail
from cases.plant import FAMILIES, INTEGRATING, log_uniform
from cases.setting import DiagnosisCase, Loop, draw_loop, settling_s
from cases.signals import coloured, steps
from retuner.schedule.gains import PidGains

CAUSES = ("ok", "aggressive", "sluggish", "slow_integrating", "stiction", "external", "saturation", "noise")
SELF_REGULATING = tuple(x for x in FAMILIES if x not in INTEGRATING)
LAG_DOMINANT = ("first", "second", "batch-p3", "batch-p7", "diffusion")
TRIES = 400

Maker = Callable[[np.random.Generator], DiagnosisCase]


def case(seed: int, index: int, cause: str | None = None) -> DiagnosisCase:
    rng = np.random.default_rng([seed, index, 2])
    cause = cause or CAUSES[index % len(CAUSES)]
    return replace(first_that_fits(rng, MAKERS[cause], cause), seed=seed, index=index)


def first_that_fits(rng: np.random.Generator, maker: Maker, group: str) -> DiagnosisCase:
    """Draw until a draw is a clear case."""
    for _ in range(TRIES):
        with suppress(NotClear):
            return maker(rng)
    raise RuntimeError(f"no loop fits group {group} in {TRIES} draws")


def loop_for(rng: np.random.Generator, cause: str) -> Loop:
    """A loop in which the cause can occur."""
    if cause == "slow_integrating":
        return draw_loop(rng, str(rng.choice([*sorted(INTEGRATING), *LAG_DOMINANT])))
    if cause == "stiction":
        return draw_loop(rng, str(rng.choice(SELF_REGULATING)))
    return draw_loop(rng, str(rng.choice(FAMILIES)))


def ordered_loop(rng: np.random.Generator, families: tuple[str, ...] = FAMILIES) -> tuple[Loop, PidGains]:
    """A loop with settings in order."""
    loop = draw_loop(rng, str(rng.choice(families)))
    return loop, settings(rng, loop, "ok")


def tuning_case(
    rng: np.random.Generator, cause: str, *, group: str = "", setpoints: bool = True, quantum: float = 0.0
) -> DiagnosisCase:
    """Settings of that cause under setpoint steps, some load steps among them; or under load steps alone."""
    loop = loop_for(rng, cause)
    gains = settings(rng, loop, cause)
    events = int(rng.integers(1, 5))
    loop, n, first = record_length(rng, loop, gains, events)
    sp = event_steps(rng, n, first, events) if setpoints else np.zeros(n)
    load = np.zeros(n)
    if not setpoints:
        load = event_steps(rng, n, first, events, alternate=bool(rng.integers(2)))
    elif rng.uniform() < 0.5:
        places = (rng.uniform(0.1, 0.9, rng.integers(1, 3)) * n).tolist()
        load = steps(n, places, (rng.choice([-1, 1], len(places)) * abs(loop.best.kp) * rng.uniform(0.3, 1.5)).tolist())
    plan = Plan(sp, load, np.zeros(n), log_uniform(rng, 0.003, 0.02), quantum=quantum)
    record = scaled_record(rng, loop, gains, plan)
    found = loop.margins(gains)
    return labelled(loop, gains, record, group or cause, {cause}, cause, ms=found.ms, gm=found.gm, events=events)


def stiction_case(
    rng: np.random.Generator,
    *,
    group: str = "stiction",
    families: tuple[str, ...] = SELF_REGULATING,
    kinds: tuple[str, ...] = ("kano", "he"),
    tuning: str = "ok",
    quantum: float = 0.0,
) -> DiagnosisCase:
    """A limit cycle made by a valve that sticks, under settings that are in order (or not)."""
    loop = draw_loop(rng, str(rng.choice(families)))
    gains = settings(rng, loop, tuning)
    made = stiction_record(rng, loop, gains, str(rng.choice(kinds)), quantum)
    if made is None:
        raise NotClear
    loop, record, note = made
    return labelled(loop, gains, record, group, {"stiction"}, "stiction", **note)


def external_case(
    rng: np.random.Generator,
    *,
    group: str = "external",
    shapes: tuple[str, ...] = ("sine",),
    jitter: float = 0.0,
    ratio: float | None = None,
    right: frozenset[str] = frozenset({"external"}),
    quantum: float = 0.0,
) -> DiagnosisCase:
    """An outside oscillation on a loop in order."""
    loop, gains = ordered_loop(rng)
    shape = str(rng.choice(shapes))
    loop, record, note = tone_record(
        rng, loop, gains, shape, ratio or far_from_own(rng), jitter=jitter, quantum=quantum
    )
    return labelled(loop, gains, record, group, set(right), f"external {shape}", **note)


def saturation_case(rng: np.random.Generator) -> DiagnosisCase:
    """A setpoint or load beyond what the output can do: co at its limit for a third of the record or more, pv off."""
    loop, gains = ordered_loop(rng)
    settle = settling_s(loop, gains)
    loop, n, first = record_length(rng, loop, gains, 1)
    first = max(first, float(rng.uniform(0.02, 0.5)) * n)
    side = float(rng.choice([-1.0, 1.0]))
    room = loop.high - loop.co0 if side > 0 else loop.co0 - loop.low
    excess = room * float(rng.uniform(1.15, 2.5))
    sp, load = np.zeros(n), np.zeros(n)
    if loop.process.integrators or rng.uniform() < 0.5:
        load = steps(n, [first], [-side * excess])
        if rng.uniform() < 0.3:
            load += steps(n, [first + float(rng.uniform(0.5, 0.8)) * (n - first)], [side * excess])
    else:
        sp = steps(n, [float(np.floor(first))], [side * excess * loop.process.k])
    clean = loop.run(gains, Upsets(sp, load))
    at_limit = (clean.co <= loop.low) | (clean.co >= loop.high)
    response = float(np.ptp(clean.pv))
    if np.mean(at_limit) < 0.35 or np.mean(np.abs(clean.sp - clean.pv)[at_limit]) < 0.1 * response:
        raise NotClear
    noise = response * log_uniform(rng, 0.003, 0.02)
    pv0 = float(rng.uniform(-20, 20)) * response
    upsets = Upsets(pv0 + sp, load, None, noise * rng.standard_normal(n))
    record = loop.run(gains, upsets, pv0=pv0)
    share = float(np.mean((record.co <= loop.low) | (record.co >= loop.high)))
    return labelled(loop, gains, record, "saturation", {"saturation"}, "saturation", share=share, settle=settle)


def noise_case(rng: np.random.Generator) -> DiagnosisCase:
    """A constant setpoint, a loop in order, and nothing but measurement noise, white or nearly so."""
    loop, gains = ordered_loop(rng)
    n = int(log_uniform(rng, 300, 2000))
    shaped = rng.standard_normal(n) if rng.uniform() < 0.7 else coloured(rng, n, float(rng.uniform(0.3, 1.0)))
    sigma = loop.room / abs(gains.kp) * log_uniform(rng, 0.002, 0.15)
    pv0 = float(rng.uniform(-200, 200)) * sigma
    upsets = Upsets(np.full(n, pv0), noise=sigma * shaped)
    record = loop.run(gains, upsets, pv0=pv0)
    return labelled(loop, gains, tail(record, 50), "noise", {"noise"}, "noise")


MAKERS: dict[str, Maker] = {
    "ok": lambda rng: tuning_case(rng, "ok"),
    "aggressive": lambda rng: tuning_case(rng, "aggressive"),
    "sluggish": lambda rng: tuning_case(rng, "sluggish"),
    "slow_integrating": lambda rng: tuning_case(rng, "slow_integrating"),
    "stiction": stiction_case,
    "external": external_case,
    "saturation": saturation_case,
    "noise": noise_case,
}
