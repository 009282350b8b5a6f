"""Regions where the loop is not: what is known of them by now leads to gains, proved, and on trial when it comes."""

import json
import math
from collections.abc import Mapping
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from loop_bench import made, scaled

from retuner import GainTable, Lookup, PidGains, Regions, RetunerSettings
from retuner.adaptive.diagnosis.second_opinion import Excitation
from retuner.adaptive.guard.guard_settings import GuardSettings
from retuner.adaptive.identification.estimate import LogModel
from retuner.adaptive.loop.margins import sensitivity_peak
from retuner.adaptive.region_model.from_neighbours import BorrowingSettings, spread
from retuner.adaptive.region_model.region_model import RegionModel, StructureModel
from retuner.adaptive.region_model.update import Agreement
from retuner.adaptive.rules.simc import simc
from retuner.adaptive.signals.response import Ending, Peak, Response
from retuner.adaptive.signals.sample import LoopSample, Window
from retuner.adaptive.supervision.by_all_samples import others_may_tell
from retuner.adaptive.supervision.decide import decide
from retuner.adaptive.supervision.decision import Action, Mode, Outcome
from retuner.adaptive.supervision.findings import Findings
from retuner.adaptive.supervision.known_processes import KnownProcesses, known_of
from retuner.adaptive.supervision.other_regions import as_right_as_others, elsewhere
from retuner.adaptive.supervision.question import Question, ResponseRecord
from retuner.adaptive.supervision.state_file import region_model_in, region_model_out, remember, restore
from retuner.adaptive.trial.phase import TrialPhase
from retuner.adaptive.trial.rollback import NOTHING_KNOWN
from retuner.adaptive.trial.trial import Trial
from retuner.report.console import live_line

REGIONS = Regions("pv", "-", ("a", "b", "c"), 0.0, (30.0, 70.0), 100.0)
OPENED = RetunerSettings(1.0, 100.0, Mode.AUTO, guard=GuardSettings().opened(8.0))


def known(k: float, variance: float = 1e-4) -> RegionModel:
    log = LogModel(np.log([k / 50.0, 5.0, 50.0]), variance * np.eye(3), 1)
    return RegionModel((StructureModel(log, 0.0),), 3, 0.0, plausible=spread(log))


def right(k: float) -> PidGains:
    return simc(known(k).log.model().seen_by_controller(1.0)).gains


def times(gains: PidGains, factor: float) -> PidGains:
    return PidGains(gains.kp * factor, gains.ki * factor)


def asked(*, there: PidGains, settings: RetunerSettings = OPENED, **about: Any) -> Mapping[int, Outcome]:
    """A response in region a after which nothing changes; b is known too. there : gains of c.

    first : the sets of a and b before they were tuned; as wrong as that of c where it is not said.
    """
    lookup = about.get("lookup", Lookup.HARD)
    table = GainTable("loop", REGIONS, (right(1.0), right(1.0), there), lookup)
    commissioned = GainTable("loop", REGIONS, (*about.get("first", (there, there)), there), lookup)
    samples = [LoopSample(float(t), 20.0, 20.0, 0.0, 0, 0, 20.0) for t in range(60)]
    response = Response(10.0, 59.0, (Peak(12.0, 5.0),), Ending.QUIET, sp_changed=True, band=0.1)
    models = about.get("models", {0: known(1.0), 1: known(1.0)})
    record = ResponseRecord(0, response, Window.of(samples), samples, table, commissioned, models)
    question = Question(record, settings, 1, Trial(), about.get("free", (1, 2)), about.get("away", ()))
    learned: Any = SimpleNamespace(agreement=about.get("agreement", Agreement.AGREES))
    ready: Any = SimpleNamespace(ready=True)
    found = Findings(question, learned=learned, wanted=ready, in_use=models[0])
    return elsewhere(found, Outcome(about.get("code", "ok"), ""))


