"""Being stopped: what must be whole is whole, and what must end ends."""

import os
import signal
from pathlib import Path

import pytest

from retuner.files import write_whole
from retuner.stopping import STOPS, stoppable, unstoppable


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
