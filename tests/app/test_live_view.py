"""The live view: no line is ever longer than the terminal is wide, and it says what is there."""

import errno
import io
import os
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest
from command_line import printed
from rich.cells import cell_len
from rich.console import Console

from retuner import Action, Decision, LoopSample, Mode, PidGains
from retuner.adaptive.signals.recogniser import RecogniserPhase, begin
from retuner.adaptive.trial.phase import TrialPhase
from retuner.config.loading import load_config, load_session
from retuner.drivers.device import RunningSet
from retuner.ledger import Ledger, LedgerReader
from retuner.live_view import live_file
from retuner.live_view.live_file import FIELDS, RING, LiveFileError, LiveReader, LiveWriter, place, thinned
from retuner.live_view.live_screen import (
    PANEL_LINES,
    PLAIN,
    LiveScreen,
    decision_lines,
    folded,
    loop_line,
    loop_lines,
    trace,
)
from retuner.live_view.loop_seen import FOLLOWING, TRIAL_WAITS, LoopObserver, LoopSeen, peaks_so_far
from retuner.live_view.watching_session import Publisher, Watching, head_of
from retuner.live_view.what_next import Changed, narrow_scores, what_next
from retuner.report.console import scores_table
from retuner.report.scores import RegionScore
from retuner.session.assembly import make_retuner
from retuner.session.loop_session import LoopSession
from retuner.session.outputs import live_file as live_path

ROOT = Path(__file__).resolve().parents[2]
WIDTHS = (80, 120, 200)
GAINS, AFTER = PidGains(4.2, 0.06, 0.0), PidGains(1.26, 0.0051, 0.0)


class Controller:
    """Says what it runs."""

    running = RunningSet(1, GAINS, 0)


def seen_oven(samples: int = 40) -> LoopSeen:
    retuner = make_retuner(load_config(ROOT / "examples" / "oven.toml"))
    observer = LoopObserver(retuner, Controller())
    for i in range(samples):
        sample = LoopSample(t_s=2.0 * i, sp=105.0, pv=90.0 + 0.1 * i, co=43.2, x=105.0)
        retuner.observe(sample)
    return observer.look(sample)


def decision(region: str = "middle", reason: str = "the swing grows " * 20) -> Decision:
    return Decision(
        1, 1830.0, "oven", region, Mode.AUTO, Action.ADVISE, "model", reason, gains_before=GAINS, gains_after=AFTER
    )


def test_what_is_seen_of_a_loop_is_where_it_is_and_what_it_waits_for() -> None:
    seen = seen_oven()
    assert seen.here.name == "middle"
    assert seen.running == GAINS
    assert seen.waits_for == "the loop to settle"
    told = seen.to_dict()
    assert told["region"] == 1
    assert [one.name for one in seen.regions] == ["low", "middle", "high"]


def test_the_peaks_found_so_far_are_those_of_the_response_under_way() -> None:
    state = begin(0.0, 1.0)._replace(started=True, t1_s=1.0, e1=3.0, t2_s=2.0, e2=-2.0, t_peak_s=3.0, e_peak=1.0)
    count = {phase: len(peaks_so_far(state._replace(phase=phase))) for phase in RecogniserPhase}
    assert list(count.values()) == [1, 1, 2, 2, 3, 3, 0, 0]
    assert peaks_so_far(state._replace(phase=RecogniserPhase.VERIFY_2)) == ((1.0, 3.0), (3.0, 1.0))
    assert peaks_so_far(state._replace(started=False, phase=RecogniserPhase.LOCATE_1)) == ()


@pytest.mark.parametrize("width", WIDTHS)
@pytest.mark.parametrize("ascii_only", [False, True])
def test_no_line_of_the_view_is_wider_than_the_terminal(width: int, ascii_only: bool) -> None:
    seen, pv = seen_oven(), [float(i % 7) for i in range(600)]
    lines = loop_lines(seen, "degC", pv, width, ascii_only=ascii_only)
    assert len(lines) == PANEL_LINES
    lines += [loop_line(seen, "degC", pv, width, ascii_only=ascii_only)]
    for detail in (False, True):
        lines += decision_lines(decision(), width, detail=detail)
    assert max(cell_len(line.plain) for line in lines) <= width
    if ascii_only:
        assert all(line.plain.isascii() for line in lines[:PANEL_LINES])


