"""Wrong gains where something else moves the loop as well: are they cured for all that?

tone    an oscillation from outside all along, at 0.35 to 8 times the loop's own period, in the load or on pv
valve   a valve that sticks (Kano 2004, He 2007); limit cycles come and go

Loops, tones and valves are those of harm.py, the starts those of batch.py, if stable. Six disturbances, setpoint and
load steps in turn, 60 dead times apart; a setpoint step is 1 to 5 times the tone, 1 to 4 times the limit cycle that the
valve makes under good gains. Judged on the true process without tone and valve, after each disturbance.
"""

from collections.abc import Iterator

import numpy as np
from cases.cycling import LONGEST_PERIOD
from cases.making import own_period_s
from cases.plant import log_uniform
from cases.setting import scaled

from online import harm
from online.judge import Judge
from online.runner import Task
from online.session import LENGTH_THETA, STARTS, Row, Session, by_kind, in_spec_after, line
from retuner.schedule.gains import PidGains

__all__ = ["KINDS", "line", "run", "table"]
KINDS = ("tone", "valve")
UPSETS, REST_SAMPLES = 6, 200


def drawn(kind: str, rng: np.random.Generator) -> tuple[harm.Scene, PidGains, tuple[float, float]]:
    """A scene, the gains at the start, and their factors."""
    while True:
        scene = harm.scene_of("external" if kind == "tone" else "stiction", rng)
        factors = STARTS[int(rng.integers(len(STARTS)))]
        start = scaled(scene.loop.best, *factors)
        if scene.loop.margins(start).stable:
            return scene, start, factors


def toned(scene: harm.Scene, rng: np.random.Generator, n: int) -> tuple[list[float], list[float]]:
    """n samples of load and of what is added to pv, with a tone in one of them."""
    loop = scene.loop
    while True:
        period = log_uniform(rng, 0.35, 8.0) * own_period_s(loop, loop.best) / loop.dt_s
        if 6 < period < LONGEST_PERIOD:
            load, out = harm.tone(rng, loop, n, period)
            return load.tolist(), out.tolist()


def run(task: Task) -> Row:
    """One loop; keys of session.Session.row."""
    rng = np.random.default_rng([task.seed, task.index, KINDS.index(task.kind), 63])
    scene, start, (kc, tau_i) = drawn(task.kind, rng)
    loop = scene.loop
    judge = Judge(loop.process, loop.dt_s, (loop.best, loop.theta_s))
    n = int(LENGTH_THETA * loop.theta_s / loop.dt_s * max(1.0, 1 / kc))
    whole = UPSETS * n + REST_SAMPLES
    if task.kind == "tone":
        size, (load, out) = float(rng.uniform(1.0, 5.0)), toned(scene, rng, whole)
    else:
        size = scene.pv_span / harm.SPAN_OVER_SWING * float(rng.uniform(1.0, 4.0))
        load, out = [0.0] * whole, (float(np.std(scene.out)) * rng.standard_normal(whole)).tolist()
    low, high = (loop.low, loop.high) if task.kind == "valve" else (-1e15, 1e15)
    session = Session(
        task, judge, start, None, scene.pv_span, co0=loop.co0, low=low, high=high, valve=scene.valve,
        lost=1e4 * scene.pv_span,
    )  # fmt: skip
    step = judge.load_like_setpoint() * size

    def upsets() -> Iterator[Judge]:
        sp, upset, at = 0.0, 0.0, REST_SAMPLES
        session.loop.run(sp, load[:at], out[:at])
        for i in range(UPSETS):
            sp, upset = (size - sp, upset) if i % 2 == 0 else (sp, step - upset)
            session.loop.run(sp, [more + upset for more in load[at : at + n]], out[at : at + n])
            at += n
            yield judge

    session.run(upsets(), UPSETS)
    return session.row("wrong", f"{loop.family} kc x{kc:g} tau_i x{tau_i:g}")


def table(rows: list[Row]) -> list[str]:
    """In spec after the last disturbance, and harm, a kind."""
    lines = []
    for _, of, head in by_kind(rows, KINDS):
        lines += [f"{head}, harmed {sum(row['worse'] > 0 for row in of)}", *in_spec_after(of, (UPSETS,))]
    return lines
