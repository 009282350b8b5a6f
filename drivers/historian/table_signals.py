"""The signals of one table: which column is the time, which are signals of which loop, and their values that are known.

A wide table has a column for each signal; a long one has a row for each value, with the signal's tag in it.
"""

import re
from collections.abc import Mapping, Sequence
from pathlib import PurePath
from types import MappingProxyType
from typing import Any

import numpy as np
import numpy.typing as npt

from retuner.adaptive.indexes.days import GAP
from retuner.adaptive.signals.sample import FloatArray, all_finite, median
from retuner.drivers.historian.assumption import Assumption, quoted
from retuner.drivers.historian.cells import decimal_mark, good, numbers, unit_beside
from retuner.drivers.historian.raw_table import VALUE, RawTable, refuse_repeated
from retuner.drivers.historian.record_form import SIGNALS, RecordForm
from retuner.drivers.historian.reshaped import unpaired
from retuner.drivers.historian.row_order import OneSignal, in_order
from retuner.drivers.historian.tags import TIME_UNIT, last_word, loops, named
from retuner.drivers.historian.time_stamps import DIGITS, Stamps, from_numbers, from_text
from retuner.drivers.recorded.recording import NUMBER, RecordingError
from retuner.schedule.late_dataclass import dataclass, field, replace

HELD_FROM = 0.05  # share of blanks from which a column is stored by exception and not full of faults
FILLER = re.compile(r"-?9{3,}|-?1e\+3[0-9]")  # numbers that systems write for a value that they did not get
FAR_OUT = 3.0  # ranges of all other values by which such a number lies off them
BESIDE = ("t", "date", "quality", "mode", "tag")  # roles of columns that hold no signal
MANUAL = ("man", "hand", "off", "iman", "lo", "track", "init")
"""How words of modes begin in which the controller has not the valve."""
A_DAY = 0.5
"""Share of the longest stretch in automatic from which another one, after a night, is another day of the record."""
OWN_WORDS: Mapping[str, frozenset[str]] = MappingProxyType(
    {"sp": frozenset({"sp", "sv"}), "pv": frozenset({"pv"}), "co": frozenset({"co", "op", "out", "output"})}
)
"""What control systems call a signal itself, beside which a read-back or a target may stand."""
TICKS = MappingProxyType({"s": 1.0, "ms": 1e3, "us": 1e6, "ns": 1e9})  # seconds by the unit that moments are kept in
SILENT = frozenset({"sp", "pv", "co"})  # column names that need no telling
HALF = 0.49  # share of rows that repeat the row before, from which a table was written twice


@dataclass(frozen=True, slots=True)
class TableSignals:
    """Signals of a table by tag and role, what was assumed of all and of each; loops that cannot be read."""

    source: str
    loops: Mapping[str, Mapping[str, OneSignal]]
    assumed: tuple[Assumption, ...]
    refused: Mapping[str, RecordingError] = field(default_factory=dict)
    of_loop: Mapping[str, tuple[Assumption, ...]] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class _Clock:
    """The rows that are kept in the order of time, and their stamps; as_they_stand : all rows, in their order."""

    rows: np.ndarray
    t_s: FloatArray
    as_they_stand: bool


