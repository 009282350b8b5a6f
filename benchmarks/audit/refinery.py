"""The audit of real records, 46 of 15 loops of a refinery, beside what their author says of them.

    python benchmarks/audit/refinery.py FOLDER --page docs/_static/refinery

FOLDER holds the records and index.csv with a label for each: stiction, or no stiction, which is not "in order".
Printed: a table in Markdown, and counts by loop. --page takes the page of the audit as it is published.
"""

import argparse
import csv
import json
import os
import shutil
import tempfile
from pathlib import Path

from retuner.cli import main as retuner

PATTERN = r"^([A-Z]+\d+)_"
PAGE = ("index.html", "audit-data.js", "loops")


def audited(records: Path, folder: Path, stretches: int) -> list[dict[str, object]]:
    """The rows of the audit, made in a folder whose name the page may tell."""
    plant = folder / "refinery"
    plant.mkdir(exist_ok=True)
    for path in sorted(records.glob("*.csv")):
        if path.name != "index.csv" and not (plant / path.name).exists():
            shutil.copy(path, plant)
    os.chdir(folder)
    if retuner(["audit", "refinery", "--tag-pattern", PATTERN, "--jobs", "1", "--stretches", str(stretches), "-q"]):
        raise SystemExit("the audit is not whole; the same command goes on")
    rows: list[dict[str, object]] = json.loads((folder / "audit" / "audit.json").read_text(encoding="utf-8"))["rows"]
    return rows


def labelled(records: Path) -> dict[str, str]:
    """What the author says of each loop; all of a loop's records have one label."""
    with (records / "index.csv").open(encoding="utf-8") as stream:
        return {row["tag"]: row["label"] for row in csv.DictReader(stream)}


def main() -> None:
    """Audit, compare, print, and keep the page."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("records", type=Path)
    parser.add_argument("--page", type=Path, help="folder in which the page is put")
    parser.add_argument("--stretches", type=int, default=4)
    parser.add_argument("--work", type=Path, help="folder of the audit, in which one that was stopped goes on")
    given = parser.parse_args()
    labels, page = labelled(given.records), given.page.resolve() if given.page else None
    with tempfile.TemporaryDirectory() as temporary:
        made = given.work.resolve() if given.work else Path(temporary)
        made.mkdir(exist_ok=True)
        rows = audited(given.records.resolve(), made, given.stretches)
        if page is not None:
            shutil.rmtree(page, ignore_errors=True)
            page.mkdir(parents=True)
            for name in PAGE:
                source = made / "audit" / name
                (shutil.copytree if source.is_dir() else shutil.copy)(source, page / name)
        os.chdir("/")
    print(
        "| # | loop | records | its author says | the audit says | sure | what to do |\n|---|---|---|---|---|---|---|"
    )
    for row in rows:
        sure = f"{row['confidence']:.0%}".replace("%", " %") if row["confidence"] is not None else ""
        told = (row["place"], row["tag"], row["records"], labels[row["tag"]], row["cause"], sure, row["action"])
        print(f"| {' | '.join(map(str, told))} |")
    sticks = [row for row in rows if labels[row["tag"]] == "stiction"]
    named = sum(row["cause"] == "stiction" for row in sticks)
    wrong = [row["tag"] for row in rows if row["cause"] == "stiction" and row not in sticks]
    retuned = [row["tag"] for row in rows if row["action"] == "retune"]
    print(f"\nlabelled stiction: {named} of {len(sticks)} loops named; named without the label: {wrong or 'none'}")
    print(f"to be retuned: {retuned or 'none'}")


if __name__ == "__main__":
    main()