@pytest.mark.parametrize("width", WIDTHS)
def test_what_a_terminal_is_sent_does_not_wrap(width: int) -> None:
    out = io.StringIO()
    console = Console(file=out, force_terminal=True, width=width, height=30, color_system=None)
    with LiveScreen(console, now_s=lambda: 0.0) as screen:
        screen.begin("oven: auto")
        screen.sample("oven", "degC", 90.0, 0.25, seen_oven)
        screen.decision(decision())
        screen.say("a sentence of many words " * 20)
        console.print(screen.picture(width, 30))
        screen.pause()
        gains = PidGains(kp=0.425, ki=0.0017, kd=0.0)
        score = RegionScore("a region with quite a long name", gains, gains, 12, 1.12, float("inf"), 42.0, 1140274.0)
        screen.table(scores_table([score], "degC"), lambda: narrow_scores([score], "degC"))
    plain = Console(file=io.StringIO(), width=width)
    shown = [plain.render_str(line, markup=False) for line in out.getvalue().splitlines()]
    text = [line.plain.split("\x1b[2K")[-1].rstrip() for line in shown]
    assert max(cell_len(line) for line in text) <= width
    assert any("waits for the loop to settle" in line for line in text)
    assert any("unstable" in line for line in text)


def test_a_decision_takes_two_lines_and_more_only_when_asked() -> None:
    two = decision_lines(decision(), 120)
    assert len(two) == 2
    assert "middle" in two[0].plain
    assert "proposed: Kc 4.2 tau_I 70 s -> Kc 1.26 tau_I 247 s" in two[0].plain
    assert two[1].plain.endswith("…")
    whole = " ".join(line.plain for line in decision_lines(decision(), 120, detail=True))
    assert whole.count("grows") == 20


def test_many_loops_get_a_line_each_and_say_how_many_more() -> None:
    console = Console(file=io.StringIO(), force_terminal=True, width=100, height=12)
    seen = seen_oven(1)
    with LiveScreen(console, now_s=lambda: 0.0) as screen:
        for i in range(32):
            screen.sample(f"loop {i}", "bar", 1.0, 0.0, lambda: seen)
        lines = console.render_lines(screen.picture(100, 12))
    assert len(lines) <= 12
    assert "and 22 more loops" in "".join(part.text for part in lines[-1])


def test_names_from_outside_cannot_write_on_the_terminal() -> None:
    told = " ".join(line.plain for line in decision_lines(decision("evil\x1b[2Jname", "a\nb\x1b[31m"), 120))
    assert "\x1b" not in told
    assert "\n" not in told


def test_without_a_terminal_there_are_plain_lines() -> None:
    out = io.StringIO()
    with LiveScreen(Console(file=out, width=80)) as screen:
        screen.begin("oven: auto")
        screen.sample("oven", "degC", 90.0, 0.5, lambda: pytest.fail("nobody looks"))
        screen.decision(decision(reason="x " * 150))
    assert len(out.getvalue().splitlines()) == 1


def test_a_trace_shows_the_shape() -> None:
    assert trace([0.0, 1.0, 2.0, 3.0], 4, "01234567") == "0257"
    assert trace([5.0] * 9, 3, PLAIN) == "___"
    assert trace([], 5) == ""
    assert len(trace(list(range(1000)), 60)) == 60


def test_a_word_that_is_too_long_stays_whole() -> None:
    assert folded("give /a/very/long/path/to/something/that/nobody/breaks now", 20)[1].startswith("/a/very")


