"""An EDS (or DCF), and the objects that a mapping names in it: found, or told in one line with the key that is wrong.

The object dictionary, its data types and the words for aborts and emergencies are those of the package `canopen`.
"""

import codecs
import configparser
import contextlib
import io
import logging
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import canopen
from canopen.objectdictionary import datatypes

from retuner.drivers.profiles.controller_access import ProfileError, description
from retuner.schedule.vendor_units import SINGLE_MAX, StorableNumbers

Key = tuple[str | int, ...]
Variable = canopen.objectdictionary.ODVariable
Dictionary = canopen.objectdictionary.ObjectDictionary
WIDEST = 8  # bytes of a number
EXACT_BITS = 53  # whole numbers of more bits are no longer told apart as floats
COMMUNICATION, MAPPING = 0x1800, 0x1A00
PDOS = 512
DISABLED = 1 << 31  # bit of a PDO's COB-ID
NO_PART = 256  # a sub-index that no object has
PARSING_ERRORS = (
    configparser.Error, canopen.ObjectDictionaryError, ValueError, LookupError, TypeError, ArithmeticError,
    AttributeError, OSError, RecursionError, AssertionError,
)  # fmt: skip
SHOWN = 120

logging.getLogger("canopen").addHandler(logging.NullHandler())


class PdoEntry(NamedTuple):
    """A mapped object: where it lies in the frame, in bits."""

    variable: Variable
    first: int
    bits: int


def read_eds(path: Path, node: int) -> Dictionary:
    """The object dictionary of an EDS file, for this node.

    Raises ProfileError: the file cannot be read, or is no EDS.
    """
    text = _decoded(description(path, "EDS")).replace("\r\n", "\n").replace("\r", "\n").rstrip(END_OF_FILE)
    text = NO_RATE.sub("", text)
    there = {index.upper() for index in WHOLE.findall(text)}
    file = io.StringIO(PART.sub(lambda found: _with_object(found, there), text))
    file.name = f"{path.stem}.eds"
    try:
        with contextlib.redirect_stderr(io.StringIO()):
            dictionary = canopen.import_od(file, node)
    except PARSING_ERRORS as error:
        told = " ".join(str(error).split())[:SHOWN]
        raise ProfileError(f"{path}: cannot be used as an EDS: {told or type(error).__name__}", ("eds",)) from None
    if not len(dictionary):
        raise ProfileError(f"{path}: describes no object; is it an EDS?", ("eds",))
    return dictionary


class EdsFile:
    """The objects of a node.

    source : name of the file. node : number of the node, 1 to 127.

    Raises ProfileError: no such node number.
    """

    def __init__(self, dictionary: Dictionary, source: str, node: int) -> None:
        if not 1 <= node <= 127:
            raise ProfileError(f"node = {node}: CANopen nodes are 1 to 127", ("node",))
        self.dictionary, self.source, self.node = dictionary, source, node

    def variable(self, name: str, key: Key, *, written: bool = False, read: bool = True) -> Variable:
        """An object by "6130", "6130:1" or its name in the EDS.

        Raises ProfileError: there is none, it is no number, or it cannot be read or written as it must be.
        """
        found = self._found(name, (*key, "object"))
        where = f"{self.source}: object {text_of(found)} ({found.name})"
        if found.data_type not in datatypes.NUMBER_TYPES or len(found) > 8 * WIDEST:
            raise ProfileError(f"{where} is not a number of at most {WIDEST} bytes", (*key, "object"))
        if written and not found.writable:
            raise ProfileError(f"{where} cannot be written ({found.access_type})", (*key, "object"))
        if read and not found.readable:
            raise ProfileError(f"{where} cannot be read ({found.access_type})", (*key, "object"))
        return found

    def _found(self, name: str, key: Key) -> Variable:
        index, _, sub = name.partition(":")
        try:
            number: int | str = int(index, 16)
        except ValueError:
            number = index if index in self.dictionary else name
        entry = self.dictionary.get(number)
        if entry is None:
            known = sorted(entry.index for entry in self.dictionary.values())
            if isinstance(number, int):
                known.sort(key=lambda index: abs(index - number))
            there = ", ".join(f"{index:04X}" for index in sorted(known[:6]))
            raise ProfileError(f"{self.source}: no object {name!r}; there is {there}", key)
        if isinstance(entry, Variable):
            return entry
        if not sub:
            subs = ", ".join(f"{i} ({entry[i].name})" for i in list(entry)[1:9])
            raise ProfileError(f"{self.source}: object {index} has parts; name one: {index}:{subs}", key)
        try:  # decimal or 0x
            part = int(sub, 16 if sub.lower().startswith("0x") else 10)
        except ValueError:
            part = NO_PART
        count = self._value(entry, 0)
        invented = count is not None and part > count
        found: Variable | None = None if invented else entry.get(part)  # the package invents parts of arrays
        if found is None:
            there = ", ".join(str(i) for i in entry)
            raise ProfileError(f"{self.source}: object {index} has no part {sub!r}; there is {there}", key)
        return found

    def tpdos(self) -> Iterator[tuple[int, list[PdoEntry]]]:
        """COB-ID and content of each PDO that the device sends, by the EDS."""
        for i in range(PDOS):
            if COMMUNICATION + i not in self.dictionary or MAPPING + i not in self.dictionary:
                continue
            communication, mapping = self.dictionary[COMMUNICATION + i], self.dictionary[MAPPING + i]
            cob, count = self._value(communication, 1), self._value(mapping, 0)
            if cob is None or cob & DISABLED or not count:
                continue
            entries, first = list[PdoEntry](), 0
            for sub in range(1, min(count, 64) + 1):
                entry = self._value(mapping, sub)
                if not entry:
                    break
                bits = entry & 0xFF
                variable = self.dictionary.get_variable(entry >> 16, entry >> 8 & 0xFF)
                if variable is not None:  # an object that the EDS does not know is passed over with its bits
                    entries.append(PdoEntry(variable, first, bits))
                first += bits
            if entries:
                yield cob & 0x7FF, entries

    def _value(self, record: Any, sub: int) -> int | None:  # noqa: ANN401  record, array or variable of the package
        """The value that the file gives a part: a DCF's parameter value, else the default."""
        try:
            part = record[sub]
        except (KeyError, TypeError):
            return None
        value = part.value if part.value is not None else part.default
        return value if isinstance(value, int) else None


