"""Deliberately bad changes: does the trial take them back, when, and what did they do meanwhile?

A loop in spec is given a bad set of gains, with a promise that is a lie of one of two kinds, half of the runs each:

wrong model   the bad set is SIMC of a wrong model, and the promise is that model's, as if identification were fooled
wrong set     the promise is the right model's for SIMC, but another set is in force, as if something went wrong later

The write comes while the loop is at rest. Setpoint and load steps in turn follow, the first one AT_REST samples later,
then one every 60 effective dead times. What puts it on trial, watches and judges is
retuner's own (adaptive/trial).

gain        Kc too large by 2.5 to 6: most of these loops are unstable
integral    tau_I too short by 4 to 10
both        Kc too large by 2 to 4 and tau_I too short by 2 to 4
sluggish    Kc too small by 4 to 10
mild        Kc too large by 1.5 to 2: out of spec, stable, and near enough to a promise to pass for kept
right       the settings are right, and replace Kc too small by 2 to 4 on a model that is off by up to 30 % in each
            number: the trial should take none back ("wrong model" in every run)

wander : a load of benchmarks/online/loads.py (walk, coloured, sinusoid, calm walk, ...) goes on all the time, before
the write too.

Time runs from the write to the moment at which the controller runs the old set again. Excursion is the largest
|sp - pv| in that time, over the same under the old set with the same upsets and noise.
"""

import math
import statistics
from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import product
from typing import Any

import numpy as np
from cases.case import share
from cases.plant import FAMILIES, HeldPlant, log_uniform
from cases.setting import Loop, draw_loop, scaled

from online.judge import Judge
from online.loads import PERIODS, load_of
from online.loop import FixedGains, LostLoop, WatchedLoop, Watching, one_region, settings
from online.runner import Task
from retuner import LinearProcess, LoopSample, PidGains, ProcessModel
from retuner.adaptive.identification.plausible import Plausible
from retuner.adaptive.process.reduction import half_rule
from retuner.adaptive.trial.load_variability import load_variability
from retuner.adaptive.trial.phase import TrialPhase
from retuner.adaptive.trial.prediction import predict

Row = dict[str, Any]
KINDS = ("gain", "integral", "both", "sluggish", "mild", "right")
LIES = ("wrong model", "wrong set")
UPSETS = 6
LENGTH_THETA = 60.0
SAMPLES_PER_THETA = 8
NOISE = 0.01
PV_SPAN = 10.0
AT_REST = 20  # Samples from the write to the first step
TRIES = 100
INEXACT = 1.3  # Factor by which the model of a right set may be off
LOST = 100.0  # A loop further from its setpoint than this many steps has been lost


@dataclass(frozen=True, slots=True)
class Injected:
    """A change. old, new : the sets. believed, said : the model and the set of the prediction."""

    old: PidGains
    new: PidGains
    believed: Plausible
    said: PidGains


class OnTrial(Watching):
    """Retuner, live, with one change put on trial that it did not decide."""

    def __init__(self, gains: PidGains, dt_s: float) -> None:
        super().__init__(one_region(gains), settings(dt_s, PV_SPAN))
        self.t_s = 0.0
        self.due: PidGains | None = None
        self.restored_s: float | None = None
        self.cause = ""
        self.passed = False

    def inject(self, change: Injected) -> None:
        """Put a set on trial with the promise that a model makes for the set that it is said to be."""
        old = self.retuner.table.gains_of(0)
        promised = predict([change.believed], old, change.said, self.retuner.settings.sample_time_s)
        wander, moved = load_variability(self.retuner.state().finder.samples)
        promised = replace(promised, wander=wander, moved=moved)
        self.retuner.trials.begin(0, old, change.new, promised, self.t_s)
        self.due = change.new

    def observe(self, sample: LoopSample) -> tuple[int, PidGains] | None:
        """As live; after the trial of the injected set nothing more is written, so that what follows is its doing."""
        self.t_s = sample.t_s
        if self.due is not None:
            due, self.due = self.due, None
            self.retuner.observe(sample)
            return 0, due
        before = self.retuner.trials.phase(0)
        wish = super().observe(sample)
        after = self.retuner.trials.phase(0)
        self.passed |= before is TrialPhase.TRIAL and after in {TrialPhase.IDLE, TrialPhase.WRITING}
        if self.decided:
            return None
        return wish

    @property
    def decided(self) -> bool:
        """Whether the trial is over."""
        return self.passed or self.restored_s is not None

    def written(self, region: int, gains: PidGains) -> None:
        """As read back."""
        restoring = self.retuner.trials.phase(0) is TrialPhase.RESTORING
        if restoring:
            self.cause, self.restored_s = str(self.retuner.trials.of(0).cause), self.t_s
            self.retuner.restored()
        else:
            self.retuner.committed(region, gains)