@pytest.mark.parametrize("factor", [0.25, 6.0])
def test_gains_that_are_far_off_are_corrected_before_the_loop_comes(factor: float) -> None:
    due = asked(there=times(right(1.0), factor))
    assert list(due) == [2]
    verdict = due[2].proof
    assert verdict.gains is not None
    assert "estimated from other regions: a, b" in due[2].reason
    process = known(1.0).log.model().seen_by_controller(1.0).linear()
    assert sensitivity_peak(process, verdict.gains) < 1.8
    assert abs(np.log(verdict.gains.ki / right(1.0).ki)) < abs(np.log(factor))
    assert due[2].prediction is not None


@pytest.mark.parametrize(
    "about",
    [
        {"there": right(1.0)},
        {"first": (right(1.0), right(1.0))},  # the table was right where it is known: it may know of a jump
        {"first": (right(1.0), times(right(1.0), 0.25))},
        {"there": times(right(1.0), 6.0), "first": (right(1.0), right(1.0))},
        {"there": times(right(1.0), 0.8)},  # nearly right: its own responses tell more
        {"free": (1,)},
        {"models": {0: known(1.0)}},  # one region shows no trend
        {"code": "unconfirmed"},
        {"agreement": Agreement.CONTRADICTS},
        {"lookup": Lookup.INTERPOLATED},
        {"settings": replace(OPENED, borrowing=BorrowingSettings(far_off=0.0))},
    ],
)
def test_what_is_nearly_right_or_not_known_stays(about: dict[str, Any]) -> None:
    assert asked(**{"there": times(right(1.0), 0.25), **about}) == {}


@pytest.mark.parametrize(
    ("own", "foreign", "told"),
    [
        (None, 0, True),  # no response has ended there
        (Excitation(setpoints=2, clear=1), 0, True),
        (Excitation(setpoints=3), 0, False),  # what is known there is what these did not confirm
        (Excitation(setpoints=2, clear=1), 1, False),  # something else was behind them
    ],
)
def test_a_region_whose_own_responses_leave_doubt_waits_for_more_of_these(own, foreign, *, told):
    excitation = {} if own is None else {2: own}
    assert others_may_tell(2, {2: known(1.0)}, excitation, {2: foreign}) is told


def test_a_set_that_is_too_much_at_its_boundary_is_eased_though_it_is_right_in_the_middle() -> None:
    """The neighbour's process was not known when it was tuned; also while it is on trial and the loop is away."""
    models = {0: known(4.0), 1: known(4.0), 2: known(1.0)}
    for about in ({}, {"free": (), "away": (2,)}):
        due = asked(there=right(1.0), models=models, **about)
        assert list(due) == [2]
        assert "on the way to region b" in due[2].reason
        verdict = due[2].proof
        assert verdict.gains.kp < 0.9 * right(1.0).kp
    alike = {region: known(1.0) for region in range(3)}
    assert asked(there=right(1.0), models=alike) == {}
    assert asked(there=times(right(1.0), 0.25), models=alike, free=(), away=(2,)) == {}, "its trial goes on"


def test_a_trial_that_waits_for_the_loop_ends_before_a_safer_change_there() -> None:
    bench = made(scaled(0.25, 0.25))
    bench.run(400)
    retuner, samples = bench.retuner, bench.samples(2000, 1.0, 0.0, 10.0)
    question = next(step.question for step in map(retuner.step, samples) if step.question is not None)
    found = decide(question)
    assert found.proof.gains is not None
    calm = replace(found, proof=None, prediction=None, code="ok", elsewhere={1: found})
    retuner.enter(question, calm, retuner.sample_number)
    first = retuner.step(next(samples)).decision
    assert first.gains_after is not None
    retuner.committed(1, first.gains_after)
    retuner.step(next(samples))
    assert retuner.trials.away(1)
    safer = replace(found, proof=replace(found.proof, gains=times(first.gains_after, 0.8)))
    retuner._due = {1: safer}
    second = retuner.step(next(samples)).decision
    assert second.action is Action.WRITE
    assert second.gains_after == times(first.gains_after, 0.8)
    assert retuner.trials.of(1).old == first.gains_after
    assert scaled(0.25, 0.25) in retuner.trials.of(1).sets.earlier, "the way back still knows the set before both"


