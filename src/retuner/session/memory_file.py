"""What a session has learned, in a file beside its ledger, so that a restart loses nothing.

    state after a decision -> memory.json (the one before it stays as memory-before.json) -> row "memory" with its hash
                           -> row "decision"

So whenever the process dies, one of the two files has a hash that the ledger knows, and it holds everything that was
decided in the rows of the ledger; what happened after it (a write that came about, a trial that ended) stands in the
rows behind, and is told to the retuner again. The session that goes on writes down what it begins with as
memory-start.json: a replay begins there.
"""

import hashlib
import json
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

from retuner.adaptive.supervision.retuner import Retuner
from retuner.adaptive.supervision.retuner_settings import RetunerSettings
from retuner.adaptive.supervision.state_file import remember, restore
from retuner.config.model import Config
from retuner.errors import LedgerError, UserError
from retuner.files import write_whole
from retuner.ledger import Recorder, Row
from retuner.session.ledger_rows import feed
from retuner.session.outputs import LEDGER, MEMORY, MEMORY_BEFORE, MEMORY_START, believed_rows, loop_folder

ROW = "memory"  # kind of the rows that know a memory by its hash
TOLD_AGAIN = frozenset(
    {"committed", "refused", "dropped", "abort", "restored", "foreign", "action", "order", "pretune"}
)
"""Rows behind a memory that the retuner is told again. A question that was open is lost with the process."""


class NoMemoryError(Exception):
    """There is no memory to go on with; the message is the line that says why, empty where there never was one."""


class Remembered(NamedTuple):
    """A memory that goes on: the retuner, the text it was read from or will be, and how many rows were told again."""

    retuner: Retuner
    text: str
    rows: int

    @property
    def sha256(self) -> str:
        """SHA-256 of the text."""
        return digest(self.text)

    @property
    def last_s(self) -> float | None:
        """Time of the newest sample that it knows, s; None without any."""
        samples = self.retuner.state().finder.samples
        return samples[-1].t_s if samples else None


def digest(text: str) -> str:
    """SHA-256 of a text."""
    return hashlib.sha256(text.encode()).hexdigest()


def about(config: Config) -> str:
    """A hash of what a memory depends on: loop, schedule, adaptation, and which controller it is.

    Not on which proposal the schedule was taken from: that is history, and changes nothing of what runs. Nor on which
    loops share its plant: what is known of the loop itself stays. Sections count by the names that they first had, so
    that memories of earlier releases are still of the same configuration.
    """
    sections = ("loop", "schedule", "adaptation")
    body = {name: getattr(config, name).model_dump(mode="json", exclude={"proposal", "plant"}) for name in sections}
    body["adaptation"]["nudge"] = body["adaptation"].pop("bumps")
    return digest(json.dumps({**body, "node": config.bus.node}, sort_keys=True))


class MemoryFile:
    """Keeps a session's memory in its folder.

    folder : of the session. config : of the loop. record : keeps rows for good.
    """

    def __init__(self, folder: Path, config: Config, record: Recorder) -> None:
        self._folder, self._about, self._record = folder, about(config), record

    def save(self, retuner: Retuner, t_s: float) -> None:
        """Write the memory as it stands, then the row that knows it; a file that cannot be written is told there."""
        text = as_text(retuner, self._about)
        path = self._folder / MEMORY
        try:
            if path.exists():
                path.replace(self._folder / MEMORY_BEFORE)
            write_whole(path, text)
        except OSError as error:
            self._record(ROW, t_s, {"sha256": None, "reason": f"{path}: {error.strerror or error}"})
            return
        self._record(ROW, t_s, {"sha256": digest(text), "reason": ""})

    def begin(self, remembered: Remembered | None, why_not: str) -> None:
        """Write down what the session begins with, or why without."""
        if remembered is not None:
            write_whole(self._folder / MEMORY_START, remembered.text)
            write_whole(self._folder / MEMORY, remembered.text)
        sha256 = remembered.sha256 if remembered is not None else None
        rows = remembered.rows if remembered is not None else 0
        if remembered is not None or why_not:
            self._record(ROW, 0.0, {"sha256": sha256, "reason": why_not, "begun": True, "rows": rows})


