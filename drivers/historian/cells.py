"""Fields as numbers: decimal comma, thousands, words for a missing value, quality flags. nan is what is missing."""

import re
from collections.abc import Iterable, Sequence
from types import MappingProxyType

import numpy as np

from retuner.adaptive.signals.sample import FloatArray, all_finite
from retuner.drivers.historian.assumption import Assumption, quoted
from retuner.drivers.historian.raw_table import MISSING, WITH_STATUS, WITH_UNIT, RawTable, without_status
from retuner.drivers.historian.record_form import RecordForm
from retuner.drivers.recorded.recording import NUMBER, RecordingError

COMMA = re.compile(r"[+-]?[0-9]+,[0-9]+(?:[eE][+-]?[0-9]+)?")
THOUSANDS = MappingProxyType(
    {
        ".": re.compile(r"[+-]?[1-9][0-9]{0,2}(?:,[0-9]{3})+(?:\.[0-9]+)?"),
        ",": re.compile(r"[+-]?[1-9][0-9]{0,2}(?:\.[0-9]{3})+(?:,[0-9]+)?"),
    }
)
THREE_AFTER = re.compile(r"[+-]?[1-9][0-9]{0,2},[0-9]{3}")
"""What may be a thousand and some as well as one and some thousandths."""
PLAIN = re.compile(r"([+-]?[0-9]+(\.[0-9]+)?\n)*+")
SYSTEM_STATE = re.compile(r"\[-[0-9]+\].*")
"""A state of the historian instead of a value, as in "[-11059] No Good Data"."""
GOOD_WORDS = frozenset({"good", "ok", "valid", "normal", "g", "true", "good, annotated", "alarm", "unackedalarm"})
"""What is said of a good value; one in alarm is still what the sensor reads."""
BAD_WORDS = frozenset({"bad", "uncertain", "invalid", "b", "u", "false", "questionable", "substituted", "stale"})
OPC_GOOD = 192  # Quality of OPC from which a value is good (OPC Data Access 2.05, 6.8)


def decimal_mark(table: RawTable, places: Iterable[int], form: RecordForm) -> tuple[str, tuple[Assumption, ...]]:
    """The decimal mark of a table's columns: a comma where one stands inside numbers and no point does.

    Raises RecordingError: all commas stand before three digits: they may part the thousands.
    """
    if form.decimal:
        return form.decimal, ()
    columns = [_text(table, p) for p in places]
    if all(map(_plain, columns)):
        return ".", ()
    fields = [_bare(f.strip()) for column in columns for f in column]
    commas = [f for f in fields if COMMA.fullmatch(f)]
    if not commas or any("." in f and NUMBER.fullmatch(f) for f in fields):
        return ".", ()
    if all(THREE_AFTER.fullmatch(f) for f in commas):
        raise RecordingError(
            f"{table.source}: {commas[0]} may separate thousands or decimals; give --decimal , or --decimal ."
        )
    return ",", (Assumption("decimal comma", 'decimal = ","'),)


def _text(table: RawTable, place: int) -> Sequence[str]:
    column = table.columns[place]
    return () if isinstance(column, np.ndarray) else column


def _plain(column: Sequence[str]) -> bool:
    """Whether all fields are digits with a decimal point at most: one look at all of them, not several at each."""
    text = "\n".join((*column, ""))
    return PLAIN.fullmatch(text) is not None and text.count("\n") == len(column)


def _bare(text: str) -> str:
    text = without_status(text)
    with_unit = WITH_UNIT.fullmatch(text)
    return with_unit["number"] if with_unit else text


