"""What the page refuses: foreign hosts and origins, wrong and old tokens, floods, malformed messages, names as code."""

import asyncio
import json
import socket
import sqlite3
from pathlib import Path

import pytest
from command_line import refused
from effort import sized
from served import AFTER, ORIGIN, Served, Session

from retuner.cli import main
from retuner.report.ledger_words import LedgerLine
from retuner.serve import hub as hubs
from retuner.serve.address import ServeOptions, is_local, lines, listening, our_names
from retuner.serve.documents import rows_csv
from retuner.serve.page_access import LASTS_S, LONGEST_S, Bucket
from retuner.serve.runs import RecordedRuns

ORDER = {"loop": "demo/1", "order": "mode", "mode": "off", "by": "Mallory"}


def orders(session: Session) -> list[Path]:
    return list((session.folder / "orders").glob("*.json"))


@pytest.mark.parametrize("host", ["evil.example", "127.0.0.1", "127.0.0.1:80", "evil.example:8017", "", "localhost:1"])
def test_a_foreign_host_name_is_answered_nothing(served: Served, host: str) -> None:
    for path in ("/", "/api/overview", "/api/stream"):
        answer = served.client.get(path, headers={"host": host})
        assert answer.status_code == 421
        assert "demo" not in answer.text


@pytest.mark.parametrize(
    "headers",
    [
        {"origin": "http://evil.example"},
        {"origin": "null"},
        {"origin": "https://127.0.0.1:8017"},
        {"origin": "http://127.0.0.1:8018"},
        {"origin": "http://127.0.0.1:8017", "sec-fetch-site": "cross-site"},
        {"origin": "http://127.0.0.1:8017", "sec-fetch-site": "same-site"},
        {},
    ],
)
def test_a_page_of_another_site_acts_on_nothing(session: Session, served: Served, headers: dict[str, str]) -> None:
    served.login()
    assert served.client.post("/api/order", json=ORDER, headers=headers).status_code == 403
    assert served.client.post("/api/login", json={"token": served.access.token}, headers=headers).status_code == 403
    if headers:
        assert served.client.get("/api/overview", headers=headers).status_code == 403
        assert served.client.get("/api/stream", headers=headers).status_code == 403
    assert orders(session) == []


def test_without_the_token_nobody_acts(session: Session, served: Served) -> None:
    assert served.client.post("/api/order", json=ORDER, headers=ORIGIN).status_code == 401
    for wrong in ("", "x", served.access.token[:-1], served.access.token + "x", "\udc80"):
        raw = json.dumps({"token": wrong})
        served.clock.s += 60.0
        assert served.client.post("/api/login", content=raw, headers=ORIGIN).status_code == 403
    assert served.client.get("/api/who").json() == {"acting": False, "read_only": False}
    assert orders(session) == []


def test_the_token_is_not_guessed_by_trying(served: Served) -> None:
    tried = [served.client.post("/api/login", json={"token": str(i)}, headers=ORIGIN).status_code for i in range(20)]
    assert tried[:5] == [403] * 5
    assert set(tried[5:]) == {429}
    right = {"token": served.access.token}
    assert served.client.post("/api/login", json=right, headers=ORIGIN).status_code == 429


def test_a_session_ends_and_its_cookie_is_worth_nothing_again(served: Served) -> None:
    served.login()
    cookie = {"cookie": f"retuner_8017={served.client.cookies['retuner_8017']}"}
    assert served.client.get("/api/who").json()["acting"] is True
    assert served.client.post("/api/logout", json={}, headers=ORIGIN).status_code == 200
    served.client.cookies.clear()
    assert served.client.post("/api/order", json=ORDER, headers={**ORIGIN, **cookie}).status_code == 401
    served.login()
    served.clock.s += LASTS_S + 1
    assert served.client.post("/api/order", json=ORDER, headers=ORIGIN).status_code == 401
    served.login()
    for _ in range(int(LONGEST_S / 600) + 2):
        served.clock.s += 600
        last = served.client.post("/api/order", json=ORDER, headers=ORIGIN).status_code
    assert last == 401


def test_the_token_of_an_earlier_start_is_worth_nothing(session: Session, served: Served) -> None:
    other = Served(session.folder)
    assert other.access.token != served.access.token
    assert len(other.access.token) >= 32
    assert other.client.post("/api/login", json={"token": served.access.token}, headers=ORIGIN).status_code == 403
    other.close()


def test_the_cookie_is_out_of_reach_of_scripts_and_other_sites(served: Served) -> None:
    answer = served.client.post("/api/login", json={"token": served.access.token}, headers=ORIGIN)
    told = answer.headers["set-cookie"].lower()
    assert "httponly" in told
    assert "samesite=strict" in told
    assert "max-age=900" in told
    assert served.access.token.lower() not in told


def test_a_page_that_was_started_read_only_takes_no_token(session: Session) -> None:
    served = Served(session.folder, read_only=True)
    answer = served.client.post("/api/login", json={"token": served.access.token}, headers=ORIGIN)
    assert (answer.status_code, "read-only" in answer.text) == (403, True)
    served.close()


