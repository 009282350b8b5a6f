"""Exports that are no table of rows yet: annotated CSV of InfluxDB, and pairs of time and value side by side.

Both become the long form, a row for each value with the name of its signal: names time, value and tag.

InfluxDB (annotated CSV): lines that begin with # tell of each column its type and whether it is part of the group key;
a blank line or a new head begins another table. A signal's name is what tells the series apart, then the field.

Pairs (PI DataLink and spreadsheets made by hand): time, value, time, value, ...; each signal has stamps of its own, and
its name stands over its value or over its time.
"""

import csv
from dataclasses import replace
from itertools import groupby

import numpy as np

from retuner.drivers.historian.assumption import Assumption, quoted
from retuner.drivers.historian.raw_table import MISSING, VALUE, Column, RawTable
from retuner.drivers.historian.tags import named
from retuner.drivers.recorded.recording import RecordingError

LONG = ("time", "value", "tag")
ANNOTATIONS = ("#group", "#datatype", "#default")
INFLUX_OWN = frozenset({"", "result", "table", "_start", "_stop", "_time", "_value", "_field"})
"""Columns of an annotated table that are no tag of the series."""
Lines = list[tuple[int, list[str]]]  # lines of a file by their number, each as its fields


def annotated_table(source: str, text: str) -> RawTable:
    """The values of an annotated file, a row each.

    Raises RecordingError: a table has no column _time, or a row another number of fields than its head.
    """
    rows: list[tuple[str, str, str, str]] = []
    lines = [(number, line) for number, line in enumerate(text.splitlines(), 1)]
    for filled, block in groupby(lines, key=lambda at: bool(at[1].strip(", "))):
        if filled:
            rows += _values(source, [(number, next(csv.reader([line]))) for number, line in block])
    if not rows:
        raise RecordingError(f"{source}: has annotations but no values")
    names = sorted({name for _, _, name, _ in rows})
    parts = [name.split("\0") for name in names]
    if len({len(p) for p in parts}) == 1:  # parts that are the same in all are left out
        telling = [i for i in range(len(parts[0])) if len({p[i] for p in parts}) > 1] or [len(parts[0]) - 1]
        parts = [[p[i] for i in telling] for p in parts]
    short = {name: ".".join(filter(None, p)) for name, p in zip(names, parts, strict=True)}
    columns = ([r[0] for r in rows], [r[1] for r in rows], [short[r[2]] for r in rows])
    return RawTable(source, LONG, columns, [r[3] for r in rows], (Assumption("annotated CSV of InfluxDB"),))


def _values(source: str, block: Lines) -> list[tuple[str, str, str, str]]:
    """Time, value, name and place of each value of one block of lines."""
    plain = [(number, fields) for number, fields in block if not fields[0].startswith("#")]
    if not plain:
        return []
    number, head = plain[0]
    if "_time" not in head:
        raise RecordingError(f"{source}:{number}: a table without _time; export it with its times")
    time = head.index("_time")
    fields = [head.index("_value")] if "_value" in head else []
    if not fields:  # of a table that was pivoted: all that are no part of the group key
        group = next((row for _, row in block if row[0] == "#group"), ["false"] * len(head))
        own = [name not in INFLUX_OWN and name[:1] != "_" for name in head]
        fields = [i for i, wanted in enumerate(own) if wanted and group[i] != "true"]
    keys = [i for i, name in enumerate(head) if name not in INFLUX_OWN and i not in fields]
    found = []
    for place, row in plain[1:]:
        if len(row) != len(head):
            raise RecordingError(f"{source}:{place}: {len(row)} fields, the head of its table has {len(head)}")
        series = "\0".join(row[i] for i in keys)
        for i in fields:
            field = row[head.index("_field")] if head[i] == "_value" and "_field" in head else head[i]
            found.append((row[time], row[i], f"{series}\0{field}", f":{place}"))
    return found


def unpaired(table: RawTable) -> RawTable:
    """The table as a long one, where its columns are pairs of time and value; else as it is."""
    n = len(table.names)
    if n < 4 or n % 2 or not all(_is_time(table, i) == (i % 2 == 0) for i in range(n)):
        return table
    times, values, tags, places = [], [], [], []
    for i in range(0, n, 2):
        over = [table.names[i + 1], table.names[i]]
        telling = [name for name in over if not name.isdigit() and named(name).role not in {"t", "date", "value"}]
        if not telling:
            raise RecordingError(
                f"{table.source}: columns {i + 1} and {i + 2} are a time and a value without a name; "
                f"write the signal's name over them, as in {quoted('FIC101.PV')}"
            )
        name = telling[0]
        stamps, column = _text(table.columns[i]), _text(table.columns[i + 1])
        for stamp, value, place in zip(stamps, column, table.places, strict=True):
            if stamp.strip().lower() not in MISSING:
                times.append(stamp)
                values.append(value)
                tags.append(name)
                places.append(place)
    told = Assumption(f"{n // 2} signals with times of their own, side by side")
    return replace(table, names=LONG, columns=(times, values, tags), places=places, assumed=(*table.assumed, told))


def _text(column: Column) -> list[str]:
    """A column's fields as text; nothing where a number or a time is missing."""
    if not isinstance(column, np.ndarray):
        return list(column)
    if column.dtype.kind == "M":
        return ["" if np.isnat(v) else str(v.astype("datetime64[us]")).replace("T", " ") for v in column]
    return ["" if np.isnan(v) else repr(float(v)) for v in column]


def _is_time(table: RawTable, place: int) -> bool:
    """Whether a column is a time, by what stands in it, or by its name alone where these are numbers."""
    column = table.columns[place]
    if isinstance(column, np.ndarray):
        return column.dtype.kind == "M" or named(table.names[place]).role == "t"
    some = [text for text in (field.strip() for field in column[:20]) if text.lower() not in MISSING]
    dated = bool(some) and all(VALUE.fullmatch(text) and ":" in text for text in some)
    return dated or named(table.names[place]).role == "t"
