"""What a person may fix of a record's form; whatever is left open is found in the record, and told.

The same names stand in a `[record]` section of a TOML file:

    [record]
    tag = "FIC101"
    columns = { pv = "flow", co = "valve" }
    time_format = "%d.%m.%Y %H:%M:%S"
    decimal = ","
"""

import math
from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Any

from retuner.drivers.historian.scaling import Scaling
from retuner.drivers.historian.tags import SEPARATED, SEPARATORS
from retuner.drivers.recorded.recording import RecordingError
from retuner.schedule.late_dataclass import dataclass, field, fields, replace

SIGNALS = ("sp", "pv", "co")
COLUMN_ROLES = ("t", "date", *SIGNALS, "mode", "quality", "tag", "value")
"""What a column may be: time (or time of day beside a date), signals, mode, quality; tag and value of long tables."""
TIME_UNITS = MappingProxyType({"ns": 1e-9, "us": 1e-6, "ms": 1e-3, "s": 1.0, "min": 60.0, "h": 3600.0, "d": 86400.0})
"""Units of a time given as a number, in seconds."""
DECIMALS = (".", ",")
DELIMITERS = MappingProxyType({",": ",", ";": ";", "\t": "\t", "tab": "\t", "|": "|", " ": " ", "space": " "})


@dataclass(frozen=True, slots=True, kw_only=True)
class RecordForm:
    """The form of a record as far as a person fixes it; empty and None leave it to be found.

    columns : column names by role (COLUMN_ROLES). tag : which loop of a table of many, as in FIC101 of FIC101.PV.
    sp : the setpoint where no column has it, in the unit of pv. dt_s : the time between rows where no column tells, s.
    time_format : of stamps as text, in the codes of strptime. time_unit : of stamps as numbers, one of TIME_UNITS.
    zone : of stamps without one, as in Europe/Berlin. decimal : "." or ",". delimiter : between fields. encoding : of
    the text. header : the line that holds the names, counted from 1; 0 for none. good : what the quality of a good
    value says. bad : further words that stand for a missing value. scale : what signals are recorded as and stand for,
    by role, as in {"pv": "4..20:0..200"} (scaling.py). words : roles by the last word of signals' names, as in
    {"meas": "pv"}, beside those that are known. signals : names as TAG.ROLE by the names that they have in the record,
    as in {"40FT17": "FIC17.PV"}; a name without role is no signal. others : further columns that are wanted by name.
    dbc : files that describe bus traffic.

    Raises ValueError: a value out of its range; the message names it.
    """

    columns: Mapping[str, str] = field(default_factory=dict)
    tag: str = ""
    sp: float | None = None
    dt_s: float | None = None
    time_format: str = ""
    time_unit: str = ""
    zone: str = ""
    decimal: str = ""
    delimiter: str = ""
    encoding: str = ""
    header: int | None = None
    good: str = ""
    bad: tuple[str, ...] = ()
    scale: Mapping[str, str] = field(default_factory=dict)
    words: Mapping[str, str] = field(default_factory=dict)
    signals: Mapping[str, str] = field(default_factory=dict)
    dbc: tuple[str, ...] = ()
    others: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        for role, text in self.scale.items():
            if role not in SIGNALS:
                raise ValueError(f'scale: "{role}": signals are {", ".join(SIGNALS)}')
            Scaling.of(text)
        for role, name in self.columns.items():
            if role not in COLUMN_ROLES or not name:
                raise ValueError(f'columns: "{role}" = "{name}": roles are {", ".join(COLUMN_ROLES)}, each with a name')
        for word, role in self.words.items():
            if role not in COLUMN_ROLES or not word:
                raise ValueError(f'words: "{word}" = "{role}": give one of {", ".join(COLUMN_ROLES)} to each word')
        for name, value in (("sp", self.sp), ("dt_s", self.dt_s)):
            if value is not None and not math.isfinite(value):
                raise ValueError(f"{name} = {value}: give a finite number")
        if self.dt_s is not None and self.dt_s <= 0:
            raise ValueError(f"dt_s = {self.dt_s:g}: time goes forward; give a number above 0")
        self._one_of("time_unit", self.time_unit, tuple(TIME_UNITS))
        self._one_of("decimal", self.decimal, DECIMALS)
        self._one_of("delimiter", self.delimiter, tuple(DELIMITERS))
        # Refuse what Python's own tables do not know.
        if self.header is not None and self.header < 0:
            raise ValueError(f"header = {self.header}: lines are counted from 1; 0 stands for none")
        try:
            "".encode(self.encoding or "utf-8")
        except LookupError:
            raise ValueError(f"encoding = {self.encoding!r}: not known; give utf-8, utf-16, cp1252, ...") from None
        try:
            if self.zone:
                from zoneinfo import ZoneInfo  # noqa: PLC0415  few records need it

                ZoneInfo(self.zone)
        except (KeyError, ValueError, OSError):
            raise ValueError(f"zone = {self.zone!r}: not known; give a name as Europe/Berlin") from None

    def called(self, name: str) -> str:
        """A signal's name as it is understood: by `signals`, by its last word in `words`, else as it stands."""
        if name in self.signals:
            return self.signals[name]
        parts = [part for part in SEPARATED.split(name) if part] if self.words else []
        role = {word.lower(): role for word, role in self.words.items()}.get(parts[-1].lower()) if parts else None
        return f"{name[: name.rindex(parts[-1])].rstrip(SEPARATORS)}.{role.upper()}".lstrip(".") if role else name

    @staticmethod
    def _one_of(name: str, value: str, known: tuple[str, ...]) -> None:
        if value and value not in known:
            raise ValueError(f"{name} = {value!r}: give one of {', '.join(map(repr, known))}")


