"""Records to identify a process from, drawn from a seed, each group a way in which records come about.

Every size is relative: noise 0.5 to 3 % of pv's response, drift a share of it, co's travel a share of its range.
Settings in force are SIMC's with kc from a quarter to twice and tau_i from a quarter to four times, stable and with an
Ms under 5.
"""

from dataclasses import dataclass, replace

import numpy as np

from cases.case import FloatArray, Record
from cases.loop import Controller, Upsets, run, run_manual
from cases.making import quantiser
from cases.plant import FAMILIES, log_uniform
from cases.setting import IdentificationCase, Loop, draw_loop, fitted, scaled, scaled_pid, settling_s
from cases.signals import ramp, random_walk, steps
from retuner.schedule.gains import PidGains

GROUPS = (
    "open-loop step",
    "open-loop steps",
    "setpoint",
    "load",
    "setpoint and load",
    "several",
    "ramp drift",
    "random-walk drift",
    "quantised",
    "saturated",
    "irregular time",
    "starts in motion",
    "pid",
)
BY_NAME = ("several loads",)  # Groups that are drawn only where they are asked for, so that the others keep their turns
MANUAL = frozenset({"open-loop step", "open-loop steps"})
MOST_SAMPLES = 2500
FEWEST_SAMPLES = 120
FINE = 8  # Steps in a sample where samples do not come at regular times
MS_IN_FORCE = 5.0
TRIES = 200

Event = tuple[float, float]  # Place in samples, and size


@dataclass(frozen=True, slots=True)
class Shape:
    """Upsets of size one, before scaling: setpoint, load (relative to the setpoint's), and drift."""

    sp: FloatArray
    load: FloatArray
    drift_in: FloatArray
    drift_out: FloatArray
    loads: tuple[Event, ...] = ()


def case(seed: int, index: int, group: str | None = None) -> IdentificationCase:
    """The case of that number; groups take turns, families are drawn."""
    rng = np.random.default_rng([seed, index, 1])
    group = group or GROUPS[index % len(GROUPS)]
    for _ in range(TRIES):
        family = str(rng.choice(FAMILIES))
        made = _manual(rng, group, family) if group in MANUAL else _closed(rng, group, family)
        if made is not None:
            return replace(made, seed=seed, index=index)
    raise RuntimeError(f"seed {seed}, case {index}: no loop fits group {group}")


def _manual(rng: np.random.Generator, group: str, family: str) -> IdentificationCase | None:
    """An experiment in manual that begins at rest: one step, or several to and fro."""
    loop = draw_loop(rng, family)
    process = loop.process
    lags = sum(process.lags_s) + sum(c1 for c1, _ in process.quadratics)
    settle = float(rng.uniform(6, 20)) * loop.theta_s if process.integrators else loop.theta_s + 4 * lags
    moves = 1 if group == "open-loop step" else int(rng.integers(2, 5))
    before = float(rng.uniform(1, 4)) * loop.theta_s
    length = before + settle * float(rng.uniform(0.8, 1.3)) * (1 if moves == 1 else 0.6 * moves)
    loop, n = fitted(loop, length, FEWEST_SAMPLES, MOST_SAMPLES)
    at = before / loop.dt_s + np.arange(moves) * (n - before / loop.dt_s) / moves
    sign = float(rng.choice([-1.0, 1.0]))
    if moves == 1:
        levels = [sign]
    else:
        levels = [
            sign * float(rng.uniform(0.5, 1.0)) * (1 if i % 2 == 0 else float(rng.choice([0.0, -1.0])))
            for i in range(moves)
        ]
    co = steps(n, [float(np.floor(x)) for x in at], np.diff([0.0, *levels]).tolist())
    co *= loop.room * log_uniform(rng, 0.05, 0.8)
    clean = run_manual(process, loop.dt_s, co, Upsets(np.zeros(n)))
    response = float(np.ptp(clean.pv))
    noise = response * log_uniform(rng, 0.005, 0.03)
    out = _manual_drift(rng, n) * response
    pv0 = response * float(rng.uniform(-20, 20))
    upsets = Upsets(np.full(n, pv0), out=out, noise=noise * rng.standard_normal(n))
    record = run_manual(process, loop.dt_s, loop.co0 + co, upsets, pv0=pv0)
    note = {"drift": float(np.any(out))}
    return IdentificationCase(group, loop, record, None, noise, note)


def _manual_drift(rng: np.random.Generator, n: int) -> FloatArray:
    """A third without, a third a ramp, a third a random walk; shares of the response."""
    kind = int(rng.integers(3))
    if kind == 0:
        return np.zeros(n)
    if kind == 1:
        return ramp(n) * float(rng.choice([-1.0, 1.0])) * log_uniform(rng, 0.02, 0.1)
    walk = random_walk(rng, n)
    return np.asarray(walk / np.std(walk) * log_uniform(rng, 0.005, 0.03))


