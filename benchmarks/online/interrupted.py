"""What becomes of a change on trial when something interrupts it, or nothing happens for days?

Loops of the drawn families begin too aggressive (Kc x 1.6 to 3, tau_I / 1 to 2, Ms over 2) or sluggish (Kc / 3 to 5);
setpoint steps of one in turn, noise is 1 % of a step, eight samples to an effective dead time.

rare         an effective dead time of 5 minutes and a setpoint step every second day
slow         an effective dead time of 3 hours, a step every 60 of them
manual       20 samples in manual at a drawn moment after each write, before the trial is decided
gap          20 samples are missing
end          the session ends and the next one goes on from its memory
telemetry    no samples come any more: 40 are missing, and the session says so
restart      the controller restarts, and the session says so
frozen       the sensor stands still, 20 to 400 samples, while the controller goes on: its output runs off to a limit
limit        a load beyond what the output can do, for 20 to 100 samples
memory       the session dies and goes on from memory at drawn moments, a change under way or not

Counted: loops in spec at the end (as the batch has it); writes that replaced a set by another cause than
evidence against it; of these, those that made the loop less robust (true Ms larger, and over 2.1), and those that took
back a set in spec for one that is not; and changes for the worse whatever they rest on (as harm.py has it).
"""

import math
from collections.abc import Iterator
from itertools import pairwise

import numpy as np
from cases.case import share
from cases.loop import FAR
from cases.plant import FAMILIES, log_uniform
from cases.setting import Loop, draw_loop, scaled, slowed

from online.judge import Judge
from online.loop import WRITTEN, Watching, one_region, settings
from online.runner import Task
from online.session import LENGTH_THETA, Row, Session, by_kind, effects, in_words, line, noise_of
from retuner import Action, LoopMode, LoopSample, PidGains, TrialEvent, remember, restore

__all__ = ["KINDS", "line", "run", "table"]
KINDS = ("rare", "slow", "manual", "gap", "end", "telemetry", "restart", "frozen", "limit", "memory")
STEPS = 6
DAY_S = 86400.0
THETA_S = {"rare": 300.0, "slow": 3 * 3600.0}
TOLD = {"end": TrialEvent.STOPPED, "telemetry": TrialEvent.LOST_TELEMETRY, "restart": TrialEvent.RESTARTED}
UNSEEN = {"gap": 20, "end": 20, "telemetry": 40}
IN_MANUAL = 20
FROZEN, PUSHED = (20, 400), (20, 100)
"""Samples for which a sensor stands still, and for which a load is beyond the output's range."""
DIES_EVERY = 150  # Samples between two ends of a session, in the mean
ROOM, BEYOND = 5.0, 8.0
"""Room of the output about its resting point, over what holds the setpoint's step; and size of the load beyond it."""
EVIDENCE = frozenset({"undo_worse", "undo_runaway"})


class Interrupted(Watching):
    """Retuner, live, to which something happens while a change is on trial."""

    def __init__(self, gains: PidGains, dt_s: float, kind: str, rng: np.random.Generator) -> None:
        super().__init__(one_region(gains), settings(dt_s, 10.0))
        self.kind, self.happened, self.ran = kind, 0, [gains]
        self.why: list[str] = [""]
        self._rng, self._wait, self._left, self._unseen = rng, -1, 0, 0
        self._stuck: float | None = None

    def observe(self, sample: LoopSample) -> tuple[int, PidGains] | None:
        """As live; at a drawn sample after a write it happens."""
        self._wait -= 1
        if self._wait == 0 and self.retuner.trials.undecided:
            self.happened += 1
            # Samples for which it goes on, where that is no matter of the session
            span = {"frozen": FROZEN, "limit": PUSHED}.get(self.kind, (IN_MANUAL, IN_MANUAL + 1))
            self._left = int(self._rng.integers(*span))
            self._unseen = UNSEEN.get(self.kind, 0)
            if self.kind in TOLD:
                # what follows from being told; the session after it goes on from memory
                decision = self.retuner.abort(TOLD[self.kind])
                if decision is not None and decision.action in WRITTEN and decision.gains_after is not None:
                    self.writes.append(decision)
                    return 0, decision.gains_after
                if self.kind == "end":
                    self._go_on()
                return None
        if self._unseen > 0:
            self._unseen -= 1
            return None
        if self.kind == "memory" and self._rng.uniform() < 1 / DIES_EVERY:
            self.happened += 1
            self._go_on()
        self._left -= self._left > 0
        if self.kind == "manual" and self._left > 0:
            sample = sample._replace(mode=LoopMode.MANUAL)
        return super().observe(sample)

    def sensor(self, pv: float) -> float:
        """What the transmitter says: pv, or what it said when it got stuck."""
        if self.kind != "frozen" or self._left <= 0:
            self._stuck = None
            return pv
        self._stuck = pv if self._stuck is None else self._stuck
        return self._stuck

    def pushed(self, load: float) -> float:
        """The load that is beyond the output's range, while it is there."""
        return load if self.kind == "limit" and self._left > 0 else 0.0

    def written(self, region: int, gains: PidGains) -> None:
        """As read back; a change is interrupted some time later."""
        super().written(region, gains)
        self.ran.append(gains)
        self.why.append(self.writes[-1].code)
        if self.writes[-1].action == Action.WRITE and self.kind not in THETA_S:
            self._wait = int(self._rng.integers(5, 60))
        if self.kind == "end" and self.writes[-1].action == Action.RESTORE:
            self._go_on()

    def _go_on(self) -> None:
        self.retuner = restore(remember(self.retuner), self.retuner.settings)


