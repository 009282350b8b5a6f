"""People's orders: approve, the way back, the lock; to a running session and to the next one; all of it replayed."""

import json
import shutil
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pytest
from command_line import answer, printed, refused
from recorded import SHORT, bodies, run_short, short_session

from retuner import LoopSample, Mode, load_config
from retuner.adaptive.trial.phase import TrialPhase
from retuner.cli import main
from retuner.commands.approve import only_place
from retuner.live_view import watching_session
from retuner.live_view.watching_session import Watching
from retuner.session.loop_session import LoopSession
from retuner.session.running import Run

BY = ["--by", "Ada", "--note", "as discussed"]


class Person:
    """Someone at another terminal: gives orders while a run goes on, each at a sample after a condition holds."""

    def __init__(self, folder: Path, orders: list[tuple[str, Any]]) -> None:
        self.folder, self.orders = folder, orders
        self.statuses: list[int] = []

    def watch(self, session: LoopSession, sample: LoopSample) -> None:
        """Called at every sample."""
        if not self.orders:
            return
        what, when = self.orders[0]
        if not when(session, sample):
            return
        self.orders.pop(0)
        if what == "manual":
            session.device.send_mode(auto=False, co=30.0, now_s=sample.t_s)
        elif what == "auto":
            session.device.send_mode(auto=True, co=0.0, now_s=sample.t_s)
        elif what == "accept":
            (waiting,) = only_place(self.folder, None).shown.waiting.values()
            self.statuses.append(main(["approve", str(self.folder), waiting[:8], *BY]))
        elif what == "approve":
            asked = session.decisions[-1].digest()[:8]
            self.statuses.append(main(["approve", str(self.folder), asked, *BY]))
        else:
            self.statuses.append(main(["ledger", "revert", str(self.folder), "--decision", "1", *BY]))


def advised(session: LoopSession, sample: LoopSample) -> bool:
    del sample
    return any(d.action == "advise" for d in session.decisions)


def written(session: LoopSession, sample: LoopSample) -> bool:
    return bool(session.changes) and sample.t_s > session.changes[-1][0] + 2.0


@pytest.fixture
def with_person(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Any:
    """`retuner run` of the short loop with a person who gives orders."""

    def run(orders: list[tuple[str, Any]], *arguments: str) -> tuple[Path, Person]:
        person = Person(tmp_path / "run", orders)

        class Watched(Watching):
            def sampled(self, loop: LoopSession, sample: LoopSample) -> None:
                super().sampled(loop, sample)
                person.watch(loop, sample)

        monkeypatch.setattr(watching_session, "Watching", Watched)
        run_short(tmp_path, *arguments)
        monkeypatch.undo()
        return person.folder, person

    return run


def test_an_approved_proposal_is_written_by_the_running_session_and_replayed(with_person, capsys):
    folder, person = with_person([("approve", advised)])
    assert person.statuses == [0]
    assert "the running session acts on it" in capsys.readouterr().out
    (order,) = bodies(folder, "order")
    assert (order["by"], order["note"], order["accepted"], order["due"]) == ("Ada", "as discussed", True, True)
    decisions = bodies(folder, "decision")
    approved = next(d for d in decisions if d["code"] == "approved")
    assert approved["action"] == "commit"
    assert approved["gains_after"] == order["proposal"]["after"]
    committed = bodies(folder, "committed")
    assert committed[0]["gains"]["kp"] == pytest.approx(approved["gains_after"]["kp"], rel=1e-6)
    assert not list((folder / "orders").glob("*.json"))
    assert len(list((folder / "orders" / "taken").glob("*.json"))) == 1
    assert "identical" in printed("replay", folder)


@pytest.mark.slow
def test_the_rollback_is_taken_and_replayed(with_person: Any) -> None:
    folder, person = with_person([("revert", written)], "--mode", "auto")
    assert person.statuses == [0]
    (order,) = bodies(folder, "order")
    assert order["order"] == "revert"
    assert order["accepted"] is True
    first = bodies(folder, "decision")[0]
    last = bodies(folder, "committed")
    assert any(row["gains"]["kp"] == pytest.approx(first["gains_before"]["kp"]) for row in last[1:])
    assert "identical" in printed("replay", folder)


def on_trial(session: LoopSession, sample: LoopSample) -> bool:
    return written(session, sample) and session.retuner.trials.phase(0) == TrialPhase.TRIAL


def in_manual(session: LoopSession, sample: LoopSample) -> bool:
    del sample
    return session.retuner.trials.phase(0) != TrialPhase.TRIAL and not session.writer.restoring


@pytest.mark.slow
@pytest.mark.uncounted
def test_an_approval_and_its_trial_that_manual_mode_interrupts_are_replayed(with_person, capsys):
    folder, _ = with_person([("approve", advised), ("manual", on_trial), ("auto", in_manual)])
    decisions = bodies(folder, "decision")
    codes = [d["code"] for d in decisions]
    assert codes.index("approved") < codes.index("kept_manual")
    kept = decisions[codes.index("kept_manual")]
    assert kept["action"] == "none"
    assert kept["gains_before"]["kp"] == pytest.approx(10.0)
    assert kept["numbers"]["ms_tried"] < 1.2
    assert any(row["trial"] == "idle" for row in bodies(folder, "judged"))
    capsys.readouterr()
    first = main(["replay", str(folder), "--json"]), capsys.readouterr().out
    assert first[0] == 0
    assert json.loads(first[1])["compared"] == len(decisions)
    assert (main(["replay", str(folder), "--json"]), capsys.readouterr().out) == first


def waits(session: LoopSession, sample: LoopSample) -> bool:
    del sample
    return bool(session.decisions) and session.decisions[-1].trial == TrialPhase.WAITING


@pytest.mark.slow
def test_a_change_that_was_tried_waits_for_a_person(with_person: Any) -> None:
    folder, person = with_person([("accept", waits)], "--mode", "trial")
    assert person.statuses == [0]
    (order,) = bodies(folder, "order")
    assert (order["accepted"], order["due"], order["proposal"]) == (True, True, None)
    assert bodies(folder, "judged")[0]["trial"] == TrialPhase.WAITING
    assert "approved before" in printed("approve", folder, order["digest"][:9], status=1)
    assert main(["replay", str(folder)]) == 0


@pytest.mark.slow
@pytest.mark.uncounted
def test_an_order_for_an_ended_session_is_taken_by_the_next_one_and_only_once(with_person, tmp_path):
    folder, _ = with_person([])
    listed = answer("approve", folder)["proposals"]
    assert listed
    assert "the next run with --out" in printed("approve", folder, listed[-1]["hash"][:12], *BY)
    with_person([])
    assert (tmp_path / "run-1" / "orders" / "taken").is_dir()
    (order,) = bodies(folder, "order")
    assert order["accepted"] is True
    assert order["proposal"]["digest"] == listed[-1]["hash"]
    decisions = bodies(folder, "decision")
    assert decisions[0]["code"] == "approved"
    assert decisions[0]["gains_after"] == listed[-1]["gains_after"]
    assert bodies(folder, "committed")[0]["why"] == "retune"
    assert "identical" in printed("replay", folder)


@pytest.fixture(scope="module")
def advice(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """An ended session with open proposals."""
    return short_session(tmp_path_factory)


@pytest.fixture
def copy(advice: Path, tmp_path: Path) -> Path:
    shutil.copytree(advice, tmp_path / "copy")
    return tmp_path / "copy"


@pytest.mark.slow
@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        (["1234567"], "at least 8"),
        (["zzzzzzzz"], "at least 8"),
        (["00000000"], "no proposal begins like this"),
        (["--unlock", "nowhere"], "there is no such region; there are all"),
        (["00000000", "--unlock", "all"], "names a region"),
        (["--by", "x\ny", "--unlock", "all"], "by must be"),
    ],
)
def test_what_cannot_be_approved_is_one_line(copy, arguments, told):
    assert told in refused("approve", copy, *arguments)
    assert not (copy / "orders").exists()


