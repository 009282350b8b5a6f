"""retuner ledger verify, show, export and revert: whether a ledger can be believed, and its rows for people and for
other programs.
"""

import contextlib
import csv
import io
import json
import math
import re
import sys
from dataclasses import fields, replace
from pathlib import Path

from rich.console import Console
from rich.markup import escape
from rich.table import Table

from retuner.commands.options import tell
from retuner.commands.signatures import ExportOptions, ShowOptions, VerifyOptions
from retuner.config.loading import load_session
from retuner.decision_page.row_values import number, part, parts, words
from retuner.decision_page.shown_units import show_units_told
from retuner.errors import UserError, one_line
from retuner.files import write_whole
from retuner.ledger import LedgerReader, Row
from retuner.live_view.what_next import what_next
from retuner.products import product
from retuner.report.ledger_words import ABOUT_A_TRIAL, LedgerLine, no_formula, told
from retuner.schedule.plain_values import plain_values
from retuner.session.outputs import CONFIG, ledger_path, rows_by_loop

SHORTEST_HEAD = 12  # hexadecimal digits; 48 bits cannot be met by chance
COLUMNS = {
    "row": "row",
    "time [s]": "when_s",
    "what": "kind",
    **{name: name for name in ("who", "loop", "region", "why", "old", "new", "evidence", "verdict")},
}
"""Heads of the table, and the field of a line below each."""


def verify(options: VerifyOptions) -> int:
    """Recompute the hash chain: status 0 when it holds, 1 when it is broken, and where.

    Raises UserError: there is no such ledger, or head is no beginning of a hash.
    """
    head = options.head
    if head is not None and not re.fullmatch(rf"[0-9a-f]{{{SHORTEST_HEAD},64}}", head):
        raise UserError(
            f"--head {head}: give {SHORTEST_HEAD} to 64 hexadecimal digits, as run and summary.json tell them"
        )
    path = ledger_path(options.file)
    with LedgerReader(path) as ledger:
        report = ledger.verify(head or "")
    same = {name: getattr(report, name) for name in ("ok", "rows", "head", "broken_seq")}
    broken = f"broken: {report.reason}; {report.rows} rows before it hold"
    line = f"{path}: {f'ok, {report.rows} rows, head {report.head}' if report.ok else broken}"
    tell({"file": str(path), **same, "reason": report.reason or None}, [line], as_json=options.as_json)
    return 0 if report.ok else 1


def _selected(rows: list[Row], options: ShowOptions) -> list[Row]:
    """Rows of one decision (its own, and those of its write), from a time on, of a kind, of a loop.

    Raises UserError: there is no such decision or kind.
    """
    names = sorted({loop for row in rows if row.kind != "session" and (loop := row.body.get("loop"))})
    if options.loop is None:
        if options.decision is not None and len(names) > 1:
            raise UserError(f"--loop: there are {len(names)} loops, name one of {', '.join(names)}")
    else:
        if options.loop not in names:
            raise UserError(f"--loop {options.loop}: no row is of this loop; there are {', '.join(names) or 'none'}")
        rows = [row for row in rows if row.body.get("loop", options.loop) == options.loop]
    if options.kind is not None:
        kinds = sorted({row.kind for row in rows})
        if options.kind not in kinds:
            raise UserError(f"--kind {options.kind}: no row is of this kind; there are {', '.join(kinds)}")
        rows = [row for row in rows if row.kind == options.kind]
    if options.since is not None:
        if math.isnan(options.since):
            raise UserError("--since nan: give seconds of the run")
        rows = [row for row in rows if row.clock_s >= options.since]
    if options.decision is None:
        return rows
    # a decision with the rows of its write, from it to the next one, where they tell of its region; and what came of
    # its trial
    inside, on_trial, region, about = False, False, None, list[Row]()
    for row in rows:
        if row.kind == "decision":
            inside = row.body.get("number") == options.decision
            region = row.body.get("region") if inside else region
        if row.body.get("region", region) != region and not (inside and row.kind == "decision"):
            continue
        on_trial = inside if row.kind == "trial" else on_trial
        ends_trial = str(row.body.get("code", "")).startswith(ABOUT_A_TRIAL)
        came_of_it = row.kind in {"judged", "restore", "restored"} or (row.kind == "decision" and ends_trial)
        if inside or (on_trial and came_of_it):
            about.append(row)
    if region is None:
        raise UserError(f"--decision {options.decision}: the ledger has no such decision")
    return about


def believed(path: Path) -> tuple[list[Row], str]:
    """The rows that can be believed, and what is wrong with the first one that cannot; empty when all can."""
    with LedgerReader(path) as ledger:
        report = ledger.verify()
        return [row for row in ledger.rows() if row.seq <= report.rows], report.reason


