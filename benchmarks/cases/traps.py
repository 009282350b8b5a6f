"""Records on which a diagnosis goes wrong, each trap a group with the answers that count as right.

external shapes     triangles, saws, filtered squares, pulses from outside, regular or with periods that vary: external
                    (or unknown, where the periods vary)
random walk         a random-walk load on a loop in order, with or without setpoint steps: anything but a retune,
                    stiction or saturation
narrow band         a random load through a resonance: the same
load steps only     ok, aggressive, sluggish and slow_integrating loops that see no setpoint change: the cause
stiction integrating, stiction lag-dominant, stiction aggressive, irregular stick-slip: stiction
own period          an outside tone within a quarter of the loop's own period: external or unknown
backlash            a valve with play in an integrating loop that cycles: stiction
backlash at rest    the same in a self-regulating loop that does not cycle: anything but a retune or saturation
compressed          ok, aggressive, sluggish, stiction, external after a historian's compression: the cause
quantised           the same read in 15 to 50 steps over pv's range: the cause
no response         the sensor stands still while co moves on: unknown, or saturation where co reached its limit
dead signal         nothing moves: unknown
quiet               a constant setpoint and nothing but the last digit: noise, ok or unknown
manual              co moved by hand or not at all, whatever the gains: noise, ok, external or unknown
cascade slave       a loop in order whose setpoint is noise from a master: ok, noise, external or unknown
two pulses          two load pulses that look like one swing and its overshoot: ok, external, noise or unknown
band anew, stuck and stepped, fast triangle, load after step: cases/fiction.py
"""

from dataclasses import replace

import numpy as np

from cases.case import Record
from cases.diagnosis import (
    LAG_DOMINANT,
    SELF_REGULATING,
    Maker,
    external_case,
    first_that_fits,
    loop_for,
    ordered_loop,
    stiction_case,
    tuning_case,
)
from cases.fiction import fast_triangle, load_after_step, standing_valve
from cases.loop import Controller, Upsets, run, run_manual
from cases.making import (
    NotClear,
    Plan,
    event_steps,
    labelled,
    own_period_s,
    quantiser,
    record_length,
    scaled_record,
    settings,
    tail,
    valve_record,
)
from cases.plant import FAMILIES, INTEGRATING, log_uniform
from cases.setting import DiagnosisCase, draw_loop, settling_s
from cases.signals import SHAPES, backlash, coloured, compressed, narrow_band, random_walk, steps

QUIET = {"ok", "noise", "external", "unknown"}
BASES = ("ok", "aggressive", "sluggish", "stiction", "external")


def external_shapes(rng: np.random.Generator) -> DiagnosisCase:
    jitter = float(rng.uniform(0.03, 0.15)) if rng.uniform() < 0.3 else 0.0
    right = frozenset({"external", "unknown"} if jitter else {"external"})
    return external_case(rng, group="external shapes", shapes=SHAPES[1:], jitter=jitter, right=right)


def own_period(rng: np.random.Generator) -> DiagnosisCase:
    return external_case(
        rng, group="own period", ratio=log_uniform(rng, 0.8, 1.25), right=frozenset({"external", "unknown"})
    )


def random_load(rng: np.random.Generator, group: str) -> DiagnosisCase:
    """A random-walk or narrow-band load, half of them with setpoint steps of about its size."""
    loop, gains = ordered_loop(rng)
    loop, n, first = record_length(rng, loop, gains, int(rng.integers(3, 9)))
    lead_in = n // 3
    whole = n + lead_in
    if group == "random walk":
        wave = random_walk(rng, whole)
    else:
        period = own_period_s(loop, gains) / loop.dt_s * log_uniform(rng, 0.7, 4.0)
        if not 10 < period < n / 4:
            raise NotClear
        wave = narrow_band(rng, whole, period, log_uniform(rng, 0.03, 0.15))
    inside = rng.uniform() < 0.7
    zero = np.zeros(whole)
    load, out = (wave, zero) if inside else (zero, wave)
    effect = float(np.ptp(run(loop.process, Controller(gains), loop.dt_s, Upsets(zero, load, out)).pv[lead_in:]))
    sp = zero
    if rng.uniform() < 0.5:
        sp = event_steps(rng, whole, lead_in + first, int(rng.integers(1, 4))) * effect * log_uniform(rng, 0.5, 2.0)
    record = scaled_record(rng, loop, gains, Plan(sp, load, out, log_uniform(rng, 0.003, 0.03), lead_in))
    return labelled(loop, gains, record, group, QUIET, f"ok under {group}")


def load_steps_only(rng: np.random.Generator) -> DiagnosisCase:
    cause = str(rng.choice(["ok", "aggressive", "sluggish", "slow_integrating"]))
    return tuning_case(rng, cause, group="load steps only", setpoints=False)