def drawn(kind: str, rng: np.random.Generator, *, aggressive: bool) -> tuple[Loop, PidGains, Judge]:
    """A loop in its kind's own time, and the gains with which it begins."""
    while True:
        loop = draw_loop(rng, str(rng.choice([x for x in FAMILIES if x != "oscillatory"])), (8.0, 8.0 + 1e-9))
        if kind in THETA_S:
            loop = slowed(loop, THETA_S[kind] / loop.theta_s)
        judge = Judge(loop.process, loop.dt_s, (loop.best, loop.theta_s))
        fast = (log_uniform(rng, 1.6, 3.0), 1 / log_uniform(rng, 1.0, 2.0))
        gains = scaled(loop.best, *(fast if aggressive else (1 / log_uniform(rng, 3.0, 5.0), 1.0)))
        if judge.of(loop.best).in_spec and (not aggressive or 2.1 < judge.of(gains).ms < math.inf):
            return loop, gains, judge


def run(task: Task) -> Row:
    """One loop; keys of session.Session.row, and interrupted (how often), taken_back, less_robust, right_taken_back."""
    rng = np.random.default_rng([task.seed, task.index, KINDS.index(task.kind), 41])
    loop, gains, judge = drawn(task.kind, rng, aggressive=task.index % 2 == 0)
    watching = Interrupted(gains, loop.dt_s, task.kind, rng)
    room = ROOM * judge.load_like_setpoint()
    low, high = (-room, room) if task.kind in {"frozen", "limit"} else (-FAR, FAR)
    session = Session(task, judge, gains, watching=watching, low=low, high=high, sensor=watching.sensor)
    n = int((2 * DAY_S if task.kind == "rare" else LENGTH_THETA * loop.theta_s) / loop.dt_s)
    piece = 1 if task.kind == "limit" else n  # between two the load may change

    def upsets() -> Iterator[None]:
        for i in range(STEPS):
            noise = noise_of(rng, n)
            for first in range(0, n, piece):
                load = watching.pushed(BEYOND * room / ROOM)
                session.loop.run(float(1 - i % 2), load, noise[first : first + piece])
            yield None

    session.run(upsets())
    session.judged.append(judge.of(session.loop.table.gains_of(0)))
    told, less, right = list[str](), 0, 0
    for one in effects(judge, watching):
        if one.worse and not one.restored:
            told.append(f"WORSE at {one.t_s:.6g} s, {in_words(one.before)} -> {in_words(one.after)}")
    back = 0
    for (before, now), why in zip(pairwise(watching.ran), watching.why[1:], strict=True):
        if why.startswith("undo_") and why not in EVIDENCE:
            was, then = judge.of(before), judge.of(now)
            back += 1
            less += then.ms > max(1.01 * was.ms, 2.1)
            right += was.in_spec and not then.in_spec
            told.append(f"{why}, {in_words(was)} -> {in_words(then)}")
    counts = {"interrupted": watching.happened, "taken_back": back, "less_robust": less, "right_taken_back": right}
    return session.row("interrupted", loop.family, **counts, story=told if task.verbose else [])


def table(rows: list[Row]) -> list[str]:
    """What was taken back, and what is in spec at the end, a kind."""
    names = ("interrupted", "taken_back", "less_robust", "right_taken_back")
    lines = []
    for _, of, head in by_kind(rows, KINDS):
        counts = ", ".join(f"{name.replace('_', ' ')} {sum(row[name] for row in of)}" for name in names)
        lines += [f"{head}, {counts}", f"  in spec at the end  {share(sum(r['spec'][-1] for r in of), len(of))}"]
    return lines