def as_text(retuner: Retuner, what: str) -> str:
    """A memory as the file has it."""
    return json.dumps({"about": what, "memory": remember(retuner)}, sort_keys=True, allow_nan=False) + "\n"


def from_text(text: str, config: Config, settings: RetunerSettings) -> Retuner:
    """The retuner that a text holds.

    Raises NoMemoryError: it is of another configuration, of another release, or damaged.
    """
    try:
        document = json.loads(text)
        of, memory = document["about"], document["memory"]
    except (ValueError, KeyError, TypeError):
        raise NoMemoryError("it is damaged") from None
    if of != about(config):
        raise NoMemoryError("it belongs to another configuration: [loop], [schedule], [adaptation] or the node differ")
    try:
        return restore(memory, settings)
    except ValueError as error:
        raise NoMemoryError(str(error)) from error


def recall(
    before: Path | None, config: Config, settings: RetunerSettings, loop: str = "", known: Sequence[Row] | None = None
) -> Remembered:
    """The memory of the session that was in the folder before, brought up to the last row of its ledger.

    loop : whose memory, empty for the only one of a session. known : the ledger's rows about it, if they were read.

    Raises NoMemoryError: there is none, or none that can be trusted: a line on why, empty where there never was one.
    """
    folder = loop_folder(before, loop) if before is not None else None
    if before is None or folder is None or not any((folder / name).exists() for name in (MEMORY, MEMORY_BEFORE)):
        raise NoMemoryError("")
    try:
        rows = known if known is not None else believed_rows(before / LEDGER)
        text, place = _known(folder, rows)
        retuner = from_text(text, config, settings)
        # tell the retuner what happened after its memory was written; how many rows told it something. How a write
        # ended that was under way then is told by what the controller runs: see the gain writer
        told = 0
        for row in rows[place + 1 :]:
            if row.kind not in TOLD_AGAIN:
                continue
            told += 1
            try:
                feed(retuner, row.kind, row.body, row.clock_s)
            except (KeyError, TypeError, ValueError) as error:
                raise NoMemoryError(f"row {row.seq} of the ledger is not what a session writes: {error}") from error
    except (NoMemoryError, LedgerError, UserError) as error:
        raise NoMemoryError(f"{folder / MEMORY}: {error}; the loop begins without memory") from error
    again = as_text(retuner, about(config))
    return Remembered(from_text(again, config, settings), again, told)


def _known(before: Path, rows: Sequence[Row]) -> tuple[str, int]:
    """The newest memory whose hash the ledger has, and the place of its row."""
    places = {row.body.get("sha256"): place for place, row in enumerate(rows) if row.kind == ROW}
    found: list[tuple[int, str]] = []
    for name in (MEMORY, MEMORY_BEFORE):
        try:
            text = (before / name).read_text(encoding="utf-8")
        except (OSError, ValueError):
            continue
        if digest(text) in places:
            found.append((places[digest(text)], text))
    if not found:
        raise NoMemoryError("it is damaged or was changed: the ledger has no memory with this hash")
    place, text = max(found)
    return text, place


def started_with(folder: Path, rows: Sequence[Row], config: Config, settings: RetunerSettings) -> Remembered | None:
    """The memory that a recorded session began with; None when it began with none.

    Raises UserError: the file is not there any more, or is not the one that the ledger knows.
    """
    begun = next((row.body for row in rows if row.kind == ROW and row.body.get("begun")), None)
    if begun is None or begun["sha256"] is None:
        return None
    path = folder / MEMORY_START
    try:
        text = path.read_text(encoding="utf-8")
    except (OSError, ValueError) as error:
        raise UserError(f"{path}: {error}") from error
    if digest(text) != begun["sha256"]:
        raise UserError(f"{path}: was changed after the run; the ledger has another hash for it")
    try:
        return Remembered(from_text(text, config, settings), text, 0)
    except NoMemoryError as error:
        raise UserError(f"{path}: {error}") from error
