"""Run one story sample by sample, and say what is true of every change that was made."""

import argparse
import math
import re
import sys
import traceback
from collections import deque
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from statistics import median
from time import process_time
from typing import Any

import numpy as np
from online.runner import collect

from retuner import Action, PidGains
from unlike_ours.controllers import ByController, ByOwnLoop
from unlike_ours.live import PlantLive
from unlike_ours.story import DISTURBANCES, NAMES, Event, Rng, Story, draw
from unlike_ours.truth import J_LIMIT, Truth

Row = dict[str, Any]
NOTICED, NOTICED_J = 1.01, 1.02  # Growth by less than these factors is no harm
LEFT = 30.0  # Ranges of pv from which the loop is lost
LONGEST_SENTENCE = 900


@dataclass(frozen=True)
class Task:
    """A story to run."""

    name: str
    seed: int
    index: int
    verbose: bool = False


def tasks(seed: int, loops: int, names: tuple[str, ...] = NAMES, *, verbose: bool = False) -> list[Task]:
    return [Task(name, seed, index, verbose) for index in range(loops) for name in names]


def run(task: Task) -> Row:
    """One story; what it raises is part of the row."""
    began, story = process_time(), draw(task.name, task.seed, task.index)
    streamed = Streamed(story, np.random.default_rng([task.seed, NAMES.index(task.name), task.index, 7]))
    row: Row = {"part": "unlike", "name": task.name, "seed": task.seed, "index": task.index, "own": story.own}
    try:
        streamed.run()
        error = ""
    except Exception:  # noqa: BLE001  any is a fault that is counted
        error = traceback.format_exc(limit=-3)
    told = list(judged(streamed))
    row |= {"start": streamed.begun, "end": streamed.now(), "spec": streamed.spec, "error": error, "told": told}
    row |= {"seconds": [k.seconds for k in streamed.session.kept if k.seconds], "cpu": process_time() - began}
    row["odd"] = [odd for k in streamed.session.kept for odd in oddities(str(k.decision))]
    row["log"] = [f"{k.t:.6g} s {k.decision.code}: {k.decision}" for k in streamed.session.kept] if task.verbose else []
    return row


class Streamed:
    """A story in motion. spec : whether the gains are in spec, before each disturbance but the first and at the end."""

    def __init__(self, story: Story, rng: Rng) -> None:
        self.story, self.rng = story, rng
        self.plant = PlantLive(story)
        self.session = (ByOwnLoop if story.own else ByController)(story.setup())
        self.t, self.sp, self.d, self.co = 0.0, story.start_pv, 0.0, story.co_start
        self.spec: list[bool] = []
        self.seen = 0
        self.moving: list[tuple[Event, float]] = []
        self.manual: tuple[float, float] = (-1.0, 0.0)
        self.begun = self.now()

    def now(self) -> tuple[float, float]:
        """Ms and J of the gains that run, here and now."""
        found = self._truth().of(self.story.tuned(self.session.gains))
        return found.ms, found.j

    def _truth(self) -> Truth:
        return self.plant.truth(self.t, self.sp)

    def _in_spec(self) -> bool:
        return self._truth().in_spec(self.story.tuned(self.session.gains))

    def run(self) -> None:
        """To its end, or until the loop is lost."""
        s, events = self.story, deque(self.story.events)
        n = int(s.length / s.dt)
        noise = s.noise(self.rng, n)
        for i in range(n):
            dt = self._elapsed()
            pv = self.plant.move(self.co, self.d, dt)
            self.t += dt
            if abs(pv - s.start_pv) > LEFT * s.span:
                break
            while events and events[0].t <= self.t:
                self._happens(events.popleft())
            # ramps and pulses that are under way
            for event, began in list(self.moving):
                over = self.t > began + event.over
                step = event.size / event.over * self.story.dt
                if over:
                    self.moving.remove((event, began))
                    self.d -= event.size if event.kind == "pulse" else 0.0
                elif event.kind == "ramp":
                    self.sp += step
                elif event.kind == "slope":
                    self.d += step
            shown = pv + noise[i]
            shown = round(shown / s.resolution) * s.resolution if s.resolution else shown
            manual = self.manual[1] if self.t < self.manual[0] else None
            self.co = self.session.step(self.t, self.sp, float(shown), dt, manual)
        self.spec.append(self._in_spec())
        self.session.end(self.t)

    def _elapsed(self) -> float:
        s, h = self.story, self.story.dt / self.story.sub
        dt = s.dt
        if s.jitter:
            dt = max(1, round(dt * (1 + s.jitter * self.rng.uniform(-1, 1)) / h)) * h
        while s.lost and self.rng.uniform() < s.lost:
            dt += s.dt
        return float(dt)

    def _happens(self, event: Event) -> None:
        if event.kind in DISTURBANCES:
            self.spec += [self._in_spec()] if self.seen else []
            self.seen += 1
        if event.kind in {"ramp", "slope", "pulse"}:
            self.moving.append((event, self.t))
        if event.kind == "sp":
            self.sp += event.size
        elif event.kind in {"load", "pulse"}:
            self.d += event.size
        elif event.kind == "manual":
            self.manual = (self.t + event.over, self.co + 0.03 * (self.story.co_range[1] - self.story.co_range[0]))
        elif event.kind == "edit":
            g = self.session.gains
            self.session.edit(self.t, PidGains(g.kp * event.size, g.ki * event.size, g.kd * event.size))
        elif event.kind == "restart":
            self.session.restart(self.t)


