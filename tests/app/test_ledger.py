"""The ledger keeps every acknowledged row, shows every change, and refuses what it cannot keep."""

import json
import math
import re
import sqlite3
import subprocess
import sys
from contextlib import suppress
from pathlib import Path

import pytest
from command_line import answer, printed
from hypothesis import given
from hypothesis import strategies as st
from recorded import SHORT

from retuner.cli import main
from retuner.commands.run import size_watch
from retuner.errors import LedgerError
from retuner.ledger import Ledger, LedgerReader
from retuner.ledger.chain import canonical_json
from retuner.ledger.lock import WriterLock
from retuner.ledger.store import BUSY_TIMEOUT_S, BUSY_TRIES
from retuner.live_view.live_screen import LiveScreen

LATER_STEPS = ", { at_s = 10.0, sp = 3.0 }, { at_s = 45.0, sp = 2.0 }"

BODY = {"region": "low", "gains": {"kp": 0.1, "ki": 1e-300}, "list": [1, None, True, "ü\n"]}


def written(path: Path, rows: int = 5) -> str:
    with Ledger(path) as ledger:
        for i in range(rows):
            ledger.append("decision", {**BODY, "i": i}, clock_s=float(i))
        return ledger.head()


def tamper(path: Path, *statements: str) -> None:
    """What an intruder with the file does: take the guards away, change, put them back."""
    connection = sqlite3.connect(path)
    guards = connection.execute("SELECT name, sql FROM sqlite_master WHERE type = 'trigger'").fetchall()
    for name, _ in guards:
        connection.execute(f"DROP TRIGGER {name}")
    for statement in statements:
        connection.execute(statement)
    for _, sql in guards:
        connection.execute(sql)
    connection.commit()
    connection.close()


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "l.sqlite"


def test_rows_come_back_as_written(tmp_path: Path) -> None:
    with Ledger(tmp_path / "l.sqlite") as ledger:
        row = ledger.append("decision", BODY, clock_s=1.5)
        assert row.body == BODY
        assert list(ledger.rows()) == [row]
        assert ledger.head() == row.hash


def test_same_rows_same_head_wherever_and_whenever(tmp_path: Path) -> None:
    assert written(tmp_path / "a.sqlite") == written(tmp_path / "b.sqlite")
    assert written(tmp_path / "c.sqlite", 4) != written(tmp_path / "d.sqlite", 5)


def test_key_order_does_not_matter_but_every_field_does(tmp_path: Path) -> None:
    heads = []
    for i, (kind, body, clock_s) in enumerate(
        [
            ("k", {"a": 1, "b": 2}, 0.0),
            ("k", {"b": 2, "a": 1}, 0.0),
            ("k", {"a": 1, "b": 3}, 0.0),
            ("j", {"a": 1, "b": 2}, 0.0),
            ("k", {"a": 1, "b": 2}, 1.0),
        ]
    ):
        with Ledger(tmp_path / f"{i}.sqlite") as ledger:
            heads.append(ledger.append(kind, body, clock_s).hash)
    assert heads[0] == heads[1]
    assert len(set(heads)) == 4


def test_reopen_goes_on_where_it_ended(path: Path, tmp_path: Path) -> None:
    written(path, 3)
    with Ledger(path) as ledger:
        assert ledger.append("more", {}, 9.0).seq == 4
        assert ledger.verify().rows == 4
    assert list(tmp_path.glob("*-wal")) == []


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
def test_numbers_that_are_none_are_refused_with_their_place(tmp_path: Path, bad: float) -> None:
    with Ledger(tmp_path / "l.sqlite") as ledger:
        with pytest.raises(ValueError, match=r"body\.gains\[1\]\.kp = .* is not a finite number"):
            ledger.append("k", {"gains": [1, {"kp": bad}]}, 0.0)
        with pytest.raises(ValueError, match="finite"):
            ledger.append("k", {}, bad)
        assert ledger.append("k", {}, 0.0).seq == 1


@pytest.mark.parametrize("bad", [{1: 2}, {"a": b"x"}, {"a": {1, 2}}, {"a": object()}, {"a": "\ud800"}, {"\ud800": 1}])
def test_what_is_no_json_is_refused(bad: dict[object, object]) -> None:
    with pytest.raises(ValueError, match="body"):
        canonical_json(bad)