def text_of(variable: Variable) -> str:
    """An object as people write it."""
    return f"{variable.index:04X}:{variable.subindex}"


def holds(variable: Variable) -> StorableNumbers:
    """The numbers that an object can hold, by its type and its limits."""
    kind = variable.data_type
    single = kind == datatypes.REAL32
    if kind in datatypes.FLOAT_TYPES:
        low, high = -SINGLE_MAX, SINGLE_MAX
        step = 0.0
    else:
        bits = min(len(variable), EXACT_BITS)
        signed = kind in datatypes.SIGNED_TYPES
        low, high = (-(2.0 ** (bits - 1)), 2.0 ** (bits - 1) - 1) if signed else (0.0, 2.0**bits - 1)
        step = 1.0
    least, most = variable.min, variable.max
    if isinstance(least, int | float) and isinstance(most, int | float) and least < most:
        low, high = max(low, float(least)), min(high, float(most))
    return StorableNumbers(low, high, step, 0.0, single=single)


# An EDS as a standard one would be written: what other makers' tools do to the text, undone before it is read.
#
# CiA 306 asks for ASCII lines under [6130] and [6130sub1]. Found beside that: a byte-order mark, UTF-16, lone
# carriage returns, DOS's end-of-file mark, [6130SUB1], parts without the section of their object, and empty baud
# rates.


MARKS = ((codecs.BOM_UTF8, "utf-8-sig"), (codecs.BOM_UTF16_LE, "utf-16"), (codecs.BOM_UTF16_BE, "utf-16"))
PART = re.compile(r"^\[([0-9A-F]{4})sub([0-9A-F]{1,2})\][ \t]*$", re.IGNORECASE | re.MULTILINE)
WHOLE = re.compile(r"^\[([0-9A-F]{4})\]", re.IGNORECASE | re.MULTILINE)
NO_RATE = re.compile(r"^BaudRate_\w+[ \t]*=[ \t]*\n", re.IGNORECASE | re.MULTILINE)
END_OF_FILE = "\x1a\0"


def _decoded(raw: bytes) -> str:
    """The text by its mark, else as UTF-8 where it is that, else as Windows writes."""
    for mark, name in MARKS:
        if raw.startswith(mark):
            return raw.decode(name, errors="replace")
    try:
        return raw.decode("utf-8")
    except UnicodeDecodeError:
        return raw.decode("latin-1")


def _with_object(found: "re.Match[str]", there: set[str]) -> str:
    """The head of a part; before the first of an object that has no section, such a section."""
    index = found[1].upper()
    part = f"[{index}sub{found[2].upper()}]"
    if index in there:
        return part
    there.add(index)
    return f"[{index}]\nParameterName={index}\nObjectType=0x9\n\n{part}"