def test_every_answer_says_what_a_browser_may_do_with_it(served: Served) -> None:
    for path in ("/", "/api/overview", "/nothing"):
        headers = served.client.get(path).headers
        assert "script-src 'self'" in headers["content-security-policy"]
        assert "unsafe-inline" not in headers["content-security-policy"]
        assert "frame-ancestors 'none'" in headers["content-security-policy"]
        assert headers["x-content-type-options"] == "nosniff"
        assert headers["cache-control"] == "no-store"
        assert headers["referrer-policy"] == "no-referrer"


MALFORMED = sized(300, 300, 100_000)


@pytest.mark.uncounted
def test_a_flood_of_malformed_messages_does_no_harm(session: Session, served: Served) -> None:
    served.login()
    pieces = [
        b"", b"{", b"[]", b"null", b'{"order":', b"\xff\xfe", b"[" * 4000, b'{"loop":"demo/1","order":7}', b"x" * 5000,
        b'{"loop":"demo/1","order":"approve","digest":{"$ne":1}}', b'{"loop":["demo"]}', b'{"order":"\\u0000"}',
    ]  # fmt: skip
    found = set()
    for i in range(MALFORMED):
        served.clock.s += 1.0 if i % 2 else 0.0
        if i % 800 == 0:
            served.clock.s += 90.0
            served.login()
        path = ("/api/order", "/api/login", "/api/logout")[i % 7 % 2]
        found.add(served.client.post(path, content=pieces[i % len(pieces)], headers=ORIGIN).status_code)
    assert found <= {400, 401, 403, 404, 413, 429}
    assert {400, 413} <= found
    assert orders(session) == []
    served.clock.s += 60.0
    assert served.client.get("/api/overview").status_code == 200


@pytest.mark.slow
@pytest.mark.uncounted
def test_a_client_that_asks_too_often_is_told_to_wait(served: Served) -> None:
    found = [served.client.get("/nothing").status_code for _ in range(450)]
    assert found.count(429) >= 40
    served.clock.s += 10.0
    assert served.client.get("/api/who").status_code == 200


def test_a_bucket_forgets_old_clients_and_never_the_rate() -> None:
    now = [0.0]
    bucket = Bucket(1.0, 2.0, lambda: now[0])
    assert [bucket.take("a") for _ in range(3)] == [True, True, False]
    assert bucket.take("b")
    now[0] = 1.0
    assert [bucket.take("a") for _ in range(2)] == [True, False]
    for i in range(20_000):
        bucket.take(str(i))
    assert len(bucket._left) <= 10_000


def test_names_of_a_configuration_are_text_and_not_code(tmp_path: Path) -> None:
    evil = "<img src=x onerror=alert(1)>"
    session = Session(tmp_path / "demo", loop=evil, region="<script>1</script>")
    session.samples(3)
    session.proposes()
    served = Served(session.folder)
    served.look()
    told = served.client.get("/api/loop/demo/1")
    assert told.headers["content-type"] == "application/json"
    assert told.json()["head"]["loop"] == evil
    page = served.client.get("/api/decision/demo/1/1").text
    assert evil not in page
    assert "<script>1" not in page
    assert "&lt;img src=x" in page
    served.close()
    session.close()


def test_no_script_of_ours_reads_text_as_html() -> None:
    folder = Path(__file__).resolve().parents[2] / "src" / "retuner" / "serve" / "static"
    for name in ("app.js", "drawing.js"):
        text = (folder / name).read_text(encoding="utf-8")
        for way in ("innerHTML", "outerHTML", "insertAdjacentHTML", "document.write", "eval(", "new Function"):
            assert way not in text


def test_a_port_that_is_taken_is_one_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    Session(tmp_path / "demo").close()
    with socket.socket() as other:
        other.bind(("127.0.0.1", 0))
        other.listen()
        port = other.getsockname()[1]
        assert main(["serve", str(tmp_path / "demo"), "--port", str(port)]) == 2
    assert capsys.readouterr().err == f"Port {port} is in use; try --port {port + 1}.\n"


def test_only_this_machine_is_served_unless_told_and_then_that_is_said() -> None:
    assert ServeOptions().host == "127.0.0.1"
    assert [is_local(host) for host in ("127.0.0.1", "localhost", "::1", "0.0.0.0", "192.0.2.1")] == [True] * 3 + [
        False
    ] * 2
    told = list(lines(ServeOptions(), 8017, "TOKEN"))
    assert told == ["watch: http://127.0.0.1:8017/", "act:   http://127.0.0.1:8017/#token=TOKEN"]
    open_ = list(lines(ServeOptions("0.0.0.0", read_only=True), 8017, "TOKEN"))
    assert open_[0] == "watch: http://127.0.0.1:8017/"
    assert open_[1].startswith("WARNING: 0.0.0.0 can be reached from the network")
    secure = ServeOptions("0.0.0.0", certificate=Path("c"), key=Path("k"))
    assert [line[:14] for line in lines(secure, 1, "T")] == ["watch: https:/", "act:   https:/"]
    assert "localhost:8017" in our_names(ServeOptions(), 8017)
    assert "panel.example:8017" in our_names(ServeOptions(names=("panel.example",)), 8017)
    assert not any("evil" in name for name in our_names(ServeOptions(), 8017))
    with listening(ServeOptions(port=0)) as ours:
        assert ours.getsockname()[0] == "127.0.0.1"


# What the page is told: overview, loop, trend, decision, ledger; names are data; a broken ledger is said to be


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
