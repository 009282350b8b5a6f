"""Tours of nonlinear plants with retuner in charge: how many visits does a region need, and what teaches?

Plants: drawn ones (schedules/records.py), one kind of them the same everywhere (constant), and from physics. Four
regions along pv, equally wide (the demo's oven has its own three, and its own gains). The setpoint goes to a new random
place and stays there for HOLD_THETA dead times of the middle; all watch the same places with the same noise. Starts:

middle    SIMC with perfect knowledge of the middle of the range, in every region
quarter   a quarter of all gains that SIMC with perfect knowledge of each region's centre gives
own       the gains of the demo (oven only)

Counted are responses, and those of them that taught; regions whose set is in spec on the process linearised at their
centre from their first, second, third, fourth visit on, of those that were visited so often. Some have no such set
that the guard may let through: SIMC with perfect knowledge of their centre has Ms over 2.1 at their own boundary, and
is too slow for the centre where it is eased to 2.1. Those that have are counted apart, and the places in them. Then
places in spec and IAE (noise aside) from the second third on, beside a table of SIMC with perfect knowledge of each
centre; changes that made Ms too large, or a region unstable, at its centre; the largest Ms of what runs at any of
PROBES places in the end, beside that of the perfect table.
"""

import math
import statistics
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from cases.case import share
from schedules import physics, records
from schedules.subject import Live, Subject

from online.judge import Judge, effect
from online.loop import FixedGains, LostLoop, Supervisor, WatchedLoop, Watching, settings
from online.runner import Task
from retuner import GainTable, Lookup, PidGains, Regions
from retuner.adaptive.guard.guard_settings import GuardSettings

Row = dict[str, Any]
WHO = ("fixed", "retuner", "perfect")
SMOOTH = "smooth"
DRAWN = (SMOOTH, "constant")
KINDS = (*DRAWN, "tank", "ph", "reactor", "drive", "oven")
REGIONS = 4
HOLD_THETA, MOST_SAMPLES = 80.0, 2500
NEAREST, FARTHEST = 0.04, 0.3  # Size of a step, in shares of the range
VISITS = 4
PROBES = 17
EASED = (1.0, 0.97, 0.94, 0.9, 0.85, 0.8, 0.75, 0.7)
"""Shares of the gains of SIMC with perfect knowledge that are tried for a region that these are too much for."""
OVEN_BOUNDS, OVEN_GAINS = (90.0, 150.0), ((0.22, 260.0), (4.2, 70.0), (0.85, 330.0))
"""As in examples/oven.toml: Kc and tau_I."""


class _Deviation:
    """A plant in absolute values, about where it rests (see loop.Moved)."""

    def __init__(self, live: Live, y0: float, co0: float) -> None:
        self._live, self._y0, self._co0 = live, y0, co0

    def move(self, u: float) -> float:
        """Hold co0 + u for one sample."""
        return self._live.move(self._co0 + u, self._y0) - self._y0


@dataclass(frozen=True, slots=True)
class Tour:
    """What all see: the plant, the table's regions, the places with their noise, and the judges at them."""

    subject: Subject
    regions: Regions
    sps: list[float]
    noise: list[list[float]]
    judges: list[Judge]
    centres: list[Judge]

    @staticmethod
    def drawn(task: Task) -> "Tour":
        """From its seed."""
        rng = np.random.default_rng([task.seed, task.index, 40])
        subject = records.draw(rng, task.kind, 4.0) if task.kind in DRAWN else physics.MAKERS[task.kind]()
        low, high = subject.low, subject.high
        inside = [low + (high - low) * i / REGIONS for i in range(1, REGIONS)]
        bounds = OVEN_BOUNDS if subject.name == "oven" else tuple(inside)
        hysteresis = max(0.005 * (high - low), 4 * subject.noise)
        names = tuple(f"r{i + 1}" for i in range(len(bounds) + 1))
        regions, span = Regions("pv", "-", names, low, bounds, high, hysteresis), subject.high - subject.low
        rim = 0.05 * span
        sps = [float(rng.uniform(subject.low + rim, subject.high - rim))]
        while len(sps) < task.places:
            sp = sps[-1] + span * float(rng.uniform(NEAREST, FARTHEST)) * float(rng.choice([-1, 1]))
            sps += [sp] if subject.low + rim <= sp <= subject.high - rim else []
        thetas = [Judge.theta(subject.local(y)) for y in subject.places(9)]
        n = min(int(HOLD_THETA * statistics.median(thetas) / subject.dt_s), MOST_SAMPLES)
        noise = [(subject.noise * rng.standard_normal(n)).tolist() for _ in sps]
        judges = [Judge(subject.local(sp), subject.dt_s) for sp in sps]
        centres = [Judge(subject.local(regions.centre(i)), subject.dt_s) for i in range(len(regions))]
        return Tour(subject, regions, sps, noise, judges, centres)

    def start(self, task: Task) -> list[PidGains]:
        """One set a region."""
        if task.start == "own":
            return [PidGains(kc, kc / tau_i, 0.0) for kc, tau_i in OVEN_GAINS]
        middle = (self.subject.low + self.subject.high) / 2
        if task.start == "quarter":
            return [PidGains(*(gain / 4 for gain in (best.kp, best.ki, best.kd))) for best in self.best]
        return [Judge(self.subject.local(middle), self.subject.dt_s).best] * len(self.regions)

    @property
    def best(self) -> list[PidGains]:
        """SIMC with perfect knowledge of each region's centre."""
        return [judge.best for judge in self.centres]


