"""The words of a ledger's rows: sentences with units, and nothing that only a program understands."""

import csv
import json
import shutil
import sqlite3
from collections.abc import Mapping
from pathlib import Path

import pytest
from command_line import answer, printed, refused
from recorded import bodies, short_session

from retuner.adaptive.trial.words_on_persons_edit import lasting_words
from retuner.cli import main
from retuner.decision_page.decision_words import one_line, response_text
from retuner.decision_page.row_values import brief
from retuner.ledger import Ledger, LedgerReader, Row
from retuner.report.ledger_words import LedgerLine, told

CONFIG = {"loop": {"name": "tank", "pv_unit": "bar"}}
WATCHED = """schema = 1
loop = { name = "tank", pv_unit = "bar", pv_min = 0.0, pv_max = 10.0, sample_time_s = 1.0 }
schedule = { variable = "sp", region = [{ name = "all", kc = 2.0, tau_i_s = 20.0 }] }
[device]
kind = "dbc"
dbc = "its.dbc"
pv = { message = "STATE", signal = "P" }
co = { message = "STATE", signal = "U" }
"""
GAINS, OTHER = {"kp": 2.0, "ki": 0.1, "kd": 0.0}, {"kp": 1.0, "ki": 0.1, "kd": 0.0}
MODEL = {"type": "fopdt", "k": 1.0, "tau1": 2340.0, "tau2": 0.0, "theta": 66.0, "zeta": 1.0}
ACCEPTED = {"accepted": True, "reason": "proved: nominal Ms 1.40", "ms": {"before": 1.13, "nominal": 1.4, "worst": 1.9}}


def decision(number: int, action: str, **more: object) -> Mapping[str, object]:
    body = {"number": number, "t_s": 5.0, "region": "all", "action": action, "code": "sluggish", "reason": "too slow"}
    return {**body, "gains_before": GAINS, "gains_after": OTHER if action != "none" else None, **more}


def tell(*rows: tuple[str, Mapping[str, object]]) -> list[LedgerLine]:
    return told(
        Row(i, float(i), kind, json.dumps(body), "", "")
        for i, (kind, body) in enumerate((("session", {"config": CONFIG}), *rows), 1)
    )[1:]


@pytest.mark.parametrize(
    ("kind", "body", "said"),
    [
        ("end", {"interrupted": False, "bus_log": "bus.blf", "bus_log_sha256": "ab"}, "the run is complete"),
        ("end", {"interrupted": True}, "the run was stopped"),
        ("abort", {"cause": "stopped", "reason": "the session ended"}, "trial interrupted: the session ended"),
        ("restored", {"regions": ["all"], "gains": GAINS, "sequence": 3, "crc": 1}, "gains read back and active: all"),
        ("link", {"state": "up", "reason": "controller found"}, "CAN link up: controller found"),
        ("foreign", {"gains": GAINS}, "gains changed by someone else: Kc 2 tau_I 20 s"),
        ("question", {"asked": 1222, "region": "all"}, "the response up to sample 1,222 is being evaluated"),
        ("answer", {"asked": 1222, "code": "accepted"}, "the evaluation of sample 1,222 is there"),
        ("memory", {"sha256": "ab"}, "saved for a restart"),
        (
            "order_of_writes",
            {"messages": [1, 0], "proved": True, "ms_between": 1.53336},
            "one set of gains in 2 messages",
        ),
    ],
)
def test_a_row_beside_decisions_is_a_sentence(kind: str, body: Mapping[str, object], said: str) -> None:
    row = tell((kind, body))[0]
    assert row.why == said
    shown = f"{row.why} {row.evidence} {row.verdict}"
    assert not any(word in shown for word in ("True", "False", "cause ", "sequence", "sha256 ", "1.53336"))


