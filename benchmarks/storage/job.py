"""What a run does to its disk, made small enough to be interrupted at every step, and how the leftovers are judged.

    python benchmarks/storage/job.py FOLDER [ROWS]

appends rows to FOLDER/ledger.sqlite and replaces FOLDER/gains.toml now and then. Each is acknowledged on stdout once it
is promised: "row SEQ HASH" and "table REVISION". It goes on where an earlier job ended. Status 0; 3 and one line on
stderr when the disk refuses.
"""

import os
import re
import sys
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path

from retuner import GainTable, PidGains, Regions
from retuner.errors import LedgerError
from retuner.files import write_whole
from retuner.ledger import Ledger
from retuner.schedule.document import from_toml, to_toml

LEDGER, TABLE = "ledger.sqlite", "gains.toml"
ROWS_PER_TABLE = 3
LITTER = re.compile(r"ledger\.sqlite(-wal|-shm|-journal|\.lock)|\.gains\.toml\.\d+\.tmp")
"""What a kill may leave beside the two files: SQLite's own, the lock's name, a table that never got its name."""


def table(revision: int) -> GainTable:
    """The table of a revision; every number in it depends on the revision, so a mixture of two shows."""
    made = GainTable(
        "loop",
        Regions("sp", "-", ("low", "high"), 0.0, (50.0,), 100.0, 1.0, 0.0),
        (PidGains(1.0 + revision, 0.1 + revision), PidGains(2.0 + revision, 0.2 + revision)),
    )
    return replace(made, revision=revision)


def work(folder: Path, rows: int, acknowledge: int, synchronous: str = "") -> None:
    """The job; acknowledge : file descriptor; synchronous : another setting of SQLite's, to see a test find its loss.

    Raises LedgerError, OSError: the disk refuses.
    """
    kept = folder / TABLE
    revision = from_toml(kept.read_text("utf-8")).revision if kept.exists() else 0
    with Ledger(folder / LEDGER) as ledger:
        if synchronous:
            ledger._connection.execute(f"PRAGMA synchronous = {synchronous}")  # noqa: SLF001  the test's own weakening
        for i in range(rows):
            row = ledger.append("decision", {"gains": {"kp": 0.1, "ki": 1e-3}, "why": "x" * 40}, float(i))
            os.write(acknowledge, f"row {row.seq} {row.hash}\n".encode())
            if i % ROWS_PER_TABLE == ROWS_PER_TABLE - 1:
                revision += 1
                write_whole(kept, to_toml(table(revision)))
                os.write(acknowledge, f"table {revision}\n".encode())


@dataclass
class Promised:
    """What was acknowledged in a folder so far."""

    rows: dict[int, str] = field(default_factory=dict)
    revision: int = 0

    def take(self, text: str) -> None:
        """Lines of a job's stdout; the last one may be cut."""
        for line in text.splitlines(keepends=True):
            words = line.split()
            if not line.endswith("\n"):
                continue
            if words[0] == "row":
                self.rows[int(words[1])] = words[2]
            elif words[0] == "table":
                self.revision = int(words[1])


def broken(folder: Path, promised: Promised) -> Iterator[str]:
    """What a folder that was interrupted at any moment must not show; nothing when all is well."""
    path = folder / LEDGER
    if promised.rows or path.exists():
        try:
            with Ledger(path) as ledger:  # it opens for writing at once, whatever lock files lie about
                kept = {row.seq: row.hash for row in ledger.rows()}
        except LedgerError as error:
            yield f"the ledger does not open: {error}"
            kept = promised.rows
        lost = {seq for seq, hash_ in promised.rows.items() if kept.get(seq) != hash_}
        if lost:
            yield f"acknowledged rows lost or changed: {sorted(lost)}"
        if len(kept) > len(promised.rows) + 1:
            yield f"{len(kept)} rows, {len(promised.rows)} acknowledged"
        promised.rows |= kept  # what is there now has been seen and must stay
    kept_table = folder / TABLE
    if promised.revision or kept_table.exists():
        yield from _broken_table(kept_table, promised)
    for name in sorted(path.name for path in folder.iterdir()):
        if name not in (LEDGER, TABLE) and not LITTER.fullmatch(name):
            yield f"left behind: {name}"


def _broken_table(kept: Path, promised: Promised) -> Iterator[str]:
    """The same for the table."""
    try:
        found = from_toml(kept.read_text("utf-8"))
    except (OSError, ValueError) as error:
        yield f"the table is torn or gone: {error}"
        return
    if found != table(found.revision):
        yield f"the table is a mixture: {found}"
    if not promised.revision <= found.revision <= promised.revision + 1:
        yield f"the table is revision {found.revision}, acknowledged was {promised.revision}"
    promised.revision = found.revision


def main() -> int:
    try:
        work(Path(sys.argv[1]), int(sys.argv[2]) if len(sys.argv) > 2 else 6, 1)
    except (LedgerError, OSError) as error:
        sys.stderr.write(f"{error}\n")
        return 3
    return 0


if __name__ == "__main__":
    sys.exit(main())