def _closed(rng: np.random.Generator, group: str, family: str) -> IdentificationCase | None:
    """A record in automatic; None when the draw is not stable enough or does not fit the group."""
    loop = draw_loop(rng, family)
    gains, tau_f = loop.best, 0.0
    kc, tau_i = log_uniform(rng, 0.25, 2.0), log_uniform(rng, 0.25, 4.0)
    if group == "pid":
        if loop.best_pid is None or any(c1 * c1 < 4 * c2 for c1, c2 in loop.process.quadratics):
            return None
        gains, tau_f, _ = scaled_pid(rng, loop.best_pid, min(kc, 1.2), tau_i)
    else:
        gains = scaled(loop.best, kc, tau_i)
    if not loop.margins(gains, tau_f).ms < MS_IN_FORCE:
        return None
    settle = settling_s(loop, gains, tau_f)
    events = 3 if group in {"several", *BY_NAME} else 1
    before = float(rng.uniform(1, 5)) * loop.theta_s
    length = before + events * settle * float(rng.uniform(0.8, 1.5))
    loop, n = fitted(loop, length, FEWEST_SAMPLES, MOST_SAMPLES)
    if not loop.margins(gains, tau_f).ms < MS_IN_FORCE:
        return None
    return _record(rng, group, loop, gains, tau_f, n, before / loop.dt_s)


def _record(
    rng: np.random.Generator, group: str, loop: Loop, gains: PidGains, tau_f: float, n: int, before: float
) -> IdentificationCase | None:
    """Scale the upsets to the output's range and run the loop."""
    fine = FINE if group == "irregular time" else 1
    h_s = loop.dt_s / fine
    lead_in = int(n * rng.uniform(0.1, 0.5)) if group == "starts in motion" else 0
    shape = _shape(rng, group, loop, (n + lead_in) * fine, (before + lead_in) * fine, lead_in * fine)
    acts = _irregular(rng, n, fine) if fine > 1 else np.arange(n + lead_in)
    free = Controller(gains, tau_f)
    clean = run(loop.process, free, h_s, Upsets(shape.sp, shape.load), acts=acts)
    response = float(np.ptp(clean.pv[lead_in:]))
    drift = _drift(rng, loop, free, h_s, shape, acts, response, float(np.ptp(clean.co)))
    share = log_uniform(rng, 0.005, 0.03)
    kick = abs(gains.kp) + abs(gains.kd) / (tau_f + loop.dt_s)
    whole = run(loop.process, free, h_s, Upsets(shape.sp, shape.load + drift.drift_in, drift.drift_out), acts=acts)
    travel = float(np.max(np.abs(whole.co))) + 3.5 * kick * share * response
    size = loop.room / travel * log_uniform(rng, 0.15, 0.95)
    if group == "saturated":
        limits = _clipping(rng, loop, whole.co * size)
        if limits is None:
            return None
        loop = replace(loop, low=limits[0], high=limits[1])
    noise = share * response * size
    pv0 = float(rng.uniform(-20, 20)) * response * size
    upsets = Upsets(
        pv0 + size * shape.sp,
        size * (shape.load + drift.drift_in),
        size * drift.drift_out,
        noise * rng.standard_normal(len(shape.sp)),
    )
    sensor = quantiser(response * size * log_uniform(rng, 0.005, 0.05)) if group == "quantised" else None
    controller = Controller(gains, tau_f, loop.low, loop.high)
    record = run(loop.process, controller, h_s, upsets, co0=loop.co0, pv0=pv0, acts=acts, sensor=sensor)
    # What the historian keeps: the part after the lead-in, without samples lost; time from where it likes
    keep = np.arange(len(record.t)) >= lead_in
    if group == "irregular time":
        keep &= rng.uniform(size=len(keep)) > 0.02
        for _ in range(int(rng.integers(1, 3))):
            start = int(rng.integers(len(keep)))
            keep[start : start + int(rng.integers(2, 12))] = False
        keep[:2] = True
    t = record.t[keep]
    origin = t[0] - float(rng.choice([0.0, 0.0, 1.0e5])) * float(np.median(np.diff(t)))
    record = Record(t - origin, record.sp[keep], record.pv[keep], record.co[keep])
    note = {"loads": float(len(shape.loads))}
    for i, (at, load) in enumerate(shape.loads):
        note |= {f"load_at{i}": at, f"load{i}": load * size}
    return IdentificationCase(group, loop, record, gains, noise, note)