def test_a_proposal_takes_the_place_of_an_older_one_until_other_gains_are_active() -> None:
    ask = ("decision", decision(1, "advise")), ("decision", decision(2, "advise"))
    rows = tell(*ask, ("committed", {"region": "all", "gains": OTHER, "crc": 1}), ("decision", decision(3, "advise")))
    assert [row.why for row in rows if row.kind == "decision"] == [
        "decision 1, proposed: too slow",
        "decision 2, proposed: too slow; in place of decision 1",
        "decision 3, proposed: too slow",
    ]


def test_what_must_wait_is_told_with_what_the_rule_gives_and_not_as_proved() -> None:
    waits = decision(5, "none", code="held_trial", verdict=ACCEPTED, proposal={"parallel": OTHER})
    assert tell(("decision", waits))[0].verdict == "the rule gives Kc 1 tau_I 10 s"
    assert tell(("decision", decision(5, "commit", verdict=ACCEPTED)))[0].verdict.startswith("proved")


def test_a_part_of_the_way_is_told_once() -> None:
    quarter = {**ACCEPTED, "allowed": [1], "step": 0.25}
    told = tell(("decision", decision(1, "commit", verdict=quarter)))[0].verdict
    assert told.endswith("; 25% of the full change: more is not proved robust")
    at_limit = {**quarter, "step": 0.52, "checks": [{"name": "step_kc", "value": 1.99, "limit": 2.0}]}
    told = tell(("decision", decision(1, "commit", verdict=at_limit)))[0].verdict
    assert told.endswith("; 52% of the full change: one change is limited to a factor of 2")
    chosen = {**quarter, "reason": "proved: nominal Ms 1.40; 25% of the proved change, which is expected to cost less"}
    assert tell(("decision", decision(1, "commit", verdict=chosen)))[0].verdict.count("25%") == 1


def test_what_is_refused_is_told_with_what_the_rule_gives() -> None:
    refused = {"accepted": False, "reason": "refused: not robust"}
    row = tell(("decision", decision(5, "none", verdict=refused, proposal={"parallel": OTHER})))[0]
    assert row.verdict == "refused: not robust; the rule gives Kc 1 tau_I 10 s"


def test_a_rollback_says_once_why() -> None:
    why = "worse than predicted: IAE 3.2 pv s per unit load step"
    undo = decision(5, "restore", code="undo_worse", reason=f"rolled back: {why}", surprise="agrees", records=3)
    judged = {"region": "all", "finding": "worse", "reason": why, "trial": "rolling back to the verified gains"}
    back = {"region": "all", "decision": "", "gains": OTHER, "reason": f"rolled back: {why}"}
    rows = tell(("decision", undo), ("judged", judged), ("restore", back))
    assert "IAE 3.2 bar s per unit load step" in rows[0].why
    assert "agrees" not in rows[0].evidence
    assert rows[1].verdict == "why: decision 5"


def test_a_record_that_agrees_with_no_other_of_its_region_agrees_with_the_other_regions() -> None:
    seen = {"estimate": {"model": MODEL}, "response": {"upset": "setpoint"}, "surprise": "agrees"}
    assert tell(("decision", decision(1, "none", records=1, **seen)))[0].evidence.endswith("from the other regions")
    assert tell(("decision", decision(1, "none", records=2, **seen)))[0].evidence.endswith("this record agrees")


def test_gains_that_stay_are_no_change() -> None:
    stays = decision(5, "restore", code="kept_stopped", gains_after=GAINS)
    row = tell(("decision", stays))[0]
    assert (row.old, row.new) == ("", "Kc 2 tau_I 20 s")


def test_a_load_step_explains_a_load_response_and_stands_beside_a_setpoint_step() -> None:
    def evidence(upset: str) -> str:
        seen = {"estimate": {"loads": [1.0], "model": MODEL}, "response": {"upset": upset}, "records": 1}
        return tell(("decision", decision(1, "none", **seen)))[0].evidence

    assert evidence("load").endswith("tau1 2,340 s theta 66 s (1 record), explained by 1 load step")
    assert evidence("setpoint").endswith(", with 1 load step beside the setpoint's")


