"""Stamps as seconds from the first one: text in the usual forms, numbers of any epoch, dates and times of day apart.

Several forms may fit a text (03/04/2024 is in March or in April). A form is one that fits every row; where two fit and
give other times between the rows, the record is not read before a person has said which. Numbers are seconds where
their size says nothing else: seconds, milliseconds, ... since 1970, days of a spreadsheet, or digits of date and time.
"""

import math
import re
from collections.abc import Callable, Sequence
from datetime import UTC, datetime, timedelta, timezone, tzinfo
from types import MappingProxyType

import numpy as np
import numpy.typing as npt

from retuner.adaptive.signals.sample import FloatArray, median
from retuner.drivers.historian.assumption import Assumption, quoted
from retuner.drivers.historian.record_form import TIME_UNITS, RecordForm
from retuner.drivers.recorded.recording import NUMBER, RecordingError
from retuner.schedule.late_dataclass import dataclass

Numbers = Sequence[float] | npt.NDArray[np.floating]
Times = Numbers | Sequence[datetime] | npt.NDArray[np.datetime64] | npt.NDArray[np.timedelta64]  # Seconds, or moments
DATES = (
    "%Y-%m-%d", "%Y/%m/%d", "%Y.%m.%d", "%d.%m.%Y", "%d/%m/%Y", "%m/%d/%Y", "%d-%m-%Y", "%m-%d-%Y", "%d.%m.%y",
    "%d/%m/%y", "%m/%d/%y", "%d-%m-%y", "%d-%b-%Y", "%d-%b-%y", "%d %b %Y", "%b %d %Y", "%b %d, %Y", "%Y%m%d",
    "%y-%m-%d", "%y/%m/%d", "%y.%m.%d",
)  # fmt: skip
"""Forms of a date, in the codes of strptime."""
ZONES = MappingProxyType(
    {
        "Z": 0.0, "UTC": 0.0, "GMT": 0.0, "EST": -5.0, "EDT": -4.0, "CST": -6.0, "CDT": -5.0, "MST": -7.0, "MDT": -6.0,
        "PST": -8.0, "PDT": -7.0, "AKST": -9.0, "AKDT": -8.0, "HST": -10.0, "WET": 0.0, "WEST": 1.0, "CET": 1.0,
        "CEST": 2.0, "EET": 2.0, "EEST": 3.0, "BST": 1.0, "JST": 9.0, "AEST": 10.0, "AEDT": 11.0,
    }
)  # fmt: skip
"""Zones by the letters that building automation writes behind a stamp, hours from UTC; of several meanings that of the
systems that write them (CST of North America)."""
TIME_OF_DAY = re.compile(
    r"(?P<h>[0-9]{1,2}):(?P<m>[0-9]{2})(?::(?P<s>[0-9]{2})(?:[.,](?P<f>[0-9]{1,9}))?)?\s*(?P<half>[AaPp]\.?[Mm]\.?)?"
    rf"\s*(?P<zone>{'|'.join(sorted(ZONES, key=len, reverse=True))}|[+-][0-9]{{2}}:?[0-9]{{2}})?"
)
OTHER_ZONE = re.compile(r"[A-Z][A-Za-z/_]+")  # A zone by any other name behind a time of day
DIGITS = re.compile(r"(?:19|20)[0-9]{12}(?:\.[0-9]+)?")  # date and time written together as 20241015215500
EPOCHS = MappingProxyType({"s": (1e9, 4e9), "ms": (1e12, 4e12), "us": (1e15, 4e15), "ns": (1e18, 4e18)})
"""Range of numbers that count from 1970, from 2001 to 2096, by unit."""
SPREADSHEET_DAYS = (30_000.0, 60_000.0)  # days since 1899-12-30 from 1982 to 2064: a spreadsheet's stamps as numbers
SPREADSHEET_1970 = 25_569.0
MATLAB_DAYS = (723_000.0, 755_000.0)  # Days of MATLAB's datenum from 1979 to 2067, which counts from the year 0
MATLAB_1970 = 719_529.0
DAY_S = 86_400.0
HOUR_S = 3600.0
EPOCH = datetime(1970, 1, 1, tzinfo=UTC)
SHOWN = 3
MONTHS_LEFT_OUT = 10.0  # times as long as with days in the right place; a day that is taken for a month makes it 30
DATED = re.compile("%[aAbBcdDeFjmuUVwWxyYgGs]")  # codes of strptime that tell a date


