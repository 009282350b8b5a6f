"""A loop out of whatever a plant exports: one table or several, one loop or many, and what was assumed on the way.

    tables -> signals by tag and role -> the loop that is meant -> rows in order -> one clock -> Recording + assumptions

What is ambiguous is not guessed: the refusal names the option that answers it.
"""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from importlib import import_module
from itertools import chain, pairwise
from pathlib import Path

import numpy as np

from retuner.adaptive import display_hook
from retuner.adaptive.signals.sample import LARGEST, FloatArray
from retuner.drivers.historian.assumption import Assumption, in_a_line, quoted
from retuner.drivers.historian.data_frames import is_frame, table_of_frame
from retuner.drivers.historian.parquet_tables import tables_of_parquet
from retuner.drivers.historian.raw_table import RawTable, decoded, text_table
from retuner.drivers.historian.record_form import RecordForm
from retuner.drivers.historian.reshaped import ANNOTATIONS, annotated_table
from retuner.drivers.historian.row_order import OneSignal, joined
from retuner.drivers.historian.scaling import scaled
from retuner.drivers.historian.table_signals import BESIDE, TableSignals, signals_of
from retuner.drivers.historian.tags import named
from retuner.drivers.recorded.recording import Recording, RecordingError
from retuner.schedule.late_dataclass import dataclass, field, replace

FILES_OF_A_FOLDER = (".csv", ".txt", ".tsv", ".parquet")
TRAFFIC = (".blf", ".asc", ".mf4", ".log")  # Logs of bus traffic; of a folder they are read where a DBC is given
TAGS_SHOWN = 8
CALENDAR_S = 1e8  # stamps from which on are moments since 1970; smaller ones are times of the record's own
EMPTY = "{}: no file in the folder; give text (.csv, .txt) or .parquet"
WHOLE = RecordForm()


@dataclass(frozen=True, slots=True)
class LoopRecord(display_hook.Drawn):
    """A record with what was assumed in reading it.

    tag : of the loop, "" where the record names none. others : further columns that were wanted, by name, at its
    samples. begin_s : when it begins, s since 1970; None where its times
    are of no calendar.
    """

    recording: Recording
    assumed: tuple[Assumption, ...]
    tag: str = ""
    begin_s: float | None = None
    others: Mapping[str, FloatArray] = field(default_factory=dict)

    def __repr__(self) -> str:
        assumed = f"; assumed: {in_a_line(self.assumed)}" if self.assumed else ""
        return f"LoopRecord({f'{self.tag}, ' * bool(self.tag)}{self.recording.summary}{assumed})"


def read_loop_record(sources: Iterable[object], form: RecordForm = WHOLE, *, in_automatic: bool = False) -> LoopRecord:
    """Read one loop.

    sources : paths of text or Parquet files or folders of them, or data frames (pandas, polars, arrow); several are
        signals of one loop apart, or its record in pieces. form : what is known of their form. in_automatic : where the
        record has modes in words, take its longest stretch in automatic.

    Raises RecordingError: a source cannot be read, holds no loop or several, or is ambiguous: one line with the option
    that answers it.
    """
    asked = [*sources]
    tables = [table for source in asked for table in _tables(source, form)]
    if not tables:
        raise RecordingError(EMPTY.format(_listed(str(one) for one in asked if isinstance(one, str | Path))))
    read = [signals_of(table, own, in_automatic=in_automatic) for table, own in _forms(tables, form)]
    return _record(*_chosen(_together(read), form, tables), read, form)


def read_records(sources: Iterable[object], form: RecordForm = WHOLE) -> list[LoopRecord]:
    """Records of one loop: of several sources each one that holds pv and co, where all do; else all as one record.

    Raises RecordingError: as read_loop_record; or the records are of several loops.
    """
    asked = [*sources]
    tables = [_tables(source, form) for source in asked]
    own = iter(_forms([*chain(*tables)], form))
    read = [[signals_of(*next(own), in_automatic=True) for _ in each] for each in tables]
    if not all(any({"pv", "co"} <= roles.keys() for roles in _pieces(each).values()) for each in read):
        tables, read = [list(chain(*tables))], [list(chain(*read))]
    if not all(tables):
        raise RecordingError(EMPTY.format(_listed(str(one) for one in asked if isinstance(one, str | Path))))
    found = [_record(*_chosen(_together(each), form, its), each, form) for its, each in zip(tables, read, strict=True)]
    tags = {record.tag for record in found}
    if len(tags) > 1:
        raise RecordingError(
            f"records of {len(tags)} loops: {_listed(sorted(tags))}; give those of one, or name it: --tag"
        )
    return found


