"""What the page is told: overview, loop, trend, decision, ledger; names are data; a broken ledger is said to be."""

import asyncio
import json
import sqlite3
from pathlib import Path

import pytest
from command_line import refused
from served import AFTER, Served, Session

from retuner.report.ledger_words import LedgerLine
from retuner.serve import hub as hubs
from retuner.serve.documents import rows_csv
from retuner.serve.runs import RecordedRuns


def test_the_overview_has_every_loop_and_what_waits_for_a_person(session: Session, served: Served) -> None:
    before = served.client.get("/api/overview").json()["sessions"][0]
    assert (before["name"], before["ended"], before["broken"]) == ("demo", False, "")
    (loop,) = before["loops"]
    assert loop["key"] == "demo/1"
    assert loop["newest"][:4] == [60.0, 50.0, 50.0, 15.0]
    assert loop["waiting"] == []
    made = session.proposes()
    served.look()
    (waiting,) = served.client.get("/api/overview").json()["sessions"][0]["loops"][0]["waiting"]
    assert (waiting["what"], waiting["region"], waiting["digest"]) == ("proposal", "low", made.digest())
    assert waiting["text"] == "Kc 0.22 tau_I 260 s -> Kc 0.88 tau_I 248 s"
    session.ends()
    served.look()
    assert served.client.get("/api/overview").json()["sessions"][0]["ended"] is True


def test_gains_out_of_reach_are_not_to_be_approved(tmp_path: Path) -> None:
    (tmp_path / "all").mkdir()
    session = Session(tmp_path / "all" / "watched", by_hand="set them by hand")
    session.samples(30)
    session.proposes()
    served = Served(session.folder.parent)
    served.look()
    (waiting,) = served.client.get("/api/overview").json()["sessions"][0]["loops"][0]["waiting"]
    assert waiting["what"] == "by hand"
    assert waiting["text"].endswith("-> Kc 0.88 tau_I 248 s; set them by hand")
    served.close()
    session.close()


def test_a_loop_is_told_with_its_decisions_and_the_page_of_each(session: Session, served: Served) -> None:
    session.proposes()
    served.look()
    told = served.client.get("/api/loop/demo/1").json()
    assert told["head"]["regions"] == ["low", "middle", "high"]
    assert told["state"]["regions"][0]["commissioned"] == "Kc 0.22 tau_I 260 s"
    (decision,) = told["decisions"]
    assert (decision["number"], decision["action"], decision["t_s"]) == (1, "advise", 60.0)
    page = served.client.get("/api/decision/demo/1/1")
    assert page.status_code == 200
    assert "oven: decision 1" in page.text
    assert "sandbox" in page.headers["content-security-policy"]
    assert "<script" not in page.text
    assert served.client.get("/api/decision/demo/1/99").status_code == 404
    assert served.client.get("/api/loop/demo/7").status_code == 404
    assert served.client.get("/api/loop/nothing/1").status_code == 404


def test_a_trend_is_thinned_and_reaches_from_the_first_to_the_newest_sample(session: Session, served: Served) -> None:
    session.samples(5, pv=77.0)
    session.samples(400)
    told = served.client.get("/api/trend/demo/1?points=50").json()
    columns = told["columns"]
    assert told["whole"] == [2.0, 870.0]
    assert (columns["t"][0], columns["t"][-1]) == (2.0, 870.0)
    assert len(columns["t"]) <= 52
    assert 77.0 in columns["pv"]
    near = served.client.get("/api/trend/demo/1?from=60&to=70").json()["columns"]
    assert near["t"] == [60.0, 62.0, 64.0, 66.0, 68.0, 70.0]
    for wrong in ("from=x", "from=nan", "to=inf", "points=1e999"):
        assert served.client.get(f"/api/trend/demo/1?{wrong}").status_code == 400


