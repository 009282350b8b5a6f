"""Write docs/indexes.md: every number of the evidence with its words, unit, how to read it, and its source.

python scripts/document_indexes.py
"""

from pathlib import Path

from retuner.decision_page.evidence_words import GROUPS, WORDS

PAGE = Path(__file__).resolve().parent.parent / "docs" / "indexes.md"
HEAD = """# The numbers of the evidence

`retuner diagnose` gives these numbers beside the cause: as a table for people, by name in the JSON. They are the
field's classic indexes and a few of our own; they put into words what a record looks like. They do not decide where
fitted hypotheses can. A number that does not apply to a record is left out. Unit "share" is 0 to 1 (shown in percent),
"pv" and "co" are the record's own units, "noise" counts in standard deviations of pv's noise. Formulas and why this
variant: `adaptive/indexes/`, one index a file.
This page is written by scripts/document_indexes.py.
"""
COLUMNS = "| name | meaning | unit | how to read it | source |\n|---|---|---|---|---|\n"


def page() -> str:
    """The page as Markdown: the groups of the command's table, then what is in the JSON only."""
    shown = {name for names in GROUPS.values() for name in names}
    groups = {**GROUPS, "in the JSON only": tuple(name for name in WORDS if name not in shown)}
    return HEAD + "".join(table(heading, names) for heading, names in groups.items())


def table(heading: str, names: tuple[str, ...]) -> str:
    """One group."""
    rows = [f"| `{name}` | {' | '.join(WORDS[name])} |\n" for name in names]
    title = heading[:1].upper() + heading[1:]
    return f"\n## {title}\n\n{COLUMNS}" + "".join(rows)


if __name__ == "__main__":
    PAGE.write_text(page(), encoding="utf-8")
