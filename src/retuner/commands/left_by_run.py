"""What a run leaves behind of each loop and of all: report, gains, trend, scores, and what a person can do now."""

import json
import platform
import sys
from collections.abc import Callable, Sequence
from functools import partial
from importlib.metadata import version
from pathlib import Path
from typing import NamedTuple

from retuner.adaptive.region_model.proposed_boundaries import Refinement
from retuner.adaptive.region_model.split_or_merge import AdviceSettings, RegionAdvice, region_advice
from retuner.adaptive.supervision.decision import gains_dict
from retuner.adaptive.trial.phase import TrialPhase
from retuner.commands.report import scores_of
from retuner.commands.run import RunJob
from retuner.errors import UserError
from retuner.files import write_json
from retuner.ledger import Ledger
from retuner.ledger.trend import write_trend
from retuner.live_view.live_screen import LiveScreen
from retuner.live_view.what_next import Changed, narrow_scores, what_next
from retuner.products import product
from retuner.report.console import counted, scores_table
from retuner.report.loops_index import LoopLine, render_index
from retuner.report.report import ReportData, render
from retuner.report.scores import RegionScore
from retuner.schedule.config_section import schedule_section
from retuner.schedule.document import to_toml
from retuner.session import outputs
from retuner.session.loop_session import LoopSession
from retuner.session.session import Session


def leave(
    job: RunJob,
    ledger: Ledger,
    session: Session,
    fixed: Session | None,
    proposed: Sequence[Refinement | None],
    screen: LiveScreen,
    *,
    interrupted: bool,
) -> None:
    """Write everything that the run leaves, and show the result. proposed : another schedule, by loop."""
    left = [
        _leave_loop(job, ledger, session, i, fixed.loops[i] if fixed else None, proposed[i], screen.say)
        for i, loop in enumerate(session.loops)
        if loop.trend.rows
    ]
    if not left:
        raise UserError("nothing to report: no sample told its region, as the scheduling variable was never known")
    if job.config.several:
        known = {one.loop.name: one for one in left}
        lines = [
            LoopLine(
                name=loop.name,
                report=str(known[loop.name].report) if loop.name in known else None,
                decisions=[decision.to_dict() for decision in loop.decisions],
                scores=known[loop.name].scores if loop.name in known else [],
                trouble=session.absent.get(loop.name, loop.left_open),
            )
            for loop in session.loops
        ]
        job.unwritten.write(job.folder / outputs.REPORT, render_index(lines, _facts(job, ledger, outputs.LOOPS)))
    # the result as a file, and for whoever asked for it
    folder, several = job.folder, job.config.several
    results = [result(one, ledger, folder / one.report.parent) for one in left]
    whole = {"folder": str(folder), "loops": results, "absent": session.absent, "ledger_head": ledger.head()}
    document = {**(whole if several else results[0]), "interrupted": interrupted}
    with job.unwritten.trying():
        write_json(folder / outputs.SUMMARY, document)
    if job.options.as_json:
        sys.stdout.write(json.dumps(document, indent=2, allow_nan=False) + "\n")
        return
    screen.pause()
    for one in left:
        name = one.loop.name if several else ""
        limit = job.config.loops[job.config.names.index(one.loop.name)].adaptation.ms_marked
        screen.table(
            scores_table(one.scores, one.unit, name, limit), partial(narrow_scores, one.scores, one.unit, name)
        )
    decisions = sum(len(loop.decisions) for loop in session.loops)
    changes = sum(len(loop.changes) for loop in session.loops)
    done = f"{counted(decisions, 'decision')}, {counted(changes, 'change')} of gains"
    made = not any(line.startswith(str(folder / outputs.REPORT)) for line in job.unwritten.lines)
    screen.say(f"{done}; report: {folder / outputs.REPORT}" if made else done)
    screen.say(f"ledger head {ledger.head()}")
    several = job.config.several
    about = outputs.rows_by_loop(ledger.rows(), job.config.names)
    for one in left:
        loop, name = one.loop, one.loop.name
        names = loop.table.regions.names
        locked = [region for i, region in enumerate(names) if loop.retuner.trials.phase(i) is TrialPhase.LOCKED]
        table = job.folder / one.report.parent / outputs.GAINS
        changed = Changed(table, job.options.config) if loop.changes else None
        config = job.config.loops[job.config.names.index(name)]
        by_hand = product("foreign device").advice_only(config) if config.foreign_device else ""
        own, known_as = config.adaptation.approval_s, name if several else ""
        for told in what_next(job.folder, about[name], own, locked, changed, known_as, by_hand=by_hand):
            screen.say(told.why)
            if told.command:
                screen.command(f"  {told.command}")