def read_loops(
    sources: Iterable[object], form: RecordForm = WHOLE, tags: Sequence[str] = ()
) -> dict[str, LoopRecord | RecordingError]:
    """Every loop of the sources by its tag; one that cannot be read is there with the reason.

    tags : loops of Parquet files that are wanted; where none is given, all.

    Raises RecordingError: a source cannot be read at all.
    """
    read: list[TableSignals] = []
    broken: list[RecordingError] = []
    for source in sources:
        try:
            read += [signals_of(table, form, in_automatic=True) for table in _tables(source, form, tags)]
        except RecordingError as error:
            broken.append(error)
    if broken and not read:
        raise broken[0]
    told = tuple(Assumption(f"left out: {error}") for error in broken)
    return _loops([*(replace(one, assumed=(*one.assumed, *told)) for one in read[:1]), *read[1:]], form)


def loop_in_pieces(files: Sequence[Path], form: RecordForm, tag: str, most_rows: int) -> Iterator[LoopRecord]:
    """One loop of wide Parquet files, each of which holds all its signals for a time, so much of it at once.

    files : in the order of time. most_rows : of a piece; small files are put together.

    Raises RecordingError: a file cannot be read, or holds the loop not at all.
    """
    pending: list[TableSignals] = []
    rows = 0
    for path in files:
        for tables in tables_of_parquet(path, form, [tag], most_rows):
            more = sum(len(table.places) for table in tables)
            if pending and rows + more > most_rows:
                yield _only(pending, form, tag)
                pending, rows = [], 0
            pending += [signals_of(table, form, in_automatic=True) for table in tables]
            rows += more
    if pending:
        yield _only(pending, form, tag)


def _only(read: Sequence[TableSignals], form: RecordForm, tag: str) -> LoopRecord:
    found = _loops(read, form).get(tag, RecordingError(f"{read[0].source}: no values of {tag} that are known"))
    if isinstance(found, RecordingError):
        raise found
    return found


def _loops(read: Sequence[TableSignals], form: RecordForm) -> dict[str, LoopRecord | RecordingError]:
    """The loops of tables; one that is broken in one of them is told so."""
    found: dict[str, LoopRecord | RecordingError] = {tag: error for one in read for tag, error in one.refused.items()}
    for tag, roles in _pieces(read).items():
        if {"pv", "co"} <= roles.keys() and tag not in found:
            try:
                found[tag] = _record(tag, _joined_pieces(roles, read[0].source), read, form)
            except RecordingError as error:
                found[tag] = error
    return found


def _record(tag: str, trends: Mapping[str, OneSignal], read: Sequence[TableSignals], form: RecordForm) -> LoopRecord:
    for role, trend in trends.items():
        if not len(trend.t_s):
            raise RecordingError(f"{read[0].source}: {role} has no value that is known; name another column")
    t_s, values, told = joined(trends["pv"], {r: s for r, s in trends.items() if r != "pv"})
    said = [*(a for one in read for a in (*one.assumed, *one.of_loop.get(tag, ()))), *told]
    source = read[0].source if len(read) == 1 else f"{read[0].source} and {len(read) - 1} more"
    for name in form.others:
        if name not in values:
            raise RecordingError(f"{source}: no column {quoted(name)}; name it as it stands in the head of the record")
        if not np.max(np.abs(values[name])) <= LARGEST:
            raise RecordingError(f"{source}: {name} is beyond {LARGEST:g} somewhere; give it in its engineering units")
    if form.sp is not None and "sp" not in values:
        values["sp"] = np.full(len(t_s), form.sp)
    if len(t_s) < 3:
        raise RecordingError(f"{source}: a record needs at least 3 samples, this one has {len(t_s)}")
    begin_s = None if abs(float(t_s[0])) < CALENDAR_S else float(t_s[0])
    recording = Recording(source, t_s - (begin_s or 0.0), values["pv"], values["co"], values.get("sp"))
    recording, more = scaled(recording, form.scale)
    others = {name: values[name] for name in form.others}
    return LoopRecord(recording, (*dict.fromkeys(said), *more), tag, begin_s, others)


def _tables(source: object, form: RecordForm, tags: Sequence[str] = ()) -> list[RawTable]:
    """The tables of a source; tags : loops that are wanted of a Parquet file, all where none is given."""
    if is_frame(source):
        return [table_of_frame(source)]
    path = Path(str(source))
    if path.is_dir():
        wanted = FILES_OF_A_FOLDER + TRAFFIC * bool(form.dbc)
        inside = sorted(p for p in path.rglob("*") if p.suffix.lower() in wanted)
        return [table for p in inside for table in _tables(p, form, tags)]
    if path.suffix.lower() == ".parquet":
        return [table for tables in tables_of_parquet(path, form, tags) for table in tables]
    if path.suffix.lower() in TRAFFIC:
        tables: list[RawTable] = import_module("retuner.drivers.historian.bus_traffic").tables_of_traffic(path, form)
        return tables
    text, assumed = decoded(path, form)
    if text.lstrip("\ufeff\r\n ").startswith(ANNOTATIONS):  # InfluxDB's annotated CSV
        found = annotated_table(str(path), text)
        return [replace(found, assumed=(*assumed, *found.assumed))]
    return [text_table(path, text, assumed, form)]


