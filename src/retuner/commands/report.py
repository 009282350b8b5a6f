"""retuner report: the report of a recorded session made again, or the page of one of its decisions."""

import json
import math
import sys
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

from retuner.commands.signatures import ReportOptions
from retuner.config.bench_plants import known_plant, stepped_plant
from retuner.config.model import Config
from retuner.decision_page.decision_document import page
from retuner.decision_page.decision_view import view_of, what_came_of
from retuner.decision_page.row_values import Document, gains_of, number, part, parts, words
from retuner.decision_page.shown_units import show_units_of
from retuner.drivers.plants.foreign_model import PlantFaultError
from retuner.drivers.plants.plant import KnownPlant
from retuner.drivers.plants.stepped import SteppedPlant
from retuner.errors import UserError, user_input
from retuner.files import write_whole
from retuner.ledger import Row
from retuner.ledger.chain import without_place
from retuner.replay.replaying import recorded_columns
from retuner.report.loops_index import LoopLine, render_index
from retuner.report.report import ReportData, render
from retuner.report.scores import Columns, Linearise, RegionScore, region_scores
from retuner.schedule.document import from_toml
from retuner.schedule.table import GainTable
from retuner.session.outputs import GAINS, REPORT, SUMMARY, RecordedSession, read_loops
from retuner.session.scenario import loads_at
from retuner.verbosity import busy


def report(options: ReportOptions) -> int:
    """Write the report of a session, or the page of one of its decisions; the exit status.

    Raises UserError: there is no such session, loop or decision, or a file of it cannot be used.
    """
    decision, out, loop = options.decision, options.out, options.loop
    recorded, config = read_loops(options.session)
    show_units_of(config)
    every = config.several and loop is None and decision is None and out is None
    with busy("drawing the report"):
        if every:
            told = _all_loops(recorded)
        else:
            one = recorded[config.place(loop)]
            columns, rows = recorded_columns(one), _decided(one)
            if decision is None:
                path, text = out or one.folder / REPORT, render(_data(one, rows, columns))
            else:
                path = out or one.folder / f"decision-{decision}.html"
                row = next((row for row in rows if row.body.get("number") == decision), None)
                if row is None:
                    there = f"it has {rows[0].body['number']} to {rows[-1].body['number']}" if rows else "it has none"
                    raise UserError(f"{one.folder}: has no decision {decision}; {there}")
                document = without_place(row.body)
                later = what_came_of(document, [without_place(each.body) for each in rows])
                text = page(view_of(document, columns, one.config.loop.pv_unit, (row.seq, row.hash), later))
            write_whole(path, text)
            told = {"session": str(one.folder), "file": str(path), "decisions": len(rows), "decision": decision}
    sys.stdout.write((json.dumps(told, indent=2) if options.as_json else str(told["file"])) + "\n")
    return 0


def _all_loops(recorded: Sequence[RecordedSession]) -> dict[str, object]:
    session, lines, files = recorded[0].bus_log.parent, [], []
    for one in recorded:
        absent = next((str(row.body["reason"]) for row in one.rows if row.kind == "absent"), "")
        documents = [without_place(row.body) for row in _decided(one)]
        if absent:
            lines.append(LoopLine(one.name, None, documents, [], absent))
            continue
        data, path = _data(one, _decided(one), recorded_columns(one)), one.folder / REPORT
        write_whole(path, render(data))
        files.append(str(path))
        lines.append(LoopLine(one.name, str(path.relative_to(session)), documents, data.scores, ""))
    last = recorded[0].rows[-1]
    facts = {"session": str(session), "ledger": f"{last.seq} rows, head {last.hash}"}
    write_whole(session / REPORT, render_index(lines, facts))
    return {"session": str(session), "file": str(session / REPORT), "loops": files}


def _decided(recorded: RecordedSession) -> list[Row]:
    return [row for row in recorded.rows if row.kind == "decision"]


