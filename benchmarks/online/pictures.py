"""The pictures of docs/developers/online.md: what a run looks like, and the shares that the tables have."""

from pathlib import Path
from typing import Any

import numpy as np
from cases.counting import interval
from cases.plant import HeldPlant
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from online import batch, injected, walks
from online.judge import Judge, Judgement
from online.loop import FixedGains, WatchedLoop
from online.runner import rows_of
from online.supervisors import Watching, one_region, settings
from retuner.adaptive.supervision.decision import Action
from retuner.schedule.gains import PidGains

Row = dict[str, Any]
WIDTH, DPI = 8.0, 110
EXAMPLE = ("P7 T=2 L=0.3", (4.0, 1.0), (0.25, 4.0))
"""Process and two wrong starts of the picture of a run."""


def shares(opened: list[Row], usual: list[Row], path: Path) -> None:
    """In spec and staying after each number of disturbances, everybody in one picture."""
    figure = Figure(figsize=(WIDTH, 3.6), layout="constrained")
    axes = figure.subplots()
    n = range(1, batch.DISTURBANCES + 1)
    curves = {
        "retuner, changes up to x8": [r["spec"] for r in opened],
        "retuner, default limits": [r["spec"] for r in usual],
    }
    for who in ("simc once", "pattern", "relay once", "fixed"):
        curves[who] = [r["rivals"][who] for r in (*opened, *usual) if who in r["rivals"]]
    for i, (name, runs) in enumerate(curves.items()):
        if not runs:
            continue
        hits = [sum(all(run[k - 1 :]) for run in runs) for k in n]
        bounds = np.array([interval(hit, len(runs)) for hit in hits])
        axes.plot(
            n, [hit / len(runs) for hit in hits], marker="o", ms=4, label=f"{name} ({len(runs)} runs)", color=f"C{i}"
        )
        axes.fill_between(n, bounds[:, 0], bounds[:, 1], alpha=0.12, color=f"C{i}", lw=0)
    axes.set(
        xlabel="disturbances",
        ylabel="in spec, and staying",
        ylim=(-0.02, 1.02),
        title="The batch of 134 processes, gains off by up to 4, 1 % noise",
    )
    axes.title.set_fontsize(9)
    axes.legend(fontsize=7, loc="center left", bbox_to_anchor=(1.0, 0.5))
    axes.grid(alpha=0.3)
    figure.savefig(path, dpi=DPI)


def example(path: Path, seed: int = 7) -> None:
    """Two runs of the batch, from too much and from too little action: pv, co, and what was written."""
    figure = Figure(figsize=(WIDTH, 5.2), layout="constrained")
    grid = figure.subplots(2, 2, sharex="col", height_ratios=[3, 2])
    member = next(m for m in batch.batch() if m.name == EXAMPLE[0])
    for column, start in enumerate(EXAMPLE[1:]):
        _example(member, start, seed, grid[0][column], grid[1][column])
    figure.savefig(path, dpi=DPI)


def _example(member: batch.Member, start: tuple[float, float], seed: int, above: Axes, below: Axes) -> None:
    judge = Judge(member.process, Judge.theta(member.process) / batch.SAMPLES_PER_THETA)
    gains = PidGains(judge.best.kp * start[0], judge.best.ki * start[0] / start[1])
    watching = Watching(one_region(gains), settings(judge.dt_s, batch.PV_SPAN))
    loop = WatchedLoop(HeldPlant(member.process, judge.dt_s), watching.retuner.table, judge.dt_s, watching)
    rng = np.random.default_rng(seed)
    n = int(batch.LENGTH_THETA * batch.SAMPLES_PER_THETA * max(1.0, 1 / start[0]))
    trace, sps, sp, load, size = [], [], 0.0, 0.0, judge.load_like_setpoint()
    for i in range(5):
        if i:
            sp, load = (1.0 - sp, load) if i % 2 else (sp, size - load)
        noise = (batch.NOISE * rng.standard_normal(n if i else batch.REST_SAMPLES)).tolist()
        trace += loop.run(sp, load, noise)
        sps += [sp] * len(noise)
    t = np.arange(1, len(trace) + 1) * judge.dt_s
    above.plot(t, [pv for pv, _ in trace], lw=0.8)
    above.plot(t, sps, lw=0.8, color="C1")
    below.plot(t, [co for _, co in trace], lw=0.7, color="C2")
    for i, d in enumerate(d for d in watching.writes if d.gains_after is not None):
        word = "put back" if d.action == Action.RESTORE else f"change {i + 1}"
        _mark(above, below, d.t_s, f"{word}: {_words(judge.of(d.gains_after))}", i)
    above.legend(fontsize=7)
    above.set_title(
        f"{member.name}: Kc x {start[0]:g}, tau_I x {start[1]:g} ({_words(judge.of(gains))})", fontsize=8, loc="left"
    )
    _labels(above, below)


