"""Write the vocabulary of docs/concepts.md: the words that the program uses and what they mean.

python scripts/document_vocabulary.py
"""

import re
from pathlib import Path

from retuner.decision_page.vocabulary import TERMS, Term

PAGE = Path(__file__).resolve().parent.parent / "docs" / "concepts.md"
BEGIN = "<!-- written by scripts/document_vocabulary.py -->\n"
COLUMNS = "| term | meaning | source |\n|---|---|---|\n"


def page() -> str:
    """The page as Markdown, with the terms at its end."""
    before, mark, _ = PAGE.read_text(encoding="utf-8").partition(BEGIN)
    return before + mark + COLUMNS + "".join(map(_row, TERMS))


def _row(term: Term) -> str:
    return f"| **{re.sub('[|]', '/', term.term)}** | {term.meaning} | {term.source} |\n"


if __name__ == "__main__":
    PAGE.write_text(page(), encoding="utf-8")
