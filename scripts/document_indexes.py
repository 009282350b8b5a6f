"""Write the last part of docs/diagnose.md: every number of the evidence with words, unit and source.

python scripts/document_indexes.py
"""

from pathlib import Path

from retuner.decision_page.evidence_words import GROUPS, WORDS

PAGE = Path(__file__).resolve().parent.parent / "docs" / "diagnose.md"
BEGIN = "<!-- written by scripts/document_indexes.py -->\n"
COLUMNS = "| name | meaning | unit | how to read it | source |\n|---|---|---|---|---|\n"


def page() -> str:
    """The page as Markdown: the groups of the command's table, then what is in the JSON only."""
    shown = {name for names in GROUPS.values() for name in names}
    groups = {**GROUPS, "in the JSON only": tuple(name for name in WORDS if name not in shown)}
    before, mark, _ = PAGE.read_text(encoding="utf-8").partition(BEGIN)
    return before + mark + "\n".join(table(heading, names) for heading, names in groups.items())


def table(heading: str, names: tuple[str, ...]) -> str:
    """One group."""
    rows = [f"| `{name}` | {' | '.join(WORDS[name])} |\n" for name in names]
    title = heading[:1].upper() + heading[1:]
    return f"### {title}\n\n{COLUMNS}" + "".join(rows)


if __name__ == "__main__":
    PAGE.write_text(page(), encoding="utf-8")
