"""A table as it stands in a file: which encoding, which delimiter, where the names are and where the rows begin.

The rows are the lines of the most usual number of fields in which at least half of the fields are values (numbers,
stamps, words for a missing value). Of the lines before the first row that have as many fields, the one in which most
names are known is the header: units and descriptions stand in the others.
"""

import re
from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import numpy.typing as npt

from retuner.adaptive.signals.sample import FloatArray
from retuner.drivers.historian.assumption import Assumption, quoted
from retuner.drivers.historian.record_form import DELIMITERS, RecordForm
from retuner.drivers.historian.tags import TIME_UNIT, known_roles
from retuner.drivers.recorded.recording import SIZE_MAX, RecordingError, fields_of, size_of
from retuner.schedule.late_dataclass import dataclass, field

Column = Sequence[str] | FloatArray | npt.NDArray[np.datetime64]
"""Fields as text, numbers (nan where there is none), or times."""

UNITS = (
    "°C|°F|°|degC|degF|deg C|deg F|C|F|K|%|mbar|barg|bar|psig|psi|hPa|kPa|MPa|Pa|mm|cm|m|l|L|m3|m³|l/s|l/min|l/h|L/min"
    "|m3/h|m³/h|m3/s|m³/s|Nm3/h|Nm³/h|gpm|kg/s|kg/h|t/h|rpm|1/min|m/s|mm/s|mV|V|mA|A|W|kW|MW|Hz|kg|t|pH|ppm|mS/cm|s|min"
)
"""Units that may stand beside a value in its field."""
WITH_UNIT = re.compile(rf"(?P<number>[+-]?[.,]*[0-9][0-9.,]*(?:[eE][+-]?[0-9]+)?) *(?P<unit>{UNITS})")
VALUE = re.compile(
    r"[+-]?[.,]*[0-9][0-9.,]*(?:[eE][+-]?[0-9]+)?"  # a number, with any point
    rf"(?: *(?:{UNITS}))?"
    r"|[0-9]{1,4}[-/.][0-9A-Za-z]{1,9}[-/.][0-9]{1,4}.*"  # a date, with or without the time
    r"|[0-9]{1,2}:[0-9]{2}.*"  # a time of day
)
WITH_STATUS = re.compile(r"(?P<value>[^{]*?) *\{(?P<status>[\w ,]*)\}(?: *@ *\w+)?")
"""A value with its state beside it, as Niagara writes it: "50.00 % {ok}", "0.0 {down,stale}", "7 {overridden} @ 8"."""
MISSING = frozenset(
    {
        "", "-", "--", "?", "nan", "null", "none", "na", "n/a", "#n/a", "#value!", "#ref!", "bad", "no data", "nodata",
        "no good data for calculation", "bad input", "i/o timeout", "comm fail", "not connect", "pt created",
        "scan off", "arc off-line", "shutdown", "intf shut", "offline", "out of serv", "under range", "over range",
        "configure",
    }
)  # fmt: skip
"""Words for a value that is not there, in small letters; historians write them into the column of the value."""
LOOKED_AT = 400  # lines that the form is told from: enough to see a preamble of any length beside rows
NOTHING = "nothing"


@dataclass(frozen=True, slots=True)
class RawTable:
    """A table before anything is made of its fields.

    source : where it is from, for messages. names : of the columns. columns : of equal length, one for each name.
    places : of the rows, as a message tells them. assumed : what was found out of its form. time_units : by column, as
    a row of units beside the names tells them.
    """

    source: str
    names: tuple[str, ...]
    columns: tuple[Column, ...]
    places: Sequence[str]
    assumed: tuple[Assumption, ...] = ()
    time_units: Mapping[int, str] = field(default_factory=dict)


def read_text_table(path: Path, form: RecordForm, most_bytes: int | None = None) -> RawTable:
    """The table of a text file; most_bytes : read no more than so many from its begin, which tells the form.

    Raises RecordingError: it cannot be read, is no text, or has no rows of values.
    """
    return text_table(path, *decoded(path, form, most_bytes), form)


