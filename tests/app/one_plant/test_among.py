"""A loop that is not alone on its plant: what the others do is no verdict, and what they do not survive is not made."""

from dataclasses import dataclass, replace
from types import SimpleNamespace
from typing import Any, cast

import pytest
from wood_berry import BLT, DT_S, records

from retuner import LoopSample, PidController, PidGains
from retuner.adaptive.decision_numbers import Basis
from retuner.adaptive.guard.guard_settings import GuardSettings
from retuner.adaptive.guard.ruling import Proof, Ruling
from retuner.adaptive.interaction.together import Closed
from retuner.adaptive.supervision import decide
from retuner.adaptive.supervision.decision import Outcome
from retuner.adaptive.supervision.findings import Findings
from retuner.adaptive.supervision.judge_evidence import seen_of
from retuner.adaptive.supervision.question import OTHER_LOOP, Question
from retuner.adaptive.trial.phase import TrialPhase
from retuner.decisions.decider import Answer
from retuner.one_plant import change_among_loops
from retuner.one_plant.change_among_loops import (
    NO_VERDICT,
    NOT_SURVIVED,
    Among,
    DecideAmong,
    OnePlant,
    half_way,
    on_one_clock,
    without_change,
)
from retuner.one_plant.controllers import on_one_plant


@dataclass
class Kept:
    """Settings of which only the guard's count."""

    guard: GuardSettings


def wanted(gains: PidGains) -> Outcome:
    """An answer that changes gains."""
    verdict = Proof(Ruling.ACCEPTED, gains, 1.0, 1.5, 1.6, 1.2, 60.0)
    return Outcome("accepted", "proved", proof=verdict)


def among(moves: tuple[int, ...] = (0, 1, 0, 1), most: float = 1.75) -> Among:
    """The first loop of Wood and Berry's column."""
    closed = tuple(Closed(one, DT_S) for one in BLT)
    return Among(("top", "bottom"), closed, tuple(records(0.01, moves)), DT_S, 0, most)


def times(factor: float) -> Outcome:
    """A change of the first loop's gains by a factor."""
    return wanted(PidGains(factor * BLT[0].kp, factor * BLT[0].ki))


def test_half_of_a_change_that_the_other_loop_does_not_survive_is_made(monkeypatch: pytest.MonkeyPatch) -> None:
    whole, half, asked = times(4.0), times(1.3), []
    monkeypatch.setattr(change_among_loops, "half_way", lambda question, refused: asked.append(refused) or question)
    monkeypatch.setattr(change_among_loops, "decide", lambda _: half)
    found = among().answered(question(0, 1), whole)
    assert asked == [whole.proof.gains]
    assert found.proof is half.proof
    assert found.reason.startswith("half of a change that was refused: with bottom on the same plant")
    assert found.reason.endswith(": proved")


def test_half_the_way_holds_every_limit_of_one_change_to_the_root_of_the_factor() -> None:
    settings = GuardSettings(kc_up_max=1.2)
    asked = Question(
        cast("Any", SimpleNamespace(in_force=BLT[0])), cast("Any", Kept(settings)), 1, cast("Any", None), after=min
    )
    found = half_way(asked, PidGains(2.25 * BLT[0].kp, 2.25 * BLT[0].ki))
    guard = found.settings.guard
    assert found.after is None
    assert (guard.kc_up_max, guard.step_up_max, guard.step_down_max) == pytest.approx((1.2, 1.5, 1.5))
    assert guard.total_ratio_max == settings.total_ratio_max


def test_a_change_that_the_other_loop_does_not_survive_is_not_made_and_what_was_learned_stays(monkeypatch):
    monkeypatch.setattr(change_among_loops, "half_way", lambda question, _: question)
    monkeypatch.setattr(change_among_loops, "decide", lambda _: times(3.0))
    found = among().answered(question(0, 1), times(4.0))
    assert found.proof is None
    assert found.code == NOT_SURVIVED
    assert "bottom on the same plant: Ms of top" in found.reason
    assert "limit 1.75" in found.reason


def test_a_change_that_all_survive_is_made() -> None:
    result = wanted(PidGains(1.3 * BLT[0].kp, 1.3 * BLT[0].ki))
    assert among().answered(question(0, 1), result) is result