def _forms(tables: Sequence[RawTable], form: RecordForm) -> list[tuple[RawTable, RecordForm]]:
    """Each table with what of the named columns is its own: a column of another file, or a file of one signal.

    Raises RecordingError: no table has a column, or is a file, of a name; or a file of that name holds several signals.
    """
    if len(tables) < 2 or not form.columns:
        return [(table, form) for table in tables]
    for role, name in form.columns.items():
        if not any(
            name in table.names or name in {Path(table.source).name, Path(table.source).stem} for table in tables
        ):
            raise RecordingError(f'no column and no file is called "{name}"; {_to_be_named(tables, role)}')
    found = []
    for table in tables:
        files = {Path(table.source).name, Path(table.source).stem}
        columns = {}
        for role, name in form.columns.items():
            if name in table.names:
                columns[role] = name
            elif name in files:
                named_ones = set(form.columns.values())
                free = [name for name in table.names if name not in named_ones and named(name).role not in BESIDE]
                free = [name for name in free if named(name).role == "value"] or free
                if len(free) != 1:
                    raise RecordingError(
                        f"{table.source}: holds {_listed(table.names)}; name its column as in --columns pv=NAME"
                    )
                columns[role] = free[0]
        found.append((table, replace(form, columns=columns)))
    return found


def _to_be_named(tables: Sequence[RawTable], role: str) -> str:
    """What a signal may be called: a column, or where there are several files one of them."""
    there = _listed(dict.fromkeys(name for table in tables for name in table.names))
    if len(tables) < 2:
        return f"there is {there}; name it as in --columns {role}=NAME"
    files = _listed(Path(table.source).stem for table in tables)
    return f"there is {there} in the files {files}; name a column or a file as in --columns {role}=NAME"


def traffic_names(path: Path, form: RecordForm) -> list[str]:
    """The names of the signals in it; errors as traffic_tables."""
    names: list[str] = import_module("retuner.drivers.historian.bus_traffic").traffic_names(path, form)
    return names


Pieces = dict[str, list[OneSignal]]  # A loop's signals by role, each in pieces


def _together(read: Sequence[TableSignals]) -> dict[str, dict[str, OneSignal]]:
    """Signals of all tables by tag and role: pieces of one signal one after the other."""
    refused = [error for one in read for error in one.refused.values()]
    if refused:
        raise refused[0]
    return {tag: _joined_pieces(roles, read[0].source) for tag, roles in _pieces(read).items()}


def _pieces(read: Sequence[TableSignals]) -> dict[str, Pieces]:
    pieces: dict[str, Pieces] = {}
    for one in read:
        for tag, trends in one.loops.items():
            for role, trend in trends.items():
                pieces.setdefault(tag, {}).setdefault(role, []).append(trend)
    if len(pieces) > 1 and "" in pieces and not {"pv", "co"} <= pieces[""].keys():
        shared = pieces.pop("")
        for roles in pieces.values():
            for role, found in shared.items():
                roles.setdefault(role, found)
    return pieces


def _joined_pieces(roles: Pieces, source: str) -> dict[str, OneSignal]:
    """Each signal as one, its pieces in the order of time."""
    found = {role: pieces[0] for role, pieces in roles.items()}
    for role, pieces in roles.items():
        if len(pieces) == 1:
            continue
        some = sorted((p for p in pieces if len(p.t_s)), key=lambda p: float(p.t_s[0]))
        if any(b.t_s[0] <= a.t_s[-1] for a, b in pairwise(some)):
            raise RecordingError(
                f"{source}: {role} has two values at the same time; give one file for it, or --columns"
            )
        t_s, values = np.concatenate([p.t_s for p in some]), np.concatenate([p.values for p in some])
        found[role] = OneSignal(t_s, values, any(p.held for p in some))
    return found


def _chosen(
    loops: Mapping[str, Mapping[str, OneSignal]], form: RecordForm, tables: Sequence[RawTable]
) -> tuple[str, Mapping[str, OneSignal]]:
    """The loop that is meant: its tag, and its signals by role."""
    source = tables[0].source
    whole = {tag: trends for tag, trends in loops.items() if {"pv", "co"} <= trends.keys()}
    if form.tag:
        fitting = [tag for tag in whole if tag.lower() == form.tag.lower()]
        if not fitting:
            raise RecordingError(f"{source}: no loop {quoted(form.tag)} with pv and co; there is {_listed(whole)}")
        return fitting[0], whole[fitting[0]]
    if len(whole) == 1:
        return next(iter(whole.items()))
    if whole:
        raise RecordingError(f"{source}: {len(whole)} loops in it; name one with --tag: {_listed(whole)}")
    missing = "co" if "pv" in {role for trends in loops.values() for role in trends} else "pv"
    raise RecordingError(f'{source}: no column "{missing}"; {_to_be_named(tables, missing)}')


def _listed(names: Iterable[str]) -> str:
    found = [name or "(no tag)" for name in names]
    more = f" and {len(found) - TAGS_SHOWN} more" if len(found) > TAGS_SHOWN else ""
    return (", ".join(found[:TAGS_SHOWN]) or "nothing") + more