@dataclass(frozen=True, slots=True)
class Stamps:
    """Times of the rows in seconds since any moment, nan where a row has no stamp; and what was assumed."""

    t_s: FloatArray
    assumed: tuple[Assumption, ...] = ()


def from_numbers(values: FloatArray, name: str, unit: str, form: RecordForm) -> Stamps:
    """Numeric stamps.

    values : nan where missing. name : of the column. unit : that its name tells, or "".
    """
    values = np.where(np.isfinite(values), values, np.nan)
    if form.time_unit or unit in TIME_UNITS:
        counted_in = form.time_unit or unit
        origin = _days_at_1970(values) if counted_in == "d" else 0.0
        return Stamps((values - origin) * TIME_UNITS[counted_in])
    typical = _typical(values)
    for known, (low, high) in EPOCHS.items():
        if low <= typical <= high:
            told = Assumption(f"time counted from 1970 in {known}", f'time_unit = "{known}"')
            return Stamps(values * TIME_UNITS[known], (told,))
    apart = np.abs(np.diff(values[np.isfinite(values)]))
    step = median(apart[apart > 0]) if np.any(apart > 0) else 1.0  # rounded stamps repeat
    origin = _days_at_1970(values)
    if origin and 0 < step < 1.0 / 24:
        whose = "a spreadsheet" if origin == SPREADSHEET_1970 else "MATLAB"
        return Stamps((values - origin) * DAY_S, (Assumption(f"time in days of {whose}", 'time_unit = "d"'),))
    told = Assumption(f"time {quoted(name)} in seconds", 'time_unit = "s"')
    return Stamps(values, () if name.strip().lower() in {"t", "t_s", "time_s"} or "t" in form.columns else (told,))


def _typical(values: FloatArray) -> float:
    return median(np.abs(values[~np.isnan(values)])) if np.isfinite(values).any() else 0.0


def _days_at_1970(values: FloatArray) -> float:
    """What the calendar in which these days count says of 1970; 0 where they are of no calendar."""
    calendars = ((SPREADSHEET_DAYS, SPREADSHEET_1970), (MATLAB_DAYS, MATLAB_1970))
    return next((at for (low, high), at in calendars if low <= _typical(values) <= high), 0.0)


def from_text(
    fields: Sequence[str], days: Sequence[str] | None, form: RecordForm, source: str, begins: Sequence[int] = ()
) -> Stamps:
    """Stamps as text, and where the date stands apart its fields; begins : rows at which another signal's begin.

    Raises RecordingError: no form fits all rows, or two do that differ.
    """
    joined = [f"{d.strip()} {f.strip()}" for d, f in zip(days, fields, strict=True)] if days is not None else fields
    texts = [text.strip() for text in joined]
    if form.time_format:
        times = _of_format(texts, form, source, begins)
        return Stamps(times if DATED.search(form.time_format) else _over_midnight(times))
    if any(texts) and all(TIME_OF_DAY.fullmatch(text) for text in texts if text):
        times = _timed(
            [f"2000-01-01 {text}" if text else "" for text in texts], _reader("%Y-%m-%d"), form, source, begins
        )
        return Stamps(_over_midnight(times), (Assumption("times of day without a date: after midnight the next day"),))
    if all(DIGITS.fullmatch(text) for text in texts[:SHOWN]):
        told = Assumption("stamps as digits of date and time", 'time_format = "%Y%m%d%H%M%S"')
        return Stamps(_timed(texts, _digits, form, source, begins), (told,))
    others = {text: zone for text in texts if (zone := _other_zone(text))}
    if others and not form.zone:
        raise RecordingError(
            f"{source}: time {next(iter(others))[:40]!a} is of a zone that is not known; give it by its city, "
            "as in --zone Asia/Kolkata"
        )
    found = _of_usual_forms([text.removesuffix(others.get(text, "")).strip() for text in texts], form, source, begins)
    if others:  # no format of strptime has these letters either
        what = f"{found.assumed[0].what}, {', '.join(sorted(set(others.values())))} as {form.zone}"
        return Stamps(found.t_s, (Assumption(what),))
    return found


def _over_midnight(t_s: FloatArray) -> FloatArray:
    """Times of day that go on into the next day, whichever way the rows run; nan where a row has none."""
    known = np.isfinite(t_s)
    t_s[known] = np.unwrap(t_s[known], period=DAY_S)
    return t_s


def _other_zone(text: str) -> str:
    """The letters behind a time of day that are those of no zone in ZONES; empty for none."""
    clock = TIME_OF_DAY.search(text) if text[-1:].isalpha() else None
    rest = text[clock.end() :].strip() if clock and not clock["zone"] else ""
    return rest if OTHER_ZONE.fullmatch(rest) else ""


