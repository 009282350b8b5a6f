"""Screens that go away, are closed or lack characters: what they show of goes on."""

import errno
import io
import os
import re
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from retuner.files import write_whole
from retuner.live_view.live_screen import LiveScreen
from retuner.report.console import RunScreen, counted, scores_table, screen_console
from retuner.report.event_words import event_line
from retuner.report.scores import RegionScore
from retuner.schedule.gains import PidGains
from retuner.stopping import STOPS, stoppable, unstoppable
from retuner.streams import LastingStream, open_streams


class BrokenPipe(io.StringIO):
    """A stream whose reader has gone after the first write."""

    def write(self, text: str) -> int:
        if self.getvalue():
            raise BrokenPipeError(errno.EPIPE, "Broken pipe")
        return super().write(text)

    def flush(self) -> None:
        if self.getvalue():
            raise BrokenPipeError(errno.EPIPE, "Broken pipe")


def test_a_screen_that_goes_away_is_told_once_and_ends_nothing(capsys: pytest.CaptureFixture[str]) -> None:
    broken = BrokenPipe()
    screen = LastingStream(broken)

    written = [screen.write(text) for text in ("shown", "lost", "lost")]
    screen.flush()

    assert written == [5, 4, 4]
    assert broken.getvalue() == "shown"
    assert capsys.readouterr().err == "retuner: nothing more can be shown: Broken pipe; the work goes on\n"


def test_what_else_a_stream_can_do_is_still_there() -> None:
    assert not LastingStream(io.StringIO()).isatty()  # type: ignore[operator]


@pytest.fixture
def streams() -> Iterator[None]:
    """Put the process's own streams back."""
    before = sys.stdin, sys.stdout, sys.stderr
    yield
    sys.stdin, sys.stdout, sys.stderr = before


@pytest.mark.usefixtures("streams")
def test_closed_streams_take_what_is_written(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("stdin", "stdout", "stderr"):
        monkeypatch.setattr(sys, name, None)

    open_streams()

    with sys.stdin, sys.stdout, sys.stderr:
        assert sys.stdout.write("x") == 1
        assert sys.stderr.write("x") == 1
        assert sys.stdin.read() == ""


def test_characters_that_the_screen_lacks_are_escaped(tmp_path: Path) -> None:
    environment = {**os.environ, "PYTHONIOENCODING": "ascii"}
    missing = tmp_path / "\N{DEGREE SIGN}.toml"
    shown = subprocess.run(
        [
            sys.executable,
            "-c",
            "import sys; from retuner.streams import open_streams; open_streams(); print(sys.argv[1])",
            missing.name,
        ],
        env=environment,
        capture_output=True,
        text=True,
        check=True,
    )
    assert shown.stdout == "\\xb0.toml\n"


def test_a_run_goes_on_when_its_screen_goes_away(monkeypatch: pytest.MonkeyPatch) -> None:
    broken = BrokenPipe()
    monkeypatch.setattr(sys, "stdout", broken)

    with RunScreen(screen_console(stderr=False), "bar") as screen:
        screen.begin("loop")
        for text in ("shown", "lost"):
            screen.say(text)

    assert broken.getvalue() == "shown\n"


def test_a_narrow_screen_cuts_no_number(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.setenv("COLUMNS", "40")
    gains = PidGains(kp=0.425, ki=0.0017, kd=0.0)
    score = RegionScore("a region with a long name", gains, gains, 12, 1.12, 1.25, 4230.0, 1140274.0)

    LiveScreen(screen_console(stderr=False)).table(scores_table([score], "bar"), list)

    shown = capsys.readouterr().out
    assert "a region with a long name 0.425, 250" in shown
    assert re.search(r"1\.12 +1\.25 +1,140,274 +4,230", shown)


def test_events_are_sentences_without_empty_values() -> None:
    body = {"accepted": True, "order": "approve", "by": "root", "reason": "", "at": "2026"}
    assert event_line("order", body) == "operator request accepted: approve by root"
    assert event_line("order", {"file": "x", "reason": "is no JSON document"}).endswith("file: is no JSON document")
    assert event_line("restored", {"regions": ["low", "high"]}) == "gains read back and active: low, high"
    assert event_line("foreign", {"gains": {"kp": 2.0, "ki": 0.1, "kd": 0.0}}).endswith(": Kc 2 tau_I 20 s")
    assert event_line("link", {"state": "up", "reason": "controller found"}) == "CAN link up: controller found"
    assert event_line("decision", body) == ""
    assert event_line("trial", {"reason": ""}) == ""


def test_things_are_counted() -> None:
    assert [counted(number, "change") for number in (1, 2)] == ["1 change", "2 changes"]


# ---- Being stopped: what must be whole is whole, and what must end ends


@pytest.mark.parametrize("number", [signal.SIGINT, *STOPS])
def test_what_is_left_behind_is_written_before_a_signal_takes_effect(number: signal.Signals) -> None:
    handlers = signal.getsignal(signal.SIGINT), signal.getsignal(signal.SIGTERM)
    done = []

    def leave() -> None:
        with stoppable(), unstoppable():
            os.kill(os.getpid(), number)
            done.append("written")

    with pytest.raises(KeyboardInterrupt):
        leave()
    assert done == ["written"]
    assert handlers == (signal.getsignal(signal.SIGINT), signal.getsignal(signal.SIGTERM))


def test_a_wait_within_a_wait_ends_with_the_outer_one_and_one_signal_is_raised_once() -> None:
    done = []

    def twice() -> None:
        with stoppable():
            with unstoppable():
                with unstoppable():
                    os.kill(os.getpid(), signal.SIGTERM)
                done.append("outer")
            done.append("never")

    with pytest.raises(KeyboardInterrupt):
        twice()
    with stoppable(), unstoppable():
        done.append("next session")
    assert done == ["outer", "next session"]


def test_between_two_waits_a_signal_stops_at_once() -> None:
    def told() -> None:
        with stoppable():
            with unstoppable():
                pass
            os.kill(os.getpid(), signal.SIGTERM)
            pytest.fail("went on")

    with pytest.raises(KeyboardInterrupt):
        told()


def test_without_a_signal_nothing_is_raised() -> None:
    with unstoppable():
        pass


def test_a_file_whose_writing_is_interrupted_leaves_no_trace(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def interrupted(handle: int) -> None:
        del handle
        raise KeyboardInterrupt

    (tmp_path / "trend.csv").write_text("old")
    monkeypatch.setattr(os, "fsync", interrupted)
    with pytest.raises(KeyboardInterrupt):
        write_whole(tmp_path / "trend.csv", "new")
    assert [path.name for path in tmp_path.iterdir()] == ["trend.csv"]
    assert (tmp_path / "trend.csv").read_text() == "old"
