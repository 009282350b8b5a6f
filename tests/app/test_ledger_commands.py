"""ledger show, export and verify of a session: every row in words, whole or as far as it can be believed."""

import csv
import json
import shutil
import sqlite3
import sys
from pathlib import Path

import pytest
from command_line import answer, printed, refused

from retuner.cli import main
from retuner.ledger import LedgerReader

sys.path.append(str(Path(__file__).parent))

from recorded import bodies, short_session


@pytest.fixture(scope="module")
def session(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return short_session(tmp_path_factory, "--mode", "auto")


@pytest.fixture
def broken(session: Path, tmp_path: Path) -> Path:
    """A copy with the fourth row changed."""
    shutil.copytree(session, tmp_path / "broken")
    with sqlite3.connect(tmp_path / "broken" / "ledger.sqlite") as connection:
        connection.execute("DROP TRIGGER no_update")
        connection.execute("UPDATE ledger SET clock_s = clock_s + 1 WHERE seq = 4")
    connection.close()
    return tmp_path / "broken"


@pytest.mark.slow
def test_every_row_is_told(session: Path) -> None:
    found = answer("ledger", "show", session)
    assert found["ok"] is True
    rows = found["rows"]
    with LedgerReader(session / "ledger.sqlite") as ledger:
        assert [row["row"] for row in rows] == [row.seq for row in ledger.rows()]
    decision = next(row for row in rows if row["kind"] == "decision")
    assert decision["who"] == "retuner"
    assert decision["region"] == "all"
    assert decision["old"] == "Kc 5 tau_I 4 s"
    assert decision["new"].startswith("Kc ")
    assert "response" in decision["evidence"]
    assert "Ms" in decision["verdict"]
    assert rows[0]["why"] == "begins: short"
    assert "numpy" in rows[0]["evidence"]


def test_text_names_both_settings_and_the_chain(session: Path) -> None:
    shown = printed("ledger", "show", session)
    assert "Kc 5 tau_I 4 s -> Kc" in shown
    assert "the chain holds" in shown


def test_a_wide_terminal_gets_a_table(session, monkeypatch):
    monkeypatch.setenv("COLUMNS", "220")
    head = printed("ledger", "show", session).splitlines()[0]
    assert head.split()[:5] == ["row", "time", "[s]", "what", "who"]


def test_rows_are_selected(session: Path) -> None:
    def rows(*arguments: str) -> list[dict[str, object]]:
        found: list[dict[str, object]] = answer("ledger", "show", session, *arguments)["rows"]
        return found

    assert {row["kind"] for row in rows("--kind", "committed")} == {"committed"}
    first = rows("--decision", "1")
    assert first[0]["kind"] == "decision"
    assert {"intent", "committed"} <= {row["kind"] for row in first}
    assert sum(row["kind"] == "decision" for row in first) == 1
    late = rows("--since", "60")
    assert late
    assert all(float(str(row["when_s"])) >= 60 for row in late)


@pytest.mark.parametrize(
    ("arguments", "told"), [(["--decision", "99"], "no such decision"), (["--kind", "rumour"], "there are ")]
)
def test_what_is_not_there_is_one_line(session, arguments, told):
    assert told in refused("ledger", "show", session, *arguments)


def test_an_export_has_everything(session: Path, tmp_path: Path) -> None:
    lines, table = tmp_path / "l.jsonl", tmp_path / "l.csv"
    assert main(["ledger", "export", str(session), "--jsonl", str(lines)]) == 0
    assert main(["ledger", "export", str(session), "--csv", str(table)]) == 0
    with LedgerReader(session / "ledger.sqlite") as ledger:
        rows = list(ledger.rows())
    documents = [json.loads(line) for line in lines.read_text().splitlines()]
    assert [(d["seq"], d["kind"], d["hash"], d["body"]) for d in documents] == [
        (row.seq, row.kind, row.hash, row.body) for row in rows
    ]
    with table.open(newline="") as stream:
        read = list(csv.DictReader(stream))
    assert [row["hash"] for row in read] == [row.hash for row in rows]
    assert [json.loads(row["body"]) for row in read] == [row.body for row in rows]
    assert not any(value[:1] in {"=", "+", "@"} for row in read for value in row.values())
    for arguments, told in (
        ([], "give --csv FILE or --jsonl FILE"),
        (["--csv", str(table)], "exists already"),
        (["--csv", str(tmp_path / "no" / "x.csv")], "make it first"),
    ):
        assert told in refused("ledger", "export", session, *arguments)


def test_a_broken_chain_is_found_and_named_and_what_is_before_it_is_shown(broken, tmp_path):
    assert "broken: row 4 was changed after it was written; 3 rows before it hold" in printed(
        "ledger", "verify", broken, status=1
    )
    found = answer("ledger", "show", broken, status=1)
    assert [row["row"] for row in found["rows"]] == [1, 2, 3]
    assert "row 4 was changed" in found["reason"]
    assert "broken: row 4" in printed("ledger", "export", broken, "--jsonl", tmp_path / "x.jsonl", status=1)
    assert "row 4 was changed" in refused("approve", broken)
    assert main(["ledger", "revert", str(broken), "--decision", "1"]) == 2
    assert not (broken / "orders").exists()


def test_a_session_of_another_kind_is_shown_as_well(tmp_path: Path) -> None:
    """Rows that this release does not write are told by what they say."""
    from retuner.ledger import Ledger

    with Ledger(tmp_path / "ledger.sqlite") as ledger:
        ledger.append("omen", {"reason": "a raven", "flies": "left"}, 3.0)
        ledger.append("decision", {"number": 1}, 4.0)
        ledger.append("order", {}, 5.0)
    shown = printed("ledger", "show", tmp_path)
    assert "a raven" in shown
    assert "flies left" in shown


def test_the_session_says_what_it_was_made_with(session: Path) -> None:
    first = bodies(session, "session")[0]
    assert first["versions"]["retuner"]
    assert len(first["config_sha256"]) == 64
    end = bodies(session, "end")[0]
    assert len(end["bus_log_sha256"]) == 64


def test_the_ledger_reads_as_one_argument(session: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """What was seen and what explains it; what was done names its decision; its trial says what came of it."""
    rows = answer("ledger", "show", session)["rows"]
    made = next(row for row in rows if row["kind"] == "decision" and row["new"])
    name = made["why"].split(",")[0]
    assert made["evidence"].split(" | ")[0].endswith("response")
    assert made["verdict"].count("Ms before") <= 1
    after = [row for row in rows if row["row"] > made["row"]]
    assert next(row["why"] for row in after if row["kind"] == "intent") == f"the gains of {name}"
    assert next(row["why"] for row in after if row["kind"] == "trial") == f"{name} is on trial"
    judged = next(row for row in after if row["kind"] == "judged")
    assert judged["why"].startswith(f"the trial of {name} ")
    told = answer("ledger", "show", session, "--decision", name.split()[1])["rows"]
    assert [row["kind"] for row in told].count("judged") == 1  # what came of it, though other decisions lie between
    assert judged["row"] in {row["row"] for row in told}
    alone = ["ledger", "show", str(session), "--json", "--kind", "judged"]
    assert main(alone) == 0
    assert json.loads(capsys.readouterr().out)["rows"][0]["why"] == judged["why"]  # also without the rows before it