def test_the_ledger_is_filtered_and_exported(session: Session, served: Served) -> None:
    session.proposes()
    served.look()
    rows = served.client.get("/api/ledger/demo").json()["rows"]
    assert [row["kind"] for row in rows] == ["session", "decision"]
    assert [row["kind"] for row in served.client.get("/api/ledger/demo?q=LOW proposed").json()["rows"]] == ["decision"]
    assert served.client.get("/api/ledger/demo?q=nothing").json()["rows"] == []
    exported = served.client.get("/api/ledger/demo/csv?q=proposed")
    assert exported.headers["content-disposition"].startswith("attachment")
    assert exported.text.splitlines()[0].startswith("row,when_s,kind")
    assert len(exported.text.splitlines()) == 2


def test_no_cell_of_an_export_is_a_formula() -> None:
    told = LedgerLine(1, 0.0, "order", "=cmd()", "oven", "@low", "-1", "+2", "new", "evidence", "verdict")
    assert rows_csv([told]).splitlines()[1] == "1,0.0,order,'=cmd(),oven,'@low,'-1,'+2,new,evidence,verdict"
    nothing = LedgerLine(1, 0.0, "session", "", "", "", "", "", "", "", "")
    assert rows_csv([nothing]).splitlines()[1] == "1,0.0,session" + 8 * ","


def test_a_row_that_was_changed_is_not_believed(session: Session, served: Served) -> None:
    session.proposes()
    session.close()
    database = sqlite3.connect(session.folder / "ledger.sqlite")
    database.execute("DROP TRIGGER no_update")
    database.execute("UPDATE ledger SET body = replace(body, 'slower', 'faster') WHERE seq = 2")
    database.commit()
    database.close()
    served.look()
    (told,) = served.client.get("/api/overview").json()["sessions"]
    assert told["broken"] == "row 2 cannot be trusted: it was changed after it was written"
    assert told["rows"] == 1
    served.login()
    order = {"loop": "demo/1", "order": "mode", "mode": "off", "by": "Ada"}
    answer = served.client.post("/api/order", json=order, headers={"origin": "http://127.0.0.1:8017"})
    assert answer.status_code == 409


def test_a_session_that_begins_anew_in_the_same_folder_is_another_one(session: Session, served: Served) -> None:
    session.close()
    session.folder.rename(session.folder.with_name("demo-1"))
    other = Session(session.folder)
    other.samples(2)
    served.hub.runs.look()
    served.look()
    found = {one["name"]: one for one in served.client.get("/api/overview").json()["sessions"]}
    assert found["demo"]["loops"][0]["newest"][0] == 4.0
    assert found["demo-1"]["loops"][0]["newest"][0] == 60.0
    other.close()


def events(served: Served, count: int, last: str = "", wanted: list[str] | None = None) -> list[str]:
    """The first events of a stream."""

    async def first() -> list[str]:
        stream = served.hub.events(wanted, last)
        found = [(await anext(stream)).decode() for _ in range(count)]
        await stream.aclose()
        return found

    return asyncio.run(first())


def test_the_stream_tells_new_samples_once_and_catches_up_whoever_comes_back(session: Session, served: Served) -> None:
    number, boot = served.hub._number, served.hub.boot
    session.samples(3, pv=51.0)
    session.proposes()
    served.look()
    _, event = events(served, 2, f"{boot}-{number}")
    name, data = event.splitlines()[:2]
    told = json.loads(data.removeprefix("data: "))
    assert name.startswith(f"id: {boot}-")
    assert [sample[2] for sample in told["loops"]["demo/1"]["samples"]] == [51.0] * 3
    assert '"rows":{"demo": 2}' in event
    _, again = events(served, 2, f"{boot}-{number}", ["demo/1"])
    assert "51.0" in again
    _, gap = events(served, 2, "another-1")
    assert gap.startswith("event: gap")


def test_who_lags_longer_than_is_kept_is_told_of_the_gap(session, served, monkeypatch):
    monkeypatch.setattr(hubs, "KEPT", 5)
    served.hub._kept = type(served.hub._kept)(maxlen=5)
    seen = f"{served.hub.boot}-{served.hub._number}"
    for _ in range(12):
        session.samples(1)
        served.hub.tick()
    assert events(served, 2, seen)[1].startswith("event: gap")


