"""retuner doctor: what works on this machine, and what to do about the rest."""

import json
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from retuner.commands.options import Json
from retuner.errors import UserError

if TYPE_CHECKING:  # slow to load, and `--help` needs none of it
    from retuner.doctor import MachineFinding

app = typer.Typer(add_completion=False)


@app.command(epilog="Example: retuner doctor --folder runs")
def doctor(
    folder: Annotated[Path, typer.Option(help="Where sessions are going to be kept.")] = Path(),
    adapters: Annotated[bool, typer.Option("--adapters", help="Ask the drivers of CAN adapters too.")] = False,
    as_json: Json = False,
) -> int:
    """Try Python, packages, buses, engine, folder and screen: what works, and what to do about the rest.

    The exit status is 1 where something does not work that every session needs.
    """
    from retuner.doctor import Level, findings
    from retuner.verbosity import quiet

    if not folder.is_dir():
        raise UserError(f"--folder {folder}: there is no such folder; make it or name another")
    found = []
    for finding in findings(folder, adapters=adapters):
        found.append(finding)
        if not as_json and not (quiet() and finding.level == Level.OK):
            sys.stdout.write("".join(f"{line}\n" for line in lines(finding)))
            sys.stdout.flush()
    works = all(finding.level != Level.BROKEN for finding in found)
    if as_json:
        sys.stdout.write(json.dumps({"ok": works, "findings": [one.to_dict() for one in found]}, indent=2) + "\n")
    else:
        broken = [finding.name for finding in found if finding.level == Level.BROKEN]
        sys.stdout.write("retuner works here\n" if works else f"does not work here: {', '.join(broken)}\n")
    return 0 if works else 1


def lines(finding: "MachineFinding") -> list[str]:
    """A finding for a person."""
    told = [f"{finding.level:<11}{finding.name}: {finding.what}"]
    return [*told, f"{'':<11}  to do: {finding.remedy}"] if finding.remedy else told