def _of_usual_forms(texts: list[str], form: RecordForm, source: str, begins: Sequence[int]) -> Stamps:
    rows = [text for text in texts if text]
    fitting: dict[str, FloatArray] = {}
    for date in DATES if rows else ():
        reader = _reader(date)
        try:
            for text in rows[:: max(1, len(rows) // 20)]:  # most forms fail here already
                reader(text)
            fitting[date] = _timed(texts, reader, form, source, begins)
        except _UnfitError:
            continue
    if not fitting:
        shown = rows[0] if rows else ""
        row = _first_unfit(texts)
        if row:
            raise RecordingError(
                f"{source}: time {texts[row][:40]!a} in row {row + 1} is not of the form of {shown[:40]!a}; "
                "take the row out, or say --time-format"
            )
        raise RecordingError(
            f"{source}: time {shown[:40]!a} has an unknown format; give --time-format, for example %d.%m.%Y %H:%M:%S"
        )
    (first, times), *others = _without_misread_days(fitting).items()
    whole = quoted(_whole(first, texts[0]))
    for other, elsewhere in others:
        if not np.allclose(elsewhere - elsewhere[0], times - times[0], atol=1e-3, equal_nan=True):
            raise RecordingError(f"{source}: {texts[0][:40]!a} may be {first} or {other}; give --time-format {whole}")
    clocks = [TIME_OF_DAY.search(text) for text in texts]
    lettered = sorted({clock["zone"] for clock in clocks if clock and clock["zone"] in ZONES} - {"Z", "UTC", "GMT"})
    if lettered:  # strptime knows no such zone, so there is no format to fix it with
        hours = ", ".join(f"{zone} as UTC{ZONES[zone]:+g} h" for zone in lettered)
        return Stamps(times, (Assumption(f"time as {first} and the time of day, {hours}"),))
    return Stamps(times, (Assumption(f"time as {first} and the time of day", f"time_format = {whole}"),))


def _without_misread_days(fitting: dict[str, FloatArray]) -> dict[str, FloatArray]:
    """The forms without those that take days for years, or for months, by which a night would last as long."""
    known = {form: t_s[np.isfinite(t_s)] for form, t_s in fitting.items()}
    spans = {form: float(np.ptp(t_s)) for form, t_s in known.items()}
    first, last = (
        min((span for form, span in spans.items() if form.startswith("%y") == at_first), default=math.inf)
        for at_first in (True, False)
    )
    if first != last:
        spans = {form: span for form, span in spans.items() if form.startswith("%y") == (first < last)}
    nearest = min(spans, key=lambda form: spans[form])
    rare = len(known[nearest]) < SHOWN or median(np.abs(np.diff(known[nearest]))) > HOUR_S
    return {form: fitting[form] for form, span in spans.items() if rare or span <= MONTHS_LEFT_OUT * spans[nearest]}


def _first_unfit(texts: Sequence[str]) -> int:
    """The row that is not of the form of those before it; 0 where the first is of none."""
    reached = [next((i for i, text in enumerate(texts) if text and not NUMBER.fullmatch(text)), 0)]
    for date in DATES:
        reader = _reader(date)
        for i, text in enumerate(texts):
            try:
                reader(text or texts[0])
            except _UnfitError:
                reached.append(i)
                break
    return max(reached)


def _whole(date: str, text: str) -> str:
    found = TIME_OF_DAY.search(text)
    if found is None:
        return date
    between = "T" if "T" in text[: found.start()] else " "
    hours = "%I:%M" if found["half"] else "%H:%M"
    rest = (":%S" if found["s"] else "") + (".%f" if found["f"] else "") + (" %p" if found["half"] else "")
    rest += "%z" if found["zone"] else ""
    return date + between + hours + rest


class _UnfitError(ValueError):
    """A form does not fit a row."""


def _reader(date: str) -> Callable[[str], datetime]:
    """A reader of stamps whose date has this form; the days that were read are kept."""
    days: dict[str, datetime] = {}

    def read(text: str) -> datetime:
        clock = TIME_OF_DAY.search(text)
        day = (text[: clock.start()] if clock else text).strip().removesuffix("T").strip().rstrip(",")
        if clock is not None and clock.end() != len(text.rstrip()):
            raise _UnfitError(text)
        if day not in days:
            try:
                days[day] = datetime.strptime(day, date)  # noqa: DTZ007  the zone follows
            except ValueError:
                raise _UnfitError(text) from None
        return days[day] if clock is None else _at(days[day], clock)

    return read


def _at(day: datetime, clock: re.Match[str]) -> datetime:
    hour, minute, second = int(clock["h"]), int(clock["m"]), int(clock["s"] or 0)
    if clock["half"]:
        if not 1 <= hour <= 12:
            raise _UnfitError(clock[0])
        hour = hour % 12 + (12 if clock["half"][0] in "Pp" else 0)
    fraction = float(f"0.{clock['f']}") if clock["f"] else 0.0
    if hour > 24 or minute > 59 or second > 60 or (hour == 24 and minute + second + fraction > 0):
        raise _UnfitError(clock[0])
    zone = clock["zone"]
    try:
        moment = day + timedelta(hours=hour, minutes=minute, seconds=second + fraction)
        if not zone:
            return moment
        hours, minutes = (ZONES[zone], 0) if zone in ZONES else (int(zone[:3]), int(zone[0] + zone[-2:]))
        return moment.replace(tzinfo=timezone(timedelta(hours=hours, minutes=minutes)))
    except (OverflowError, ValueError):
        raise _UnfitError(clock[0]) from None


def _digits(text: str) -> datetime:
    try:
        moment = datetime.strptime(text[:14], "%Y%m%d%H%M%S")  # noqa: DTZ007  the zone follows
    except ValueError:
        raise _UnfitError(text) from None
    return moment + timedelta(seconds=float("0" + text[14:]) if len(text) > 14 else 0.0)


def _of_format(texts: Sequence[str], form: RecordForm, source: str, begins: Sequence[int]) -> FloatArray:

    def read(text: str) -> datetime:
        try:
            return datetime.strptime(text, form.time_format)  # noqa: DTZ007  the zone follows
        except ValueError:
            raise RecordingError(f"{source}: time {text[:40]!a} is not of the form {form.time_format}") from None

    return _timed(texts, read, form, source, begins)


def _timed(
    texts: Sequence[str], read: Callable[[str], datetime], form: RecordForm, source: str, begins: Sequence[int]
) -> FloatArray:
    """Seconds since 1970 of each text, nan where there is none."""
    zone: tzinfo | None = None
    if form.zone:
        from zoneinfo import ZoneInfo  # noqa: PLC0415  few records need it

        zone = ZoneInfo(form.zone)
    found, last, zoned = np.full(len(texts), math.nan), -math.inf, zone is not None
    first = frozenset(begins)
    for i, text in enumerate(texts):
        last = -math.inf if i in first else last
        if not text:
            continue
        moment = read(text)
        zoned = zoned or moment.tzinfo is not None
        if moment.tzinfo is None and zone is None:
            found[i] = last = (moment.replace(tzinfo=UTC) - EPOCH).total_seconds()
        elif moment.tzinfo is not None:
            found[i] = last = (moment - EPOCH).total_seconds()
        else:
            early, late = ((moment.replace(tzinfo=zone, fold=fold) - EPOCH).total_seconds() for fold in (0, 1))
            found[i] = last = late if early <= last < late else early
    if not zoned and any(_hour_comes_twice(piece) for piece in np.split(found, sorted(first))):
        raise RecordingError(f"{source}: the clock goes back by one hour; give --zone, for example Europe/Berlin")
    return found


def _hour_comes_twice(t_s: FloatArray) -> bool:
    """Whether stamps of one signal go back once, by half an hour to an hour, and on beyond where they were."""
    known = t_s[np.isfinite(t_s)]
    back = np.diff(known)[np.diff(known) < 0]
    return len(back) == 1 and bool(-HOUR_S <= back[0] <= -HOUR_S / 2) and bool(known[-1] > np.max(known[:-1]))


def seconds(t: Times) -> npt.NDArray[np.float64]:
    """Times as seconds: numbers are seconds already, moments count from the first one."""
    values = np.asarray(t)
    if values.dtype.kind == "O":  # Python's own moments; numpy knows those without a zone
        for v in values:
            if not isinstance(v, datetime):
                raise ValueError(f"t = {v!r}: give seconds or moments")  # noqa: TRY004  as any wrong value here
        without = [v if v.tzinfo is None else v.astimezone(UTC).replace(tzinfo=None) for v in values]
        values = np.array([np.datetime64(v, "us") for v in without])
    if values.dtype.kind == "M":
        values = values - values[:1]
    if values.dtype.kind == "m":
        return values / np.timedelta64(1, "s")
    return values.astype(np.float64)