@given(
    st.recursive(
        st.none() | st.booleans() | st.integers() | st.floats(allow_nan=False, allow_infinity=False) | st.text(),
        lambda inner: st.lists(inner) | st.dictionaries(st.text(), inner),
    )
)
def test_canonical_json_is_a_fixed_point(value: object) -> None:
    text = canonical_json(value)
    assert json.loads(text) == value
    assert canonical_json(json.loads(text)) == text


@pytest.mark.parametrize(
    "statement",
    [
        "UPDATE ledger SET body = '{}' WHERE seq = 2",
        "DELETE FROM ledger WHERE seq = 5",
        "DELETE FROM head",
        "UPDATE head SET seq = 4",
        "INSERT INTO ledger VALUES (9, 0, 'k', '{}', 'x', 'y')",
        "INSERT INTO ledger SELECT 6, clock_s, kind, body, previous, 'z' FROM ledger WHERE seq = 2",
        "INSERT OR REPLACE INTO ledger SELECT seq, 7, kind, body, previous, hash FROM ledger WHERE seq = 5",
    ],
)
def test_the_file_itself_refuses_changes(path: Path, statement: str) -> None:
    head = written(path)
    connection = sqlite3.connect(path)
    with pytest.raises(sqlite3.IntegrityError):
        connection.execute(statement)
    connection.close()
    with LedgerReader(path) as ledger:
        assert ledger.verify().head == head


@pytest.mark.parametrize(
    ("statement", "broken", "reason"),
    [
        ("UPDATE ledger SET body = replace(body, 'low', 'mid') WHERE seq = 3", 3, "changed"),
        ("UPDATE ledger SET clock_s = 7 WHERE seq = 1", 1, "changed"),
        ("UPDATE ledger SET kind = 'x' WHERE seq = 5", 5, "changed"),
        ("UPDATE ledger SET hash = 'x' WHERE seq = 2", 2, "changed"),
        ("UPDATE ledger SET previous = 'x' WHERE seq = 2", 2, "does not follow"),
        ("DELETE FROM ledger WHERE seq = 2", 2, "missing"),
        ("DELETE FROM ledger WHERE seq = 1", 1, "missing"),
        ("DELETE FROM ledger WHERE seq > 3", 4, "cut off"),
        ("DELETE FROM ledger", 1, "cut off"),
    ],
)
def test_verify_names_the_first_row_that_was_tampered_with(path, statement, broken, reason):
    written(path)
    tamper(path, statement)
    with LedgerReader(path) as ledger:
        report = ledger.verify()
    assert (report.ok, report.broken_seq) == (False, broken)
    assert reason in report.reason
    with pytest.raises(LedgerError, match="evidence"):
        Ledger(path)


def test_rows_cut_off_together_with_the_head_show_against_a_hash_noted_elsewhere(path):
    head = written(path, 5)
    with LedgerReader(path) as ledger:
        middle = list(ledger.rows())[2].hash
    assert main(["ledger", "verify", str(path), "--head", head[:12]]) == 0
    assert main(["ledger", "verify", str(path), "--head", middle]) == 0
    tamper(
        path,
        "DELETE FROM ledger WHERE seq > 3",
        "UPDATE head SET seq = 3, hash = (SELECT hash FROM ledger WHERE seq = 3)",
    )
    assert main(["ledger", "verify", str(path)]) == 0, "the file alone cannot show it"
    document = answer("ledger", "verify", path, "--head", head, status=1)
    assert (document["ok"], document["rows"], document["broken_seq"]) == (False, 3, 4)
    assert f"no row has the hash {head[:12]}" in document["reason"]


def test_a_broken_chain_is_status_1_and_no_ledger_status_2(path, tmp_path, capsys):
    written(path)
    tamper(path, "UPDATE ledger SET clock_s = 7 WHERE seq = 2")
    assert "row 2 was changed after it was written; 1 rows before it hold" in printed(
        "ledger", "verify", path, status=1
    )
    assert main(["ledger", "verify", str(tmp_path / "none")]) == 2
    assert main(["ledger", "verify", str(path), "--head", "xyz"]) == 2
    assert capsys.readouterr().err.count("\n") == 2


def test_a_value_of_another_kind_breaks_the_chain(path: Path) -> None:
    written(path)
    tamper(path, "UPDATE ledger SET clock_s = 'soon' WHERE seq = 2")
    with LedgerReader(path) as ledger:
        assert ledger.verify().broken_seq == 2


def test_reading_while_writing(path: Path) -> None:
    with Ledger(path) as ledger, LedgerReader(path) as reader:
        ledger.append("k", {}, 0.0)
        assert reader.verify().rows == 1
        ledger.append("k", {}, 1.0)
        assert reader.verify().rows == 2


