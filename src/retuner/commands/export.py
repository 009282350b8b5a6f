"""retuner export: a gain table for firmware, a PLC, a spreadsheet or a CAN tool, or back into its configuration."""

import sys
from collections.abc import Callable
from pathlib import Path
from typing import Annotated

import typer

from retuner.commands.options import ActionOption, Controller, PvSpan, controller_units, put_file
from retuner.errors import UserError, user_input
from retuner.gain_export.numbers import c_header, csv_table, dbc_table, identifier, numbers_of, structured_text
from retuner.schedule.document import from_toml
from retuner.schedule.table import GainTable

app = typer.Typer(add_completion=False)

GAINS = "gains.toml"
LARGEST = 1 << 20  # bytes
FORMATS: dict[str, tuple[str, Callable[[GainTable, str], str]]] = {
    "c": ("h", lambda table, source: c_header(numbers_of(table), source)),
    "st": ("st", lambda table, source: structured_text(numbers_of(table), source)),
    "dbc": ("dbc", lambda table, _: dbc_table(table)),
    "csv": ("csv", lambda table, _: csv_table(table)),
}
"""Suffix of the file and its writer, by the name of the format."""


@app.command(epilog="Example: retuner export runs/oven/gains.toml --format c --out gains.h")
def export(
    path: Annotated[Path, typer.Argument(metavar="GAINS", help="Gain table (gains.toml), or the folder of a run.")],
    form: Annotated[str, typer.Option("--format", help="c, st (IEC 61131-3), dbc or csv.")] = "",
    out: Annotated[
        Path | None, typer.Option(help="File to write; - for the screen. Default: beside the table.")
    ] = None,
    into: Annotated[Path | None, typer.Option(help="Configuration that gets the gains; its comments stay.")] = None,
    controller: Controller = None,
    action: ActionOption = None,
    pv_span: PvSpan = None,
) -> int:
    """Write a gain table for firmware, a PLC or a CAN tool, or back into its configuration; --controller shows it."""
    units = controller_units(controller, pv_span, action)
    if not form and into is None and units is None:
        raise UserError(f"--format: give one of {', '.join(FORMATS)}, or --into and a configuration, or --controller")
    if form and form not in FORMATS:
        raise UserError(f"--format {form}: give one of {', '.join(FORMATS)}")
    if form and form != "csv" and units is not None:
        raise UserError(f"--controller: --format {form} carries kp, ki and kd; only csv has a controller's own numbers")
    if form and into is not None and out is not None and out.resolve() == into.resolve():
        raise UserError("--out and --into name one file; give two")
    file = path / GAINS if path.is_dir() else path
    if path.is_dir() and not file.is_file() and (loops := sorted(path.glob(f"loops/*/{GAINS}"))):
        raise UserError(f"{path}: has a gain table a loop, give one of {', '.join(map(str, loops))}")
    table = _read(file)
    if form:
        suffix, writer = FORMATS[form]
        with user_input(str(file)):
            text = writer(table, file.name) if units is None else csv_table(table, units)
        if out == Path("-"):
            sys.stdout.write(text)
        else:
            target = out or file.with_name(f"{identifier(table.loop)}_gains.{suffix}")
            put_file(target, text)
            sys.stdout.write(
                f"{target} written: {len(table.gains)} set{'s' * (len(table.gains) != 1)}, revision {table.revision}\n"
            )
    elif units is not None:
        sys.stdout.write("".join(f"{name}: {units.text(table.gains_of(name))}\n" for name in table.regions.names))
    if into is not None:
        from retuner.gain_export.gains_into_config import into_config

        text, told = into_config(into, table)
        put_file(into, text)
        sys.stdout.write(f"{into}: " + ("; ".join(told) or "has these gains already") + "\n")
    return 0


def _read(path: Path) -> GainTable:
    try:
        with path.open("rb") as stream:
            raw = stream.read(LARGEST + 1)
    except OSError as error:
        raise UserError(f"{path}: cannot be read: {error.strerror}; give the gains.toml of a run") from None
    if len(raw) > LARGEST:
        raise UserError(f"{path}: is larger than {LARGEST} bytes; is it a gain table?")
    if b"\n[adaptation]" in raw:
        raise UserError(f"{path}: is a configuration; give the gains.toml of a run")
    with user_input(str(path)):
        return from_toml(raw.decode("utf-8"))
