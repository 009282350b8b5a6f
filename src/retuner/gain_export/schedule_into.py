"""A schedule that a session proposed, into the configuration that shall run it: the section [schedule] is replaced.

Everything else of the file stays as it was written. What was written must be read back as the proposed table, or
nothing is written at all.
"""

from pathlib import Path
from typing import Any

import tomlkit
from tomlkit.exceptions import TOMLKitError
from tomlkit.items import Table

from retuner.config.loading import UnusableError, load_session, parse_session
from retuner.decisions.proposed_schedule import digest_of, stands
from retuner.errors import UserError
from retuner.schedule.table import GainTable
from retuner.scheduling import schedule_section


def schedule_into(path: Path, table: GainTable, note: str) -> str:
    """The configuration's text with this schedule in place of its own.

    table : as proposed, of the loop that it names. note : a comment above the section.

    Raises
    ------
    UserError
        The configuration cannot be read, has no such loop, or would be refused or read as another schedule.
    """
    session, text = load_session(path)
    if session.several and table.loop not in session.names:
        raise UserError(
            f"{path}: has the loops {', '.join(session.names)}, the proposal is for {table.loop!r}; "
            "a schedule goes only where its records came from"
        )
    place = session.place(table.loop if session.several else None)
    try:
        document = tomlkit.parse(text)
        holder: Any = document["loop"][place] if session.several else document
        holder["schedule"] = _section(table, note)
        written = tomlkit.dumps(document)
        config = parse_session(written).loops[place]
    except (TOMLKitError, KeyError, TypeError) as error:
        raise UserError(f"{path}: its [schedule] cannot be found to be replaced: {error}") from None
    except UnusableError as unusable:
        flaw = unusable.findings[0]
        raise UserError(f"{path}: with the proposed schedule it would be refused: {flaw.key} {flaw.message}") from None
    if not stands(config):
        raise UserError(f"{path}: the schedule would not be read back as it was proposed; nothing was changed")
    return written


def _section(table: GainTable, note: str) -> Table:
    """The section, with its hash."""
    found: Any = tomlkit.parse(schedule_section(table))["schedule"]
    section = tomlkit.table()
    section.comment(note)
    section["proposal"] = digest_of(table)
    section["lookup"] = str(table.lookup)
    for key, value in found.items():
        section[key] = value
    return section