def run(task: Task) -> Row:
    """One injected change; keys rolled_back, passed, theta (time in effective dead times), loops, excursion, cause."""
    rng = np.random.default_rng([task.seed, task.index, KINDS.index(task.kind), 32])
    loop, change = drawn(task.kind, rng, LIES[task.index % len(LIES)])
    judge = Judge(loop.process, loop.dt_s, (loop.best, loop.theta_s))
    trial = OnTrial(change.old, loop.dt_s)
    n = int(LENGTH_THETA * SAMPLES_PER_THETA)
    noise = [(NOISE * rng.standard_normal(n)).tolist() for _ in range(UPSETS + 1)]
    load = judge.load_like_setpoint()
    loads = np.zeros((UPSETS + 1, n))
    if task.wander:
        more = math.ceil(n * (UPSETS + 1) / PERIODS)
        loads = load * load_of(task.wander, rng, more, SAMPLES_PER_THETA)[: loads.size].reshape(loads.shape)
    course = Course(noise, loads.tolist(), load)
    tried = watched(loop, trial, course, change)
    usual = watched(loop, None, course, change)
    upto = len(tried) if trial.restored_s is None else int(trial.restored_s / loop.dt_s)
    excursion = max(tried[:upto], default=0.0) / max(usual[: max(upto, n + 1)], default=1.0)
    back = trial.restored_s is not None
    took_s = trial.restored_s - (n - AT_REST) * loop.dt_s if trial.restored_s is not None else math.nan
    verdict = judge.of(change.new)
    return {
        "part": "injected",
        "kind": task.kind,
        "lie": "wrong model" if change.said == change.new else "wrong set",
        "wander": task.wander,
        "seed": task.seed,
        "index": task.index,
        "family": loop.family,
        "ms": verdict.ms,
        "j": verdict.j,
        "rolled_back": back,
        "passed": trial.passed and not back,
        "phase": str(trial.retuner.trials.phase(0)),
        "cause": trial.cause,
        "lost": tried[-1] >= LOST,
        "theta": took_s / loop.theta_s,
        "upsets": took_s / (n * loop.dt_s),
        "excursion": excursion,
        "verified": trial.retuner.table.gains_of(0) == change.old,
    }


def drawn(kind: str, rng: np.random.Generator, lie: str) -> tuple[Loop, Injected]:
    """A loop in spec and a bad set with its lie; or a sluggish loop and the right set."""
    for _ in range(TRIES):
        family = str(rng.choice([x for x in FAMILIES if x != "oscillatory"]))
        loop = draw_loop(rng, family, (SAMPLES_PER_THETA, SAMPLES_PER_THETA + 1e-9))
        # On Kc and tau_I
        kc, tau_i = {
            "gain": lambda: (log_uniform(rng, 2.5, 6.0), 1.0),
            "integral": lambda: (1.0, 1 / log_uniform(rng, 4.0, 10.0)),
            "both": lambda: (log_uniform(rng, 2.0, 4.0), 1 / log_uniform(rng, 2.0, 4.0)),
            "sluggish": lambda: (1 / log_uniform(rng, 4.0, 10.0), 1.0),
            "mild": lambda: (log_uniform(rng, 1.5, 2.0), 1.0),
            "right": lambda: (1 / log_uniform(rng, 2.0, 4.0), 1.0),
        }[kind]()
        model = half_rule(loop.process)
        if tau_i < 1 and not model.tau1_s:
            continue  # no wrong lag makes an integrating process ask for a short tau_I
        judge = Judge(loop.process, loop.dt_s, (loop.best, loop.theta_s))
        bad = scaled(loop.best, kc, tau_i)
        if kind == "right" and judge.of(loop.best).in_spec:
            k, theta, tau1, tau2 = (log_uniform(rng, 1 / INEXACT, INEXACT) for _ in range(4))
            tau1_s = model.tau1_s * tau1
            tau2_s = min(model.tau2_s * tau2, tau1_s) if tau1_s else model.tau2_s * tau2
            inexact = replace(model, k=model.k * k, theta_s=model.theta_s * theta, tau1_s=tau1_s, tau2_s=tau2_s)
            return loop, Injected(bad, loop.best, Plausible(inexact, 0.0), loop.best)
        if judge.of(loop.best).in_spec and not judge.of(bad).in_spec:
            if lie == "wrong set":
                return loop, Injected(loop.best, bad, Plausible(model, 0.0), loop.best)
            return loop, Injected(loop.best, bad, Plausible(_wrong(model, kc, tau_i), 0.0), bad)
    raise RuntimeError(f"no loop fits {kind} in {TRIES} draws")