def show(options: ShowOptions) -> int:
    """Who, when, why, from what to what, on what evidence, with what verdict: row by row; 1 when the chain is broken.

    Raises UserError: there is no such ledger, or no such rows.
    """
    path = ledger_path(options.session)
    rows, broken = believed(path)
    chosen = _selected(rows, options)
    show_units_told(part(rows[0].body, "config") if rows else {})
    # the chosen ones of all rows in words: a row is told by those before it
    wanted = {row.seq for row in chosen}
    lines = [line for line in told(rows) if line.row in wanted]
    if options.as_json:
        document = {
            "ledger": str(path),
            "ok": not broken,
            "reason": broken or None,
            "rows": [{**line.to_dict(), "body": row.body} for line, row in zip(lines, chosen, strict=True)],
        }
        sys.stdout.write(json.dumps(document, indent=2, allow_nan=False) + "\n")
    else:
        console = Console()
        if console.width >= TABLE_WIDTH:
            console.print(_table(_folded(chosen, lines)))
        elif chosen:
            console.print(_list(_folded(chosen, lines)), highlight=False, soft_wrap=True)
        ending = f"broken: {broken}" if broken else "the chain holds"
        if options == ShowOptions(session=options.session) and rows and rows[0].kind == "session":
            # What waits for a person when the last row is written: why, and the command
            config = part(rows[0].body, "config")
            loops = parts(config, "loops") or [config]
            names = [words(part(one, "loop"), "name") for one in loops]
            by_hand = [""] * len(loops)
            with contextlib.suppress(UserError):  # a ledger is read without its configuration, too
                loops_run = load_session(path.parent / CONFIG, as_run=True)[0].loops
                by_hand = [
                    product("foreign device").advice_only(one) if one.foreign_device else "" for one in loops_run
                ]
            about = rows_by_loop(rows, names) if len(loops) > 1 else {"": tuple(rows)}
            for loop, own in about.items():
                at = names.index(loop) if loop else 0
                open_s = number(part(loops[at], "adaptation"), "approval_s") or math.inf
                for one in what_next(path.parent, own, open_s, (), None, loop, by_hand=by_hand[at]):
                    line = f"open: {one.why.removesuffix(':')}{f'; {one.command}' * bool(one.command)}"
                    console.print(line, highlight=False, markup=False, soft_wrap=True)
        console.print(
            f"{path}: {len(chosen)} of {len(rows)} rows; {ending}", highlight=False, markup=False, soft_wrap=True
        )
    return 1 if broken else 0


TABLE_WIDTH = 160  # characters of a terminal from which a table is easier to read than a list


def _table(lines: list[LedgerLine]) -> Table:
    table = Table(box=None, pad_edge=False)
    shown = {head: name for head, name in COLUMNS.items() if head != "loop" or _several(lines)}
    for head in shown:
        table.add_column(escape(head), justify="right" if head in {"row", "time [s]"} else "left", overflow="fold")
    for line in lines:
        values = line.to_dict() | {"when_s": f"{line.when_s:,.1f}"}
        table.add_row(*(escape(one_line(values[name])) for name in shown.values()))
    return table


def _several(lines: list[LedgerLine]) -> bool:
    return len({line.loop for line in lines if line.loop}) > 1


def _folded(rows: list[Row], lines: list[LedgerLine]) -> list[LedgerLine]:
    """The steps of a bump to and fro, and that the controller took each, as one line while nothing else happens."""
    found, going = list[LedgerLine](), False
    for row, line in zip(rows, lines, strict=True):
        last = found[-1] if found else None
        step = row.kind in {"bump", "nudge"} and row.body.get("cause") in {"next", "taken"}  # nudge in older ledgers
        if last is not None and going and step and last.loop == line.loop:
            found[-1] = replace(last, evidence=f"and so on, to row {line.row}")
        else:
            found.append(line)
        going = step
    return found


def _list(lines: list[LedgerLine]) -> str:
    out, several = [], _several(lines)
    for line in lines:
        where = f"{line.loop} {line.region}" if several else line.region
        head = f"{line.row:5d}  {line.when_s:10,.1f} s  {line.kind}  {line.who}  {where}"
        out.append(escape(one_line(head.rstrip())))
        change = f"{line.old} -> {line.new}" if line.old and line.new else line.new
        out += [f"       {escape(one_line(text))}" for text in (line.why, change, line.evidence, line.verdict) if text]
    return "\n".join(out)


def export(options: ExportOptions) -> int:
    """Write the rows into a file for other programs; the exit status, 1 when the chain is broken.

    Raises UserError: there is no such ledger, or not one file is named, a new one in a folder that is there.
    """
    path, as_csv, as_jsonl = ledger_path(options.session), options.as_csv, options.as_jsonl
    if (as_csv is None) == (as_jsonl is None):
        raise UserError("give --csv FILE or --jsonl FILE, one of them")
    target = as_csv or as_jsonl
    assert target is not None
    if target.exists():
        raise UserError(f"{target}: exists already; give another name")
    if not target.parent.is_dir():
        raise UserError(f"{target}: the folder {target.parent} does not exist; make it first")
    rows, broken = believed(path)
    if as_csv:
        stream = io.StringIO()
        writer = csv.writer(stream, lineterminator="\n")
        names = [field.name for field in fields(LedgerLine)]
        writer.writerow([*names, "body", "hash"])
        for row, one in zip(rows, told(rows), strict=True):
            line = one.to_dict()
            writer.writerow([*(no_formula(line[name]) for name in names), row.text, row.hash])
        text = stream.getvalue()
    else:
        documents = (plain_values(row, "seq clock_s kind body previous hash") for row in rows)
        text = "".join(json.dumps(one, allow_nan=False) + "\n" for one in documents)
    write_whole(target, text)
    ending = f"; broken: {broken}" if broken else ""
    sys.stdout.write(f"{target}: {len(rows)} rows of {path}{ending}\n")
    return 1 if broken else 0
