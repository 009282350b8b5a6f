"""Write docs/vocabulary.md: the words that the program uses, what they mean, and what they replace.

python scripts/document_vocabulary.py
"""

import re
from pathlib import Path

from retuner.decision_page.vocabulary import TERMS, Term

PAGE = Path(__file__).resolve().parent.parent / "docs" / "vocabulary.md"
HEAD = """# Vocabulary

One word for one thing, in screens, reports, pages and docs. Keys of JSON documents and of ledger rows are contracts,
and some are older words: `damping` is the half-cycle decay ratio, `promise` the predicted performance.
This page is written by scripts/document_vocabulary.py.

| term | meaning | source |
|---|---|---|
"""


def page() -> str:
    """The page as Markdown."""
    return HEAD + "".join(map(_row, TERMS))


def _row(term: Term) -> str:
    return f"| **{re.sub('[|]', '/', term.term)}** | {term.meaning} | {term.source} |\n"


if __name__ == "__main__":
    PAGE.write_text(page(), encoding="utf-8")
