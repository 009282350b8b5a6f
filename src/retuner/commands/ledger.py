"""retuner ledger verify: whether a ledger can be believed, by its own hashes and by a hash noted elsewhere."""

import json
import re
import sys
from pathlib import Path

from retuner.errors import UserError
from retuner.ledger import LedgerReader
from retuner.session.recorded_session import ledger_path

SHORTEST_HEAD = 12  # hexadecimal digits; 48 bits cannot be met by chance


def verify(path: Path, *, head: str | None, as_json: bool) -> int:
    """Recompute the chain; the exit status: 0 when it holds, 1 when it is broken.

    Raises
    ------
    UserError
        The file is no ledger that can be read, or head is no hash.
    """
    if head is not None and not re.fullmatch(rf"[0-9a-f]{{{SHORTEST_HEAD},64}}", head):
        raise UserError(
            f"--head {head}: give {SHORTEST_HEAD} to 64 hexadecimal digits, as run and summary.json tell them"
        )
    path = ledger_path(path)
    with LedgerReader(path) as ledger:
        report = ledger.verify(head or "")
    if as_json:
        document = {
            "file": str(path),
            "ok": report.ok,
            "rows": report.rows,
            "head": report.head,
            "broken_seq": report.broken_seq,
            "reason": report.reason or None,
        }
        sys.stdout.write(json.dumps(document, indent=2, allow_nan=False) + "\n")
    elif report.ok:
        sys.stdout.write(f"{path}: ok, {report.rows} rows, head {report.head}\n")
    else:
        sys.stdout.write(f"{path}: broken: {report.reason}; {report.rows} rows before it hold\n")
    return 0 if report.ok else 1