def unit_beside(table: RawTable, place: int) -> str:
    """The unit that stands in every field of a column beside its value; empty where none does.

    Raises RecordingError: values have different units, or only some have one.
    """
    first, where = "", ""
    if _plain(_text(table, place)):
        return ""
    for i, field in enumerate(_text(table, place)):
        text = without_status(field)
        with_unit = WITH_UNIT.fullmatch(text)
        if text.lower() in MISSING or not (with_unit or NUMBER.fullmatch(text)):
            continue
        unit = with_unit["unit"] if with_unit else "no unit"
        if first and unit != first and {unit, first} != {"%", "no unit"}:
            here = f"{table.source}{table.places[i]}: {table.names[place]} = {text[:40]!a}"
            raise RecordingError(f"{here}: {unit}, and {first} in{where.replace(':', ' line ')}; export it in one unit")
        first, where = first or unit, where or table.places[i]
    return first.removesuffix("no unit")


def numbers(table: RawTable, place: int, decimal: str, form: RecordForm) -> FloatArray:
    """A column as numbers, nan where a value is missing, shape (n,).

    Raises RecordingError: a field is neither a number nor a word for a missing value, or the column holds times.
    """
    column = table.columns[place]
    if isinstance(column, np.ndarray):
        if column.dtype.kind == "M":
            raise RecordingError(f"{table.source}: {table.names[place]} holds times; name a column of numbers")
        values: FloatArray = column.astype(np.float64, copy=False)
        return values if all_finite(values) else np.where(np.isfinite(values), values, np.nan)
    missing = MISSING | {word.strip().lower() for word in form.bad}
    if decimal == "." and _plain(column) and missing.isdisjoint(column):
        return np.fromiter(map(float, column), np.float64, len(column))
    found = np.empty(len(column))
    for i, field in enumerate(column):
        found[i] = _number(table, place, i, field.strip(), decimal, missing)
    return found


def _number(table: RawTable, place: int, row: int, text: str, decimal: str, missing: frozenset[str]) -> float:
    if text.lower() in missing:
        return np.nan
    if decimal == "." and NUMBER.fullmatch(text):
        return float(text)
    status = WITH_STATUS.fullmatch(text)
    if status:
        return _number(table, place, row, status["value"], decimal, missing) if _fine(status["status"]) else np.nan
    plain = _bare(text)
    if decimal == ",":
        plain = plain.replace(".", "") if THOUSANDS[","].fullmatch(plain) else plain
        plain = plain.replace(",", ".") if "." not in plain else "?"
    elif THOUSANDS["."].fullmatch(plain):
        plain = plain.replace(",", "")
    if NUMBER.fullmatch(plain):
        return float(plain)
    if SYSTEM_STATE.fullmatch(text):
        return np.nan
    why = f" is not a number; if it marks a missing value, give --bad {quoted(text[:40])}"
    if decimal == "." and COMMA.fullmatch(text):
        why = " has a decimal comma, others a point; write one of them"
    raise RecordingError(f"{table.source}{table.places[row]}: {table.names[place]} = {text[:40]!a}{why}")


def _fine(status: str) -> bool:
    """Whether a value of this state, one word or several between commas, is what the signal was."""
    return {word.strip().lower() for word in status.split(",")} <= GOOD_WORDS


def good(table: RawTable, place: int, form: RecordForm) -> np.ndarray:
    """Where a quality says that a value is good, shape (n,): words, OPC's numbers, or what the form names.

    Raises RecordingError: it cannot be told which of its values are good.
    """
    words = [str(f).strip().lower().removesuffix(".0") for f in table.columns[place]]
    seen = set(words)
    if form.good:
        return np.array([word == form.good.strip().lower() for word in words])
    if all(word.startswith("{") for word in seen):
        return np.array([_fine(word.strip("{} ")) for word in words])
    if len(seen) == 1 and not seen <= BAD_WORDS:
        return np.ones(len(words), dtype=bool)
    if seen <= GOOD_WORDS | BAD_WORDS | MISSING:
        return np.array([word in GOOD_WORDS for word in words])
    if all(word.isdigit() or word in MISSING for word in seen):
        opc = np.array([word.isdigit() and int(word) >= OPC_GOOD for word in words])
        if opc.any():
            return opc
    shown, name = ", ".join(sorted(seen)[:6]), table.names[place]
    raise RecordingError(f"{table.source}: quality {name} is {shown}; name the good value with --good")
