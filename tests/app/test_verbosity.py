"""-q, -v and -vv are the same in every command; what is answered stands on standard output whatever was chosen."""

import io
import logging
import sys
from collections.abc import Iterator

import pytest
from command_line import run
from rich.console import Console

from retuner import verbosity
from retuner.live_view.live_screen import LiveScreen
from retuner.verbosity import LOGGER, be_normal, busy, quiet

TUNE = ["tune", "--type", "fopdt", "--k", "1", "--tau1", "10", "--theta", "2"]


@pytest.fixture(autouse=True)
def as_it_was() -> Iterator[None]:
    yield
    be_normal()


class Terminal(io.StringIO):
    """A stream that says it is a screen."""

    def isatty(self) -> bool:
        return True


@pytest.mark.parametrize("command", ["run", "identify", "ledger show", "experiment step", "tune", "doctor"])
def test_every_command_has_them(command: str) -> None:
    shown = run(*command.split(), "--help").stdout

    assert "--quiet" in shown
    assert "--verbose" in shown
    assert shown.count("-v,") == 1


def test_quiet_may_stand_before_the_command_and_after_it() -> None:
    before = run("-q", *TUNE)
    after = run(*TUNE, "-q")

    assert (before.returncode, before.stdout) == (after.returncode, after.stdout)
    assert before.stdout == run(*TUNE).stdout


def test_a_command_begins_as_if_none_had_been_before_it() -> None:
    run("-q", *TUNE)
    assert quiet()
    run("-vv", *TUNE)
    assert not quiet()
    run(*TUNE)

    handlers = (*LOGGER.handlers, *logging.getLogger().handlers)
    assert not [one for one in handlers if isinstance(one, verbosity._ErrorStream)]


def test_verbose_tells_on_the_error_stream_and_answers_the_same() -> None:
    plain, told = run(*TUNE), run(*TUNE, "-v")

    assert told.stdout == plain.stdout
    assert plain.stderr == ""
    assert "retuner: tune" in told.stderr
    assert "s of CPU" in told.stderr


def test_work_that_takes_long_is_shown_on_a_terminal_and_wiped(monkeypatch: pytest.MonkeyPatch) -> None:
    screen = Terminal()
    monkeypatch.setattr(sys, "stderr", screen)
    monkeypatch.setattr(verbosity, "FIRST_S", 0.0)
    monkeypatch.setattr(verbosity, "EVERY_S", 0.001)

    with busy("reading a.csv"):
        while screen.getvalue().count("reading a.csv") < 3:
            pass

    assert "reading a.csv ... 0 s" in screen.getvalue()
    assert screen.getvalue().endswith("\r" + " " * len("reading a.csv ... 0 s") + "\r")


@pytest.mark.parametrize("stream", [Terminal(), io.StringIO()])
def test_nothing_is_shown_to_a_file_or_when_quiet(stream: io.StringIO, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "stderr", stream)
    monkeypatch.setattr(verbosity, "FIRST_S", 0.0)
    verbosity._hush(stream.isatty())

    with busy("reading a.csv"):
        pass

    assert stream.getvalue() == ""


def test_quick_work_shows_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    screen = Terminal()
    monkeypatch.setattr(sys, "stderr", screen)

    with busy("reading a.csv"):
        pass

    assert screen.getvalue() == ""


def test_a_quiet_run_says_what_it_leaves_and_nothing_of_its_course() -> None:
    screen = Terminal()
    live = LiveScreen(Console(file=screen, force_terminal=True), answers_only=True)

    with live:
        live.begin("oven")
        live.event("the CAN link is down")
        live.say("report: runs/report.html")

    assert not live.live
    assert screen.getvalue() == "report: runs/report.html\n"