@pytest.mark.parametrize(
    ("most", "factor", "made"), [(1.75, 1.5, False), (2.1, 1.5, True), (1.4, 1.02, False), (1.4, 0.9, True)]
)
def test_the_loop_itself_holds_the_limit_of_an_identified_process(monkeypatch, most, factor, *, made):
    """Its Ms is 1.48 now; where it is over the limit it does not grow, however little."""
    monkeypatch.setattr(change_among_loops, "half_way", lambda question, _: question)
    monkeypatch.setattr(change_among_loops, "decide", lambda _: times(factor))
    found = among(most=most).answered(question(0, 1), times(factor))
    assert (found.proof is not None) == made


def test_the_limit_is_that_of_the_guard_for_an_identified_process() -> None:
    asked = pair(100.0, 5.0).among(0)
    assert asked.ms_most == GuardSettings().ms_nominal


def test_what_is_not_known_of_the_plant_counts_nothing() -> None:
    result = wanted(PidGains(4 * BLT[0].kp, 4 * BLT[0].ki))
    assert among((0, 0)).answered(question(0, 1), result) is result


@pytest.mark.parametrize(("factor", "made"), [(1.2, False), (0.8, True)])
def test_no_more_action_without_a_model_on_a_plant_that_is_not_known(monkeypatch, factor, *, made):
    blind = replace(times(factor), basis=Basis.PATTERN)
    monkeypatch.setattr(change_among_loops, "half_way", lambda question, _: question)
    monkeypatch.setattr(change_among_loops, "decide", lambda _: blind)
    found = among((0, 0)).answered(question(0, 1), blind)
    assert (found.proof is not None) == made
    assert made or "before bottom on the same plant is known" in found.reason


def test_records_of_controllers_that_count_from_different_times_are_put_on_one_clock() -> None:
    first = [(float(i), 0.0, i / 10, 0.0) for i in range(50)]
    late = [(1000.0 + i, 0.0, i / 10, 0.0) for i in range(50)]
    for other in (late, first[:-1]):  # the second is a sample behind, as one that is asked in the middle of a sample
        one, two = on_one_clock([first, other], 1.0)
        assert len(one.pv) == len(two.pv)
        assert two.pv[:-1] == pytest.approx(one.pv[:-1])


def retuner(samples: list[LoopSample], name: str, gains: PidGains = BLT[0]) -> Any:
    return SimpleNamespace(
        samples=samples,
        band=0.05,
        region=0,
        scheduled=(0.0, 0.0),
        settings=SimpleNamespace(sample_time_s=1.0, filter_s=0.0, guard=SimpleNamespace(ms_nominal=1.75)),
        table=SimpleNamespace(loop=name, at=lambda *_: gains),
        trials=SimpleNamespace(of=lambda _: SimpleNamespace(phase=TrialPhase.IDLE, new=None)),
    )


def pair(stepped_s: float, settles_s: float) -> OnePlant:
    """Two loops; the setpoint of the second is stepped and its pv follows so many seconds later."""
    quiet = [LoopSample(float(i), 0.0, 0.0, 0.0) for i in range(200)]
    moved = [LoopSample(float(i), float(i >= stepped_s), float(i >= stepped_s + settles_s), 0.0) for i in range(200)]
    return OnePlant([retuner(quiet, "one"), retuner(moved, "two")])


def question(start_s: float, end_s: float, *, setpoint: bool = False, phase: TrialPhase = TrialPhase.TRIAL) -> Any:
    response = SimpleNamespace(t_start_s=start_s, t_end_s=end_s, sp_changed=setpoint)
    record = SimpleNamespace(response=response, samples=[SimpleNamespace(t_s=199.0)])
    return Question(cast("Any", record), cast("Any", None), 200, cast("Any", SimpleNamespace(phase=phase)))


