"""What a run leaves in its folder: report.html, ledger.sqlite, trend, bus.blf, gains.toml and summary.json.

A folder that holds an earlier run is moved aside under a number, never written over: a ledger is evidence.
"""

import json
from pathlib import Path

from retuner.errors import UserError
from retuner.files import write_whole

LEDGER, REPORT, SUMMARY, GAINS, BUS_LOG, TREND = (
    "ledger.sqlite", "report.html", "summary.json", "gains.toml", "bus.blf", "trend",
)  # fmt: skip
OURS = {LEDGER, REPORT, SUMMARY, GAINS, BUS_LOG}


def fresh_folder(folder: Path) -> Path | None:
    """Make an empty folder for a run; an earlier run there is moved to folder-1, folder-2, ..., whose path is returned.

    Raises
    ------
    UserError
        The path is a file, or a folder that holds something else than a run of ours.
    """
    if folder.exists() and not folder.is_dir():
        raise UserError(f"{folder}: is a file; give a folder for the run with --out")
    moved = None
    if folder.is_dir() and any(folder.iterdir()):
        if not any((folder / name).exists() for name in OURS):
            raise UserError(f"{folder}: is not empty and holds no earlier run; give another folder with --out")
        number = 1
        while folder.with_name(f"{folder.name}-{number}").exists():
            number += 1
        moved = folder.with_name(f"{folder.name}-{number}")
        folder.rename(moved)
    folder.mkdir(parents=True, exist_ok=True)
    return moved


def give_back(folder: Path, moved: Path | None) -> None:
    """Undo fresh_folder after a run in which nothing happened: our files go, the earlier run comes back."""
    for path in folder.iterdir():
        if path.name in OURS or path.name.startswith(LEDGER):
            path.unlink()
    folder.rmdir()
    if moved is not None:
        moved.rename(folder)


def write_json(path: Path, document: object) -> None:
    """A JSON document as a whole file, readable."""
    write_whole(path, json.dumps(document, indent=2, allow_nan=False) + "\n")