def text_table(path: Path, text: str, assumed: tuple[Assumption, ...], form: RecordForm) -> RawTable:
    """The table of a text; assumed : what was found out of its encoding. Errors as read_text_table."""
    if "\0" in text:
        number = text[: text.index("\0")].count("\n") + 1
        raise RecordingError(f"{path}:{number}: a NUL byte: not a text file")
    lines = [(i, line.lstrip("# ")) for i, line in enumerate(text.splitlines(), start=1) if line.strip("# ")]
    if not lines:
        raise RecordingError(f"{path}: is empty; give a record with time, pv and co")
    # lines from the middle and the end: rows, whatever stands before them
    half = LOOKED_AT // 2
    some = lines if len(lines) <= LOOKED_AT else [*lines[len(lines) // 2 :][:half], *lines[-half:]]
    delimiter = DELIMITERS.get(form.delimiter) or _delimiter([line for _, line in some])
    rows = [
        (number, line.split() if delimiter == " " else fields_of(path, number, line, delimiter, spaced=True))
        for number, line in lines
    ]
    rows = [(number, fields) for number, fields in rows if any(field.strip() for field in fields)]
    used = {i for _, fields in rows for i, field in enumerate(fields) if field.strip()}
    if form.header != 0 and len(used) < max(len(fields) for _, fields in rows):
        # columns in which nothing stands anywhere, as between two delimiters where one would do
        rows = [(number, [field for i, field in enumerate(fields) if i in used]) for number, fields in rows]
    header, body, cut = _shape(path, rows, form)
    assumed += cut
    width = len(body[0][1])
    if not header:
        assumed += (Assumption("no header: columns are called 1, 2, ... in their order", "header = 0"),)
    best = max(header, key=known_roles, default=[])
    names = [name.strip().strip('"') or str(i + 1) for i, name in enumerate([*best, *[""] * (width - len(best))])]
    columns = tuple(zip(*(fields for _, fields in body), strict=True))
    kept = set(form.columns.values())
    called = tuple(name if name in kept else form.called(name) for name in names)
    # units of time stand in the lines before the rows that hold not the names
    beside = [(i, text.strip("[]() ").lower()) for row in header if row is not best for i, text in enumerate(row)]
    units = {place: TIME_UNIT[unit] for place, unit in beside if unit in TIME_UNIT}
    return RawTable(str(path), called, columns, [f":{number}" for number, _ in body], assumed, units)


def decoded(path: Path, form: RecordForm, most_bytes: int | None = None) -> tuple[str, tuple[Assumption, ...]]:
    """The file as text: by its mark, else as UTF-8 where it is that, else by its bytes as Windows writes them."""
    try:
        size = size_of(path, "a record as text or Parquet")
        if size > SIZE_MAX:
            raise RecordingError(f"{path}: larger than {SIZE_MAX} bytes; cut the record into pieces")
        with path.open("rb") as stream:
            data = stream.read(-1 if most_bytes is None else most_bytes)
    except OSError as error:
        raise RecordingError(f"{path}: cannot be read: {error}") from error
    if len(data) < size:  # whole lines only
        data = data[: data.rfind(b"\n") + 1] or data
    known: list[tuple[str, tuple[Assumption, ...]]] = [("utf-8-sig", ())]
    if data.startswith((b"\xff\xfe", b"\xfe\xff")):
        known.insert(0, ("utf-16", (Assumption("read as UTF-16", 'encoding = "utf-16"'),)))
    elif data[1:400:2].count(0) > 0.4 * len(data[1:400:2]) and data[:1] != b"\0":
        known.insert(0, ("utf-16-le", (Assumption("read as UTF-16", 'encoding = "utf-16-le"'),)))
    known.append(("latin-1", (Assumption("not UTF-8: read as Latin-1", 'encoding = "latin-1"'),)))
    for encoding, assumed in [(form.encoding, ())] if form.encoding else known:
        try:
            return data.decode(encoding), assumed
        except UnicodeDecodeError as error:
            if form.encoding:
                raise RecordingError(
                    f"{path}: byte {error.start} is no {form.encoding}; give the right encoding"
                ) from error
    raise AssertionError("any bytes are Latin-1")


def without_status(field: str) -> str:
    """A field as it stands, without the state that may stand beside its value."""
    text = field.strip().strip('"')
    found = WITH_STATUS.fullmatch(text) if "{" in text else None
    return found["value"] if found else text


def is_value(field: str) -> bool:
    """Whether a field is a number, a stamp or a word for a missing value."""
    text = without_status(field)
    return bool(VALUE.fullmatch(text)) or text.lower() in MISSING


def _delimiter(lines: Sequence[str]) -> str:
    """The delimiter under which most lines have the same number of fields, more than one, with most values in them."""

    def speaks_for(delimiter: str) -> tuple[float, float, int]:
        split = [line.split(delimiter) for line in lines]
        count, times = Counter(map(len, split)).most_common(1)[0]
        if count < 2:
            return (0.0, 0.0, 0)
        fields = [field for row in split for field in row]
        return (times / len(split), sum(map(is_value, fields)) / len(fields), count)

    best = max(("\t", ";", ",", "|"), key=lambda d: tuple(round(x, 1) for x in speaks_for(d)[:2]))
    return best if speaks_for(best)[2] else " "


def _is_row(fields: Sequence[str]) -> bool:
    values = [bool(VALUE.fullmatch(without_status(field))) for field in fields]
    return any(values) and sum(map(is_value, fields)) >= len(fields) / 2


Rows = list[tuple[int, list[str]]]  # fields of each line, by its number


def _shape(path: Path, rows: Rows, form: RecordForm) -> tuple[list[list[str]], Rows, tuple[Assumption, ...]]:
    """Lines that may hold the names, the rows of values, and what was left out."""
    counted = Counter(len(fields) for _, fields in rows[-LOOKED_AT:] if _is_row(fields))
    if not counted:
        header = ", ".join(rows[0][1]) or NOTHING
        raise RecordingError(f"{path}: no row of numbers; there is {header[:80]}")
    width = counted.most_common(1)[0][0]
    first = next(i for i, (_, fields) in enumerate(rows) if len(fields) == width and _is_row(fields))
    if form.header is not None:
        first = max(first, sum(number <= form.header for number, _ in rows))
    before, body = rows[:first], rows[first:]
    if not body:
        raise RecordingError(f"{path}: header = {form.header}: no rows after it; lines are counted from 1")
    told: tuple[Assumption, ...] = ()
    if len(body) > 1 and len(body[-1][1]) != width:
        told = (Assumption("the last line is cut: left out"),)
        body = body[:-1]
    for number, fields in body:
        if len(fields) != width:
            hint = "; a decimal comma needs ; between fields" if len(fields) == 2 * width else ""
            raise RecordingError(f"{path}:{number}: {len(fields)} fields, other rows have {width}{hint}")
    if form.header is not None:
        return [fields for number, fields in before if number == form.header], body, told
    # a header with a name less than the rows have fields, where their last field is not just a delimiter
    whole = any(len(fields) == width for _, fields in before) or not any(fields[-1].strip() for _, fields in body)
    for number, fields in () if whole else before:
        if len(fields) == width - 1 and known_roles(fields):
            raise RecordingError(
                f"{path}:{number}: {width - 1} names over rows of {width} fields (a comma in a stamp, row numbers?); "
                "give each column its name, or --record with header = 0, and --columns t=1,pv=2,..."
            )
    return [fields for _, fields in before if width in {len(fields), len(fields) + 1}], body, told


def refuse_repeated(table: RawTable, place: int) -> None:
    """Refuse a column whose name stands twice."""
    name = table.names[place]
    if table.names.count(name) > 1:
        raise RecordingError(f"{table.source}: two columns are called {quoted(name)}; rename one")
