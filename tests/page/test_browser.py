"""The page in a real browser: watch, approve, take back, lose and regain the connection, two browsers at once.

Where there is no Chromium the tests are skipped and say so; RETUNER_REQUIRE_BROWSER=1 (as in CI) makes that a failure.
RETUNER_SCREENSHOTS names a folder for pictures of what was seen.
"""

from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from chromium import Seen
from selenium.webdriver.common.by import By
from stepped import Server, Stepped, serving, stepped

from retuner.report.report import ReportData, render

pytestmark = [pytest.mark.slow, pytest.mark.uncounted]


@pytest.fixture
def session(tmp_path: Path) -> Iterator[Stepped]:
    with stepped(tmp_path / "demo") as made:
        made.step(300)
        yield made


@pytest.fixture
def server(session: Stepped) -> Iterator[Server]:
    made = serving(session.folder)
    yield made
    made.end()


def test_a_person_sees_a_proposal_approves_it_and_takes_it_back(session, server, browsers):
    before = session.gains
    one, other = browsers(), browsers(420, 900, dark=True)
    one.open(server.address)
    one.sees("Nothing waits for an operator.")
    other.open(f"{server.address}#/loop/demo/1")
    other.sees("No decision yet.")
    session.until_decided(1)
    session.step(20)
    for seen in (one, other):
        seen.wait(lambda seen=seen: "needs you" in seen.text().lower(), "the proposal is not shown")
    one.picture("overview")
    other.picture("loop-420-dark")
    assert not other.wider_than_the_screen()
    one.open(f"{server.address}#token={server.token}")
    one.sees("may act")
    assert server.token not in one.driver.current_url
    one.open(f"{server.address}#/loop/demo/1")
    one.press("Approve")
    one.confirms("Ada")
    session.step(100)
    proposed = session.session.loops[0].decisions[0].gains_after
    assert session.gains.kp == pytest.approx(proposed.kp, rel=1e-6)
    one.sees("on trial")
    assert "[object" not in one.text()
    one.picture("loop-on-trial")
    number = session.session.loops[0].decisions[-1].number
    other.sees(f"✓{number}")
    one.press("Roll back")
    one.confirms("Ada")
    session.step(100)
    assert session.gains == before
    one.sees("rolled back")
    other.sees(f"↩{number + 1}")
    orders = [row.body for row in session.ledger.rows() if row.kind == "order" and row.body["due"]]
    assert [(body["order"], body["by"], body["accepted"]) for body in orders] == [
        ("approve", "Ada", True),
        ("revert", "Ada", True),
    ]
    assert one.errors() == other.errors() == []


def test_a_decision_opens_with_its_whole_reasoning_and_the_ledger_is_filtered(session, server, browsers):
    session.until_decided(1)
    seen = browsers()
    seen.open(f"{server.address}#token={server.token}")
    seen.sees("may act")
    seen.open(f"{server.address}#/loop/demo/1")
    seen.press("Show full reasoning")
    seen.wait(lambda: seen.driver.find_element(By.TAG_NAME, "iframe"), "the page of the decision does not open")
    seen.driver.switch_to.frame(seen.driver.find_element(By.TAG_NAME, "iframe"))
    seen.sees("Robustness and predicted responses")
    seen.driver.switch_to.default_content()
    seen.picture("decision")
    seen.press("Try settings")
    seen.sees("What if: ")
    seen.sees("mean error of the record")
    seen.picture("tried")
    seen.press("Propose")
    seen.confirms("Ada")
    session.step(400)
    order = [row.body for row in session.ledger.rows() if row.kind == "order"][-1]
    assert (order["order"], order["by"], order["accepted"]) == ("propose", "Ada", True)
    assert "order_proposed" in [one.code for one in session.session.loops[0].decisions]
    search = seen.driver.find_element(By.CSS_SELECTOR, "input[type=search]")
    search.send_keys("advise low")
    seen.wait(
        lambda: "link" not in seen.driver.find_element(By.CSS_SELECTOR, "table:last-of-type").text, "not filtered"
    )
    assert seen.errors() == []


def test_a_page_that_loses_its_server_comes_back_and_has_missed_nothing(session, browsers):
    first = serving(session.folder)
    seen = browsers()
    seen.open(f"{first.address}#/loop/demo/1")
    seen.sees("No decision yet.")
    first.end()
    seen.sees("connection lost")
    session.until_decided(1)
    session.step(200)
    second = serving(session.folder, first.port)
    try:
        seen.wait(lambda: "connection lost" not in seen.text() and "needs you" in seen.text().lower(), "it is not back")
        shown = seen.driver.execute_script("return document.querySelectorAll('.values b')[3].textContent")
        seconds = session.bench.clock.now_s()
        assert shown == f"0:{int(seconds // 60):02d}:{int(seconds % 60):02d}"
    finally:
        second.end()


def test_hold_everything_is_one_key_one_question_and_no_mode_is_left(session, server, browsers):
    seen = browsers()
    seen.open(f"{server.address}#token={server.token}")
    seen.sees("may act")
    seen.press("Hold everything")
    seen.confirms("Grace")
    session.step(40)
    retuner = session.session.loops[0].retuner
    assert [str(retuner.settings.mode_of(i)) for i in range(2)] == ["off", "off"]
    session.step(1200)
    assert len(session.session.loops[0].decisions) == 0
    assert seen.errors() == []


def test_a_report_fits_a_phone(session: Stepped, browsers: Callable[..., Seen], tmp_path: Path) -> None:
    session.until_decided(1)
    loop = session.session.loops[0]
    table, columns = loop.table, loop.trend.columns()
    data = ReportData("quick", "bar", table, table, [], list(loop.decisions), columns, columns, [], [20.0])
    (tmp_path / "report.html").write_text(render(data), encoding="utf-8")
    seen = browsers(420, 900)
    seen.open((tmp_path / "report.html").as_uri())
    seen.sees("retuning report")
    assert not seen.wider_than_the_screen()
    assert seen.driver.execute_script("return innerWidth") == 420
    seen.picture("report-420")
