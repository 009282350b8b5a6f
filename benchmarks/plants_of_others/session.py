"""One session: a loop of somebody else's plant with wrong gains, retuner in auto, and what came of it on the plant.

Starts are the published gains, and the best ones (truth.py) with kc, or kc and tau_I, off by FACTOR. After the session
the plant is run again, with the same seed, under gains that stay: those of the start, those at the end, the published
ones, and the best. IAE, the largest error and the output's total variation of these runs say what the change is worth
on the plant; Ms and J are of the answer to a step (truth.py).
"""

import math
import sys
from dataclasses import dataclass
from typing import Any

from online.judge import Effect, effect

from plants_of_others.loop import Action, Card, Controlled, Plant, Tripped
from plants_of_others.truth import Truth, steps
from retuner import PidGains

Row = dict[str, Any]
FACTOR = 4.0
AFTER = (1, 3, 6)
OVER = ("start", "published", "best")
"""Whose IAE that of the end is told over: the middle session, and in brackets the worst."""
REPLAYED: dict[tuple[object, ...], Row] = {}  # Sessions under gains that stay: the same for every start
STARTS = {"published": None, "low": (1 / FACTOR, 1.0), "high": (FACTOR, 1.0), "slow": (1 / FACTOR, FACTOR)}
"""Kc and tau_I as factors of the best."""


@dataclass(frozen=True, slots=True)
class Task:
    """One session. together : all loops of the plant start off, and are retuned at the same time."""

    loop: str
    start: str
    seed: int
    opened: bool = False
    replays: bool = True
    verbose: bool = False
    together: bool = False


def begins_with(card: Card, truth: Truth, start: str) -> PidGains:
    """The gains of the start."""
    factors = STARTS[start]
    if factors is None:
        return card.published
    best = truth.judge.best
    return PidGains(best.kp * factors[0], best.ki * factors[0] / factors[1], 0.0)


Sets = dict[str, PidGains]  # The gains of each loop that is ours


def run(plant: Plant, truths: dict[str, Truth], task: Task) -> Row:
    mine = list(truths) if task.together else [task.loop]
    first = {loop: begins_with(plant.cards[loop], truths[loop], task.start) for loop in mine}
    all_live, tripped = _session(plant, task, first, watched=True)
    live, truth = all_live[task.loop], truths[task.loop]
    if task.verbose:
        tell(live, truth)
    if not any(control.writes for control in all_live.values()):  # so it was a session under gains that stay
        REPLAYED[_key(plant, task, first)] = {**measured(live), "tripped": tripped}
    everybody = {
        "start": first,
        "end": {loop: control.gains[-1] for loop, control in all_live.items()},
        "published": {loop: plant.cards[loop].published for loop in mine},
        "best": {loop: truths[loop].judge.best for loop in mine},
    }
    replays = {who: _replayed(plant, task, gains) for who, gains in everybody.items()} if task.replays else {}
    sets = {who: gains[task.loop] for who, gains in everybody.items()}
    codes: dict[str, int] = {}
    for decision in live.decisions:
        codes[decision.code] = codes.get(decision.code, 0) + 1
    made: list[Effect] = []
    for d in live.writes:
        assert d.gains_after is not None
        restored = d.action is Action.RESTORE
        made.append(effect(truth.judge, d.t_s, d.gains_before, d.gains_after, restored=restored))
    harm = {
        "changes": sum(not e.restored for e in made),
        "restored": sum(e.restored for e in made),
        "worse": sum(e.worse and not e.restored for e in made),
        "worse_restored": sum(e.worse and e.restored for e in made),
        "unstable": sum(math.isinf(e.after.ms) and math.isfinite(e.before.ms) for e in made),
        "effects": [[e.t_s, e.before.ms, e.before.j, e.after.ms, e.after.j, float(e.restored)] for e in made],
    }
    return {
        "plant": plant.name,
        "loop": task.loop,
        "start": task.start,
        "seed": task.seed,
        "opened": task.opened,
        "together": task.together,
        "tripped": tripped,
        "misfit": truth.misfit,
        "gains": {name: [gains.kp, gains.ki] for name, gains in sets.items()},
        "judged": {name: _judged(truth, gains) for name, gains in sets.items()},
        **_after(plant, task, truth, live),
        **harm,
        "live": measured(live),
        "replays": replays,
        "codes": codes,
    }


def _session(plant: Plant, task: Task, sets: Sets, *, watched: bool) -> tuple[dict[str, Controlled], str]:
    controls = {
        loop: Controlled(plant.cards[loop], gains, plant.rest(loop), watched=watched, opened=task.opened)
        for loop, gains in sets.items()
    }
    try:
        plant.session(controls, task.loop, task.seed)
    except Tripped as why:
        return controls, str(why)
    return controls, ""