class _Left(NamedTuple):
    """What a run leaves of one loop. report : below the session's folder. advice : on its regions."""

    loop: LoopSession
    unit: str
    scores: list[RegionScore]
    report: Path
    advice: Sequence[RegionAdvice | Refinement]


def _leave_loop(
    job: RunJob,
    ledger: Ledger,
    session: Session,
    i: int,
    fixed: LoopSession | None,
    other: Refinement | None,
    say: Callable[[str], None],
) -> _Left:
    """What the run leaves of one loop, in the folder of the loop. other : the schedule that its records ask for. say :
    takes a line on what stays open.
    """
    config, loop = job.config.loops[i], session.loops[i]
    folder = outputs.loop_folder(job.folder, loop.name if job.config.several else "")
    columns = loop.trend.columns()
    fixed_columns = fixed.trend.columns() if fixed is not None and fixed.trend.rows else None
    scores = scores_of(config, loop.table, loop.changes, columns, fixed_columns, job.config.loops, say)
    job.unwritten.write(folder / outputs.GAINS, to_toml(loop.table))
    retuner = loop.retuner
    regions, models, dt_s = retuner.table.regions, retuner.region_models, retuner.settings.sample_time_s
    advice = (*region_advice(regions, models, dt_s, AdviceSettings()), *([other] if other is not None else ()))
    kind = config.output.trend
    with job.unwritten.trying():
        write_trend(folder / outputs.TREND, loop.trend, kind)
    # the proposed schedule as files that a person may take up. loop : its name where it is one of several
    if other is not None:
        job.unwritten.write(folder / outputs.REFINED, to_toml(other.table))
        job.unwritten.write(
            folder / outputs.REFINED_SCHEDULE, schedule_section(other.table, loop.name if job.config.several else "")
        )
    data = ReportData(
        loop=config.loop.name,
        unit=config.loop.pv_unit,
        before=config.gain_table(),
        after=loop.table,
        scores=scores,
        decisions=list(loop.decisions),
        run=columns,
        fixed=fixed_columns,
        changes=[t for t, _ in loop.changes],
        events=loop.scenario.played,
        facts=_facts(job, ledger, f"{outputs.TREND}.{kind}", i)
        | ({"not restored": loop.left_open} if loop.left_open else {}),
        stopped=config.scenario is not None and not loop.scenario.finished,
        advice=[one.sentence for one in advice],
        ms_limit=config.adaptation.ms_marked,
    )
    job.unwritten.write(folder / outputs.REPORT, render(data))
    return _Left(loop, config.loop.pv_unit, scores, (folder / outputs.REPORT).relative_to(job.folder), advice)


def _facts(job: RunJob, ledger: Ledger, trend: str, i: int | None = None) -> dict[str, str]:
    """What a reader of the report needs to find the rest, or to do the run again. i : of which loop, None for all."""
    loops = job.config.loops if i is None else (job.config.loops[i],)
    buses = {f"{one.bus.interface} {one.bus.channel}, node {one.node}": None for one in loops}
    seeds = [str(one.device.seed) if one.device else "a real controller" for one in loops]
    return {
        "retuner": version("retuner"),
        "Python": platform.python_version(),
        "bus": "; ".join(buses),
        "seed": ", ".join(dict.fromkeys(seeds)),
        "ledger": f"{outputs.LEDGER}, {ledger.verify().rows} rows, head {ledger.head()}",
        "trend": trend,
        "bus log": outputs.BUS_LOG,
        "gains": outputs.GAINS,
        "configuration": outputs.CONFIG,
    }


def result(left: _Left, ledger: Ledger, folder: Path) -> dict[str, object]:
    """The run of a loop as one JSON document: decisions, gains before and after per region, scores."""
    loop = left.loop
    return {
        "loop": loop.name,
        "folder": str(folder),
        "decisions": [decision.to_dict() for decision in loop.decisions],
        "gains": [
            {"region": name, **gains_dict(gains)}
            for name, gains in zip(loop.table.regions.names, loop.table.gains, strict=True)
        ],
        "scores": [score.to_dict() for score in left.scores],
        "advice": [one.to_dict() for one in left.advice],
        "revision": loop.table.revision,
        "ledger_head": ledger.head(),
    }