@pytest.mark.parametrize(
    ("start_s", "end_s", "setpoint", "said"),
    [
        (105, 150, False, True),  # the other one is still under way
        (125, 150, False, True),  # it has come to rest before, but acts through a slow element
        (125, 135, False, False),  # too long ago for so short a response
        (90, 150, False, True),  # it moved in the middle
        (20, 80, False, False),  # before
        (105, 150, True, False),  # our own step, begun after the other's
        (90, 150, True, True),
    ],
)
def test_a_response_to_another_loops_move_is_no_verdict(start_s, end_s, setpoint, said):
    found = pair(100.0, 15.0).moved_beside(0, question(start_s, end_s, setpoint=setpoint))
    assert ("two, on the same plant, moved its setpoint at 100 s" in found) == said


class Inner:
    """A decider with one answer at once."""

    def __init__(self, result: Outcome) -> None:
        self.result, self.spoilt = result, ""

    def ask(self, question: Question) -> None:
        self.spoilt = question.spoilt

    def answer(self, _sample_number: int) -> Answer | None:
        return Answer(self.result)


@pytest.mark.parametrize("refused", [False, True])
def test_what_stands_in_place_of_a_decision_comes_after_the_questions_row(monkeypatch, *, refused):
    result = wanted(BLT[0])
    inner = Inner(without_change(result, "refused: for once") if refused else result)
    plant = pair(100.0, 15.0)
    monkeypatch.setattr(plant, "among", lambda _own: None)
    decider = DecideAmong(inner, plant, 0)
    decider.ask(question(105, 150))
    assert inner.spoilt.endswith(NO_VERDICT)
    assert decider.answer(200) is None
    answer = decider.answer(200)
    assert answer.trouble.startswith(inner.spoilt)
    assert answer.trouble.endswith("refused: for once" if refused else NO_VERDICT)
    assert (answer.result.proof is None) == refused


def test_a_response_of_a_trial_that_another_loop_moved_says_nothing_and_all_samples_may(monkeypatch):
    change = wanted(BLT[0]).proof

    def speaks(_: Findings, own: Outcome) -> Outcome:
        return replace(own, code="accepted", reason="more action", proof=change, basis=Basis.ALL_SAMPLES)

    monkeypatch.setattr(decide, "findings_of", lambda _: pytest.fail("it is asked"))
    monkeypatch.setattr(decide, "gains_that_win", speaks)
    monkeypatch.setattr(decide, "expectation", lambda _, winner: winner)
    asked = replace(question(105, 150), spoilt="two moved")
    found = decide.decide(asked)
    assert (found.code, found.reason) == (OTHER_LOOP, "more action")
    record = cast("Any", SimpleNamespace(window=SimpleNamespace(t_s=[199.0]), samples=[], response=None, crossed=False))
    seen = seen_of(record, found)
    assert seen.outside  # so the judge finds it inconclusive
    assert seen.next_due  # and the trial makes room
    monkeypatch.setattr(decide, "gains_that_win", lambda _, own: own)
    assert decide.decide(asked).reason == "two moved"


def test_a_change_proved_beside_gains_that_are_no_longer_in_force_is_not_made(monkeypatch: pytest.MonkeyPatch) -> None:
    plant = pair(10.0, 5.0)
    decider = DecideAmong(Inner(wanted(BLT[0])), plant, 0)
    monkeypatch.setattr(plant, "among", lambda _own: None)
    decider.ask(question(105, 150, phase=TrialPhase.IDLE))
    answer = decider.answer(200)
    assert answer.result.proof is not None
    decider.ask(question(105, 150, phase=TrialPhase.IDLE))
    plant.retuners[1].table.at = lambda *_: PidGains(-1.0, -0.1)
    assert decider.answer(200) is None
    answer = decider.answer(200)
    assert answer.result.proof is None
    assert "got other gains meanwhile" in answer.trouble


def test_controllers_join_in_pairs_and_none_that_decides_elsewhere() -> None:
    one = PidController(PidGains(1.0, 0.1), dt_s=1.0, pv_range=(0, 100))
    with pytest.raises(ValueError, match="two controllers or more"):
        on_one_plant(one)
    other = PidController(PidGains(1.0, 0.1), dt_s=1.0, pv_range=(0, 100))
    on_one_plant(one, other)
    assert one.step(50.0, 40.0) == other.step(50.0, 40.0)
    with pytest.raises(ValueError, match="in another process already"):
        on_one_plant(one, other)
