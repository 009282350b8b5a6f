"""A schedule that a session proposed, into the configuration that shall run it: the section [schedule] is replaced.

Everything else of the file stays as it was written. What was written must be read back as the proposed table, and the
rest as it was, or nothing is written at all. The configuration must be of the loop that the session ran: a schedule
depends on its pv range and sample time, and on the regions that it replaces.
"""

import re
import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import tomlkit
from tomlkit.exceptions import TOMLKitError

from retuner.config.loading import UnusableError, load_session, parse_session
from retuner.config.model import Config
from retuner.decisions.proposed_schedule import digest_of, stands
from retuner.errors import UserError
from retuner.gain_export.gains_into_config import sameness
from retuner.schedule.config_section import schedule_section
from retuner.schedule.table import GainTable

SAME = ("name", "pv_unit", "pv_min", "pv_max", "sample_time_s")  # keys of [loop] on which a schedule depends
END = "where the proposed schedule ends"
STRINGS = re.compile(r'"(?:[^"\\]|\\.)*"|\'[^\']*\'')


class Written(NamedTuple):
    """A configuration with another schedule: its text, and how many lines of the old section had a comment."""

    text: str
    comments: int


def schedule_into(path: Path, table: GainTable, ran: Config, note: str, ended: GainTable | None = None) -> Written:
    """The configuration with this schedule in place of its own.

    table : as proposed. ran : the loop as the session ran it. note : a comment above the section. ended : the gains at
    the session's end, where they are known; the configuration may have them by now.

    Raises UserError: the configuration cannot be read, is of another loop, has a region that somebody holds, or would
    be refused or read as another schedule.
    """
    session, text = load_session(path)
    # Index of the loop that the session ran
    if ran.loop.name not in session.names:
        loops = f"the loop{'s' * (len(session.names) > 1)} {', '.join(session.names)}"
        raise UserError(
            f"{path}: has {loops}, the proposal is for {ran.loop.name!r}; "
            "a schedule goes only where its records came from"
        )
    place = session.names.index(ran.loop.name)
    own = session.loops[place]
    if own.schedule.proposal == digest_of(table) and stands(own):
        raise UserError(f"{path}: has this schedule already; nothing is left to do")
    differences = list(_differences(own, ran, ended))
    if differences:
        raise UserError(f"{path}: {differences[0]}; a schedule goes only where its records came from")
    # A region that somebody holds would be let go with the section
    for region in own.schedule.regions:
        held = [key for key in ("mode", "locked") if getattr(region, key) is not None]
        if held:
            raise UserError(
                f"{path}: region {region.name!r} has its own {' and '.join(held)}, which would go with the old "
                "schedule; take that out of the region first"
            )
    try:
        written = _replaced(text, place if session.several else None, table, note)
        config = parse_session(written.text).loops[place]
    except UnusableError as unusable:
        flaw = unusable.findings[0]
        raise UserError(f"{path}: with the proposed schedule it would be refused: {flaw.key} {flaw.message}") from None
    except (TOMLKitError, KeyError, TypeError, AttributeError, ValueError):
        headers = "[[loop]] and [loop.schedule]" if session.several else "[schedule] and [[schedule.region]]"
        raise UserError(
            f"{path}: its schedule cannot be found to be replaced; write it in one place, under {headers}"
        ) from None
    rest = place if session.several else None
    if not stands(config) or _rest(written.text, rest) != _rest(text, rest):
        raise UserError(f"{path}: the schedule would not be read back as it was proposed; nothing was changed")
    return written


def _differences(config: Config, ran: Config, ended: GainTable | None) -> Iterator[str]:
    """What is another in a configuration than it was in the session: of the loop, of its regions, and regions whose
    gains somebody has changed since: they would go without a word.
    """
    for key in SAME:
        here, there = getattr(config.loop, key), getattr(ran.loop, key)
        if here != there:
            yield f"loop.{key} is {here}, the session ran with {there}"
    here, there = config.gain_table(), ran.gain_table()
    if here.regions.names != there.regions.names:
        yield f"has the regions {', '.join(here.regions.names)}, the session ran {', '.join(there.regions.names)}"
    if here.regions != there.regions:
        yield "its regions are of another variable or have other boundaries than those that the session ran"
    if here.lookup != there.lookup:
        yield f"schedule.lookup is {here.lookup}, the session ran with {there.lookup}"
    same = sameness(config)
    for i, (name, gains) in enumerate(zip(there.regions.names, config.gains(), strict=False)):
        known = [one.gains[i] for one in (there, ended) if one is not None and one.regions == there.regions]
        if not any(same(gains, one) for one in known):
            yield f"the gains of region {name!r} are neither those at the start of the session nor those at its end"


def _replaced(text: str, loop: int | None, table: GainTable, note: str) -> Written:
    """The text with the new section. What stands below the last key of the old one belongs to the next: it stays."""
    crlf = "\n" not in text.replace("\r\n", "")
    document = tomlkit.parse(text.replace("\r\n", "\n") if crlf else text)
    holder: Any = document if loop is None else document["loop"][loop]
    own = "schedule" in holder
    old = holder["schedule"].as_string() if own else ""
    # Comments and blank lines at the end of a section
    section = old if own else holder.as_string()
    lines = section.splitlines(keepends=True)
    while lines and (not lines[-1].strip() or lines[-1].lstrip().startswith("#")):
        lines.pop()
    kept = section[len("".join(lines)) :]
    comments = sum("#" in STRINGS.sub("", line) for line in old.removesuffix(kept).splitlines())
    comments += own and bool(holder["schedule"].trivia.comment)
    found: Any = tomlkit.parse(schedule_section(table))["schedule"]
    section = tomlkit.table()
    section.comment(note)
    section["proposal"] = digest_of(table)
    section["lookup"] = str(table.lookup)
    for key, value in found.items():
        section[key] = value
    last: Any = section["region"]
    last[-1].add(tomlkit.comment(END))
    holder["schedule"] = section
    written = tomlkit.dumps(document)
    if not own:
        # The text without what stands above a new section at the end of its loop and belongs below it
        start = written.rindex("[loop.schedule]", 0, written.index(str(section["proposal"])))
        above = written[:start].rstrip().removesuffix(kept.strip()).rstrip()
        written = f"{above}\n\n{written[start:]}"
    written = re.sub(rf"# {END}\n(\n?)", lambda end: kept or end[1], written, count=1)
    return Written(written.replace("\n", "\r\n") if crlf else written, comments)


def _rest(text: str, loop: int | None) -> dict[str, Any]:
    document = tomllib.loads(text)
    (document if loop is None else document["loop"][loop]).pop("schedule", None)
    return document