def test_a_hash_says_no_when_its_proposal_has_ended(copy: Path) -> None:
    config = copy / "config.toml"
    config.write_text(config.read_text().replace("[adaptation]", "[adaptation]\napproval_s = 1.0"))
    assert answer("approve", copy)["proposals"] == []
    first = bodies(copy, "decision")[0]
    first.pop("samples")
    digest = digest_of(first)
    told = answer("approve", copy, digest[:10], status=1)
    assert told["approved"] is None
    assert "expired" in told["reason"]


def digest_of(document: dict[str, Any]) -> str:
    from hashlib import sha256

    from retuner.ledger.chain import canonical

    return sha256(canonical(document)).hexdigest()


def test_a_revert_names_a_decision_that_is_there(copy: Path) -> None:
    assert "no such decision" in refused("ledger", "revert", copy, "--decision", "99")
    told = answer("ledger", "revert", copy, "--to", "1", *BY)
    assert told["gains"]["kp"] == pytest.approx(5.0)
    assert json.loads(Path(told["file"]).read_text())["decision"] == 1


@pytest.mark.slow
@pytest.mark.uncounted
def test_what_is_no_order_is_refused_with_a_row_and_nothing_else_happens(with_person, tmp_path, capsys):
    def litter(session: LoopSession, sample: LoopSample) -> bool:
        del session
        if sample.t_s > 20.0 and not (tmp_path / "run" / "orders").exists():
            orders = tmp_path / "run" / "orders"
            orders.mkdir()
            (orders / "huge.json").write_bytes(b" " * 5000)
            (orders / "foreign.txt").write_text("hello")
            (orders / "list.json").write_text("[1, 2]")
            (orders / "folder.json").mkdir()
            (orders / ".half.tmp").write_text("{")
        return False

    folder, _ = with_person([("none", litter)])
    rows = bodies(folder, "order")
    assert sorted(row["file"] for row in rows) == ["folder.json", "foreign.txt", "huge.json", "list.json"]
    assert all(row["accepted"] is False and row["reason"] for row in rows)
    assert bodies(folder, "committed") == []
    assert main(["replay", str(folder)]) == 0
    del capsys


def test_an_approval_of_a_session_that_is_off_is_refused(tmp_path: Path) -> None:
    (tmp_path / "short.toml").write_text(SHORT)
    folder = tmp_path / "run"
    folder.mkdir()
    rows: list[tuple[str, dict[str, Any]]] = []

    def record(kind: str, t_s: float, body: Mapping[str, object]) -> None:
        assert t_s >= 0
        rows.append((kind, dict(body)))

    run = Run(load_config(tmp_path / "short.toml"), record, mode=Mode.OFF, folder=folder)
    (folder / "orders").mkdir()
    order = {
        "order": "unlock",
        "by": "Ada",
        "at": "2030-01-31T12:00:00Z",
        "note": "",
        "digest": "",
        "decision": 0,
        "region": "all",
    }
    (folder / "orders" / "one.json").write_text(json.dumps(order))
    run.simulated()
    told = [body for kind, body in rows if kind == "order"]
    assert len(told) == 1
    assert told[0]["accepted"] is False
    assert "off" in told[0]["reason"]