def test_a_prediction_has_units() -> None:
    both = {"iae": [1234.0]}
    promise = {"setpoint": both, "setpoint_before": both, "load": both, "load_before": both}
    row = tell(("trial", {"region": "all", "promise": promise}))[0]
    assert (
        row.verdict == "predicted IAE per unit step: setpoint 1,230 s (before 1,230), load 1,230 bar s (before 1,230)"
    )


def test_a_loop_that_was_unstable_was_never_at_rest() -> None:
    """The numbers of a prediction are the best model's, the least and the greatest; null is no rest on that model."""
    promise = {"load": {"iae": [204.0, 203.0, 205.0]}, "load_before": {"iae": [None, 35.1, None]}}
    row = tell(("trial", {"region": "all", "promise": promise}))[0]
    assert row.verdict == "predicted IAE per unit step: load 204 bar s (never at rest before)"


@pytest.mark.parametrize(
    ("value", "said"), [(0.0123, "0.0123"), (999.6, "1,000"), (1390.0, "1,390"), (2.5e8, "2.5e+08")]
)
def test_three_figures(value: float, said: str) -> None:
    assert brief(value) == said


@pytest.mark.parametrize(
    ("lasts_s", "said"), [(50.0, "50 s"), (7199.0, "7,199 s"), (28800.0, "8 h"), (172800.0, "2 d")]
)
def test_how_long(lasts_s: float, said: str) -> None:
    assert lasting_words(lasts_s) == said


@pytest.mark.parametrize(("overshoot", "said"), [(0.58, "overshoot 58%"), (15.13, "second peak 15.1 times the first")])
def test_a_second_peak(overshoot: float, said: str) -> None:
    seen = {"response": {"upset": "load", "overshoot": overshoot, "period_s": 1390.0}}
    assert response_text(decision(1, "none", **seen)) == f"load response, {said}, period 1,390 s"


def test_a_decision_that_no_response_led_to_names_no_cause() -> None:
    edited = decision(2, "none", code="edited", reason="an operator replaced Kc 2 by Kc 1")
    assert one_line(edited) == "an operator replaced Kc 2 by Kc 1"


def test_what_came_back_where_the_loop_is_not_has_the_gains_of_its_own_region() -> None:
    body = {"regions": ["high"], "gains": GAINS, "waits": {"high": {"kp": 0.3, "ki": 0.0005, "kd": 0.0}}}
    (line,) = tell(("restored", body))
    shown = repr(line)
    assert "high: Kc 0.3 tau_I 600 s in the table, for when the loop comes" in shown
    assert "active" not in shown
    assert "Kc 2" not in shown


def test_what_waits_for_a_person_is_told_at_the_end(tmp_path: Path) -> None:
    with Ledger(tmp_path / "ledger.sqlite") as ledger:
        ledger.append("session", {"config": CONFIG}, 0.0)
        ledger.append("decision", {**decision(1, "advise"), "loop": "tank"}, 5.0)
    shown = printed("ledger", "show", tmp_path)
    assert "open: all: decision 1 proposes 2, 20 -> 1, 10; retuner approve " in shown
    (tmp_path / "config.toml").write_text(WATCHED)
    assert "its description has no gains, so nothing is written" in (shown := printed("ledger", "show", tmp_path))
    assert "retuner approve" not in shown
    digest, _, told_of = printed("approve", tmp_path).partition(" ")
    assert "its description has no gains" in told_of
    assert "is not approved: its description has no gains" in printed("approve", tmp_path, digest, status=1)
    assert "open:" not in printed("ledger", "show", tmp_path, "--kind", "decision")


# ledger show, export and verify of a session: every row in words, whole or as far as it can be believed


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
    for arguments, said in (
        ([], "give --csv FILE or --jsonl FILE"),
        (["--csv", str(table)], "exists already"),
        (["--csv", str(tmp_path / "no" / "x.csv")], "make it first"),
    ):
        assert said in refused("ledger", "export", session, *arguments)


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
