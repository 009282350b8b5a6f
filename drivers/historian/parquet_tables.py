"""Parquet: only the columns that are wanted, in pieces of a size, a long table's signals apart.

A wide file has a column for each signal. A long one has a row for each value and its signal's name beside it, in a
column or in a folder's name as tools write data sets (tag=FIC101.PV/part-0.parquet): its signals are given as tables of
their own, so that what follows need not look at millions of names. Row groups that hold no wanted signal are not read.
"""

from collections.abc import Iterator, Sequence
from importlib import import_module
from pathlib import Path
from typing import Any

from retuner.drivers.historian.data_frames import RowNumbers, column_of
from retuner.drivers.historian.raw_table import RawTable
from retuner.drivers.historian.record_form import RecordForm
from retuner.drivers.historian.tags import loops, named
from retuner.drivers.recorded.recording import RecordingError, open_parquet
from retuner.schedule.late_dataclass import dataclass

MOST_ROWS = 1 << 20  # rows of a piece: four months at ten seconds; the memory of a piece is some hundred bytes a row


@dataclass(frozen=True, slots=True)
class ParquetShape:
    """What a file holds, nothing of it read: names of its columns, rows; the signal that its folder names, or ""."""

    names: tuple[str, ...]
    rows: int
    folder_signal: str


def parquet_shape(path: Path) -> ParquetShape:
    """What a Parquet file holds. Raises RecordingError: the file cannot be read, or pyarrow is not installed."""
    with open_parquet(path) as file:
        return ParquetShape(tuple(file.schema_arrow.names), file.metadata.num_rows, signal_of_folder(path))


def signal_of_folder(path: Path) -> str:
    """The signal that a folder of a data set names, or ""."""
    for part in reversed(path.parts[:-1]):
        key, equals, value = part.partition("=")
        if equals and value and named(key).role == "tag":
            return value
    return ""


def tables_of_parquet(
    path: Path, form: RecordForm, tags: Sequence[str] = (), most_rows: int | None = None
) -> Iterator[list[RawTable]]:
    """The file in pieces, each the tables of its signals.

    form : names columns that are not called by their role. tags : loops that are wanted, all where none is given.
    most_rows : of a piece; None for all in one.

    Raises RecordingError: the file cannot be read, or pyarrow is not installed.
    """
    with open_parquet(path) as file:
        schema = file.schema_arrow
        tag, value = (_place(role, schema.names, form) for role in ("tag", "value"))
        if tag and value and not any({"pv", "co"} & roles.keys() for roles in _loops(schema.names, form).values()):
            yield _long(path, file, (tag, value), form, {t.lower() for t in tags or ([form.tag] if form.tag else ())})
            return
        names = _wanted(schema, form, {t.lower() for t in tags})
        whole = most_rows is None or file.metadata.num_rows <= most_rows
        batches = [file.read(columns=names)] if whole else file.iter_batches(most_rows, columns=names)
        # the columns as the form calls them, a signal that its folder names by that name
        signal, values = signal_of_folder(path), loops(names).get("", {}).get("value", [])
        own = {names[place]: signal for place in values[:1]} if signal else {}
        kept = {*form.columns.values(), *form.others}
        called = tuple(name if name in kept else form.called(own.get(name, name)) for name in names)
        at = 0
        for batch in batches:
            if batch.num_rows:
                columns = tuple(column_of(name, batch.column(name), copy=False) for name in names)
                yield [RawTable(str(path), called, columns, RowNumbers(batch.num_rows, at))]
            at += batch.num_rows


def _loops(names: Sequence[str], form: RecordForm) -> dict[str, dict[str, list[int]]]:
    return loops([form.called(name) for name in names])


def _place(role: str, names: Sequence[str], form: RecordForm) -> str:
    """The column of a role of a table without tags in its names; "" for none."""
    found = loops(names).get("", {}).get(role, [])
    return form.columns.get(role) or (names[found[0]] if found else "")