def put_back(path: Path, task: injected.Task) -> None:
    """A bad change on trial, and the verified set again."""
    figure = Figure(figsize=(WIDTH, 4.0), layout="constrained")
    above, below = figure.subplots(2, 1, sharex=True, height_ratios=[3, 2])
    rng = np.random.default_rng([task.seed, task.index, injected.KINDS.index(task.kind), 32])
    loop, bad, wrong = injected.drawn(task.kind, rng)
    judge = Judge(loop.process, loop.dt_s, (loop.best, loop.theta_s))
    trial, size = injected.OnTrial(loop.best, loop.dt_s), judge.load_like_setpoint()
    watched = WatchedLoop(HeldPlant(loop.process, loop.dt_s), one_region(loop.best), loop.dt_s, trial)
    n, trace, sps, sp, load = int(25 * injected.SAMPLES_PER_THETA), [], [], 0.0, 0.0
    before = n - injected.AT_REST
    for i, length in enumerate((before, injected.AT_REST, n, n, n)):
        if i == 1:
            trial.inject(bad, wrong, bad)
        if i > 1:
            sp, load = (sp, size - load) if i % 2 else (1.0 - sp, load)
        trace += watched.run(sp, load, (injected.NOISE * rng.standard_normal(length)).tolist())
        sps += [sp] * length
    t = np.arange(1, len(trace) + 1) * loop.dt_s / loop.theta_s
    above.plot(t, [pv for pv, _ in trace], lw=0.8)
    above.plot(t, sps, lw=0.8)
    below.plot(t, [co for _, co in trace], lw=0.8, color="C2")
    _mark(above, below, before * loop.dt_s / loop.theta_s, "bad set written", 0)
    if trial.restored_s is not None:
        _mark(above, below, trial.restored_s / loop.theta_s, f"put back: {trial.cause}", 1)
    above.legend(fontsize=7)
    title = f"Kc and tau_I both wrong, {_words(judge.of(bad))}: put on trial, taken back"
    above.set_title(title, fontsize=8, loc="left")
    _labels(above, below)
    below.set_xlabel("effective dead times", fontsize=7)
    figure.savefig(path, dpi=DPI)


def walk(path: Path, task: walks.Task) -> None:
    """A walk under fixed gains and under retuner, its last part, and the gains over the range."""
    figure = Figure(figsize=(WIDTH, 5.4), layout="constrained")
    above, middle, below = figure.subplots(3, 1, height_ratios=[3, 3, 3])
    drawn = walks.Walk.drawn(task)
    same = walks.table_of([drawn.best(50.0)] * len(walks.NAMES))
    watching = Watching(same, settings(drawn.dt_s, 100.0))
    last = 8
    for axes, (name, who) in zip((above, middle), {"fixed": FixedGains(), "retuner": watching}.items(), strict=True):
        loop = WatchedLoop(
            drawn.plant(drawn.sps[0]), same, drawn.dt_s, who, co0=drawn.process.rest(drawn.sps[0]), sp0=drawn.sps[0]
        )
        traces = [loop.run(sp, 0.0, noise) for sp, noise in zip(drawn.sps, drawn.noise, strict=True)][-last:]
        pv = [pv for trace in traces for pv, _ in trace]
        t = np.arange(len(pv)) * drawn.dt_s
        axes.plot(t, np.repeat(drawn.sps[-last:], len(traces[0])), lw=0.8, color="C1")
        axes.plot(t, pv, lw=0.8)
        axes.set_title(f"{name}: the last {last} of {len(drawn.sps)} setpoints", fontsize=8, loc="left")
        axes.tick_params(labelsize=7)
    y = np.linspace(0, 100, 101)
    below.semilogy(y, [abs(drawn.best(float(x)).kp) for x in y], label="SIMC with perfect knowledge", color="C4")
    for gains, name, colour in ((same, "before", "C7"), (watching.retuner.table, "retuner, after the walk", "C0")):
        kp = [abs(gains.gains[min(int(x // 25), 3)].kp) for x in y]
        below.step(y, kp, where="mid", label=name, color=colour)
    below.set_xlabel("pv, % of its range", fontsize=7)
    below.set_ylabel("|Kc|", fontsize=7)
    below.legend(fontsize=7)
    below.tick_params(labelsize=7)
    figure.savefig(path, dpi=DPI)


def _words(found: Judgement) -> str:
    return f"Ms {found.ms:.2f}, J {found.j:.2f}" if np.isfinite(found.ms) else "unstable"


def _mark(above: Axes, below: Axes, at: float, word: str, i: int) -> None:
    """A moment in both parts, named in the legend."""
    above.axvline(at, color=f"C{3 + i}", lw=1, ls="--", label=word)
    below.axvline(at, color=f"C{3 + i}", lw=1, ls="--")


def _labels(above: Axes, below: Axes) -> None:
    above.set_ylabel("pv and setpoint", fontsize=7)
    below.set_ylabel("co", fontsize=7)
    below.set_xlabel("time, s", fontsize=7)
    for axes in (above, below):
        axes.tick_params(labelsize=7)


def draw(folder: Path, files: list[Path]) -> list[Path]:
    """All pictures; files : rows of the batch, with opened and with default limits."""
    rows = [row for file in files for row in rows_of(file)]
    folder.mkdir(parents=True, exist_ok=True)
    names = [folder / f"online-{name}.png" for name in ("batch", "run", "walk", "undo")]
    shares([r for r in rows if r["opened"]], [r for r in rows if not r["opened"]], names[0])
    example(names[1])
    walk(names[2], walks.Task(1, 0, 30))
    put_back(names[3], injected.Task("both", 1, 0))
    return names
