"""retuner audit: which loops of a plant deserve a visit, out of a folder of its trends."""

import re
import sys
from collections.abc import Sequence

from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

from retuner.audit.catalogue import Catalogue, catalogue, files_of
from retuner.audit.loop_row import AuditSettings, Row, is_fault
from retuner.audit.ranked_loops import mean_error, summary, write_joined, write_results
from retuner.audit.result_store import ResultStore, rows_of
from retuner.audit.working import Pass, diagnosing, expected, on_a_cluster, on_this_machine, processes, screening
from retuner.commands.options import controller_units
from retuner.commands.recorded.recorded_loop import record_form
from retuner.commands.signatures import AuditOptions
from retuner.errors import UserError, user_input
from retuner.report.console import screen_console
from retuner.verbosity import quiet

JOINED = "names.toml"
SHOWN = 10  # Loops that are told on the screen; the page has all


def audit(options: AuditOptions) -> int:
    """Audit; the exit status: 0, or 1 when no loop could be judged.

    Raises UserError, RecordingError: a source or an option cannot be used.
    """
    form = record_form(options)
    with user_input("--stretches"):
        settings = AuditSettings(options.stretches, form)
    if not 0 <= options.diagnose <= 100:
        raise UserError(f"--diagnose {options.diagnose:g}: give 0 to 100 percent of the loops")
    _refuse_pattern("--area", options.area)
    units = controller_units(options.controller, options.pv_span, None)
    before = rows_of(options.since) if options.since is not None else []
    files = files_of(options.sources)
    _refuse_pattern("--tag-pattern", options.tag_pattern)
    found = catalogue(files, settings.form, options.tag_pattern)
    if not found.tasks:
        why = f"; {found.refused[0][1]}" if found.refused else ""
        there = f"none in its {len(files)} file{'s' * (len(files) != 1)}" if files else "it has no files of records"
        raise UserError(
            f"{options.sources[0]}: no loop found, {there}{why}; give a folder of CSV, text or Parquet files"
        )
    with ResultStore(options.out) as store:
        write_joined(options.out / JOINED, found)
        store.drop_others(set(found.tags))
        share = options.diagnose / 100
        # say how long a long audit takes, and how to have it sooner
        told = expected(len(found.tags), options.stretches, options.diagnose / 100, options.jobs or processes())
        if told and not (options.scheduler or options.as_json or quiet()):
            sys.stderr.write(told + "\n")
        first = screening(found.tasks, settings, store.done(), share)
        if _pass(first, found.tags, options, store, "screened" if share < 1 else "loops"):
            stopped = True
        elif share >= 1 or settings.stretches == 0:
            stopped = False
        else:
            then = diagnosing(found.tasks, settings, store.rows(), store.done(), share)
            stopped = _pass(then, tuple(tag for task in then.signed for tag in task.tags), options, store, "diagnosed")
        rows = write_results(options.out, store.rows(), before, found.refused, options.sources, options.area, units)
    _tell(rows, found, options)
    if stopped:
        left = len(found.tags) - len(rows)
        what = f"{left} loops are left" if left else "some loops are not diagnosed yet"
        sys.stderr.write(f"stopped: {what}; the same command goes on\n")
        raise KeyboardInterrupt
    return 0 if any("failed" not in row for row in rows) else 1


def _refuse_pattern(option: str, text: str) -> None:
    try:
        re.compile(text)
    except re.error as error:
        raise UserError(f"{option} {text}: {error}; give a regular expression") from error


def _pass(some: Pass, tags: Sequence[str], options: AuditOptions, store: ResultStore, what: str) -> bool:
    """Do the tasks; whether it was stopped by Ctrl-C, with what was done kept. tags : all, done ones too."""
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    hidden = options.as_json or quiet() or not sys.stderr.isatty()
    done = len(tags) - sum(len(task.tags) for task in some.tasks)
    with Progress(*columns, console=screen_console(stderr=True), disable=hidden) as bar:
        shown = bar.add_task(what, total=len(tags), completed=done)
        try:
            todo, settings = some.tasks, some.settings
            jobs = min(options.jobs or processes(), max(len(todo), 1))
            cluster = options.scheduler
            for task, rows in (
                on_a_cluster(todo, settings, cluster) if cluster else on_this_machine(todo, settings, jobs)
            ):
                store.keep(rows, some.signed[task])
                bar.advance(shown, len(task.tags))
        except KeyboardInterrupt:
            return True
    return False


def _tell(rows: Sequence[Row], found: Catalogue, options: AuditOptions) -> None:
    if options.as_json:
        sys.stdout.write((options.out / "audit.json").read_text(encoding="utf-8"))
        return
    for path, reason in found.refused[:SHOWN]:
        sys.stderr.write(f"left out: {reason if str(path) in reason else f'{path}: {reason}'}\n")
    tag, roles = next(((tag, roles) for tag, roles in found.signals.items() if tag), ("", {}))
    apart = [task for task in found.tasks if task.separate]
    files = sum(len(task.files) for task in apart)
    by_name = f"{files} files are records of {len(apart)} {'loop' if len(apart) == 1 else 'loops'}, by their names"
    shown = ", ".join(f"{role} = {roles[role]}" for role in sorted(roles)) + ("; " if roles and apart else "")
    shown += by_name if apart else ""
    more = f"; {len(found.others)} names belong to no loop" if found.others else ""
    names_told = (f"{tag}: " if tag else "") + shown + more
    sys.stderr.write(
        f"names: {names_told}; {options.out / JOINED} lists all; correct it and give it back with --record\n"
    )
    sys.stdout.write(summary(rows, len(found.refused)) + "\n")
    for row in [row for row in rows if is_fault(row)][:SHOWN]:
        sure = f", {row['confidence']:.0%} sure" if row["confidence"] is not None else ""
        error, share = mean_error(row), row.get("avoidable")
        if error is None or not isinstance(share, float) or not row.get("basis"):
            cost = ""
        else:
            by = {"Harris": "Harris index"}.get(str(row["basis"]), row["basis"])
            cost = f"; mean error {error:.3g}; about {100 * share:.0f} % avoidable ({by})"
        sys.stdout.write(f"{row['place']:>4}  {row['tag']}: {row['action']}{sure}{cost}\n      {row['reason']}\n")
    if options.since is not None:
        # what became worse since the earlier audit, in a line
        worse = [f"{row['tag']} ({row['change']})" for row in rows if str(row["change"]).startswith("worse")]
        more = f" and {len(worse) - SHOWN} more" if len(worse) > SHOWN else ""
        sys.stdout.write(f"worse since then: {', '.join(worse[:SHOWN]) or 'none'}{more}\n")
    sys.stdout.write(f"the page: {options.out / 'index.html'}\n")