def signals_of(table: RawTable, form: RecordForm, *, in_automatic: bool = False) -> TableSignals:
    """Read a table; of a record with modes only its longest stretch in automatic, where that is wanted.

    Raises RecordingError: a named column is not there, there is no time, or a field is none of a value's forms.
    """
    if not form.columns.keys() & {"t", "value"} and form.dt_s is None:
        table = unpaired(table)
    found = loops(table.names)
    plain = found.get("", {})
    told = list(table.assumed)
    if {"tag", "value"} <= {*plain, *form.columns} and not any({"pv", "co"} & roles.keys() for roles in found.values()):
        return _long(table, plain, form, told)
    wanted = _signal_places(table, found, form)
    if not any(wanted.values()):
        return TableSignals(table.source, {}, tuple(told))
    decimal, mark = decimal_mark(table, [p for roles in wanted.values() for p in roles.values()], form)
    clock, more = _clock(table, found, form, decimal)
    told += [*mark, *more]
    good_rows = _good(table, plain.get("quality", []), form, told)
    known: dict[str, dict[str, OneSignal]] = {}
    refused: dict[str, RecordingError] = {}
    own: dict[str, tuple[Assumption, ...]] = {}
    for tag, roles in wanted.items():
        try:
            qualities, of_it = found.get(tag, {}).get("quality", []) if tag else [], list[Assumption]()
            rows = good_rows & _good(table, qualities, form, of_it)
            if in_automatic:
                rows &= _automatic(table, found.get(tag, {}).get("mode", []), clock, form, of_it)
            known[tag] = _trends(table, roles, decimal, clock, rows, form, of_it)
            own[tag] = tuple(of_it)
        except RecordingError as error:
            if len(wanted) == 1:
                raise
            refused[tag] = error
    return TableSignals(table.source, known, tuple(told), refused, own)


def _column(table: RawTable, role: str, form: RecordForm, otherwise: Sequence[int]) -> int | None:
    """The column of a role: as it is named, else the first that was found."""
    name = form.columns.get(role)
    if name is None:
        return otherwise[0] if otherwise else None
    if name not in table.names:
        there = ", ".join(table.names[:12]) or "nothing"
        raise RecordingError(
            f'{table.source}: no column "{name}"; there is {there}; name it as in --columns {role}=NAME'
        )
    return table.names.index(name)


def _signal_places(
    table: RawTable, found: Mapping[str, Mapping[str, list[int]]], form: RecordForm
) -> dict[str, dict[str, int]]:
    """Columns of the signals by tag and role; what a person names belongs to every loop there is."""
    if {"pv", "co"} <= {role for role in SIGNALS if role in form.columns}:
        found = {"": found.get("", {})}
    places: dict[str, dict[str, int]] = {}
    for tag, roles in (found or {"": {}}).items():
        if form.tag and tag and tag.lower() != form.tag.lower():
            continue
        for role in SIGNALS:
            place = _column(table, role, form, _plainest(table, role, roles.get(role, []), form))
            if place is not None:
                places.setdefault(tag, {})[role] = place
                refuse_repeated(table, place)
    beside = {name: table.names.index(name) for name in form.others if name in table.names}
    places = {tag: wanted | beside for tag, wanted in places.items()}
    # a table of further columns alone, as one of a file or a message: they belong to every loop
    return places or ({"": beside} if beside else _by_file_name(table, found, form))


def _plainest(table: RawTable, role: str, places: Sequence[int], form: RecordForm) -> Sequence[int]:
    """The one of several columns for a signal that is called by its own letters: PV beside an actual value.

    Raises RecordingError: None is, or two are, and nobody named one.
    """
    plain = [p for p in places if last_word(table.names[p]) in OWN_WORDS[role]]
    if len({table.names[place] for place in places}) < 2 or role in form.columns:
        return places
    if len(plain) != 1:
        both = " or ".join(quoted(table.names[place]) for place in places[:3])
        raise RecordingError(f"{table.source}: {role} may be {both}; say --columns {role}=NAME")
    return plain


def _by_file_name(
    table: RawTable, found: Mapping[str, Mapping[str, list[int]]], form: RecordForm
) -> dict[str, dict[str, int]]:
    """A file of one signal: its name says which; its column is the only one beside the time."""
    read = named(form.called(PurePath(table.source).stem))
    role = "co" if read.role == "mv" else read.role
    used = {place for roles in found.values() for r in BESIDE for place in roles.get(r, [])}
    used |= {table.names.index(name) for name in form.columns.values() if name in table.names}
    free = [place for place in range(len(table.names)) if place not in used]
    if role not in SIGNALS or not free:
        return {}
    return {read.tag: {role: found.get("", {}).get("value", free)[0]}}