@pytest.mark.parametrize("other", [PidGains(1.0, 0.05), PidGains(-4.0, -0.01), PidGains(0.3, 0.0)])
def test_a_set_is_as_right_by_the_table_as_that_of_another_region_is_there(other: PidGains) -> None:
    """The same Ms, whatever the two sets are: the hypothesis is that the table knows of the difference."""
    sign = 1 if other.kp > 0 else -1
    theirs = PidGains(sign * 2.0, sign * 0.04)
    log = LogModel(np.log([0.02, 5.0, 50.0]), 1e-4 * np.eye(3), sign)
    models = {0: RegionModel((StructureModel(log, 0.0),), 3, 0.0, plausible=spread(log))}
    (found,) = as_right_as_others(models, 2, (theirs, theirs, other), 0.0, OPENED.tracker)
    slower = 1.0 if not other.ki else (other.kp / other.ki) / (theirs.kp / theirs.ki)
    expected = PidGains(theirs.kp, theirs.ki if other.ki else 0.0)
    there, here = (model.linear() for model in (found.model, log.model()))
    assert found.model.theta_s == pytest.approx(5.0 * slower)
    assert sensitivity_peak(there, other) == pytest.approx(sensitivity_peak(here, expected), rel=1e-3)


def test_a_table_says_nothing_where_nobody_knows_a_process_or_a_set_has_no_gain() -> None:
    models = {0: known(1.0)}
    assert as_right_as_others({}, 2, (right(1.0),) * 3, 0.0, OPENED.tracker) == ()
    assert as_right_as_others(models, 0, (right(1.0),) * 3, 0.0, OPENED.tracker) == ()
    assert as_right_as_others(models, 2, (right(1.0), right(1.0), PidGains(0.0, 0.1)), 0.0, OPENED.tracker) == ()


def test_what_is_known_of_a_region_without_records_is_what_the_others_lend() -> None:
    table = GainTable("loop", REGIONS, (right(1.0), right(1.0), right(1.0)))
    lent = known_of(KnownProcesses(table, {0: known(1.0), 1: known(1.0)}, 0.0, OPENED), 2)
    assert len(lent.processes) > 1
    assert known_of(KnownProcesses(table, {}, 0.0, OPENED), 2) == NOTHING_KNOWN


@pytest.mark.slow
@pytest.mark.uncounted
def test_what_is_due_and_was_not_made_before_a_restart_is_found_again() -> None:
    """A restart forgets that it was due; what it follows from is remembered."""
    bench = made(scaled(0.25, 0.25))
    bench.run(400)
    samples = bench.samples(1000, 1.0, 0.0, 10.0)
    question = next(step.question for step in map(bench.retuner.step, samples) if step.question is not None)
    calm = replace(decide(question), proof=None, prediction=None, code="ok")
    due = replace(calm, elsewhere={1: decide(question)})
    bench.retuner.enter(question, due, bench.retuner.sample_number)
    again = restore(json.loads(json.dumps(remember(bench.retuner))), bench.retuner.settings)
    assert again.step(next(samples)).decision is None
    assert again.trials.idle(1, again.now_s)
    before = {0: known(1.0), 1: known(1.0)}
    after = {region: region_model_in(json.loads(json.dumps(region_model_out(m)))) for region, m in before.items()}
    there = times(right(1.0), 0.25)
    one, other = (asked(there=there, models=models)[2] for models in (before, after))
    assert one.proof.gains == other.proof.gains


@pytest.mark.parametrize(("own", "free"), [(None, (1,)), (Excitation(setpoints=3), ())])
def test_a_question_asks_of_no_region_that_waits(own: Excitation | None, free: tuple[int, ...]) -> None:
    bench = made(scaled(0.25, 0.25))
    bench.run(400)
    if own is not None:
        bench.retuner.excitation[1] = own
    steps = map(bench.retuner.step, bench.samples(1000, 1.0, 0.0, 10.0))
    assert next(step.question.free for step in steps if step.question is not None) == free


