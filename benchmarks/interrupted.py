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

Counted: loops in spec at the end (as benchmarks/online has it); writes that replaced a set by another cause than
evidence against it; of these, those that made the loop less robust (true Ms larger, and over 2.1), and those that took
back a set in spec for one that is not; and changes for the worse whatever they rest on (as benchmarks/online/harm.py).

Example: OMP_NUM_THREADS=1 python benchmarks/interrupted.py --seed 1 --loops 8
"""

import argparse
import math
import sys
from dataclasses import dataclass, field, replace
from itertools import pairwise

import numpy as np
from cases.case import FloatArray
from cases.loop import FAR
from cases.plant import FAMILIES, HeldPlant, log_uniform
from cases.setting import Loop, draw_loop, scaled
from online.judge import Judge, counted
from online.loop import WRITTEN, LostLoop, WatchedLoop, Watching, one_region, settings
from online.session import effects

from retuner.adaptive.signals.sample import LoopMode, LoopSample
from retuner.adaptive.supervision.decision import Action
from retuner.adaptive.supervision.state_file import remember, restore
from retuner.adaptive.trial.phase import TrialEvent
from retuner.schedule.gains import PidGains

KINDS = ("rare", "slow", "manual", "gap", "end", "telemetry", "restart", "frozen", "limit", "memory")
STEPS = 6
LENGTH_THETA = 60.0
DAY_S = 86400.0
THETA_S = {"rare": 300.0, "slow": 3 * 3600.0}
TOLD = {"end": TrialEvent.STOPPED, "telemetry": TrialEvent.LOST_TELEMETRY, "restart": TrialEvent.RESTARTED}
UNSEEN = {"gap": 20, "end": 20, "telemetry": 40}
IN_MANUAL = 20
FROZEN, PUSHED = (20, 400), (20, 100)
"""Samples for which a sensor stands still, and for which a load is beyond the output's range."""
DIES_EVERY = 150
"""Samples between two ends of a session, in the mean."""
ROOM, BEYOND = 5.0, 8.0
"""Room of the output about its resting point, over what holds the setpoint's step; and size of the load beyond it."""
EVIDENCE = frozenset({"undo_worse", "undo_runaway"})


@dataclass(slots=True)
class Count:
    """Counts of one kind."""

    loops: int = 0
    in_spec: int = 0
    interrupted: int = 0
    taken_back: int = 0
    less_robust: int = 0
    right_taken_back: int = 0
    worse: int = 0
    stories: list[str] = field(default_factory=list)


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
            by = THETA_S[kind] / loop.theta_s
            p = loop.process
            process = replace(
                p,
                k=p.k / by**p.integrators,
                lags_s=tuple(by * x for x in p.lags_s),
                quadratics=tuple((by * c1, by * by * c2) for c1, c2 in p.quadratics),
                **{
                    name: tuple(by * x for x in getattr(p, name)) for name in ("leads_s", "zeros_s") if hasattr(p, name)
                },
                theta_s=by * p.theta_s,
            )
            best = PidGains(loop.best.kp, loop.best.ki / by, loop.best.kd * by)
            loop = replace(loop, process=process, best=best, theta_s=by * loop.theta_s, dt_s=by * loop.dt_s)
        judge = Judge(loop.process, loop.dt_s, (loop.best, loop.theta_s))
        fast = (log_uniform(rng, 1.6, 3.0), 1 / log_uniform(rng, 1.0, 2.0))
        gains = scaled(loop.best, *(fast if aggressive else (1 / log_uniform(rng, 3.0, 5.0), 1.0)))
        if judge.of(loop.best).in_spec and (not aggressive or 2.1 < judge.of(gains).ms < math.inf):
            return loop, gains, judge


def run(kind: str, seed: int, index: int, count: Count) -> None:
    """One loop."""
    rng = np.random.default_rng([seed, index, KINDS.index(kind), 41])
    loop, gains, judge = drawn(kind, rng, aggressive=index % 2 == 0)
    watching = Interrupted(gains, loop.dt_s, kind, rng)
    plant = HeldPlant(loop.process, loop.dt_s)
    room = ROOM * judge.load_like_setpoint()
    low, high = (-room, room) if kind in {"frozen", "limit"} else (-FAR, FAR)
    watched = WatchedLoop(
        plant, watching.retuner.table, loop.dt_s, watching, low=low, high=high, sensor=watching.sensor
    )
    n = int((2 * DAY_S if kind == "rare" else LENGTH_THETA * loop.theta_s) / loop.dt_s)
    try:
        for i in range(STEPS):
            for noise in _pieces(0.01 * rng.standard_normal(n), 1 if kind == "limit" else n):
                watched.run(float(1 - i % 2), watching.pushed(BEYOND * room / ROOM), noise)
    except LostLoop:
        count.stories.append(f"{kind} {index}: lost")
    count.loops += 1
    count.interrupted += watching.happened
    count.in_spec += judge.of(watched.table.gains_of(0)).in_spec
    for one in effects(judge, watching):
        if one.worse and not one.restored:
            count.worse += 1
            count.stories.append(
                f"{kind} {index}: WORSE at {one.t_s:.6g} s, Ms {one.before.ms:.2f} -> {one.after.ms:.2f}, "
                f"J {one.before.j:.2f} -> {one.after.j:.2f}"
            )
    for (before, now), why in zip(pairwise(watching.ran), watching.why[1:], strict=True):
        if not why.startswith("undo_") or why in EVIDENCE:
            continue
        was, then = judge.of(before), judge.of(now)
        count.taken_back += 1
        count.less_robust += then.ms > max(1.01 * was.ms, 2.1)
        count.right_taken_back += was.in_spec and not then.in_spec
        count.stories.append(f"{kind} {index}: {why}, Ms {was.ms:.2f} -> {then.ms:.2f}, J {was.j:.2f} -> {then.j:.2f}")


def _pieces(noise: FloatArray, length: int) -> list[list[float]]:
    """The noise in pieces, between which the load may change."""
    return [noise[i : i + length].tolist() for i in range(0, len(noise), length)]


def main() -> int:
    """Print a line a kind."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--loops", type=int, default=8, help="of each kind; every second one begins sluggish")
    parser.add_argument("--kind", choices=("all", *KINDS), default="all")
    parser.add_argument("--verbose", action="store_true", help="tell what was taken back")
    options = parser.parse_args()
    lines = [
        f"interrupted trials, seed {options.seed}, {options.loops} loops a kind",
        f"{'kind':<11}{'interrupted':>12}{'taken back':>12}{'less robust':>13}{'right ones':>12}{'worse':>7}"
        "   in spec at the end",
    ]
    for kind in KINDS if options.kind == "all" else (options.kind,):
        count = Count()
        for index in range(options.loops):
            run(kind, options.seed, index, count)
        lines.append(
            f"{kind:<11}{count.interrupted:>12}{count.taken_back:>12}{count.less_robust:>13}"
            f"{count.right_taken_back:>12}{count.worse:>7}   {counted(count.in_spec, count.loops)}"
        )
        lines += count.stories if options.verbose else []
    sys.stdout.write("\n".join(lines) + "\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
