"""A run with its page beside it ends well: the page stays up where a person watches, and says what came of it."""

import base64
import hashlib
import json
import os
import pty
import re
import signal
import subprocess
import sys
import threading
import time
import urllib.request
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from recorded import SHORT
from served import Served, Session
from starlette.testclient import TestClient

from retuner.report.what_if import section

WITHIN_S = 120.0
ADDRESS = re.compile(rb"http://127\.0\.0\.1:\d+/")


def summary(folder: Path, fixed: float | None) -> None:
    """The result of a run as `run` leaves it, as far as the page looks at it."""
    decisions = [{"action": action} for action in ("commit", "none", "commit")]
    scores = [{"iae_fixed": fixed, "iae": 30.0}, {"iae_fixed": None, "iae": 5.0}]
    (folder / "summary.json").write_text(json.dumps({"decisions": decisions, "scores": scores}), encoding="utf-8")


@pytest.mark.parametrize(
    ("fixed", "text"),
    [(120.0, "ended: 2 changes, error -75 % against the same run with fixed gains"), (None, "ended: 2 changes")],
)
def test_a_session_that_ended_says_what_came_of_it(tmp_path: Path, fixed: float | None, text: str) -> None:
    session = Session(tmp_path / "demo")
    session.samples(20)
    summary(session.folder, fixed)
    (session.folder / "report.html").write_text("<p>the report</p>", encoding="utf-8")
    with asking(session) as client:
        assert client.get("/api/loop/demo/1").json()["outcome"] is None  # an earlier run's: this one goes on
    session.ends()
    with asking(session) as client:
        told = {"text": text, "report": "/report/demo"}
        assert client.get("/api/loop/demo/1").json()["outcome"] == told
        assert client.get("/api/overview").json()["sessions"][0]["outcome"] == told
        report = client.get("/report/demo")
    assert report.text == "<p>the report</p>"
    assert "sandbox" in report.headers["content-security-policy"]
    session.close()


def test_a_result_that_is_damaged_or_missing_is_no_outcome(tmp_path: Path) -> None:
    session = Session(tmp_path / "demo")
    session.samples(20)
    session.ends()
    (session.folder / "report.html").write_text("", encoding="utf-8")
    for damaged in ("", "{", "[]", '{"decisions": [{}], "scores": []}', '{"loops": 3}'):
        (session.folder / "summary.json").write_text(damaged, encoding="utf-8")
        with asking(session) as client:
            assert client.get("/api/loop/demo/1").json()["outcome"] is None
    (session.folder / "report.html").unlink()
    with asking(session) as client:
        assert client.get("/report/demo").status_code == 404
        assert client.get("/report/none").status_code == 404
    session.close()


@contextmanager
def asking(session: Session) -> Iterator[TestClient]:
    """The page of a session, which has looked at it."""
    served = Served(session.folder)
    served.look()
    try:
        yield served.client
    finally:
        served.close()


class OnTerminal:
    """`retuner run --serve` with a terminal of its own, and all that it says."""

    def __init__(self, folder: Path) -> None:
        (folder / "short.toml").write_text(SHORT, encoding="utf-8")
        self.said, ours = b"", pty.openpty()
        command = [
            sys.executable,
            "-P",
            "-m",
            "retuner",
            "run",
            "short.toml",
            "--out",
            "run",
            "--no-compare",
            "--serve",
        ]
        self.run = subprocess.Popen(
            command, cwd=folder, stdin=ours[1], stdout=ours[1], stderr=ours[1], start_new_session=True
        )
        os.close(ours[1])
        self._ours = ours[0]
        self._reader = threading.Thread(target=self._read)
        self._reader.start()

    def _read(self) -> None:
        try:
            while part := os.read(self._ours, 4096):
                self.said += part
        except OSError:  # the other end is closed
            pass

    def says(self, text: bytes) -> None:
        until = time.monotonic() + WITHIN_S
        while text not in self.said:
            assert time.monotonic() < until, self.said
            assert self.run.poll() is None, self.said
            self._reader.join(0.1)

    def end(self) -> int:
        status = self.run.wait(WITHIN_S)
        self._reader.join()
        os.close(self._ours)
        return status


@pytest.mark.slow
def test_the_page_of_a_run_at_a_terminal_stays_until_ctrl_c(tmp_path: Path) -> None:
    run = OnTerminal(tmp_path)
    run.says(b"the page stays up; Ctrl-C ends it")
    address = ADDRESS.search(run.said)
    assert address
    with urllib.request.urlopen(f"{address[0].decode()}api/overview", timeout=30) as answer:
        outcome = json.load(answer)["sessions"][0]["outcome"]
    assert outcome["text"].startswith("ended: ")
    run.run.send_signal(signal.SIGINT)
    assert run.end() == 0


@pytest.mark.nightly
def test_without_a_terminal_a_run_ends_by_itself(tmp_path: Path) -> None:
    (tmp_path / "short.toml").write_text(SHORT, encoding="utf-8")
    command = [sys.executable, "-P", "-m", "retuner", "run", "short.toml", "--out", "run", "--no-compare", "--serve"]
    run = subprocess.run(
        command, cwd=tmp_path, stdin=subprocess.DEVNULL, capture_output=True, timeout=WITHIN_S, check=True
    )
    assert b"stays up" not in run.stdout
    assert (tmp_path / "run" / "report.html").is_file()


def test_the_served_report_runs_its_own_panel_and_no_other_script(tmp_path: Path) -> None:
    session = Session(tmp_path / "demo")
    page = section([("</script><script>alert(1)</script>", {"dt": 1.0})], {"sets": ["final", "baseline"]})
    (session.folder / "report.html").write_text(page, encoding="utf-8")
    with asking(session) as client:
        policy = client.get("/report/demo").headers["content-security-policy"]
    scripts = re.findall(r"<script>(.*?)</script>", page, re.DOTALL)
    allowed = [base64.b64encode(hashlib.sha256(one.encode()).digest()).decode() for one in scripts]
    assert len(scripts) == 1
    assert f"sandbox allow-scripts; script-src 'sha256-{allowed[0]}'" in policy
    assert '<section id="what-if" hidden>' in page  # no empty heading where the script does not run
    session.close()