def run(task: Task) -> Row:
    """One tour under fixed gains, retuner, and perfect knowledge of each region's centre."""
    tour = Tour.drawn(task)
    first, span = tour.start(task), tour.subject.high - tour.subject.low
    wanted = settings(tour.subject.dt_s, span, opened=task.opened)

    def table(gains: list[PidGains]) -> GainTable:
        return GainTable("loop", tour.regions, tuple(gains), Lookup(task.lookup))

    watching = Watching(table(first), wanted)
    everybody: dict[str, tuple[GainTable, Supervisor]] = {
        "fixed": (table(first), FixedGains()),
        "retuner": (table(first), watching),
        "perfect": (table(tour.best), FixedGains()),
    }
    found = {who: toured(tour, gains, supervisor) for who, (gains, supervisor) in everybody.items()}
    if task.verbose:
        for decision in watching.decisions:
            sys.stdout.write(f"{decision.t_s:>9.1f} {decision.region} {decision.action} {decision.reason}\n")
    return {
        "part": "tours",
        "seed": task.seed,
        "index": task.index,
        "kind": task.kind,
        "start": task.start,
        "lookup": task.lookup,
        "opened": task.opened,
        "who": found,
        "bearable": bearable(tour),
        "where": [sum(sp >= bound for bound in tour.regions.law().bounds) for sp in tour.sps],
        "worst": [_worst(tour, table(list(gains))) for gains in (watching.retuner.table.gains, tour.best)],
        **_told(watching),
        **_harm(tour, watching),
    }


def toured(tour: Tour, table: GainTable, supervisor: Supervisor) -> dict[str, Any]:
    """The places under one of them. visits : by region, whether its own set was in spec at the end of each visit."""
    subject = tour.subject
    y0, co0 = tour.sps[0], subject.rest(tour.sps[0])
    plant = _Deviation(subject.live(y0), y0, co0)
    reach = 3 * (subject.high - subject.low)
    limits = {"low": subject.co_min, "high": subject.co_max}
    loop = WatchedLoop(plant, table, subject.dt_s, supervisor, co0=co0, sp0=y0, lost=reach, **limits)
    law = tour.regions.law()
    iae, spec = [], []
    visits: list[list[bool]] = [[] for _ in tour.centres]
    for sp, noise, judge in zip(tour.sps, tour.noise, tour.judges, strict=True):
        try:
            trace = loop.run(sp, 0.0, noise)
        except LostLoop:
            break
        iae.append(sum(abs(sp - pv + more) for (pv, _), more in zip(trace, noise, strict=True)) * subject.dt_s)
        spec.append(judge.of(loop.gains).in_spec)
        region = sum(sp >= bound for bound in law.bounds)
        visits[region].append(tour.centres[region].of(loop.table.gains_of(region)).in_spec)
    missing = len(tour.sps) - len(iae)
    return {
        "iae": iae + [math.inf] * missing,
        "spec": spec + [False] * missing,
        "visits": visits,
        "changes": loop.changes,
        "lost": missing > 0,
    }


def bearable(tour: Tour) -> list[bool]:
    """By region, whether a set in spec at its centre keeps the guard's limit as far as it runs: SIMC with perfect
    knowledge of the centre, or all its gains times one of EASED.
    """
    limit, found = GuardSettings().ms_border, []
    for region, best in enumerate(tour.best):
        low, high = tour.regions.span(region)
        edge = tour.regions.axes[0].hysteresis
        ends = [
            Judge(tour.subject.local(y), tour.subject.dt_s)
            for y in (max(low - edge, tour.subject.low), min(high + edge, tour.subject.high))
        ]
        eased = [PidGains(*(gain * share for gain in (best.kp, best.ki, best.kd))) for share in EASED]
        good = (one for one in eased if all(end.of(one).ms <= limit for end in ends))
        found.append(any(tour.centres[region].of(one).in_spec for one in good))
    return found


def _worst(tour: Tour, table: GainTable) -> float:
    """Largest Ms at any place of the range."""
    law = tour.regions.law()
    return max(
        Judge(tour.subject.local(y), tour.subject.dt_s).of(table.at(sum(y >= b for b in law.bounds), y)).ms
        for y in tour.subject.places(PROBES)
    )


