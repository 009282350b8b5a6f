"""What the page refuses: foreign hosts and origins, wrong and old tokens, floods, malformed messages, names as code."""

import json
import socket
from pathlib import Path

import pytest
from effort import sized
from served import ORIGIN, Served, Session

from retuner.cli import main
from retuner.serve.address import ServeOptions, is_local, lines, listening, our_names
from retuner.serve.page_access import LASTS_S, LONGEST_S, Bucket

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