def test_a_second_writer_is_refused_and_the_first_goes_on(path: Path) -> None:
    with Ledger(path) as ledger:
        with pytest.raises(LedgerError, match="another run writes this ledger"):
            Ledger(path)
        assert ledger.append("k", {}, 0.0).seq == 1
    with Ledger(path) as ledger:
        assert ledger.append("k", {}, 0.0).seq == 2


WRITER = """
import os, sys
from retuner.ledger import Ledger
ledger = Ledger(sys.argv[1])
for i in range(int(sys.argv[2])):
    row = ledger.append("k", {"i": i}, float(i))
    os.write(1, b"%d\\n" % row.seq)
ledger._connection.execute("BEGIN IMMEDIATE")
ledger._connection.execute("INSERT INTO ledger VALUES (?, 0, 'half', '{}', ?, 'x')", (row.seq + 1, row.hash))
os._exit(9)
"""


@pytest.mark.parametrize("rows", [1, 20])
def test_a_killed_writer_loses_no_acknowledged_row_and_leaves_no_half_one(path: Path, rows: int) -> None:
    killed = subprocess.run([sys.executable, "-P", "-c", WRITER, path, str(rows)], capture_output=True, check=False)
    assert killed.returncode == 9, killed.stderr
    acknowledged = int(killed.stdout.split()[-1])
    with Ledger(path) as ledger:
        assert ledger.verify().rows == acknowledged == rows
        assert ledger.append("k", {}, 0.0).seq == rows + 1


def test_a_second_process_is_refused_while_the_first_lives(path: Path) -> None:
    with Ledger(path):
        second = subprocess.run(
            [sys.executable, "-P", "-c", WRITER, path, "1"], capture_output=True, text=True, check=False
        )
    assert "another run writes this ledger" in second.stderr


READ_TWICE = """
import os, sqlite3, sys
from retuner.ledger import Ledger, LedgerReader
ledger = Ledger(sys.argv[1])
ledger.append("k", {}, 0.0)
LedgerReader(sys.argv[1]).verify()  # the page that shows the run reads in the same process
os.write(1, b".")
sys.stdin.readline()  # meanwhile another process has read, and closed as if it were the last
ledger.append("k", {}, 1.0)
os._exit(9)
"""


def test_readers_here_and_elsewhere_do_not_take_the_writers_rows_away(path: Path) -> None:
    """A handle opened and closed beside SQLite drops the writer's locks; then a reader elsewhere deletes its WAL."""
    command = [sys.executable, "-P", "-c", READ_TWICE, str(path)]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE) as writer:
        assert writer.stdout.read(1) == b"."
        connection = sqlite3.connect(path)
        connection.execute("SELECT count(*) FROM ledger").fetchone()
        connection.close()
        writer.communicate(b"\n")
    assert writer.returncode == 9
    with LedgerReader(path) as ledger:
        assert ledger.verify().rows == 2


def test_a_closed_ledger_leaves_its_file_and_nothing_else(tmp_path: Path) -> None:
    written(tmp_path / "l.sqlite")
    assert [path.name for path in tmp_path.iterdir()] == ["l.sqlite"]


def test_a_lock_file_that_a_killed_run_left_does_no_harm(tmp_path: Path) -> None:
    (tmp_path / "l.sqlite.lock").write_bytes(b"")
    written(tmp_path / "l.sqlite")
    assert [path.name for path in tmp_path.iterdir()] == ["l.sqlite"]


@pytest.mark.parametrize("size", [1, 2, 511])
def test_a_file_too_short_for_any_database_stays_as_it_is(path: Path, size: int) -> None:
    """SQLite would take it for an empty one and write over it: somebody's notes would be gone."""
    path.write_bytes(b"n" * size)
    with pytest.raises(LedgerError, match="is not a database"):
        Ledger(path)
    assert path.read_bytes() == b"n" * size


def test_a_broken_ledger_is_let_go_of(path: Path) -> None:
    """Its lock stays with nobody: whoever looks into it next is told that it is broken, not that it is in use."""
    written(path)
    tamper(path, "UPDATE ledger SET clock_s = 7 WHERE seq = 2")
    kept = []
    for _ in range(2):
        with pytest.raises(LedgerError, match="row 2 was changed") as found:
            Ledger(path)
        kept.append(found)  # whatever the failed object holds is still held here
    assert not path.with_name("l.sqlite.lock").exists()


