"""Docstrings of this house as reStructuredText for the site: sections, `name : meaning` items, formulas, examples.

They are plain sentences: stars, bars and underscores in them mean themselves, so nothing that is written in a docstring
can break the build of the site.
"""

import re
from collections.abc import Iterator
from inspect import cleandoc
from itertools import groupby

ITEM = re.compile(r"(?P<names>\w+(?:, \w+)*) : (?P<text>.*)")
NEXT_ITEM = re.compile(r"(?<=[.;]) (?=\w+(?:, \w+)* : )")
RULE = re.compile(r"-{3,}")


def as_rst(docstring: str) -> list[str]:
    """The lines of a docstring, marked up."""
    lines = cleandoc(docstring).splitlines()
    out: list[str] = []
    for title, body in sections(lines):
        out += [f".. rubric:: {title}", ""] if title else []
        for blank, block in groupby(body, key=lambda line: not line.strip()):
            if not blank:
                out += [*paragraph(list(block), of_errors=title == "Raises"), ""]
    return out


def sections(lines: list[str]) -> Iterator[tuple[str, list[str]]]:
    """Headings underlined with dashes, each with its lines; the first has none."""
    title, body = "", []
    for number, line in enumerate(lines):
        if RULE.fullmatch(line) and body:
            following = body.pop()
            yield title, body
            title, body = following, []
        elif number + 1 < len(lines) or line:
            body.append(line)
    yield title, body


def paragraph(block: list[str], *, of_errors: bool) -> Iterator[str]:
    """One paragraph: an example, a formula that stands indented, items, or sentences."""
    if block[0].startswith(">>>"):
        yield from block
    elif all(line.startswith("    ") for line in block):
        yield from ["::", "", *block]
    else:
        for item in items(block, of_errors=of_errors):
            yield from ([f"- {item}"] if item.startswith("``") else [item])
            yield ""


def items(block: list[str], *, of_errors: bool) -> Iterator[str]:
    """Each `name : meaning` with the lines indented below it, and the sentences between, as one line each."""
    told: list[str] = []
    for line in block:
        inside = line.startswith(" ")
        if ITEM.match(line) or not told or (not inside and (of_errors or ITEM.match(told[-1]))):
            told += [f"{line} : " if of_errors and not ITEM.match(line) else line]
        else:
            told[-1] = f"{told[-1].strip()} {line.strip()}" if not of_errors else told[-1] + line.strip()
    for item in (one for line in told for one in NEXT_ITEM.split(line)):
        found = ITEM.fullmatch(item)
        yield f"``{found['names']}``: {escaped(found['text'])}" if found else escaped(item)


def escaped(text: str) -> str:
    """Plain text: `names` become code, every other sign means itself."""
    parts = re.split(r"(`[^`]*`)", text)
    parts[::2] = [re.sub(r"([*|_\\`])", r"\\\1", part) for part in parts[::2]]
    parts[1::2] = [f"`{part}`" for part in parts[1::2]]
    return "".join(parts)