def form_from_toml(path: Path) -> RecordForm:
    """The `[record]` section of a TOML file.

    Raises RecordingError: no such file or section, a key that is not known, or a value of another kind or out of range.
    """
    import tomllib  # noqa: PLC0415  few records need it

    try:
        section = tomllib.loads(path.read_text(encoding="utf-8")).get("record")
    except OSError as error:
        raise RecordingError(f"{path}: cannot be read: {error.strerror}") from error
    except ValueError as error:
        raise RecordingError(f"{path}: not TOML: {str(error).splitlines()[0]}") from error
    if not isinstance(section, dict):
        raise RecordingError(f"{path}: no section [record]; begin one with a line [record]")
    known = {f.name: f for f in fields(RecordForm)}
    given: dict[str, Any] = dict(section)
    for name, value in given.items():
        if name not in known:
            raise RecordingError(f"{path}: [record] {name}: no such key; there is {', '.join(known)}")
        kind, told = KINDS.get(name, (str, "text in quotes"))
        entries = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
        odd = next(((key, entry) for key, entry in entries if not isinstance(entry, str)), None)
        if not isinstance(value, kind) or isinstance(value, bool) or odd is not None:
            wrong = f"{name} = {value!r}"
            if odd is not None and isinstance(value, dict):
                wrong = f'{name} "{odd[0]}" = {odd[1]!r}'
            raise RecordingError(f"{path}: [record] {wrong}: give {told}")
    try:
        given |= {name: tuple(given[name]) for name in ("bad", "dbc", "others") if name in given}
        return replace(RecordForm(), **given)
    except ValueError as error:
        raise RecordingError(f"{path}: [record] {error}") from error


KINDS: Mapping[str, tuple[type | tuple[type, ...], str]] = MappingProxyType(
    {
        "columns": (dict, 'names by role as in { pv = "flow" }'),
        "words": (dict, 'roles by word as in { meas = "pv" }'),
        "signals": (dict, 'names as TAG.ROLE as in { "40FT17" = "FIC17.PV" }'),
        "sp": ((int, float), "a number"),
        "dt_s": ((int, float), "a number in seconds"),
        "header": (int, "the number of a line"),
        "bad": (list, 'words as in ["Offline"]'),
        "dbc": (list, 'files as in ["plant.dbc"]'),
        "others": (list, 'names of columns as in ["FI104"]'),
        "scale": (dict, 'ranges by signal as in { pv = "4..20:0..200" }'),
    }
)
"""What a key of another kind than text takes, and how that is said; entries are texts."""
