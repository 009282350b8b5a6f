"""Gains for regions where the loop is not: what comes of them where the curves between the regions foretell wrongly?

Two to six regions along pv, of unequal width. The process is another in each, in ways that no neighbour tells:

jump     the same everywhere, but one region's gain is 3 times as large or as small
trend    the gain grows from region to region, by 4 in all, up to a drawn region, and falls again from there
delay    the same everywhere, but one region's dead time is 3 times as long or as short
outside  the same everywhere; its gain changes by 3 with something that is no scheduling variable, at drawn times
smooth   gain, lags and dead time along smooth curves, by 4 (schedules/drawn.py): what the curves are made for

Parameters change within BLEND of pv at a boundary. Tables begin right (SIMC with perfect knowledge of each centre),
right but for one region (a quarter, or twice), at a quarter, with the first region's gains everywhere, or each off by a
drawn factor. The setpoint walks; or goes to and fro between two regions and seldom elsewhere; or stays near one place
and leaves it seldom. Every loop is run with the default settings, without such changes (far_off = 0), and under a table
of perfect knowledge: the same places and noise.

A change is judged at the centre of its region, on the true process as it is then. Counted are changes; those for the
worse (as in harm.py); what the first visit cost, as IAE over that of the run without such changes; those that were
rolled back, and how long after the loop came; and sets in spec that were rolled back.
"""

import math
import statistics
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np
from cases.processes import log_uniform
from schedules import drawn
from schedules.subject import Live, Subject, sampling

from online.counting import at_most
from online.judge import Judge, effect
from online.loop import FixedGains, LostLoop, Supervisor, WatchedLoop
from online.supervisors import Watching, settings
from online.varying import Local, VaryingPlant
from retuner.adaptive.process.model import LinearProcess
from retuner.adaptive.supervision.decision import Action, Decision
from retuner.adaptive.supervision.settings import RetunerSettings
from retuner.schedule.gains import PidGains
from retuner.schedule.regions import Regions
from retuner.schedule.table import GainTable

Row = dict[str, Any]
KINDS = ("jump", "trend", "delay", "outside", "smooth")
STARTS = ("right", "one", "quarter", "first", "mixed")
WAYS = ("walk", "switch", "stay")
PLACES = 18
FEWEST, MOST = 2, 6
"""Regions."""
NARROWEST = 12.0
BLEND = 1.0
JUMP, TREND = 3.0, 4.0
HOLD_THETA, MOST_SAMPLES = 60.0, 1500
RIM, NEAREST, FARTHEST = 4.0, 4.0, 30.0
SELDOM = 0.2
"""Share of the steps that leave the places where the loop mostly is; and of those before which the outside changes."""
POINTS = 800


@dataclass(frozen=True, slots=True)
class Task:
    """One loop."""

    seed: int
    index: int
    kind: str
    places: int = PLACES
    opened: bool = False


def tasks(seed: int, kind: str, count: int, **more: Any) -> list[Task]:
    """The first `count` loops of a kind."""
    return [Task(seed, index, kind, **more) for index in range(count)]


