"""The rows of a ledger as they come: each one looked at, believed or not, and told in words once."""

from collections import deque
from pathlib import Path

from retuner.decision_page.row_values import part, parts, words
from retuner.decision_page.shown_units import show_units_told
from retuner.errors import LedgerError
from retuner.ledger import LedgerReader, Row
from retuner.ledger.chain import GENESIS, next_row, without_place
from retuner.report.ledger_words import LedgerLine, Teller
from retuner.session.order_queue import OrderState, shown

ROWS_KEPT = 20_000  # rows in words that are kept, the newest ones; `retuner ledger` has all of them
DECISIONS_KEPT = 2_000
AT_ONCE = 500  # Rows read in one turn: nobody holds the file longer than that takes

Document = dict[str, object]


class Decided:
    """A decision with its place in the ledger."""

    __slots__ = ("document", "hash", "number", "row")

    def __init__(self, row: Row) -> None:
        self.document: Document = without_place(row.body)
        self.number = int(str(self.document.get("number") or 0))
        self.row, self.hash = row.seq, row.hash


class LedgerTail:
    """Reads on where it stopped.

    path : the ledger; it may be written by another process.

    Raises LedgerError: it is no ledger of this release.
    """

    def __init__(self, path: Path) -> None:
        self._reader = LedgerReader(path)
        self.count, self.head = 0, GENESIS
        self.broken = ""
        self.names: list[str] = []
        self.told: deque[LedgerLine] = deque(maxlen=ROWS_KEPT)
        self._teller = Teller()
        self.decisions: deque[Decided] = deque(maxlen=DECISIONS_KEPT)
        self.shown: dict[str, OrderState] = {}
        self.ended = False
        self.interrupted = False

    def read_on(self) -> int:
        """Take in what has come; the number of new rows. A row that cannot be believed ends the reading."""
        if self.broken:
            return 0
        try:
            rows = self._reader.rows_after(self.count, AT_ONCE)
        except LedgerError as error:
            self.broken = str(error)
            return 0
        taken = 0
        for row in rows:
            try:
                expected = next_row(self.head, self.count + 1, row.clock_s, row.kind, row.text)
            except (ValueError, TypeError):
                expected = None
            if expected != row:
                self.broken = f"row {self.count + 1} cannot be trusted: it was changed after it was written"
                break
            self.count, self.head = row.seq, row.hash
            self.told.append(self._teller.told(row))
            body = row.body
            if row.kind == "session":
                config = part(body, "config")
                show_units_told(config)
                self.names = [words(part(one, "loop"), "name") for one in (parts(config, "loops") or [config])]
                self.shown = {name: OrderState() for name in self.names}
            # the loops that a row is about: the one that it names, where there are several, or all
            named = body.get("loop") if len(self.names) > 1 else None
            for name in [name for name in self.names if named in {None, name}]:
                shown((row,), self.shown[name])
            if row.kind == "decision":
                self.decisions.append(Decided(row))
            elif row.kind == "end":
                self.ended, self.interrupted = True, bool(body.get("interrupted"))
            taken += 1
        return taken

    def decision(self, loop: str, number: int) -> Decided | None:
        """A decision of a loop by its number."""
        own = (one for one in reversed(self.decisions) if words(one.document, "loop") == loop)
        return next((one for one in own if one.number == number), None)

    def shown_of(self, loop: str) -> OrderState:
        """What of a loop a person may refer to."""
        return self.shown.get(loop) or OrderState()

    def close(self) -> None:
        """Close the file."""
        self._reader.close()