def _data(recorded: RecordedSession, rows: list[Row], columns: Columns) -> ReportData:
    config = recorded.config
    before = config.gain_table()
    names = before.regions.names
    written = (row for row in recorded.rows if row.kind == "committed" and row.body.get("why") == "retune")
    changes = [row for row in written if row.body.get("region") in names]
    after, kept_table = before, recorded.folder / GAINS
    if kept_table.is_file():
        with user_input(str(kept_table)):
            after = from_toml(kept_table.read_text(encoding="utf-8"))
    else:  # the session goes on, or was killed: what its ledger says was written
        for row in changes:
            gains = gains_of(part(row.body, "gains"))
            if gains is not None:
                after = after.with_gains(names.index(row.body["region"]), gains)
    changed = [(row.clock_s, names.index(row.body["region"])) for row in changes]
    path = recorded.folder / SUMMARY
    try:
        summary: Any = json.loads(path.read_text(encoding="utf-8")) if path.is_file() else {}
    except ValueError as error:
        raise UserError(f"{path}: is no JSON: {error}") from None
    summary = summary if isinstance(summary, dict) else {}
    scores = scores_of(config, after, changed, columns)
    steps = config.scenario.steps if config.scenario else []
    # the scores with what only the summary has kept: IAE with fixed gains, Ms of a plant that is not ours
    kept = {words(one, "region"): one for one in parts(summary, "scores")}
    last = recorded.rows[-1]
    return ReportData(
        loop=config.loop.name,
        unit=config.loop.pv_unit,
        before=before,
        after=after,
        scores=[_as_kept(kept.get(score.region, {}), score) for score in scores],
        decisions=[without_place(row.body) for row in rows],
        run=columns,
        fixed=None,
        changes=[t_s for t_s, _ in changed],
        events=[step.at_s for step in steps if step.at_s <= columns["t"][-1]],
        facts={
            "session": str(recorded.folder),
            "ledger": f"{last.seq} rows, head {last.hash}",
            "retuner": str(recorded.versions.get("retuner", "")),
        },
        stopped=recorded.end is None or bool(recorded.end.get("interrupted")),
        advice=[words(one, "sentence") for one in parts(summary, "advice")],
        ms_limit=config.adaptation.ms_marked,
    )


def scores_of(
    config: Config,
    after: GainTable,
    changed: list[tuple[float, int]],
    columns: Columns,
    fixed: Columns | None = None,
    bench: Sequence[Config] = (),
    say: Callable[[str], None] = lambda _: None,
) -> list[RegionScore]:
    """Each region before and after, from the columns of a trend; fixed : those of the run with fixed gains.

    bench : configurations of all its loops, to step a copy of a plant that is not ours; without them its Ms stay open.
    say : takes a line on why they stay open all the same.
    """
    known: KnownPlant | SteppedPlant | None = None
    if config.device and config.device.plant:
        known = known_plant(config) or (stepped_plant(config, bench, columns["sp"], columns["co"]) if bench else None)
    before, loads, loop = config.gain_table(), loads_at(config.scenario, columns["t"]), config.loop

    def scores(true: Linearise | None) -> list[RegionScore]:
        return region_scores(before, after, changed, columns, fixed, true, loop.sample_time_s, loop.tau_f_s, loads)

    try:
        return scores(known.linearise if known is not None else None)
    except PlantFaultError as fault:  # a copy that tells nothing takes nothing from the report
        say(f"{loop.name}: no Ms on the simulated process: {fault}")
        return scores(None)


def _as_kept(kept: Document, score: RegionScore) -> RegionScore:
    def ms(name: str, now: float | None) -> float | None:
        unstable = kept.get(f"stable_{name}") is False
        return now if now is not None else math.inf if unstable else number(kept, f"ms_{name}")

    before, after = ms("before", score.ms_before), ms("after", score.ms_after)
    return replace(score, iae_fixed=number(kept, "iae_fixed"), ms_before=before, ms_after=after)