class Pieces:
    """A process over y in 0..100, one a region; `outside` multiplies its gain from now on."""

    def __init__(self, pieces: Sequence[Local], bounds: Sequence[float]) -> None:
        self.outside = 1.0
        self._logs = [np.log([p.k, p.tau1_s, p.theta_s]) for p in pieces]
        self._second = pieces[0].tau2_s / pieces[0].tau1_s
        self._bounds = bounds
        grid = 100.0 * (np.arange(POINTS) + 0.5) / POINTS
        held = np.cumsum([1 / self.at(float(y)).k for y in grid]) * 100.0 / POINTS
        self._held = [0.0, *held.tolist()]

    def at(self, y: float) -> Local:
        """The linearisation at y."""
        now = self._logs[0]
        for bound, one, other in zip(self._bounds, self._logs, self._logs[1:], strict=False):
            share = (1 + math.tanh((min(max(y, 0.0), 100.0) - bound) / BLEND)) / 2
            now = now + share * (other - one)
        k, tau, theta = (math.exp(value) for value in now)
        return Local(self.outside * k, tau, self._second * tau, theta)

    def rest(self, y: float) -> float:
        """The input that holds y: the integral of dy/k(y), from 50."""
        inside = min(max(y, 0.0), 100.0)
        i = min(int(inside * POINTS / 100.0), POINTS - 1)
        low, high = self._held[i], self._held[i + 1]
        held = low + (high - low) * (inside * POINTS / 100.0 - i) - self._held[POINTS // 2]
        return held / self.outside + (y - inside) / self.at(inside).k


class _Deviation:
    """In absolute values, about where it rests (loop.Moved)."""

    def __init__(self, live: Live, y0: float, co0: float) -> None:
        self._live, self._y0, self._co0 = live, y0, co0

    def move(self, u: float) -> float:
        """Hold co0 + u for one sample."""
        return self._live.move(self._co0 + u, self._y0) - self._y0


class _Alive:
    """A process in pieces in motion, in absolute values."""

    def __init__(self, pieces: Pieces, dt_s: float, place: float) -> None:
        self._y0, self._u0 = place, pieces.rest(place)
        self._plant = VaryingPlant(pieces.at, pieces.rest, dt_s, place)

    def move(self, co: float, _place: float) -> float:
        """See Live."""
        return self._y0 + self._plant.move(co - self._u0)


@dataclass(frozen=True, slots=True)
class Scene:
    """What all see. outside : of the gain, a value a place."""

    subject: Subject
    pieces: Pieces | None
    regions: Regions
    start: list[PidGains]
    sps: list[float]
    outside: list[float]
    noise: list[list[float]]
    judges: dict[tuple[int, float], Judge]

    def judge(self, region: int, outside: float) -> Judge:
        """Of the centre of a region, the outside being so."""
        key = (region, outside)
        if key not in self.judges:
            self.now(outside)
            self.judges[key] = Judge(self.subject.local(self.regions.centre(region)), self.subject.dt_s)
        return self.judges[key]

    def now(self, outside: float) -> None:
        """The outside is so from now on."""
        if self.pieces is not None:
            self.pieces.outside = outside

    def region(self, sp: float) -> int:
        """In which a setpoint lies."""
        return sum(sp >= bound for bound in self.regions.law().bounds)


def scene_of(task: Task) -> Scene:
    """From its seed."""
    rng = np.random.default_rng([task.seed, task.index, KINDS.index(task.kind), 55])
    count = int(rng.integers(max(FEWEST, 3 if task.kind == "trend" else 2), MOST + 1))
    bounds = _bounds(rng, count)
    pieces = None if task.kind == "smooth" else Pieces(_pieces(rng, task.kind, count), bounds)
    subject = drawn.draw(rng, "smooth", TREND) if pieces is None else _subject(pieces, task.kind)
    names = tuple(f"r{i + 1}" for i in range(count))
    regions = Regions("pv", "-", names, 0.0, bounds, 100.0, max(0.5, 4 * subject.noise))
    sps = _places(rng, str(rng.choice(WAYS)), task.places)
    thetas = [Judge.theta(subject.local(regions.centre(i))) for i in range(count)]
    n = min(int(HOLD_THETA * statistics.median(thetas) / subject.dt_s), MOST_SAMPLES)
    noise = [(subject.noise * rng.standard_normal(n)).tolist() for _ in sps]
    scene = Scene(subject, pieces, regions, [], sps, _outside(rng, task), noise, {})
    return replace(scene, start=_start(rng, STARTS[task.index % len(STARTS)], scene))


def _bounds(rng: np.random.Generator, count: int) -> tuple[float, ...]:
    """Of so many regions of drawn widths."""
    widths = NARROWEST + (100.0 - count * NARROWEST) * rng.dirichlet(np.ones(count))
    return tuple(float(x) for x in np.cumsum(widths)[:-1])


def _pieces(rng: np.random.Generator, kind: str, count: int) -> list[Local]:
    """The process of each region."""
    scale, tau1 = 10 ** rng.uniform(-1, 2), log_uniform(rng, 0.7, 15.0)
    tau2 = tau1 * log_uniform(rng, 0.05, 0.5) if rng.uniform() < 0.5 else 0.0
    usual = Local(log_uniform(rng, 0.5, 5.0), tau1 * scale, tau2 * scale, scale)
    odd, factor = int(rng.integers(count)), JUMP ** float(rng.choice([-1, 1]))
    found = [usual] * count
    if kind == "jump":
        found[odd] = replace(usual, k=usual.k * factor)
    elif kind == "delay":
        found[odd] = replace(usual, theta_s=usual.theta_s * factor)
    elif kind == "trend":
        turn, step = int(rng.integers(1, count - 1)), TREND ** (float(rng.choice([-1, 1])) / (count - 1))
        found = [replace(usual, k=usual.k * step ** (turn - abs(i - turn))) for i in range(count)]
    return found


def _subject(pieces: Pieces, kind: str) -> Subject:
    def local(y: float) -> LinearProcess:
        return pieces.at(y).linear()

    rests = (pieces.rest(0.0), pieces.rest(100.0))
    room = 1.5 * abs(rests[1] - rests[0])
    dt_s = sampling(local, 0.0, 100.0)
    return Subject(
        name=kind,
        kind=kind,
        low=0.0,
        high=100.0,
        by="pv",
        dt_s=dt_s,
        noise=drawn.NOISE,
        span=100.0,
        live=lambda y: _Alive(pieces, dt_s, y),
        rest=pieces.rest,
        local=local,
        co_min=min(rests) - room,
        co_max=max(rests) + room,
    )


def _places(rng: np.random.Generator, way: str, count: int) -> list[float]:
    """Setpoints."""
    homes = [float(x) for x in rng.uniform(RIM, 100.0 - RIM, 2)]
    sps = [homes[0]]
    while len(sps) < count:
        if way == "walk" or rng.uniform() < SELDOM:
            sp = sps[-1] + float(rng.uniform(NEAREST, FARTHEST)) * float(rng.choice([-1, 1]))
        else:
            home = homes[len(sps) % 2] if way == "switch" else homes[0]
            sp = home + float(rng.uniform(NEAREST, 2 * NEAREST)) * float(rng.choice([-1, 1]))
        apart = abs(sp - sps[-1]) >= NEAREST / 2
        sps += [sp] if apart and RIM <= sp <= 100.0 - RIM else []
    return sps


def _outside(rng: np.random.Generator, task: Task) -> list[float]:
    """The factor of the gain at every place."""
    if task.kind != "outside":
        return [1.0] * task.places
    found = [JUMP ** (0.5 * float(rng.choice([-1, 1])))]
    while len(found) < task.places:
        found.append(1 / found[-1] if rng.uniform() < SELDOM else found[-1])
    return found


def _start(rng: np.random.Generator, start: str, scene: Scene) -> list[PidGains]:
    """One set a region."""
    count = len(scene.regions)
    best = [scene.judge(i, scene.outside[0]).best for i in range(count)]
    factors = [1.0] * count
    if start == "one":
        factors[int(rng.integers(count))] = float(rng.choice([0.25, 2.0]))
    elif start == "quarter":
        factors = [0.25] * count
    elif start == "mixed":
        factors = [float(x) for x in rng.choice([0.25, 0.5, 1.0, 1.5], count)]
    sets = [best[0]] * count if start == "first" else best
    return [PidGains(g.kp * f, g.ki * f, g.kd * f) for g, f in zip(sets, factors, strict=True)]


@dataclass(frozen=True, slots=True)
class Ridden:
    """The places under one of them. iae : a value a place, infinite from where it was lost. ends_s : of the places."""

    iae: list[float]
    ends_s: list[float]
    changes: int


def run(task: Task) -> Row:
    """One loop, three times."""
    scene = scene_of(task)
    wanted = settings(scene.subject.dt_s, 100.0, opened=task.opened)
    without = replace(wanted, borrowing=replace(wanted.borrowing, far_off=0.0))
    watching, ablated = _watching(scene, wanted), _watching(scene, without)
    best = [scene.judge(i, scene.outside[0]).best for i in range(len(scene.regions))]
    ways = {"retuner": _ridden(scene, scene.start, watching), "perfect": _ridden(scene, best, FixedGains())}
    if any(_is_elsewhere(decision) for decision in watching.writes):
        ways["without"] = _ridden(scene, scene.start, ablated)
    else:  # the same decisions
        ablated, ways["without"] = watching, ways["retuner"]
    return {
        "part": "elsewhere",
        "seed": task.seed,
        "index": task.index,
        "kind": task.kind,
        "opened": task.opened,
        "start": STARTS[task.index % len(STARTS)],
        "regions": len(scene.regions),
        "iae": {who: sum(way.iae) for who, way in ways.items()},
        "changes": {who: way.changes for who, way in ways.items()},
        "worse": {who: _worse(scene, each, ways[who]) for who, each in (("retuner", watching), ("without", ablated))},
        "elsewhere": [_followed(scene, d, watching, ways) for d in watching.writes if _is_elsewhere(d)],
    }


def _watching(scene: Scene, wanted: RetunerSettings) -> Watching:
    return Watching(GainTable("loop", scene.regions, tuple(scene.start)), wanted)


def _ridden(scene: Scene, gains: list[PidGains], supervisor: Supervisor) -> Ridden:
    """All places."""
    subject, y0 = scene.subject, scene.sps[0]
    scene.now(scene.outside[0])
    co0 = subject.rest(y0)
    plant = _Deviation(subject.live(y0), y0, co0)
    table = GainTable("loop", scene.regions, tuple(gains))
    limits = {"low": subject.co_min, "high": subject.co_max}
    loop = WatchedLoop(plant, table, subject.dt_s, supervisor, co0=co0, sp0=y0, lost=300.0, **limits)
    iae: list[float] = []
    ends: list[float] = []
    for sp, outside, noise in zip(scene.sps, scene.outside, scene.noise, strict=True):
        scene.now(outside)
        try:
            trace = loop.run(sp, 0.0, noise)
        except LostLoop:
            break
        iae.append(sum(abs(sp - pv + more) for (pv, _), more in zip(trace, noise, strict=True)) * subject.dt_s)
        ends.append(loop.t_s)
    return Ridden(iae + [math.inf] * (len(scene.sps) - len(iae)), ends, loop.changes)


def _is_elsewhere(decision: Decision) -> bool:
    return decision.later and decision.action == Action.COMMIT


def _at(ends_s: list[float], t_s: float) -> int:
    """The place at a time."""
    return min(sum(end < t_s for end in ends_s), len(ends_s) - 1)


def _effect(scene: Scene, decision: Decision, ends_s: list[float]) -> dict[str, Any]:
    assert decision.gains_after is not None
    region = scene.regions.names.index(decision.region)
    judge = scene.judge(region, scene.outside[_at(ends_s, decision.t_s)])
    found = effect(judge, decision.t_s, decision.gains_before, decision.gains_after)
    return asdict(found) | {"worse": found.worse, "ms_limit": judge.ms_limit}


def _worse(scene: Scene, watching: Watching, ridden: Ridden) -> int:
    """Changes for the worse where the loop was."""
    own = [d for d in watching.writes if d.action == Action.COMMIT and not _is_elsewhere(d)]
    return sum(_effect(scene, d, ridden.ends_s)["worse"] for d in own)


def _followed(scene: Scene, made: Decision, watching: Watching, ways: dict[str, Ridden]) -> dict[str, Any]:
    """One change elsewhere, what it was in truth, and what came of it."""
    ridden, region = ways["retuner"], scene.regions.names.index(made.region)
    since = _at(ridden.ends_s, made.t_s)
    visits = [i for i in range(since + 1, len(ridden.iae)) if scene.region(scene.sps[i]) == region]
    later = [d for d in watching.writes if d.number > made.number and d.region == made.region]
    cost, back_theta = math.nan, math.nan
    came = "not visited"
    if visits:
        cost = ridden.iae[visits[0]] / ways["without"].iae[visits[0]]
        came = "stays" if not later else "changed again" if later[0].action == Action.COMMIT else "rolled back"
    if later and later[0].action != Action.COMMIT and visits:
        theta = scene.judge(region, scene.outside[since]).theta_s
        back_theta = (later[0].t_s - ridden.ends_s[visits[0] - 1]) / theta
    told = {"region": region, "came": came, "cost": cost, "back_theta": back_theta, "reason": made.reason}
    told["then"] = later[0].reason if later else ""
    told["code"] = later[0].code if later else ""
    return _effect(scene, made, ridden.ends_s) | told


def line(row: Row) -> str:
    """A loop in which gains were given elsewhere, for people."""
    perfect, without = row["iae"]["perfect"], row["iae"]["without"]
    told = [
        f"{row['kind']} {row['index']} {row['start']}, {row['regions']} regions: IAE over perfect "
        f"{row['iae']['retuner'] / perfect:.2f} (without {without / perfect:.2f}), changes {row['changes']['retuner']} "
        f"({row['changes']['without']})"
    ]
    told += [
        f"    t {x['t_s']:.4g} region {x['region'] + 1} Ms {x['before']['ms']:.2f} -> {x['after']['ms']:.2f}, J "
        f"{x['before']['j']:.2f} -> {x['after']['j']:.2f}{' WORSE' if x['worse'] else ''}; {x['came']}, "
        f"first visit {x['cost']:.2f}; {x['reason']}; {x['then']}"
        for x in row["elsewhere"]
    ]
    return "\n".join(told)


def table(rows: list[Row]) -> list[str]:
    """Counts a kind and of all, with the exact upper end of the 95 % interval of the share for the worse."""
    lines = [
        f"{'kind':<10}{'loops':>6}{'changes elsewhere':>19}{'worse Ms':>10}{'worse J':>9}{'right, back':>13}"
        f"{'back':>6}{'IAE over perfect':>18}{'without':>9}{'changes':>9}{'without':>9}   for the worse, first visit"
    ]
    kinds = [(kind, [row for row in rows if row["kind"] == kind]) for kind in KINDS]
    for name, of in [*kinds, ("all", rows)]:
        if of:
            lines.append(_line_of(name, of))
    return lines


def _line_of(name: str, rows: list[Row]) -> str:
    found = [x for row in rows for x in row["elsewhere"]]
    back = [x for x in found if x["came"] == "rolled back"]
    right = sum(x["after"]["in_spec"] for x in back)
    worse = [x for x in found if x["worse"]]
    iae = {who: statistics.median(row["iae"][who] / row["iae"]["perfect"] for row in rows) for who in rows[0]["iae"]}
    changes = {who: sum(row["changes"][who] for row in rows) for who in rows[0]["changes"]}
    costs = sorted(x["cost"] for x in found if math.isfinite(x["cost"]))
    cost = f"{statistics.median(costs):.2f}, at worst {costs[-1]:.2f}" if costs else "-"
    times = sorted(x["back_theta"] for x in back if math.isfinite(x["back_theta"]))
    late = f"; back after {statistics.median(times):.0f}, at worst {times[-1]:.0f} dead times" if times else ""
    return (
        f"{name:<10}{len(rows):>6}{len(found):>19}{sum(x['ms_worse'] for x in found):>10}"
        f"{sum(x['iae_worse'] for x in found):>9}{right:>13}{len(back):>6}{iae['retuner']:>18.2f}{iae['without']:>9.2f}"
        f"{changes['retuner']:>9}{changes['without']:>9}   {len(worse)} of {len(found)}, at most "
        f"{at_most(len(worse), len(found)):.1%}, {cost}{late}"
    )
