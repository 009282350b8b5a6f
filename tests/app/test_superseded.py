"""A newer proposal of a region supersedes the older ones: in the list, for who approves, and for the session."""

import shutil
from pathlib import Path
from typing import Any

import pytest
from command_line import answer, printed
from recorded import bodies, run_short, short_session

from retuner.adaptive.signals.sample import LoopSample
from retuner.cli import main
from retuner.commands.approve import only_place
from retuner.live_view import watching_session
from retuner.live_view.watching_session import Watching
from retuner.session.loop_session import LoopSession
from retuner.session.orders import Order, OrderKind, put_order

REFUSED = "a newer proposal of its region supersedes it: "


@pytest.fixture(scope="module")
def advice(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """An ended session that advised its one region twice."""
    return short_session(tmp_path_factory)


@pytest.fixture
def copy(advice: Path, tmp_path: Path) -> Path:
    shutil.copytree(advice, tmp_path / "run")
    return tmp_path / "run"


def order_of(digest: str) -> Order:
    return Order(OrderKind.APPROVE, "Ada", "2030-01-31T12:00:00Z", digest=digest)


def listed(session: Path, *more: str) -> dict[str, Any]:
    found: dict[str, Any] = answer("approve", session, *more)
    return found


def test_the_list_shows_the_newest_and_on_request_all(copy: Path) -> None:
    (newest,) = (told := listed(copy))["proposals"]
    assert (newest["decision"], newest["superseded_by"], told["superseded"]) == (2, None, 1)
    older, again = listed(copy, "--all")["proposals"]
    assert again == newest
    assert older["superseded_by"] == newest["hash"]
    text = printed("approve", copy)
    assert "supersedes 1 older" in text
    assert "1 open proposal at" in text
    assert "(and 1 superseded; --all lists them)" in text
    assert f"superseded by {newest['hash'][:8]}" in printed("approve", copy, "--all")
    assert main(["approve", str(copy), newest["hash"], "--all"]) == 2


def test_a_superseded_proposal_is_refused_with_its_successor(copy: Path) -> None:
    older, newest = listed(copy, "--all")["proposals"]
    text = printed("approve", copy, older["hash"][:8], status=1)
    assert text == f"{older['hash'][:8]} is not approved: {REFUSED}{newest['hash'][:8]}\n"
    assert not (copy / "orders").exists()
    assert main(["approve", str(copy), newest["hash"][:8], "--by", "Ada"]) == 0


@pytest.mark.slow
def test_the_next_session_refuses_it_as_well(copy: Path, tmp_path: Path) -> None:
    shown = only_place(copy, None).shown
    older, newest = shown.proposals
    put_order(copy, order_of(older))
    run_short(tmp_path)
    (order,) = bodies(tmp_path / "run", "order")
    assert (order["accepted"], order["reason"]) == (False, REFUSED + newest[:8])
    assert bodies(tmp_path / "run", "committed") == []


@pytest.mark.slow
@pytest.mark.uncounted
def test_the_running_session_refuses_it_as_well(tmp_path, monkeypatch):
    class Late(Watching):
        """Somebody had looked before the second proposal, and orders after it."""

        def sampled(self, loop: LoopSession, sample: LoopSample) -> None:
            super().sampled(loop, sample)
            if len(loop.decisions) == 2 and not (tmp_path / "run" / "orders").exists():
                put_order(tmp_path / "run", order_of(loop.decisions[0].digest()))

    monkeypatch.setattr(watching_session, "Watching", Late)
    folder = run_short(tmp_path)
    (order,) = bodies(folder, "order")
    assert order["accepted"] is False
    assert order["reason"] == REFUSED + list(only_place(folder, None).shown.proposals)[1][:8]
    assert "identical" in printed("replay", folder)
