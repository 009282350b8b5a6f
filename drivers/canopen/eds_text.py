"""An EDS as a standard one would be written: what other makers' tools do to the text, undone before it is read.

CiA 306 asks for ASCII lines under [6130] and [6130sub1]. Found beside that: a byte-order mark, UTF-16, lone carriage
returns, DOS's end-of-file mark, [6130SUB1], parts without the section of their object, and empty baud rates.
"""

import codecs
import re

MARKS = ((codecs.BOM_UTF8, "utf-8-sig"), (codecs.BOM_UTF16_LE, "utf-16"), (codecs.BOM_UTF16_BE, "utf-16"))
PART = re.compile(r"^\[([0-9A-F]{4})sub([0-9A-F]{1,2})\][ \t]*$", re.IGNORECASE | re.MULTILINE)
WHOLE = re.compile(r"^\[([0-9A-F]{4})\]", re.IGNORECASE | re.MULTILINE)
NO_RATE = re.compile(r"^BaudRate_\w+[ \t]*=[ \t]*\n", re.IGNORECASE | re.MULTILINE)
END_OF_FILE = "\x1a\0"


def plain_text(raw: bytes) -> str:
    """The text in standard form. Whatever it holds beside, it is left for the reader to judge."""
    text = _decoded(raw).replace("\r\n", "\n").replace("\r", "\n").rstrip(END_OF_FILE)
    text = NO_RATE.sub("", text)
    there = {index.upper() for index in WHOLE.findall(text)}
    return PART.sub(lambda found: _with_object(found, there), text)


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
