"""One section of a TOML text, read strictly: every value by key and kind, every error one line that says where.

Lines are found by looking for headers and for keys at the start of a line, which is how people and to_toml write them;
a key written otherwise (inline table, inside a string of several lines) is named without its line.
"""

import re
import sys
import tomllib
from collections import Counter

HEADER = re.compile(r"\s*(\[\[?)\s*([A-Za-z0-9_-]+)\s*\]")
KEY = re.compile(r"\s*([A-Za-z0-9_-]+)\s*=")
SHOWN = 40
"""How many characters of a refused value a message shows."""

Lines = dict[tuple[str, str], int]
"""Line, counted from 1, of a key in a section; the key "" is the section's header."""


def read_toml(text: str) -> "TomlSection":
    """The top of a document.

    Raises
    ------
    ValueError
        The text is not TOML; tomllib says line and column.
    """
    try:
        values: dict[str, object] = tomllib.loads(text)
    except RecursionError:
        raise ValueError("not TOML that can be read: brackets are nested too deeply") from None
    except ValueError as error:
        raise ValueError(f"not TOML: {error}") from None
    return TomlSection(values, "", find_lines(text))


def find_lines(text: str) -> Lines:
    """Where sections and keys stand; the i-th [[name]] is called "name i", from 0."""
    lines: Lines = {}
    section = ""
    entries: Counter[str] = Counter()
    for number, line in enumerate(text.split("\n"), start=1):
        if header := HEADER.match(line):
            section = header[2]
            if header[1] == "[[":
                entries[section] += 1
                section = f"{section} {entries[section] - 1}"
            lines.setdefault((section, ""), number)
        elif key := KEY.match(line):
            lines.setdefault((section, key[1]), number)
    return lines


class TomlSection:
    """Values of a section. name : "" for the top of the document. lines : where its keys stand.

    Every method that reads raises ValueError when the key is missing or its value is of another kind.
    """

    def __init__(self, values: dict[str, object], name: str, lines: Lines) -> None:
        self._values = values
        self._name = name
        self._lines = lines

    def error(self, message: str, key: str = "") -> ValueError:
        """An error that says where: the line of the key, else that of the section, else the section alone."""
        line = self._lines.get((self._name, key)) or self._lines.get((self._name, ""))
        place = ", ".join(part for part in (f"line {line}" if line else "", self._name) if part)
        return ValueError(f"{place}: {message}" if place else message)

    def has(self, key: str) -> bool:
        """Whether the key is there."""
        return key in self._values

    def only(self, *known: str) -> None:
        """Refuse keys that nobody would read."""
        for key in self._values:
            if key not in known:
                raise self.error(f"{_short(key)} is unknown here; known are {', '.join(known)}", key)

    def text(self, key: str) -> str:
        """A string."""
        value = self._value(key)
        if not isinstance(value, str):
            raise self._kind(key, "a text in quotes")
        return value

    def whole(self, key: str) -> int:
        """An integer; a truth value is none."""
        value = self._value(key)
        if not isinstance(value, int) or isinstance(value, bool):
            raise self._kind(key, "a whole number")
        return value

    def number(self, key: str) -> float:
        """A finite number."""
        return self._finite(key, self._value(key))

    def numbers(self, key: str) -> tuple[float, ...]:
        """A list of finite numbers, maybe empty."""
        value = self._value(key)
        if not isinstance(value, list):
            raise self._kind(key, "a list of numbers")
        return tuple(self._finite(key, item) for item in value)

    def section(self, key: str) -> "TomlSection":
        """The section [key]."""
        value = self._value(key)
        if not isinstance(value, dict):
            raise self._kind(key, f"a section [{key}]")
        return TomlSection(value, key, self._lines)

    def sections(self, key: str) -> list["TomlSection"]:
        """The sections [[key]], at least one."""
        value = self._value(key)
        if not isinstance(value, list) or not value or not all(isinstance(item, dict) for item in value):
            raise self._kind(key, f"one or more sections [[{key}]]")
        return [TomlSection(item, f"{key} {i}", self._lines) for i, item in enumerate(value)]

    def _value(self, key: str) -> object:
        if key not in self._values:
            raise self.error(f"{key} is missing")
        return self._values[key]

    def _finite(self, key: str, value: object) -> float:
        """A value that must be a finite number."""
        if not isinstance(value, int | float) or isinstance(value, bool):
            raise self._kind(key, "a number")
        if not -sys.float_info.max <= value <= sys.float_info.max:
            raise self.error(f"{key} = {_short(value)} is not a finite number", key)
        return float(value)

    def _kind(self, key: str, wanted: str) -> ValueError:
        """The error of a value of another kind."""
        return self.error(f"{key} = {_short(self._values[key])} must be {wanted}", key)


def _short(value: object) -> str:
    """A value for a message of one line."""
    try:
        text = repr(value)
    except ValueError:  # an integer of thousands of digits
        return "a very long number"
    return text if len(text) <= SHOWN else text[:SHOWN] + "..."
