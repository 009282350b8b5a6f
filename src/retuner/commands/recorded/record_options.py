"""The record that options give, and telling what was assumed where they leave its form open."""

import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from retuner.commands.options import FormOptions
from retuner.drivers.historian.assumption import Assumption, in_a_line, in_full
from retuner.drivers.historian.loop_record import LoopRecord, read_loop_record, read_records
from retuner.drivers.historian.record_form import COLUMN_ROLES, RecordForm, form_from_toml
from retuner.errors import UserError, user_input
from retuner.verbosity import LOGGER, busy, quiet


def record_form(options: FormOptions) -> RecordForm:
    """What the options fix, over what the file of --record fixes.

    Raises UserError, RecordingError: a value out of range, or a file that cannot be used.
    """
    form = form_from_toml(options.record) if options.record is not None else RecordForm()
    texts = ("tag", "time_format", "time_unit", "zone", "decimal", "good")
    given: dict[str, Any] = {name: getattr(options, name) for name in texts if getattr(options, name)}
    given |= {k: v for k, v in (("sp", options.sp), ("dt_s", options.dt)) if v is not None}
    given |= {"bad": (*form.bad, options.bad)} if options.bad else {}
    given |= {"dbc": tuple(map(str, options.dbc))} if options.dbc else {}
    with user_input("the form of the record"):
        # --scale as signal to what it is recorded as and stands for
        found: dict[str, str] = {}
        for part in (p.strip() for p in options.scale.split(",") if p.strip()):
            role, equals, scaling = part.partition("=")
            if not equals or role in found:
                raise UserError(f"--scale {part}: give signal=range, each signal once, as in pv=4..20:0..200")
            found[role] = scaling
        scale = {**form.scale, **found}
        return replace(form, columns={**form.columns, **renamed(options.columns)}, scale=scale, **given)


def renamed(text: str) -> dict[str, str]:
    """--columns as role to column name.

    Raises UserError: a part is not role=name, a role is not known, or is given twice.
    """
    found: dict[str, str] = {}
    for part in (p.strip() for p in text.split(",") if p.strip()):
        role, equals, name = part.partition("=")
        if not equals or role not in COLUMN_ROLES or not name or role in found:
            raise UserError(f"--columns {part}: give role=name, each role once; roles are {', '.join(COLUMN_ROLES)}")
        found[role] = name
    return found


def read_record(
    files: Sequence[Path], options: FormOptions, *, in_automatic: bool = False, others: Sequence[str] = ()
) -> LoopRecord:
    """The record in these files. others : further columns that are wanted.

    Raises UserError, RecordingError: a file or an option cannot be used.
    """
    with busy(f"reading {', '.join(map(str, files))}"):
        form = record_form(options)
        form = replace(form, others=tuple(dict.fromkeys((*form.others, *others))))
        read = read_loop_record(files, form, in_automatic=in_automatic)
    LOGGER.info("read %d samples from %s", len(read.recording.t_s), read.recording.source)
    return read


def read_several(files: Sequence[Path], options: FormOptions) -> list[LoopRecord]:
    """The records in automatic of one loop: a file each, or one in several files; errors as read_record."""
    with busy(f"reading {', '.join(map(str, files))}"):
        found = read_records(files, record_form(options))
    for read in found:
        LOGGER.info("read %d samples from %s", len(read.recording.t_s), read.recording.source)
    return found


def days_told(days: int, records: int) -> tuple[Assumption, ...]:
    """Words where records were read in parts."""
    told = f"{days} parts, each a record of its own: gaps without samples, or with the controller off, left out"
    return (Assumption(told),) if days > records else ()


def tell_assumed(assumed: tuple[Assumption, ...], options: FormOptions) -> None:
    """What was assumed, on the error stream, beside the result: in one line, or as a [record] section."""
    if options.assume:
        sys.stderr.write("\n".join(in_full(assumed)) + "\n")
    elif assumed and not quiet():
        sys.stderr.write(f"assumed: {in_a_line(assumed)} (--assume prints how to fix it otherwise)\n")