def _wanted(schema: Any, form: RecordForm, tags: set[str]) -> list[str]:  # noqa: ANN401  arrow's
    """The columns that are read: of the loops that are wanted, and those that belong to no loop."""
    tags = tags or ({form.tag.lower()} if form.tag else set())
    if not tags:
        return list(schema.names)
    kept = {*form.columns.values(), *form.others}
    kept |= {f.name for f in schema if str(f.type).startswith(("timestamp", "date"))}
    for tag, roles in _loops(schema.names, form).items():
        if not tag or tag.lower() in tags:
            kept |= {schema.names[place] for places in roles.values() for place in places}
    fitting = [name for name in schema.names if name in kept]
    apart = not any({"pv", "co", "sp"} & roles.keys() for roles in _loops(fitting, form).values())
    return list(schema.names) if apart and not {"pv", "co", "sp"} & form.columns.keys() else fitting


def _long(path: Path, file: Any, at: tuple[str, str], form: RecordForm, tags: set[str]) -> list[RawTable]:  # noqa: ANN401
    """A table of its own for each signal of a long one; at : columns of the tag and of the value."""
    arrow, compute = import_module("pyarrow"), import_module("pyarrow.compute")
    names = _distinct(file, at[0])
    signals: dict[str, str] = {}
    for tag, roles in _loops(names, form).items():
        if not tags or tag.lower() in tags:
            for role in ("sp", "pv", "co", "mode"):
                places = roles.get(role, [])
                if len(places) > 1:
                    both = " and ".join(names[place] for place in places[:2])
                    raise RecordingError(f"{path}: {both} may both be {role} of {tag}; leave one out of the export")
                signals |= {names[place]: f"{tag}.{role.upper()}" for place in places}
    beside = [n for n in file.schema_arrow.names if n not in at and (named(n).role or n in form.columns.values())]
    names = [at[0], at[1], *beside]
    wanted = arrow.array(list(signals), arrow.string())
    found = []
    for group in _groups(file, at[0], set(signals)):
        table = file.read_row_group(group, columns=names)
        found.append(table.filter(compute.is_in(table.column(at[0]).cast(arrow.string()), wanted)))
    if not found:
        return []
    whole = arrow.concat_tables(found)
    fields = compute.index_in(whole.column(at[0]).cast(arrow.string()), wanted)
    tables = []
    for i, name in enumerate(signals.values()):
        rows = whole.filter(compute.equal(fields, i))
        columns = tuple(column_of(n, rows.column(n)) for n in [*beside, at[1]])
        tables.append(RawTable(str(path), (*beside, name), columns, RowNumbers(rows.num_rows)))
    return tables


def long_names(path: Path, form: RecordForm) -> list[str]:
    """The signals' names in a long file; nothing where it is wide.

    Raises RecordingError: the file cannot be read, or pyarrow is not installed.
    """
    with open_parquet(path) as file:
        tag = _place("tag", file.schema_arrow.names, form)
        return _distinct(file, tag) if tag else []


def _distinct(file: Any, column: str) -> list[str]:  # noqa: ANN401
    """The values of a column of text, in their order; a row group at a time."""
    found: dict[str, None] = {}
    for group in range(file.num_row_groups):
        values = file.read_row_group(group, columns=[column]).column(column)
        found |= dict.fromkeys(str(v) for v in values.unique().to_pylist() if v is not None)
    return list(found)


def _groups(file: Any, column: str, wanted: set[str]) -> Iterator[int]:  # noqa: ANN401
    """Row groups that may hold a wanted name, by the least and greatest name that they say they hold."""
    place = file.schema_arrow.names.index(column)
    for group in range(file.num_row_groups):
        said = file.metadata.row_group(group).column(place).statistics
        if said is None or not said.has_min_max or any(said.min <= name <= said.max for name in wanted):
            yield group