def test_at_the_end_a_proposal_is_named_with_the_command_that_approves_it(tmp_path):
    with Ledger(tmp_path / "ledger.sqlite") as ledger:
        made = decision()
        ledger.append("decision", {**made.to_dict(), "samples": 1}, 1830.0)
        told = what_next(
            tmp_path / "my run", ledger.rows(), 86400.0, ["high"], Changed(tmp_path / "gains.toml", Path("oven.toml"))
        )
    assert told[0].command == f"retuner approve '{tmp_path / 'my run'}' {made.digest()[:8]}"
    assert "4.2, 70 -> 1.26, 247" in told[0].why
    assert told[1].command.endswith("--unlock high")
    with LedgerReader(tmp_path / "ledger.sqlite") as reader:
        (watched,) = what_next(tmp_path, reader.rows(), 86400.0, [], None, by_hand="its description has no gains")
    assert watched.why.endswith("; its description has no gains")
    assert not watched.command
    assert told[2].command == f"retuner export {tmp_path / 'gains.toml'} --into oven.toml"
    with LedgerReader(tmp_path / "ledger.sqlite") as reader:
        assert what_next(tmp_path, reader.rows(), 86400.0, [], None, "dryer 2")[0].command.split()[3:6] == [
            "--loop",
            "'dryer",
            "2'",
        ]
    assert "--verbose" in printed("run", "--help")


def test_what_needs_a_person_is_said() -> None:
    seen = seen_oven(1)
    assert seen.needs_a_person == ""
    locked = replace(seen.regions[0], trial=str(TrialPhase.LOCKED))
    told = replace(seen, regions=(locked, *seen.regions[1:]))
    assert told.needs_a_person == "low: locked"
    assert "needs you" in loop_lines(told, "degC", [1.0], 80)[-1].plain


def test_every_phase_of_a_trial_says_what_is_waited_for() -> None:
    told = {*TRIAL_WAITS, TrialPhase.IDLE, TrialPhase.TRIAL, TrialPhase.AWAY, TrialPhase.COOLING}
    assert told == set(TrialPhase)
    assert set(FOLLOWING) == set(RecogniserPhase)


def test_what_comes_again_and_again_is_told_when_it_has_doubled(tmp_path: Path) -> None:
    out = io.StringIO()
    screen = LiveScreen(Console(file=out, width=200))
    watching = Watching(screen, load_session(ROOT / "examples" / "oven.toml")[0], tmp_path)
    for t_s in range(20):
        watching.recorded(None, "lost", float(t_s), {"count": 1})
    watching.recorded(None, "lost", 20.0, {"count": 1, "reason": "half of all samples are lost"})
    told = out.getvalue().splitlines()
    assert [line.split(", ")[-1] for line in told[:-1]] == [told[0], "2 so far", "4 so far", "8 so far", "16 so far"]
    assert told[-1].endswith("half of all samples are lost")
    late = replace(decision(reason="late"), code="passed_over")
    loop = cast("LoopSession", SimpleNamespace(name="oven", decisions=[late]))
    for _ in range(5):
        watching.recorded(loop, "decision", 30.0, {})
    assert out.getvalue().count("decisions take longer than the loop's responses") == 1


# The live file: what a session writes and another process reads, with nothing between them that could wait.


def row(t_s: float, pv: float = 1.0) -> tuple[float, ...]:
    return (t_s, 1.0, pv, 50.0, 0.0, 0.0, 1.0, 0.1, 0.0)


def test_what_is_written_is_read_while_it_grows(tmp_path: Path) -> None:
    writer = LiveWriter(tmp_path / "live", {"loop": "oven"})
    reader = LiveReader(tmp_path / "live")
    assert reader.head == {"loop": "oven"}
    assert reader.state() == {}
    for i in range(10):
        writer.sample(row(float(i)))
    fresh = reader.since(0)
    assert fresh.table[:, 0].tolist() == list(range(10))
    assert (fresh.following, fresh.missed) == (10, False)
    writer.sample(row(10.0))
    writer.state({"t_s": 10.0})
    assert reader.since(fresh.following).table[:, 0].tolist() == [10.0]
    assert reader.state() == {"t_s": 10.0}
    assert reader.since(99).missed  # another session began in its place