def backlash_at_rest(rng: np.random.Generator) -> DiagnosisCase:
    """Play of a few percent that the loop's responses go through."""
    loop, gains = ordered_loop(rng, SELF_REGULATING)
    loop, n, first = record_length(rng, loop, gains, int(rng.integers(1, 4)))
    sp = event_steps(rng, n, first, int(rng.integers(1, 4)))
    width = 2.0 * float(rng.uniform(0.03, 0.12))
    clean = run(loop.process, Controller(gains), loop.dt_s, Upsets(sp))
    size = loop.room * 0.7 / float(np.max(np.abs(clean.co)))

    plan = Plan(size * sp, np.zeros(n), np.zeros(n), log_uniform(rng, 0.003, 0.02))
    play = width * loop.room * 0.7
    record = valve_record(rng, loop, gains, plan, lambda start: backlash(play, start), float(np.ptp(clean.pv)) * size)
    return labelled(loop, gains, record, "backlash at rest", QUIET | {"stiction"}, "ok with play")


def stored(rng: np.random.Generator, group: str) -> DiagnosisCase:
    """One of the five plain causes, compressed or quantised."""
    base = str(rng.choice(BASES))
    quantum = 1.0 / float(rng.uniform(15, 50)) if group == "quantised" else 0.0
    if base == "stiction":
        made = stiction_case(rng, group=group, quantum=quantum)
    elif base == "external":
        made = external_case(rng, group=group, quantum=quantum)
    else:
        made = tuning_case(rng, base, group=group, quantum=quantum)
    return made if group == "quantised" else replace(made, record=compressed(rng, made.record))


def no_response(rng: np.random.Generator) -> DiagnosisCase:
    """From some time on the sensor stands still beside the setpoint, and the integral carries co away."""
    loop, gains = ordered_loop(rng)
    loop, n, _ = record_length(rng, loop, gains, 3)
    error = loop.room / abs(gains.kp) * float(rng.uniform(0.02, 0.3)) * float(rng.choice([-1.0, 1.0]))
    stands = rng.uniform() < 0.5
    noise = np.zeros(n) if rng.uniform() < 0.4 else abs(error) * log_uniform(rng, 0.003, 0.1) * rng.standard_normal(n)
    pv0 = float(rng.uniform(-20, 20)) * error
    sp = np.full(n, pv0) if stands else pv0 + event_steps(rng, n, 0.2 * n, 2) * error
    start = pv0 - error if stands else pv0
    reads = iter((start + noise).tolist())
    record = loop.run(gains, Upsets(sp), pv0=pv0, sensor=lambda _: next(reads))
    at_limit = float(np.mean((record.co <= loop.low) | (record.co >= loop.high)))
    if float(np.ptp(record.co)) < 0.02 * (loop.high - loop.low):
        raise NotClear
    right = {"unknown", "saturation"} if at_limit > 0.2 else {"unknown"}
    return labelled(loop, gains, record, "no response", right, "no response", share=at_limit)


def dead_signal(rng: np.random.Generator) -> DiagnosisCase:
    """Setpoint, pv and co each a constant, pv or co perhaps with one last digit that flickers once."""
    loop, gains = ordered_loop(rng)
    n = int(rng.integers(300, 1200))
    level = float(rng.uniform(-50, 150))
    pv = np.full(n, level)
    if rng.uniform() < 0.3:
        pv[int(rng.integers(n))] += 1e-4 * abs(level)
    off = level if rng.uniform() < 0.5 else level + float(rng.uniform(-1, 1))
    record = Record(np.arange(n) * loop.dt_s, np.full(n, off), pv, np.full(n, float(rng.choice([loop.low, loop.co0]))))
    right = {"unknown", "saturation"} if record.co[0] == loop.low else {"unknown"}
    return labelled(loop, gains, record, "dead signal", right, "dead signal")


def quiet(rng: np.random.Generator) -> DiagnosisCase:
    """Constant setpoint, the last digit of pv flickers."""
    loop, gains = ordered_loop(rng)
    n = int(log_uniform(rng, 300, 1500))
    sigma = loop.room / abs(gains.kp) * log_uniform(rng, 1e-4, 2e-3)
    quantum = sigma * float(rng.uniform(1.0, 4.0))
    pv0 = round(float(rng.uniform(-200, 200))) * quantum
    upsets = Upsets(np.full(n + 50, pv0), noise=sigma * rng.standard_normal(n + 50))
    record = loop.run(gains, upsets, pv0=pv0, sensor=quantiser(quantum))
    if np.ptp(record.pv[50:]) == 0:
        raise NotClear
    return labelled(loop, gains, tail(record, 50), "quiet", {"ok", "noise", "unknown"}, "quiet")