def test_it_follows_with_the_next_sample_and_is_on_trial_when_the_loop_comes() -> None:
    bench = made(scaled(0.25, 0.25))
    bench.run(400)
    retuner, samples = bench.retuner, bench.samples(1000, 1.0, 0.0, 10.0)
    question = next(step.question for step in map(retuner.step, samples) if step.question is not None)
    found = decide(question)
    assert found.proof.accepted
    calm = replace(found, proof=None, prediction=None, code="ok", elsewhere={1: found})
    assert retuner.enter(question, calm, retuner.sample_number).action is Action.NONE
    decision, under_way = retuner.step(next(samples)).decision, retuner.recogniser
    assert (decision.action, decision.region) == (Action.WRITE, retuner.table.regions.names[1])
    assert decision.gains_after is not None
    assert decision.later
    assert decision.to_dict()["later"] is True
    assert "in the table, to be written when the loop enters the region: Kc" in live_line(decision)
    retuner.committed(1, decision.gains_after)
    assert retuner.recogniser is under_way  # what goes on where the loop is goes on
    retuner.step(next(samples))
    assert retuner.trials.phase(1) is TrialPhase.AWAY
    assert retuner.table.gains_of(0) == scaled(0.25, 0.25)


# When a response counts as one that crossed a boundary: by its gains, or along the setpoint by the way of pv.


GAINS = PidGains(1.0, 0.05)


def record(variable: str, pv: tuple[float, float], entered_s: float, *, sp_changed: bool = True) -> ResponseRecord:
    table = GainTable("loop", Regions(variable, "-", ("low", "high"), 0.0, (50.0,), 100.0), (GAINS, GAINS))
    values = np.linspace(*pv, 60).tolist()
    samples = [LoopSample(float(t), 60.0, y, 0.0, 0, 0, 60.0 if variable == "sp" else y) for t, y in enumerate(values)]
    response = Response(10.0, 59.0, (Peak(12.0, 5.0),), Ending.QUIET, sp_changed, 0.1)
    return ResponseRecord(1, response, Window.of(samples), samples, table, table, {}, entered_s=entered_s)


@pytest.mark.parametrize(("entered_s", "expected"), [(-math.inf, False), (5.0, False), (10.0, False), (30.0, True)])
def test_by_when_the_region_was_entered(entered_s: float, expected: bool) -> None:
    found = record("pv", (55.0, 70.0), entered_s)
    assert found.crossed is expected
    assert (found.pattern is None) is expected


def test_along_the_setpoint_by_where_pv_was() -> None:
    assert record("sp", (20.0, 60.0), 10.0).crossed
    assert not record("sp", (55.0, 65.0), 10.0).crossed
    assert not record("sp", (45.0, 52.0), 10.0, sp_changed=False).crossed  # a load: it came from nowhere else


def test_one_that_went_far_inside_its_region_is_fitted_in_motion() -> None:
    assert record("pv", (55.0, 70.0), -math.inf).moved
    assert not record("pv", (55.0, 62.0), -math.inf).moved
    alone = GainTable("loop", Regions("pv", "-", ("all",), 0.0, (), 100.0), (GAINS,))
    assert not replace(record("pv", (55.0, 95.0), -math.inf), region=0, table=alone).moved


def test_how_far_it_went_is_a_share_of_the_axis_and_nothing_where_there_is_one_region() -> None:
    found = record("pv", (55.0, 62.0), -math.inf)
    assert found.share == pytest.approx(0.07 * 49 / 59)  # of the response itself, which begins at 10 s
    alone = GainTable("loop", Regions("pv", "-", ("all",), 0.0, (), 100.0), (GAINS,))
    assert replace(found, region=0, table=alone).share == 0.0