def test_only_our_files_are_served_and_they_are_whole(served: Served) -> None:
    for path in (
        "/",
        "/app.js",
        "/app.css",
        "/drawing.js",
        "/uplot.js",
        "/uplot.css",
        "/uplot.licence.txt",
        "/icon.svg",
    ):
        answer = served.client.get(path)
        assert answer.status_code == 200
        assert len(answer.content) > 200
        assert "http://" not in answer.text.replace("http://www.w3.org/2000/svg", "").replace("https://", "")
    for path in ("/etc/passwd", "/../config.toml", "/static/app.js", "/%2e%2e/ledger.sqlite", "/demo/ledger.sqlite"):
        assert served.client.get(path).status_code == 404
    page = served.client.get("/").text
    assert "<script>" not in page
    assert "onclick" not in page
    assert "style=" not in page


def test_an_act_goes_into_an_order_file_of_the_session(session: Session, served: Served) -> None:
    made = session.proposes()
    served.look()
    served.login()
    headers = {"origin": "http://127.0.0.1:8017"}
    order = {"loop": "demo/1", "order": "approve", "digest": made.digest(), "by": "Ada", "note": "as discussed"}
    told = served.client.post("/api/order", json=order, headers=headers)
    assert told.status_code == 200
    (file,) = (session.folder / "orders").glob("*.json")
    written = json.loads(file.read_text())
    assert (written["by"], written["note"], written["digest"]) == ("Ada", "as discussed", made.digest())
    assert str(AFTER.kp) not in file.read_text()
    for wrong in ({"by": ""}, {"order": "delete"}, {"digest": "abc"}, {"decision": "1"}, {"by": 7}, {"mode": "auto"}):
        assert served.client.post("/api/order", json={**order, **wrong}, headers=headers).status_code == 400
    assert served.client.post("/api/order", json={**order, "loop": "x/1"}, headers=headers).status_code == 404
    mode = {"loop": "demo/1", "order": "mode", "mode": "advise", "by": "Ada", "region": "nowhere"}
    own = {"loop": "demo/1", "order": "propose", "region": "middle", "by": "Ada"}
    for gains in (None, [1, 2, 3], {"kp": 1}, {"kp": 1, "ki": 0.1, "kd": "0"}, {"kp": 1, "ki": -1, "kd": 0}):
        told = served.client.post("/api/order", json={**own, "gains": gains}, headers=headers)
        assert (told.status_code, "k" in told.text) == (400, True), gains
    told = served.client.post("/api/order", json=mode, headers=headers)
    assert (told.status_code, "there is no region nowhere; there are" in told.text) == (404, True)
    assert len(list((session.folder / "orders").glob("*.json"))) == 1
    session.ends()
    served.look()
    assert served.client.post("/api/order", json=order, headers=headers).status_code == 409


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        (["nowhere"], "nowhere: there is no such folder"),
        (["."], ".: holds no session"),
        (["demo", "--certificate", "none.pem"], "none.pem: there is no such file"),
        (["demo", "--host", "203.0.113.9"], "cannot listen there"),
    ],
)
def test_what_cannot_be_served_is_one_line_and_status_2(arguments, told, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    if arguments[0] == "demo":
        Session(tmp_path / "demo").close()
    shown = refused("serve", *arguments)
    assert told in shown
    assert len(shown.splitlines()) == 1


def test_a_ledger_of_another_version_is_told(tmp_path: Path) -> None:
    Session(tmp_path / "demo").close()
    database = sqlite3.connect(tmp_path / "demo" / "ledger.sqlite")
    database.execute("PRAGMA user_version = 99")
    database.commit()
    database.close()
    assert "is a ledger of version 99; this release reads version" in refused("serve", tmp_path / "demo")
    with pytest.raises(Exception, match="version 99"):
        RecordedRuns(tmp_path)