def test_who_sleeps_too_long_is_told_that_samples_are_missed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(live_file, "RING", 100)
    writer, samples = LiveWriter(tmp_path / "live", {}), 1000
    reader = LiveReader(tmp_path / "live")
    for i in range(samples):
        writer.sample(row(float(i), float(i % 10)))
    fresh = reader.since(5)
    assert fresh.missed
    assert fresh.table[-1, 0] == samples - 1
    assert 90 <= len(fresh.table) <= 100


def test_coarser_rings_reach_further_back_and_keep_what_stands_out(tmp_path, monkeypatch):
    monkeypatch.setattr(live_file, "RING", 100)
    writer, reader = LiveWriter(tmp_path / "live", {}), None
    for i in range(3000):
        writer.sample(row(float(i), 99.0 if i == 700 else 1.0))
    reader = LiveReader(tmp_path / "live")
    whole = reader.span(0.0, 3000.0, 60)
    assert len(whole) <= 60
    assert whole[0, 0] <= 64
    assert 99.0 in whole[:, 2]
    near = reader.span(2950.0, 3000.0, 200)
    assert near[:, 0].tolist() == list(range(2950, 3000))
    assert len(reader.span(5000.0, 6000.0, 10)) == 0


def test_the_thinned_rows_are_in_order_with_the_extremes_and_the_newest() -> None:
    table = np.zeros((1000, len(FIELDS)))
    table[:, 0] = np.arange(1000)
    table[123, 2], table[777, 2] = 5.0, -5.0
    kept = thinned(table, 50)
    assert len(kept) <= 50
    assert {123.0, 777.0, 999.0} <= set(kept[:, 0])
    assert (np.diff(kept[:, 0]) > 0).all()
    assert thinned(table[:7], 50) is not None


def test_a_torn_document_is_not_taken(tmp_path: Path) -> None:
    writer = LiveWriter(tmp_path / "live", {})
    writer.state({"a": 1})
    raw = bytearray((tmp_path / "live").read_bytes())
    raw[live_file.STATE + 10] ^= 1
    (tmp_path / "live").write_bytes(bytes(raw))
    assert LiveReader(tmp_path / "live").state() == {}
    writer.state({"too large": "x" * live_file.SLOT})
    assert writer.trouble == ""


@pytest.mark.parametrize("content", [b"", b"something else", live_file.MAGIC])
def test_another_file_is_refused_in_a_line(tmp_path: Path, content: bytes) -> None:
    (tmp_path / "live").write_bytes(content)
    with pytest.raises(LiveFileError, match="is no live file"):
        LiveReader(tmp_path / "live")
    with pytest.raises(LiveFileError, match="No such file"):
        LiveReader(tmp_path / "none")


def test_a_sample_is_found_where_it_was_put() -> None:
    assert place(0, 0) == live_file.SAMPLES
    assert place(1, 0) - place(0, RING - 1) == live_file.SAMPLE.size
    assert place(2, RING + 3) == place(2, 3)


def test_a_full_disk_ends_the_watching_and_not_the_session(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    config = load_config(ROOT / "examples" / "oven.toml")
    retuner, told = make_retuner(config), []

    class Controller:
        running = RunningSet(1, PidGains(1.0, 0.1, 0.0), 0)

    observer = LoopObserver(retuner, Controller())
    publisher = Publisher(tmp_path, head_of(config, retuner.table), observer, told.append)
    samples = [LoopSample(t_s=2.0 * i, sp=50.0, pv=49.0, co=30.0, x=50.0) for i in range(6)]
    for sample in samples[:3]:
        retuner.observe(sample)
        publisher.sample(sample)
    reader = LiveReader(live_path(tmp_path, 1))
    assert reader.head["regions"] == ["low", "middle", "high"]
    assert reader.since(0).table[:, 2].tolist() == [49.0] * 3
    assert reader.state()["regions"][0]["settings"] == "Kc 0.22 tau_I 260 s"

    def full(*_: object) -> int:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(os, "pwrite", full)
    for sample in samples[3:]:
        publisher.sample(sample)
    assert len(told) == 1
    assert "No space left on device; the session continues" in told[0]