def _clock(
    table: RawTable, found: Mapping[str, Mapping[str, list[int]]], form: RecordForm, decimal: str
) -> tuple[_Clock, list[Assumption]]:
    if form.dt_s is not None:
        rows = np.arange(len(table.places))
        return _Clock(rows, (rows * form.dt_s).astype(np.float64), as_they_stand=True), []
    stamps = _stamps(table, found, form, decimal)
    again = np.r_[False, np.diff(stamps.t_s) == 0]
    repeats = np.flatnonzero(again).tolist()
    # samples are not so alike throughout
    twice = np.mean(again) >= HALF and all(column[i] == column[i - 1] for column in table.columns for i in repeats)
    if twice:
        stamps = replace(stamps, t_s=np.where(again, np.nan, stamps.t_s))
    rows, t_s, told = in_order(stamps.t_s, table.source)
    if twice:
        told[0] = Assumption(f"{len(repeats)} rows that repeat the row before: left out")
    return _Clock(rows, t_s, t_s is stamps.t_s), [*stamps.assumed, *told]


def _stamps(
    table: RawTable,
    found: Mapping[str, Mapping[str, list[int]]],
    form: RecordForm,
    decimal: str,
    begins: Sequence[int] = (),
) -> Stamps:
    """The time of each row; begins : rows at which the times of another signal begin."""
    times = [place for roles in found.values() for place in roles.get("t", [])]
    dates = [place for roles in found.values() for place in roles.get("date", [])]
    place, date = _column(table, "t", form, times), _column(table, "date", form, dates)
    place, date = (date, None) if place is None else (place, date)
    place = _by_content(table) if place is None else place
    if place is None:
        raise RecordingError(
            f'{table.source}: no column "t"; there is {", ".join(table.names[:12])}; name it as in --columns t=NAME, '
            "or give --dt, the seconds between rows"
        )
    refuse_repeated(table, place)
    if "t" not in form.columns:
        several = len({named(table.names[place]).tag for place in times}) > 1
        clocks = [[str(field).strip() for field in table.columns[place]] for place in times] if several else []
        if any(clock != clocks[0] for clock in clocks):
            names = ", ".join(table.names[place] for place in times[:3])
            why = f"each signal has times of its own ({names}); give a file for each signal, as FIC101.PV.csv"
            raise RecordingError(f"{table.source}: {why}")
    column = table.columns[place]
    if isinstance(column, np.ndarray) and column.dtype.kind == "M":
        return Stamps(_seconds(column))
    text = [] if isinstance(column, np.ndarray) else [field.strip() for field in column]
    some = [field.replace(",", ".") for field in text[:: max(1, len(text) // 20)] if field]
    written_out = all(DIGITS.fullmatch(field) for field in some) or not all(NUMBER.fullmatch(field) for field in some)
    if text and written_out:  # dates and times, and no count of seconds
        apart = table.columns[date] if date is not None and "-" not in text[0] and text[0].count(":") else None
        return from_text(text, [str(d) for d in apart] if apart is not None else None, form, table.source, begins)
    name, beside = table.names[place], table.time_units.get(place, "")
    values, unit = numbers(table, place, decimal, form), TIME_UNIT.get(named(name).unit, "")
    if unit or form.time_unit or not beside:
        return from_numbers(values, name, unit, form)
    told = Assumption(f"time {quoted(name)} in {beside}, of the row of units", f'time_unit = "{beside}"')
    return replace(from_numbers(values, name, beside, form), assumed=(told,))


def _seconds(moments: npt.NDArray[Any]) -> FloatArray:
    """Moments in seconds since 1970, nan where one is missing."""
    unit, many = np.datetime_data(moments.dtype)
    if unit not in TICKS:
        return _seconds(moments.astype("datetime64[ns]"))
    t_s: FloatArray = moments.view(np.int64) / (TICKS[unit] / many)
    missing = np.isnat(moments)
    return np.where(missing, np.nan, t_s) if missing.any() else t_s


def _by_content(table: RawTable) -> int | None:
    """The first column that holds dates, whatever it is called."""
    for place, column in enumerate(table.columns):
        if isinstance(column, np.ndarray):
            if column.dtype.kind == "M":
                return place
            continue
        some = [field.strip() for field in column[:20]]
        if all(VALUE.fullmatch(f) and ":" in f for f in some) or all(DIGITS.fullmatch(f) for f in some):
            return place
    return None


def _good(table: RawTable, places: Sequence[int], form: RecordForm, told: list[Assumption]) -> np.ndarray:
    rows = np.ones(len(table.places), dtype=bool)
    named_so = _column(table, "quality", form, ())
    places = places if named_so is None else [named_so]
    for place in places:
        rows &= good(table, place, form)
    if not rows.all():
        told.append(Assumption(f"{int(np.sum(~rows))} rows of bad quality left out"))
    return rows


def _automatic(
    table: RawTable, places: Sequence[int], clock: _Clock, form: RecordForm, told: list[Assumption]
) -> np.ndarray:
    """Rows in automatic, where a column says the mode in words: the longest stretch, or each day of several."""
    everything = np.ones(len(table.places), dtype=bool)
    place = _column(table, "mode", form, places)
    column = table.columns[place] if place is not None else np.zeros(0)
    if isinstance(column, np.ndarray):
        return everything
    manual = np.array([column[row].strip().lower().startswith(MANUAL) for row in clock.rows])
    if not manual.any() or manual.all():
        words = sorted({field.strip() for field in column})
        if len(words) > 1 and any(NUMBER.fullmatch(word) for word in words):
            told.append(Assumption(f"mode is in numbers ({', '.join(words[:3])}): not used, all rows taken"))
        return everything
    stretches = np.flatnonzero(np.diff(np.r_[1, manual, 1])).reshape(-1, 2)
    lengths = stretches[:, 1] - stretches[:, 0]
    days = stretches[lengths >= A_DAY * np.max(lengths)]
    nights_s = clock.t_s[days[1:, 0]] - clock.t_s[days[:-1, 1] - 1]
    if len(days) == 1 or np.min(nights_s) <= GAP * median(np.diff(clock.t_s)):
        days = stretches[[int(np.argmax(lengths))]]
    everything[:] = False
    for begin, end in days.tolist():
        everything[clock.rows[begin:end]] = True
    what = "the longest stretch" if len(days) == 1 else f"{len(days)} stretches"
    told.append(Assumption(f"{what} in automatic taken, {int(np.sum(everything))} of {len(manual)} rows"))
    return everything


def _trends(
    table: RawTable,
    roles: Mapping[str, int],
    decimal: str,
    clock: _Clock,
    good_rows: np.ndarray,
    form: RecordForm,
    told: list[Assumption],
) -> dict[str, OneSignal]:
    """Signals of one loop without what is missing; nothing is copied where nothing is."""
    trends = {}
    plain_clock = clock.as_they_stand and bool(good_rows.all())
    for role, place in roles.items():
        _tell_unit(table, place, role, told)
        values = _without_filler(numbers(table, place, decimal, form), role, told)
        everything = plain_clock and all_finite(values)
        # a blank beside the loop takes no row from it
        held = not everything and (role in form.others or (role != "pv" and _stored_by_exception(table, place)))
        missing = 0 if everything else int(np.sum(~np.isfinite(values[clock.rows])))
        if missing and not held:
            told.append(Assumption(f"{missing} value{'s' * (missing != 1)} of {role} missing: left out"))
        if table.names[place] not in {*SILENT, role} and role not in form.columns:
            name = quoted(table.names[place])
            told.append(Assumption(f"{role} is {name}", f"columns.{role} = {name}"))
        if everything:
            trends[role] = OneSignal(clock.t_s, values, held)
        else:
            known = (np.isfinite(values) & good_rows)[clock.rows]
            trends[role] = OneSignal(clock.t_s[known], values[clock.rows][known], held)
    return trends


def _without_filler(values: FloatArray, role: str, told: list[Assumption]) -> FloatArray:
    """The values, nan for -9999 and the like, by which systems fill what they did not get: far from all the others."""
    for end in {float(of.reduce(values, initial=np.nan)) for of in (np.fmin, np.fmax)}:
        if not FILLER.fullmatch(f"{end:g}"):
            continue
        others = values[np.isfinite(values) & (values != end)]
        if len(others) < len(values) / 2:
            continue
        if min(abs(end - float(f(others))) for f in (np.min, np.max)) > FAR_OUT * max(float(np.ptp(others)), 1.0):
            told.append(Assumption(f"{end:g} of {role} stands for a missing value", f'bad = ["{end:g}"]'))
            values = np.where(values == end, np.nan, values)
    return values


def _tell_unit(table: RawTable, place: int, role: str, told: list[Assumption]) -> None:
    unit = unit_beside(table, place)
    if unit and unit != "%":
        told.append(Assumption(f"{role} in {unit}, as its values say"))


def _stored_by_exception(table: RawTable, place: int) -> bool:
    """Whether a column is blank where its signal did not change."""
    column = table.columns[place]
    if isinstance(column, np.ndarray):
        return bool(np.mean(np.isnan(column)) > HELD_FROM) if column.dtype.kind == "f" else False
    return sum(not field.strip() for field in column) > HELD_FROM * len(column)


def _long(table: RawTable, plain: Mapping[str, list[int]], form: RecordForm, told: list[Assumption]) -> TableSignals:
    tag_at, value_at = (_column(table, role, form, plain.get(role, [])) for role in ("tag", "value"))
    assert tag_at is not None
    assert value_at is not None
    tags = np.array([str(field).strip() for field in table.columns[tag_at]])
    decimal, mark = decimal_mark(table, [value_at], form)
    changes = np.flatnonzero(tags[1:] != tags[:-1]) + 1
    begins = changes.tolist() if len(changes) < len(set(tags)) else []  # one signal after the other
    stamps = _stamps(table, {"": plain}, form, decimal, begins)
    good_rows = _good(table, plain.get("quality", []), form, told)
    known: dict[str, dict[str, OneSignal]] = {}
    own: dict[str, tuple[Assumption, ...]] = {}
    told += [*mark, *stamps.assumed]
    names = sorted(set(tags))
    found = []
    for tag, roles in loops([form.called(name) for name in names]).items():
        if form.tag and tag.lower() != form.tag.lower():
            continue
        for role in SIGNALS:
            places = roles.get(role, [])
            if len(places) > 1:
                both = " and ".join(quoted(names[place]) for place in places[:2])
                raise RecordingError(f"{table.source}: {both} may both be {role} of {tag}; leave one out of the export")
            found += [(tag, role, names[place]) for place in places]
    taken = {name for *_, name in found}
    for tag, role, name in found + [("", name, name) for name in form.others if name in names and name not in taken]:
        of_it: np.ndarray = np.flatnonzero(tags == name)
        columns = tuple(c[of_it] if isinstance(c, np.ndarray) else [c[row] for row in of_it] for c in table.columns)
        its = replace(table, columns=columns, places=[table.places[row] for row in of_it])
        _tell_unit(its, value_at, role, told)
        values = numbers(its, value_at, decimal, form)
        fine = np.isfinite(values) & good_rows[of_it]
        rows, t_s, more = in_order(stamps.t_s[of_it[fine]], table.source)
        known.setdefault(tag, {})[role] = OneSignal(t_s, values[fine][rows])
        own[tag] = (*own.get(tag, ()), *more, Assumption(f"{role} is {quoted(name)}"))
    return TableSignals(table.source, known, tuple(told), of_loop=own)