def test_a_row_is_waited_for_as_long_as_the_page_says() -> None:
    """docs/developers/safety.md: up to two minutes."""
    assert BUSY_TRIES * BUSY_TIMEOUT_S == 120.0


@pytest.mark.skipif(not Path("/proc/self/fd").is_dir(), reason="counts the handles that Linux shows")
def test_locks_that_were_missed_leave_no_handle_open(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A process that writes for weeks must not run out of them."""
    import fcntl

    lock, flock = tmp_path / "l.sqlite.lock", fcntl.flock
    missed = [0]

    def late(handle: int, how: int) -> None:
        flock(handle, how)
        if missed[0] < 5:
            missed[0] += 1
            lock.unlink()

    monkeypatch.setattr(fcntl, "flock", late)
    before = len(list(Path("/proc/self/fd").iterdir()))
    held = WriterLock(tmp_path / "l.sqlite")
    assert (missed[0], len(list(Path("/proc/self/fd").iterdir()))) == (5, before + 1)
    with pytest.raises(LedgerError, match="another run"):
        WriterLock(tmp_path / "l.sqlite")
    assert len(list(Path("/proc/self/fd").iterdir())) == before + 1
    held.close()
    held.close()
    assert (len(list(Path("/proc/self/fd").iterdir())), lock.exists()) == (before, False)


@pytest.mark.skipif(sys.platform == "win32", reason="flock is POSIX's")
def test_a_lock_whose_file_lost_its_name_is_taken_anew(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Another writer ended between our opening of the lock file and our locking it: what we hold nobody else sees."""
    import fcntl

    path = tmp_path / "l.sqlite"
    lock, flock, calls = tmp_path / "l.sqlite.lock", fcntl.flock, []

    def late(handle: int, how: int) -> None:
        flock(handle, how)
        calls.append(handle)
        if len(calls) == 1:
            lock.unlink()

    monkeypatch.setattr(fcntl, "flock", late)
    with Ledger(path):
        assert len(calls) == 2
        assert lock.exists()
        with pytest.raises(LedgerError, match="another run"):
            Ledger(path)


def test_after_a_failed_write_nothing_more_is_promised(path: Path) -> None:
    with Ledger(path) as ledger:
        ledger.append("k", {}, 0.0)
        ledger._connection.execute("PRAGMA max_page_count = 1")  # a full disk, as SQLite sees it
        with pytest.raises(LedgerError, match="row 2 cannot be written: database or disk is full"):
            ledger.append("k", {"long": "x" * 200_000}, 1.0)
        with pytest.raises(LedgerError, match="open it anew"):
            ledger.append("k", {}, 1.0)
    with Ledger(path) as ledger:
        assert ledger.append("k", {}, 1.0).seq == 2


def sqlite_file(path: Path, *statements: str) -> None:
    connection = sqlite3.connect(path)
    for statement in statements:
        connection.execute(statement)
    connection.commit()
    connection.close()


def test_foreign_and_other_versions_are_refused_in_one_line(tmp_path: Path) -> None:
    sqlite_file(tmp_path / "foreign.sqlite", "CREATE TABLE t (x)")
    written(tmp_path / "newer.sqlite")
    sqlite_file(tmp_path / "newer.sqlite", "PRAGMA user_version = 2")
    (tmp_path / "text.sqlite").write_text("not a database at all, but long enough to be looked at " * 20)
    for name, reason in [("foreign", "another program"), ("newer", "version 2"), ("text", "not a database")]:
        before = (tmp_path / f"{name}.sqlite").read_bytes()
        for kind in (Ledger, LedgerReader):
            with pytest.raises(LedgerError, match=reason) as caught:
                kind(tmp_path / f"{name}.sqlite")
            assert len(str(caught.value).splitlines()) == 1
        assert (tmp_path / f"{name}.sqlite").read_bytes() == before


def test_a_ledger_whose_run_was_killed_before_its_first_row_is_no_other_programs(tmp_path: Path) -> None:
    sqlite_file(tmp_path / "l.sqlite", "PRAGMA journal_mode = WAL")
    assert (tmp_path / "l.sqlite").stat().st_size > 0
    with pytest.raises(LedgerError, match="holds nothing: the run that made it was ended before its first row"):
        LedgerReader(tmp_path / "l.sqlite")
    assert written(tmp_path / "l.sqlite")


def test_missing_places_are_named(tmp_path: Path) -> None:
    with pytest.raises(LedgerError, match="does not exist"):
        Ledger(tmp_path / "none" / "l.sqlite")
    with pytest.raises(LedgerError, match="no such ledger"):
        LedgerReader(tmp_path / "l.sqlite")
    (tmp_path / "folder").mkdir()
    with pytest.raises(LedgerError, match="folder"):
        Ledger(tmp_path / "folder")


def test_every_flipped_byte_is_noticed_or_harmless(path: Path) -> None:
    head = written(path, 3)
    good = path.read_bytes()
    with LedgerReader(path) as reader:
        rows = list(reader.rows())
    for at in range(0, len(good), 37):
        path.write_bytes(good[:at] + bytes([good[at] ^ 0x55]) + good[at + 1 :])
        with suppress(LedgerError), LedgerReader(path) as reader:
            believed = reader.verify().ok
            assert not believed or (list(reader.rows()), reader.head()) == (rows, head)


def test_truncated_files_are_refused(path: Path) -> None:
    written(path, 40)
    good = path.read_bytes()
    for kept in range(1, len(good), 1024):
        path.write_bytes(good[:kept])
        with pytest.raises(LedgerError):
            Ledger(path)


def test_a_ledger_that_has_grown_is_told_once_and_stays_whole(tmp_path: Path) -> None:
    told: list[str] = []
    with Ledger(tmp_path / "ledger.sqlite") as ledger:
        look = size_watch(ledger, 0.2, told.append)
        look()
        assert told == []
        for number in range(40):
            ledger.append("decision", {"number": number, "reason": "x" * 8000}, float(number))
            look()
        assert ledger.size_bytes() > 300_000
        assert ledger.verify().rows == 40
    assert len(told) == 1
    assert re.search(r"ledger\.sqlite: has grown past 0\.2 MB \(\[output\] ledger_mb_warn\) and is never cut", told[0])


def test_a_run_tells_that_its_ledger_has_grown(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Ledger, "size_bytes", lambda _: 2_000_000)
    (tmp_path / "short.toml").write_text(
        SHORT.replace("duration_s = 80.0", "duration_s = 5.0").replace(LATER_STEPS, "")
    )
    told: list[str] = []
    monkeypatch.setattr(LiveScreen, "say", lambda _, line: told.append(line))
    with (tmp_path / "short.toml").open("a") as file:
        file.write("[output]\nledger_mb_warn = 1.5\n")
    assert main(["run", str(tmp_path / "short.toml"), "--out", str(tmp_path / "run"), "--no-compare"]) == 0
    assert len([line for line in told if "has grown past 1.5 MB" in line]) == 1


def test_a_file_that_somebody_else_has_locked_is_waited_for(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("retuner.ledger.store.BUSY_TIMEOUT_S", 0.001)
    with Ledger(tmp_path / "l.sqlite") as ledger:
        other = sqlite3.connect(tmp_path / "l.sqlite", isolation_level=None)
        other.execute("BEGIN IMMEDIATE")
        waited, real = [], ledger._connection

        class Impatient:
            """The connection; the other process lets go after three refusals."""

            def execute(self, *arguments: object) -> object:
                waited.append(arguments)
                if len(waited) > 3 and other.in_transaction:
                    other.execute("ROLLBACK")
                return real.execute(*arguments)

        ledger._connection = Impatient()
        ledger.append("decision", {"a": 1}, 1.0)
        ledger._connection = real
        other.execute("BEGIN IMMEDIATE")
        with pytest.raises(LedgerError, match="locked"):
            ledger.append("decision", {"a": 2}, 2.0)
        other.close()
    assert len(waited) == 4
    with LedgerReader(tmp_path / "l.sqlite") as reader:
        assert reader.verify().rows == 1


def test_a_reader_that_stays_keeps_no_row_out_of_the_file(tmp_path: Path) -> None:
    ledger = Ledger(tmp_path / "ledger.sqlite")
    with LedgerReader(tmp_path / "ledger.sqlite") as reader:
        for i in range(5):
            ledger.append("decision", {"number": i}, float(i))
        assert [row.seq for row in reader.rows_after(0, 3)] == [1, 2, 3]
        assert [row.seq for row in reader.rows_after(3, 99)] == [4, 5]
        ledger.close()
        (tmp_path / "copy.sqlite").write_bytes((tmp_path / "ledger.sqlite").read_bytes())
        with LedgerReader(tmp_path / "copy.sqlite") as copy:
            assert copy.verify() == reader.verify()
            assert copy.verify().rows == 5