def _wrong(model: ProcessModel, kc: float, tau_i: float) -> ProcessModel:
    """A model on which kc times too much gain and tau_i times the integral time look as SIMC does on the true one."""
    if tau_i == 1.0:
        return replace(model, k=model.k / kc)
    return replace(model, k=model.k * tau_i / kc, tau1_s=model.tau1_s * tau_i, theta_s=model.theta_s * tau_i)


@dataclass(frozen=True, slots=True)
class Course:
    """noise, loads : a stretch between two steps each. load : size of a load step."""

    noise: list[list[float]]
    loads: list[list[float]]
    load: float

    def stretches(self) -> Iterator[tuple[list[float], list[float]]]:
        """Noise and load; the write comes after the first of them."""
        yield self.noise[0][:-AT_REST], self.loads[0][:-AT_REST]
        yield self.noise[0][-AT_REST:], self.loads[0][-AT_REST:]
        yield from zip(self.noise[1:], self.loads[1:], strict=True)


def watched(loop: Loop, trial: OnTrial | None, course: Course, change: Injected) -> list[float]:
    """|sp - pv| without noise of every sample, the change written at the end of the first of the stretches."""
    process: LinearProcess = loop.process
    supervisor = trial or FixedGains()
    watched_loop = WatchedLoop(HeldPlant(process, loop.dt_s), one_region(change.old), loop.dt_s, supervisor, lost=LOST)
    errors: list[float] = []
    sp = now = 0.0
    try:
        for i, (stretch, wanders) in enumerate(course.stretches()):
            if i == 1 and trial:
                trial.inject(change)
            if i > 1:
                sp, now = (sp, course.load - now) if i % 2 else (1.0 - sp, now)
            trace = watched_loop.run(sp, [now + more for more in wanders], stretch)
            errors += [abs(sp - pv + more) for (pv, _), more in zip(trace, stretch, strict=True)]
            if trial and trial.decided:
                break
    except LostLoop:
        errors.append(LOST)
    return errors


def line(row: Row) -> str:
    """A change that was not taken back, or did much, for people."""
    if row["rolled_back"] and row["excursion"] < 5:
        return ""
    ms = f"Ms {row['ms']:.2f}" if math.isfinite(row["ms"]) else "unstable"
    head = f"{row['kind']} {row['index']} {row['lie']} {row['family']}: {ms} J {row['j']:.2f} {row['phase']}"
    return f"{head} {row['cause']} {row['theta']:.0f} dead times, excursion {row['excursion']:.1f}"


def table(rows: list[Row]) -> list[str]:
    """A line a kind."""
    lines = [
        f"{'kind':<10}{'lie':<12}{'changes':>8}{'unstable':>9}{'passed':>8}{'lost':>6}{'median':>9}"
        f"{'90 %':>7}{'most':>7} dead times{'median':>9}{'most':>7} excursion   rolled back"
    ]
    for kind, lie in product(KINDS, LIES):
        of = [row for row in rows if (row["kind"], row["lie"]) == (kind, lie)]
        if not of:
            continue
        back = [row for row in of if row["rolled_back"]]
        times = sorted(row["theta"] for row in back) or [math.nan]
        peaks = [row["excursion"] for row in of]
        lines.append(
            f"{kind:<10}{lie:<12}{len(of):>8}{sum(math.isinf(r['ms']) for r in of):>9}{sum(r['passed'] for r in of):>8}"
            f"{sum(r['lost'] for r in of):>6}{statistics.median(times):>9.0f}{times[int(0.9 * (len(times) - 1))]:>7.0f}"
            f"{times[-1]:>7.0f}{'':11}{statistics.median(peaks):>9.1f}{max(peaks):>7.1f}{'':13}"
            f"{share(len(back), len(of))}"
        )
    wrong = sum(row["rolled_back"] and not row["verified"] for row in rows)
    lines.append(f"restored to anything but the verified set: {wrong}")
    return lines