def judged(streamed: Streamed) -> Iterator[Row]:
    """The changes that retuner made, each with what is true of it."""
    for kept in streamed.session.kept:
        moved = any(
            abs(b - a) > NOTICED_J * abs(a) - abs(a)
            for a, b in zip(_numbers(kept.before), _numbers(kept.after), strict=True)
        )
        if moved and "edit" not in kept.decision.code:
            story, decision = streamed.story, kept.decision
            truth = streamed.plant.truth(kept.t, kept.sp)
            old, new = (story.tuned(gains) for gains in (kept.before, kept.after))
            before, after = truth.of(old), truth.of(new)
            lost = truth.in_spec(old) and not truth.in_spec(new)
            # J grew and is over its limit, and no Ms over its own was lowered by it
            rescued = before.ms > truth.ms_limit and after.ms < before.ms
            yield {
                "t": kept.t,
                "code": decision.code,
                "before": (before.ms, before.j),
                "after": (after.ms, after.j),
                "promised": promised(str(decision)),
                "unstable": math.isinf(after.ms) and math.isfinite(before.ms),
                "ms_worse": after.ms > NOTICED * before.ms and after.ms > truth.ms_limit,
                "j_worse": (after.j > max(NOTICED_J * before.j, J_LIMIT) and not rescued),
                "right_changed": truth.in_spec(old) and decision.action is Action.WRITE,
                "right_lost": lost,
                "right_back": lost and decision.action is Action.RESTORE,
            }


def _numbers(gains: PidGains) -> tuple[float, float, float]:
    return gains.kp, gains.ki, gains.kd


def promised(said: str) -> float | None:
    """The Ms that a change promises on the most likely model; None where the sentence has none."""
    found = re.search(r"Ms (?:[\d.]+|unstable) -> ([\d.]+)", said)
    return float(found.group(1).rstrip(".")) if found else None


def oddities(said: str) -> list[str]:
    """What contradicts itself in a decision's sentence, or is no word; as far as a pattern sees it."""
    odd = []
    for pattern in (
        r"requested ([\d.]+\d), limit ([\d.]+\d)",
        r"by a factor of ([\d.]+\d) \(limit ([\d.]+\d)\)",
        r"known to a factor of ([\d.]+\d); ([\d.]+\d) is needed",
    ):
        found = re.search(pattern, said)
        odd += [said] if found and float(found.group(1)) <= float(found.group(2)) else []
    odd += [said] if re.search(r"\b(nan|inf|None)\b", said) or len(said) > LONGEST_SENTENCE else []
    return odd


# ---- Retuner streamed on loops unlike those of the other benchmarks, through the public interface alone.
#
# The simulator (process.py), the truth (truth.py), the controllers (controllers.py) and the stories (story.py) share
# nothing with the rest of benchmarks/. Each story is a loop with eight disturbances at irregular times, in mode auto,
# with the default limits. Truth is Ms and J of the exact process. In spec: Ms at most 1.8 (or 1.03 of the reference's),
# J at most 1.25 of the reference's, the PI controller of least J at Ms 1.55.
#
# Examples
# --------
#   OPENBLAS_NUM_THREADS=1 python benchmarks/unlike_ours --seed 1 --loops 2 --jobs 1
#   python benchmarks/unlike_ours --seed 1 --loops 1 --only ringing derivative --verbose