def _told(watching: Watching) -> Row:
    """How many responses there were, and how many of them taught."""
    seen = [d for d in watching.decisions if d.response is not None or d.code == "left_region"]
    taught = [d for d in seen if d.agreement is not None and d.agreement.code != "silent"]
    codes: dict[str, int] = {}
    for decision in seen:
        codes[decision.code] = codes.get(decision.code, 0) + 1
    return {"responses": len(seen), "taught": len(taught), "codes": codes}


def _harm(tour: Tour, watching: Watching) -> Row:
    """Changes for the worse, judged at the centre of their region."""
    worse = unstable = 0
    for made in watching.writes:
        assert made.gains_after is not None
        region = tour.regions.names.index(made.region)
        found = effect(tour.centres[region], made.t_s, made.gains_before, made.gains_after)
        worse += found.ms_worse
        unstable += math.isinf(found.after.ms) and math.isfinite(found.before.ms)
    return {"ms_worse": worse, "made_unstable": unstable}


def _later(values: list[Any]) -> list[Any]:
    """From the second third on."""
    return values[len(values) // 3 :]


def _ratio(row: Row, who: str) -> float:
    iae, perfect = (sum(_later(row["who"][name]["iae"])) for name in (who, "perfect"))
    return float(iae / perfect)


def good_after(visits: list[list[bool]], n: int) -> list[bool]:
    """Whether, in regions with n visits and more, the set was in spec at the end of the n-th and of every later one."""
    return [all(visit[n - 1 :]) for visit in visits if len(visit) >= n]


def _borne(row: Row) -> list[bool]:
    """The regions with so many visits that have a set which the guard may let through: whether they are good."""
    visits: Sequence[list[bool]] = row["who"]["retuner"]["visits"]
    return good_after([visit for visit, ok in zip(visits, row["bearable"], strict=True) if ok], VISITS)


def _where_one_can_be(row: Row, who: str) -> list[bool]:
    """Whether the later places were in spec, of regions that have a set which the guard may let through."""
    pairs = zip(row["who"][who]["spec"], row["where"], strict=True)
    return [ok for ok, region in _later(list(pairs)) if row["bearable"][region]]


def line(row: Row) -> str:
    """A tour for people."""
    good, borne, parts = good_after(row["who"]["retuner"]["visits"], VISITS), _borne(row), []
    for who in WHO:
        spec = _later(row["who"][who]["spec"])
        parts.append(f"{who} {_ratio(row, who):.2f} {sum(spec)}/{len(spec)}")
    return (
        f"{row['kind']:<16} {row['index']:>2} {row['start']}: {row['taught']} of {row['responses']} taught; "
        f"{sum(good)} of {len(good)} regions good, {sum(borne)} of {len(borne)} that can be; {'; '.join(parts)}; "
        f"largest Ms {row['worst'][0]:.2f} (perfect {row['worst'][1]:.2f}); "
        f"changes {row['who']['retuner']['changes']}, worse {row['ms_worse']}, unstable {row['made_unstable']} "
        f"{row['codes']}"
    )


def table(rows: list[Row]) -> list[str]:
    """A line a kind of plant and start, and all together."""
    groups: dict[tuple[str, str, str], list[Row]] = {}
    for row in rows:
        groups.setdefault((row["kind"], row["start"], row["lookup"]), []).append(row)
    lines = [
        f"{'plant, start':<34}{'taught':>12}{'good after 1, 2, 3, 4 visits':>34}{'IAE':>7}{'worst':>7}  places in spec"
    ]
    named = [(", ".join(key), group) for key, group in groups.items()]
    for name, group in [*named, *([("all", rows)] if len(named) > 1 else [])]:
        taught = f"{sum(row['taught'] for row in group)}/{sum(row['responses'] for row in group)}"
        goods = [
            [ok for row in group for ok in good_after(row["who"]["retuner"]["visits"], n)] for n in range(1, VISITS + 1)
        ]
        good = " ".join(f"{sum(each)}/{len(each)}" for each in goods)
        ratios = [_ratio(row, "retuner") for row in group]
        spec = {who: [ok for row in group for ok in _later(row["who"][who]["spec"])] for who in WHO}
        told = {who: share(sum(each), len(each)) for who, each in spec.items()}
        borne = [ok for row in group for ok in _borne(row)]
        told["can"] = share(sum(borne), len(borne))
        there = {who: [ok for row in group for ok in _where_one_can_be(row, who)] for who in ("retuner", "perfect")}
        told["there"] = " and ".join(f"{sum(each)} ({who})" for who, each in there.items())
        harm = f"worse {sum(row['ms_worse'] for row in group)}, unstable {sum(row['made_unstable'] for row in group)}"
        lost = sum(row["who"]["retuner"]["lost"] for row in group)
        lines.append(
            f"{name:<34}{taught:>12}{good:>34}{statistics.median(ratios):>7.2f}{max(ratios):>7.2f}  "
            f"{told['retuner']} (perfect {told['perfect']}, fixed {told['fixed']}); "
            f"good after {VISITS} where one set can be: {told['can']}; of {len(there['perfect'])} places there "
            f"{told['there']}; {harm}, lost {lost}"
        )
    return lines