def _shape(rng: np.random.Generator, group: str, loop: Loop, n: int, first: float, lead_in: int) -> Shape:
    """Upsets of a group; loads are drawn so that their response is about as large as the setpoint's."""
    sp, loads = _events(rng, group, n, first)
    if lead_in:
        early = float(rng.uniform(0.0, 0.8)) * lead_in
        if rng.uniform() < 0.5:
            sp = [*sp, (early, float(rng.uniform(-1, 1)))]
        else:
            loads = [*loads, (early, float(rng.uniform(-1, 1)))]
    load_size = float(rng.choice([-1.0, 1.0])) * log_uniform(rng, 0.5, 2.0) * abs(loop.best.kp)
    loads = [(at, size * load_size) for at, size in loads]
    zero = np.zeros(n)
    drift = zero
    if group == "ramp drift":
        drift = ramp(n) * float(rng.choice([-1.0, 1.0]))
    if group == "random-walk drift":
        drift = random_walk(rng, n)
    inside = rng.uniform() < 0.5
    setpoint = steps(n, [float(np.floor(at)) for at, _ in sp], [size for _, size in sp])
    load = steps(n, [at for at, _ in loads], [size for _, size in loads])
    return Shape(setpoint, load, drift if inside else zero, zero if inside else drift, tuple(loads))


def _events(rng: np.random.Generator, group: str, n: int, first: float) -> tuple[list[Event], list[Event]]:
    """Setpoint and load steps, each as place in samples and size; groups without a kind of their own draw one."""
    sign = float(rng.choice([-1.0, 1.0]))
    kind = group
    if group not in {"setpoint", "load", "setpoint and load", "several", *BY_NAME}:
        likely = 0.85 if group in {"saturated", "pid"} else 0.5
        kind = "setpoint" if rng.uniform() < likely else "load"
    if kind == "setpoint":
        return [(first, sign)], []
    if kind == "load":
        return [], [(first, sign)]
    if kind in BY_NAME:
        places = first + (n - first) * np.array([0.0, *np.sort(rng.uniform(0.15, 0.85, int(rng.integers(1, 4))))])
        return [], [(float(at), float(rng.choice([-1.0, 1.0])) * float(rng.uniform(0.5, 1))) for at in places]
    if kind == "setpoint and load":
        return [(first, sign)], [(first + float(rng.uniform(0.1, 0.7)) * (n - first), float(rng.choice([-1.0, 1.0])))]
    sp: list[Event] = []
    loads: list[Event] = []
    for place in first + (n - first) * np.array([0.0, *np.sort(rng.uniform(0.2, 0.85, 2))]):
        chosen = sp if rng.uniform() < 0.5 else loads
        chosen.append((float(place), float(rng.choice([-1.0, 1.0])) * float(rng.uniform(0.5, 1))))
    return sp, loads


def _drift(
    rng: np.random.Generator,
    loop: Loop,
    free: Controller,
    h_s: float,
    shape: Shape,
    acts: FloatArray,
    response: float,
    travel: float,
) -> Shape:
    """Drift scaled so that pv's part of it is a share of the response, and co's no more than a third of its travel."""
    if not (np.any(shape.drift_in) or np.any(shape.drift_out)):
        return shape
    zero = np.zeros(len(shape.sp))
    alone = run(loop.process, free, h_s, Upsets(zero, shape.drift_in, shape.drift_out), acts=acts)
    wanted = response * log_uniform(rng, 0.02, 0.1)
    size = min(wanted / float(np.ptp(alone.pv)), 0.33 * travel / float(np.ptp(alone.co)))
    return Shape(shape.sp, shape.load, size * shape.drift_in, size * shape.drift_out)


def _clipping(rng: np.random.Generator, loop: Loop, co: FloatArray) -> tuple[float, float] | None:
    """A range that the output leaves for a while, and that holds where it ends; None when it has no peak."""
    side = 1.0 if abs(np.max(co)) > abs(np.min(co)) else -1.0
    peak, end = float(np.max(side * co)), float(side * co[-1])
    if peak < 1.3 * max(end, 0.0):
        return None
    limit = max(end, 0.0) + float(rng.uniform(0.2, 0.7)) * (peak - max(end, 0.0))
    share = float(np.mean(side * co > limit))
    if not 0.02 < share < 0.5:
        return None
    return (loop.low, loop.co0 + limit) if side > 0 else (loop.co0 - limit, loop.high)


def _irregular(rng: np.random.Generator, n: int, fine: int) -> FloatArray:
    """Steps at which samples come: every `fine` steps, up to a quarter of that early or late."""
    late = rng.integers(-(fine // 4), fine // 4 + 1, n)
    late[0] = 0
    return np.asarray(np.clip(np.arange(n) * fine + late, 0, n * fine - 1))