AFTER = (1, 3, 6)
HARM = ("unstable", "ms_worse", "j_worse", "right_changed", "right_lost", "right_back")
HEADS = f"{'story':<15}{'loops':>6}{'in spec after 1, 3, 6, at the end':>36}  changes; {', '.join(HARM)}; errors, odd"


def main() -> int:
    parser = argparse.ArgumentParser(
        prog="benchmarks/unlike_ours", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--loops", type=int, default=2, help="of each story (2)")
    parser.add_argument("--only", nargs="+", default=NAMES, choices=NAMES, metavar="STORY", help=", ".join(NAMES))
    parser.add_argument("--every", type=int, default=1, help="only every n-th run")
    parser.add_argument("--offset", type=int, default=0, help="and the first of these")
    parser.add_argument("--jobs", type=int, default=None)
    parser.add_argument("--out", type=Path, metavar="FILE", help="every run as a line of JSON")
    parser.add_argument("--verbose", action="store_true", help="tell every decision")
    options = parser.parse_args()
    names = tuple(options.only)
    todo = tasks(options.seed, options.loops, names, verbose=options.verbose)[options.offset :: options.every]
    rows, whole = collect(run, todo, options.jobs, options.out, line)
    print(f"unlike ours, seed {options.seed}", *table(rows), sep="\n")
    return 0 if rows and whole else 1


def line(row: Row) -> str:
    (ms, j), (ms_end, j_end) = row["start"], row["end"]
    spec = "".join("#" if good else "." for good in row["spec"])
    told = [f"{name} {n}" for name in HARM if (n := count([row], name))]
    said = [*told, *([row["error"]] if row["error"] else []), *row["odd"], *row["log"]]
    ends = f"Ms {ms:.2f} J {j:.2f} -> Ms {ms_end:.2f} J {j_end:.2f}"
    head = f"{row['name']:<15}{row['index']:>3}  {ends}  {spec:<8}  changes {len(row['told'])}  {row['cpu']:.0f} s"
    return "\n    ".join([head, *said])


def count(rows: Sequence[Row], name: str) -> int:
    """Changes of which this is true."""
    return sum(change[name] for row in rows for change in row["told"])


def table(rows: Sequence[Row]) -> list[str]:
    groups = [(name, [row for row in rows if row["name"] == name]) for name in NAMES]
    return [HEADS, *(_line(name, group) for name, group in [*groups, ("all", rows)] if group), *_promises(rows)]


def staying(row: Row, n: int) -> bool:
    """In spec after so many disturbances and after every later one."""
    return bool(row["spec"]) and all(row["spec"][n - 1 :])


def _line(name: str, rows: Sequence[Row]) -> str:
    spec = " ".join(f"{sum(staying(row, n) for row in rows):>7}" for n in AFTER)
    spec += f" {sum(bool(row['spec']) and row['spec'][-1] for row in rows):>7}"
    harm = ", ".join(str(count(rows, what)) for what in HARM)
    changes, errors = sum(len(row["told"]) for row in rows), sum(bool(row["error"]) for row in rows)
    return f"{name:<15}{len(rows):>6}{spec:>36}  {changes:>7}; {harm}; {errors}, {sum(len(row['odd']) for row in rows)}"


def _promises(rows: Sequence[Row]) -> list[str]:
    """True Ms over the promised one, and what decisions take."""
    told = [change for row in rows for change in row["told"] if change["promised"] and not change["unstable"]]
    ratios = sorted(change["after"][0] / change["promised"] for change in told)
    seconds = sorted(second for row in rows for second in row["seconds"])
    if not ratios or not seconds:
        return []
    return [
        f"true Ms over promised: median {median(ratios):.2f}, largest {ratios[-1]:.2f}, of {len(ratios)} changes",
        f"a decision: median {median(seconds):.2f} s, largest {seconds[-1]:.1f} s, of {len(seconds)}",
    ]


if __name__ == "__main__":
    sys.exit(main())