def _key(plant: Plant, task: Task, sets: Sets) -> tuple[object, ...]:
    return plant.name, task.loop, task.seed, *sets.items()


def _replayed(plant: Plant, task: Task, sets: Sets) -> Row:
    key = _key(plant, task, sets)
    if key not in REPLAYED:
        controls, tripped = _session(plant, task, sets, watched=False)
        REPLAYED[key] = {**measured(controls[task.loop]), "tripped": tripped}
    return REPLAYED[key]


def measured(control: Controlled) -> Row:
    """IAE, largest error and total variation of a whole session, the first tenth apart (start-up)."""
    track, skip = control.track, len(control.track.pv) // 13
    errors = [abs(sp - pv) for sp, pv in zip(track.sp[skip:], track.pv[skip:], strict=True)]
    return {
        "iae": sum(errors) * control.card.dt_s,
        "largest": max(errors, default=math.inf),
        "tv": steps(track.co[skip:]),
        "samples": len(errors),
    }


def _judged(truth: Truth, gains: PidGains) -> list[float]:
    found = truth.judge.of(gains)
    return [found.ms, found.j, float(found.in_spec)]


def _after(plant: Plant, task: Task, truth: Truth, live: Controlled) -> Row:
    """Whether it was in spec just before each next event, in order; and what ran then."""
    times = [*plant.times(task.loop, task.seed)[1:], len(live.gains) * live.card.dt_s]
    found = [truth.judge.of(live.gains_at(t - 2 * live.card.dt_s)) for t in times]
    return {"spec": [x.in_spec for x in found], "ms": [x.ms for x in found], "j": [x.j for x in found]}


def tell(live: Controlled, truth: Truth) -> None:
    """Every decision, with what is true."""
    for d in live.decisions:
        after = d.gains_after if d.action in {Action.WRITE, Action.RESTORE} else None
        now = truth.judge.of(after or d.gains_before)
        cause = "" if d.diagnosis is None else f" [{d.diagnosis.cause}]"
        sys.stdout.write(
            f"  {d.t_s:>9.6g} s {d.action:<8} {d.code:<24}{cause} Ms {now.ms:.2f} J {now.j:.2f}: {d.reason}\n"
        )


def line(row: Row) -> str:
    judged, replays = row["judged"], row["replays"]
    ratios = " ".join(f"{name} {_ratio(replays, name, 'start'):.2f}" for name in ("end", *OVER[1:]) if replays)
    marks = "".join("+" if ok else "-" for ok in row["spec"])
    shown = " ".join(f"{name} {ms:.2f}/{j:.2f}" for name, (ms, j, _) in judged.items())
    return (
        f"{row['plant']} {row['loop']:<22} {row['start']:<9} {row['seed']:>4} {marks:<13} Ms/J {shown}; "
        f"IAE over start's: {ratios}; changes {row['changes']} restored {row['restored']} worse {row['worse']}"
        f"+{row['worse_restored']} unstable {row['unstable']}{'; ' + row['tripped'] if row['tripped'] else ''} "
        f"{row['codes']}"
    )


def _ratio(replays: dict[str, Row], name: str, over: str) -> float:
    if replays[over]["tripped"] or replays[name]["tripped"]:
        return 0.0 if not replays[name]["tripped"] else math.inf
    return float(replays[name]["iae"] / replays[over]["iae"])


def table(rows: list[Row]) -> list[str]:
    groups: dict[str, list[Row]] = {}
    for row in rows:
        for key in (f"{row['plant']} {row['start']}", f"all {row['start']}", "all"):
            groups.setdefault(key, []).append(row)
    head = f"{'plant, start':<26}{'runs':>5}{'in spec after 1, 3, 6, end':>28}"
    head += f"  changes  worse  unstable  tripped  IAE at the end over that of: {', '.join(OVER)}"
    order = sorted(groups, key=lambda key: (key.startswith("all"), key == "all", key))
    return [head, *(_line(key, groups[key]) for key in order)]


def _line(key: str, rows: list[Row]) -> str:
    counts = [sum(all(row["spec"][n - 1 :]) for row in rows) for n in AFTER]
    counts.append(sum(row["spec"][-1] for row in rows))
    ratios = [sorted(_ratio(row["replays"], "end", who) for row in rows if row["replays"]) for who in OVER]
    told = [f"{x[len(x) // 2]:.2f} ({x[-1]:.2f})" if x else "-" for x in ratios]
    worse = sum(row["worse"] + row["worse_restored"] for row in rows)
    return (
        f"{key:<26}{len(rows):>5}{' '.join(f'{c:>6}' for c in counts):>28}{sum(r['changes'] for r in rows):>9}"
        f"{worse:>7}{sum(r['unstable'] for r in rows):>10}{sum(bool(r['tripped']) for r in rows):>9}  {' '.join(told)}"
    )
