"""The ledger: what was seen, decided and written, append-only, hash-chained, durable before a change takes effect."""

from retuner.ledger.chain import ChainReport, Row
from retuner.ledger.store import Ledger, LedgerReader, Recorder

__all__ = ["ChainReport", "Ledger", "LedgerReader", "Recorder", "Row"]