def manual(rng: np.random.Generator) -> DiagnosisCase:
    """co constant or moved by hand; the gains given are not in force, and of any kind."""
    loop = draw_loop(rng, str(rng.choice(FAMILIES)))
    gains = settings(rng, loop, str(rng.choice(["ok", "aggressive", "sluggish"])))
    loop, n, _ = record_length(rng, loop, gains, 3)
    zero = np.zeros(n)
    count = int(rng.integers(0, 5))
    co = event_steps(rng, n, 0.1 * n, count) * loop.room * log_uniform(rng, 0.05, 0.6) if count else zero
    load = steps(n, [float(rng.uniform(0.1, 0.9)) * n], [loop.room * 0.1]) if rng.uniform() < 0.5 else zero
    walk = random_walk(rng, n)
    effect = max(float(np.ptp(run_manual(loop.process, loop.dt_s, co, Upsets(zero, load)).pv)), 1e-9)
    if count == 0 and not np.any(load):
        effect = abs(loop.process.k) * loop.room * 0.05
    out = walk / np.ptp(walk) * effect * float(rng.uniform(0.05, 0.5)) if rng.uniform() < 0.5 else zero
    pv0 = float(rng.uniform(-20, 20)) * effect
    upsets = Upsets(np.full(n, pv0), load, out, effect * log_uniform(rng, 0.005, 0.05) * rng.standard_normal(n))
    record = run_manual(loop.process, loop.dt_s, loop.co0 + co, upsets, pv0=pv0)
    return labelled(loop, gains, record, "manual", QUIET, "manual", moves=count)


def cascade_slave(rng: np.random.Generator) -> DiagnosisCase:
    """The setpoint is the noisy output of a master."""
    loop, gains = ordered_loop(rng)
    loop, n, _ = record_length(rng, loop, gains, int(rng.integers(2, 7)))
    corner = max(settling_s(loop, gains) / loop.dt_s * log_uniform(rng, 0.02, 0.5), 0.3)
    if corner > n / 4:
        raise NotClear
    sp = coloured(rng, n + 100, corner) + 0.3 * rng.standard_normal(n + 100)
    zero = np.zeros(n + 100)
    record = scaled_record(rng, loop, gains, Plan(sp, zero, zero, log_uniform(rng, 0.005, 0.05), 100))
    return labelled(loop, gains, record, "cascade slave", QUIET, "ok under a noisy setpoint")


def two_pulses(rng: np.random.Generator) -> DiagnosisCase:
    """Two short loads of opposite sign, the second smaller, half a period of the loop apart or a little more."""
    loop, gains = ordered_loop(rng)
    loop, n, first = record_length(rng, loop, gains, 2)
    half = own_period_s(loop, gains) / loop.dt_s / 2 * float(rng.uniform(0.8, 2.0))
    width = half * float(rng.uniform(0.2, 0.8))
    second = -float(rng.uniform(0.4, 0.9))
    third = float(rng.uniform(0.2, 0.5)) if rng.uniform() < 0.4 else 0.0
    places, sizes = [], []
    for i, size in enumerate((1.0, second, third)):
        places += [first + i * half, first + i * half + width]
        sizes += [size, -size]
    if places[-1] > 0.9 * n:
        raise NotClear
    zero = np.zeros(n)
    record = scaled_record(rng, loop, gains, Plan(zero, steps(n, places, sizes), zero, log_uniform(rng, 0.003, 0.02)))
    return labelled(loop, gains, record, "two pulses", QUIET, "ok after two pulses")


def stiction_lag_dominant(rng: np.random.Generator) -> DiagnosisCase:
    """A lag of ten or more effective dead times."""
    made = stiction_case(rng, group="stiction lag-dominant", families=LAG_DOMINANT)
    if max(made.loop.process.lags_s) < 10 * made.loop.theta_s:
        raise NotClear
    return made


TRAPS: dict[str, Maker] = {
    "external shapes": external_shapes,
    "own period": own_period,
    "random walk": lambda rng: random_load(rng, "random walk"),
    "narrow band": lambda rng: random_load(rng, "narrow band"),
    "load steps only": load_steps_only,
    "stiction integrating": lambda rng: stiction_case(
        rng, group="stiction integrating", families=tuple(sorted(INTEGRATING))
    ),
    "stiction lag-dominant": stiction_lag_dominant,
    "stiction aggressive": lambda rng: stiction_case(rng, group="stiction aggressive", tuning="aggressive"),
    "irregular stick-slip": lambda rng: stiction_case(rng, group="irregular stick-slip", kinds=("irregular",)),
    "backlash": lambda rng: stiction_case(
        rng, group="backlash", families=tuple(sorted(INTEGRATING)), kinds=("backlash",)
    ),
    "backlash at rest": backlash_at_rest,
    "compressed": lambda rng: stored(rng, "compressed"),
    "quantised": lambda rng: stored(rng, "quantised"),
    "no response": no_response,
    "dead signal": dead_signal,
    "quiet": quiet,
    "manual": manual,
    "cascade slave": cascade_slave,
    "two pulses": two_pulses,
    "band anew": lambda rng: standing_valve(rng, stepped=False),
    "stuck and stepped": lambda rng: standing_valve(rng, stepped=True),
    "fast triangle": fast_triangle,
    "load after step": lambda rng: load_after_step(rng, loop_for),
}


def case(seed: int, index: int, trap: str | None = None) -> DiagnosisCase:
    rng = np.random.default_rng([seed, index, 3])
    trap = trap or list(TRAPS)[index % len(TRAPS)]
    return replace(first_that_fits(rng, TRAPS[trap], trap), seed=seed, index=index)
