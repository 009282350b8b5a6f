"""The retuner as a whole on simulated loops: it cures, it refuses, it repeats itself exactly."""

import json
import math
import re
import sys
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path
from types import FrameType

import numpy as np
import pytest
from loop_bench import GOOD, Bench, made, scaled, table

from retuner.adaptive.choice.choice_settings import ChoiceSettings
from retuner.adaptive.diagnosis.cause import Cause
from retuner.adaptive.diagnosis.diagnosis_settings import DiagnosisSettings
from retuner.adaptive.diagnosis.second_opinion import Excitation
from retuner.adaptive.diagnosis.wrong_way import acts_wrong_way
from retuner.adaptive.loop.margins import sensitivity_peak
from retuner.adaptive.process.model import LinearProcess
from retuner.adaptive.region_model.update import Agreement
from retuner.adaptive.signals.recogniser import RecogniserPhase
from retuner.adaptive.signals.response import Ending
from retuner.adaptive.signals.sample import LoopMode, LoopSample, Window
from retuner.adaptive.supervision import confirmation
from retuner.adaptive.supervision.decision import Action, Decision, Mode
from retuner.adaptive.supervision.findings import STEPS
from retuner.adaptive.supervision.response_finder import Left, ResponseFinder
from retuner.adaptive.supervision.retuner import Retuner
from retuner.adaptive.supervision.retuner_settings import RetunerSettings
from retuner.adaptive.supervision.state_file import remember, restore
from retuner.schedule.gains import PidGains
from retuner.schedule.regions import Axis, Regions
from retuner.schedule.table import GainTable


@pytest.mark.uncounted
@pytest.mark.parametrize(
    ("kp", "ki", "cause", "sign"),
    [
        (0.25, 0.25, Cause.SLUGGISH, -1),
        pytest.param(2.4, 2.4, Cause.AGGRESSIVE, 1, marks=pytest.mark.slow),
        (2.4, 2.4, Cause.AGGRESSIVE, -1),
        pytest.param(0.3, 1.5, Cause.SLOW_INTEGRATING, 1, marks=pytest.mark.slow),
    ],
)
def test_wrong_gains_are_cured_for_their_cause(kp: float, ki: float, cause: Cause, sign: int) -> None:
    start = PidGains(sign * GOOD.kp * kp, sign * GOOD.ki * ki)
    bench = made(start, sign=sign)
    decisions = bench.exercise()
    committed = [d for d in decisions if d.action == Action.WRITE]
    assert committed[0].diagnosis.cause == cause
    final = bench.retuner.table.gains_of(0)
    true = LinearProcess(sign * 1.0, (50.0,), (), 5.5)
    assert sensitivity_peak(true, final) < 1.8
    assert final.ki / (sign * GOOD.ki) == pytest.approx(1.0, rel=0.25)
    assert bench.retuner.table.revision == len(committed)
    assert bench.retuner.table.gains_of(1) == start


def test_a_load_that_agrees_lets_the_rest_of_a_limited_change_through(monkeypatch: pytest.MonkeyPatch) -> None:
    """Gains of a quarter: the setpoint step shows it, and each change may double them; the load adds no proof."""
    monkeypatch.setattr(confirmation, "unconfirmed", None)  # nobody asks
    bench = made(scaled(0.25, 0.25))
    found = bench.run(400) + bench.run(600, 1.0) + bench.run(600, 1.0, 2.0)
    steps = [d for d in found if d.action == Action.WRITE]
    assert [bool(d.response and d.response.sp_changed) for d in steps] == [True, False]
    assert steps[1].agreement == Agreement.AGREES
    assert all(d.gains_after and d.gains_after.ki > 1.5 * d.gains_before.ki for d in steps)


@pytest.mark.slow
@pytest.mark.uncounted
def test_a_load_that_confirms_what_a_setpoint_step_had_shown_changes_the_gains() -> None:
    """The process loses more than half of its gain at rest: one step is odd, the load after it is the second record."""
    bench = made(GOOD)
    bench.run(400)
    assert all(d.action == Action.NONE for d in [*bench.run(500, 1.0), *bench.run(500, 0.0), *bench.run(500, 0.0)])
    bench.sign = 0.4
    (contradicting,) = bench.run(600, 1.0)
    (confirming,) = bench.run(600, 1.0, 1.0)
    assert (contradicting.agreement, contradicting.action) == (Agreement.CONTRADICTS, Action.NONE)
    assert (confirming.agreement, confirming.action) == (Agreement.CHANGED, Action.WRITE)
    assert not confirming.response.sp_changed
    assert confirming.gains_after.kp == pytest.approx(2 * GOOD.kp)  # the most that one change may do


@pytest.mark.slow
def test_a_model_that_the_loop_refutes_is_forgotten(monkeypatch: pytest.MonkeyPatch) -> None:
    bench = made(scaled(2.4, 2.4), Mode.ADVISE)
    bench.run(400)
    assert [d.action for d in bench.run(500, 1.0)] == [Action.ADVISE]
    assert bench.retuner.excitation[0].setpoints == 1
    monkeypatch.setattr(confirmation, "not_seen", lambda *_: "the loop came to rest")
    (refuted,) = bench.run(500, 1.0, 2.0)  # a load: a setpoint step that needs none is not asked
    assert (refuted.code, refuted.action, refuted.agreement) == ("unconfirmed", Action.NONE, Agreement.AGREES)
    assert (bench.retuner.region_models, bench.retuner.excitation) == ({}, {})
    (again,) = bench.run(500, 0.0, 2.0)
    assert again.agreement == Agreement.FIRST


def test_good_gains_are_left_alone() -> None:
    bench = made(scaled(0.95, 0.95))
    decisions = bench.exercise()
    assert len(decisions) >= 5
    assert all(d.action == Action.NONE for d in decisions)
    assert {d.diagnosis.cause for d in decisions if d.diagnosis} == {Cause.OK}


def test_off_decides_nothing() -> None:
    assert made(scaled(0.25, 0.25), Mode.OFF).exercise() == []


def test_a_quiet_loop_gives_no_decision() -> None:
    assert made(GOOD).run(3000) == []


def test_a_response_that_crosses_a_boundary_teaches_both_sides() -> None:
    bench = made(scaled(0.25, 0.25))
    bench.run(400)
    (found,) = bench.run(10, sp=1.0, x=40.0) + bench.run(600, sp=1.0, x=75.0)
    assert (found.region, found.agreement) == ("b", Agreement.FIRST)
    assert set(bench.retuner.region_models) == {0, 1}
    model = bench.retuner.region_models[1]
    assert model.log.model().k == pytest.approx(1.0, rel=0.3)  # a valve's curve may be behind a part of it
    assert abs(math.log(model.log.model().k)) < 2 * model.log.gain_uncertainty()
    assert not model.identifiable  # of gains at a quarter, the dead time is hardly seen
    assert "crossed a boundary" in found.reason
    assert found.action == Action.NONE


def test_a_setpoint_step_that_takes_the_loop_over_a_boundary_teaches_where_the_gains_arrive_two_samples_later() -> None:
    bench = made(scaled(0.25, 0.25))
    bench.run(400)
    samples = enumerate(bench.samples(600, 1.0, 0.0, 75.0))
    (found,) = filter(None, (bench.retuner.observe(one._replace(revision=int(i >= 2))) for i, one in samples))
    assert (found.region, found.agreement) == ("b", Agreement.FIRST)
    assert bench.retuner.region_models[1].log.model().k == pytest.approx(1.0, rel=0.3)


def test_a_gap_or_manual_mode_begins_anew() -> None:
    bench = made(scaled(0.25, 0.25))
    bench.run(400)
    bench.run(30, sp=1.0)
    last = LoopSample(bench.t + 60.0, 1.0, 0.3, 0.2, LoopMode.AUTO, 0, 10.0)
    for each in (last, last._replace(t_s=last.t_s + 1, mode=LoopMode.MANUAL)):
        assert bench.retuner.observe(each) is None
        state = bench.retuner.recogniser
        assert state.phase == RecogniserPhase.SETTLE


def bad(values: Iterable[float]) -> list[dict[str, float]]:
    return [{field: value} for field in ("t_s", "sp", "pv", "co", "x") for value in values]


@pytest.mark.uncounted
def test_what_is_not_finite_is_refused_and_changes_nothing() -> None:
    bench, twin = made(scaled(0.25, 0.25)), made(scaled(0.25, 0.25))
    for seconds, sp in ((400, 0.0), (7, 1.0), (40, 1.0), (500, 1.0), (600, 0.0)):  # at rest, in a response, behind one
        assert [d.canonical() for d in bench.run(seconds, sp)] == [d.canonical() for d in twin.run(seconds, sp)]
        good = LoopSample(bench.t, sp, 0.0, 0.0, LoopMode.AUTO, 0, 10.0)
        for change in bad([math.nan, math.inf, -math.inf]):
            with pytest.raises(ValueError, match=r"finite|increase"):
                bench.retuner.observe(good._replace(**change))
    assert bench.retuner.table != table(scaled(0.25, 0.25))  # so there was something to compare


def test_time_that_does_not_increase_is_refused() -> None:
    bench = made(GOOD)
    bench.run(50)
    with pytest.raises(ValueError, match="time does not increase"):
        bench.retuner.observe(LoopSample(bench.t - 5, 0.0, 0.0, 0.0))


def test_a_loop_whose_output_never_leaves_its_limit_is_not_retuned() -> None:
    retuner = Retuner(table(scaled(0.25, 0.25)), RetunerSettings(1.0, 10.0, Mode.AUTO))
    bench = Bench(retuner)
    found = []
    for phase, sp in ((400, 0.0), (600, 1.0)):
        for sample in bench.samples(phase, sp, 0.0, 10.0):
            decision = retuner.observe(sample._replace(co=10.0, limited=1))
            found += [decision] if decision else []
    assert found
    assert {d.diagnosis.cause for d in found if d.diagnosis} == {Cause.SATURATION}
    assert all(d.action == Action.NONE for d in found)


@pytest.mark.slow
@pytest.mark.uncounted
def test_a_restored_memory_decides_as_if_never_stopped() -> None:
    bench, twin = made(scaled(0.25, 0.4), seed=5), made(scaled(0.25, 0.4), seed=5)
    bench.run(400)
    twin.run(400)
    early = bench.run(620, sp=1.0)
    assert [d.canonical() for d in twin.run(620, sp=1.0)] == [d.canonical() for d in early]
    bench.run(37, sp=1.0, load=0.5)
    twin.run(37, sp=1.0, load=0.5)
    text = json.dumps(remember(bench.retuner), allow_nan=False)
    bench.retuner = restore(json.loads(text), bench.retuner.settings)
    later = bench.exercise(2)
    assert later
    assert [d.canonical() for d in later] == [d.canonical() for d in twin.exercise(2)]


def test_what_a_belief_rests_on_is_remembered() -> None:
    bench = made(GOOD)
    bench.run(10)
    bench.retuner.excitation = {0: Excitation(setpoints=1, loads=2, clear=4, alternative=5)}
    again = restore(json.loads(json.dumps(remember(bench.retuner))), bench.retuner.settings)
    assert again.excitation == bench.retuner.excitation


def test_a_memory_of_another_layout_is_refused_and_none_is_misread_by_place() -> None:
    """Code that is exchanged under a session reads what other code wrote: a phase that is no whole number, a time in
    the place of a count. Whatever moved, it is told at once, and not by an index error a sample later.
    """
    bench = made(GOOD)
    bench.run(40)
    memory, wanted = json.loads(json.dumps(remember(bench.retuner))), bench.retuner.settings
    assert restore({key: memory[key] for key in memory if key != "layout"}, wanted).sample_number == 40
    for kind in memory["layout"]:
        moved = memory["layout"] | {kind: memory["layout"][kind][::-1]}
        with pytest.raises(ValueError, match="another layout"):
            restore(memory | {"layout": moved}, wanted)
    for name in ("recogniser", "region", "noise", "led"):
        for at in range(len(memory[name])):
            for wrong in ([1.0], "x", {}):
                values = [wrong if i == at else value for i, value in enumerate(memory[name])]
                with pytest.raises(ValueError, match=r"."):
                    restore(memory | {name: values}, wanted)
    phase = [3.5, *memory["recogniser"][1:]]
    samples = [memory["samples"][1], memory["samples"][0]]
    for damage in ({"recogniser": phase}, {"recogniser": [99, *phase[1:]]}, {"samples": samples}):
        with pytest.raises(ValueError, match=r"."):
            restore(memory | damage, wanted)


@pytest.mark.parametrize("damage", [{"version": 1}, {"table": "x"}, {"region_models": {"0": {}}}, {"noise": None}])
def test_a_damaged_memory_is_refused_in_one_line(damage: dict[str, object]) -> None:
    bench = made(GOOD)
    bench.run(10)
    with pytest.raises(ValueError, match=r".") as caught:
        restore(remember(bench.retuner) | damage, bench.retuner.settings)
    assert "\n" not in str(caught.value)


@pytest.mark.slow
@pytest.mark.uncounted
def test_a_response_longer_than_what_is_kept_is_cut_and_still_teaches() -> None:
    short = RetunerSettings(1.0, 10.0, Mode.AUTO, wait_s=2000.0, history=150)
    bench = Bench(Retuner(table(scaled(0.25, 0.02)), short))
    bench.run(100)
    found = bench.run(900, 1.0) + bench.run(200, 0.0)
    assert found[0].response.ending == Ending.TIMEOUT
    assert found[0].estimate is not None


@pytest.mark.slow
@pytest.mark.parametrize("kind", [np.float64, np.float32])
def test_samples_and_gains_in_numbers_of_numpy_decide_the_same_bytes(kind: type[np.floating]) -> None:
    start = [kind(scaled(0.25, 0.25).kp), kind(scaled(0.25, 0.25).ki)]
    bench = made(PidGains(*map(float, start)))
    recorded = [*bench.samples(300, 0.0, 0.0, 10.0), *bench.samples(500, 1.0, 0.0, 10.0)]
    arrays = [
        LoopSample(
            *map(kind, (s.t_s, s.sp, s.pv, s.co)), np.int64(s.mode), np.int64(0), kind(s.x), np.int64(0), kind(s.x2)
        )
        for s in recorded
    ]
    plain = [LoopSample(*map(float, s[:4]), int(s.mode), 0, float(s.x), 0) for s in arrays]
    found, expected = (
        [d.canonical() for d in map(made(gains).retuner.observe, samples) if d]
        for gains, samples in ((PidGains(*start), arrays), (PidGains(*map(float, start)), plain))
    )
    assert found == expected
    assert len(found) == 1


# The finder on a map: filtered values choose, an unknown one holds, manual keeps the hysteresis.


HEAT = Axis("sp", "degC", 0.0, (50.0,), 100.0, 2.0)
FLOW = Axis("can", "%", 0.0, (50.0,), 100.0, 5.0, 0.0, 4.0, "flow")
GAINS = tuple(PidGains(1.0 + i, 0.02) for i in range(4))
TABLE = GainTable("boiler", Regions.along(tuple("abcd"), HEAT, FLOW), GAINS)
SETTINGS = RetunerSettings(sample_time_s=1.0, pv_span=100.0, mode=Mode.ADVISE)
NAN = math.nan


def sample(t_s: float, x: float = 20.0, x2: float = 20.0, mode: int = LoopMode.AUTO, pv: float = 0.0) -> LoopSample:
    return LoopSample(t_s, 0.0, pv + 0.01 * (t_s % 3), 30.0 + 0.01 * (t_s % 2), mode, 0, x, 0, x2)


def watched(samples: list[LoopSample], table: GainTable = TABLE) -> tuple[ResponseFinder, list[object]]:
    finder = ResponseFinder(table.regions, table.at, SETTINGS)
    return finder, [seen for s in samples if (seen := finder.step(s)) is not None]


def test_the_second_variable_chooses_through_its_filter() -> None:
    samples = [sample(float(t), x2=20.0 if t < 10 else 90.0) for t in range(40)]
    finder, seen = watched(samples)
    assert seen == []
    assert finder.region == 1
    early = ResponseFinder(TABLE.regions, TABLE.at, SETTINGS)
    places = []
    for s in samples:
        early.step(s)
        places.append(early.region)
    assert places.index(1) == 13  # 20 + 70 (1 - 0.8^n) passes 50 + 5 with the 4th sample of the new value
    assert finder.scheduled[0] == 20.0
    assert finder.scheduled[1] == pytest.approx(90.0, abs=0.1)


def test_an_unknown_variable_keeps_its_axis_and_cuts_responses() -> None:
    samples = [sample(float(t)) for t in range(100)]
    samples += [sample(float(t), pv=5.0) for t in range(100, 104)]  # a response has begun
    samples += [sample(float(t), x2=NAN, x=80.0) for t in range(104, 110)]
    samples += [sample(float(t), x=80.0, x2=20.0) for t in range(110, 120)]
    finder, seen = watched(samples)
    cut = [s for s in seen if isinstance(s, Left)]
    assert cut[0] == Left(0, under_way=True)
    assert all(not s.under_way for s in cut[1:])
    assert finder.region == 2, "heat goes on by itself"
    assert finder.scheduled == (80.0, 20.0)


def test_nothing_begins_before_all_variables_are_known() -> None:
    finder, seen = watched([sample(float(t), x2=NAN) for t in range(5)])
    assert (finder.region, seen) == (None, [])
    finder.step(sample(5.0, x2=80.0))
    assert finder.region == 1


@pytest.mark.parametrize("wrong", [{"x": NAN}, {"x": math.inf}, {"pv": NAN}])
def test_what_comes_with_every_sample_must_be_a_number(wrong: dict[str, float]) -> None:
    finder, _ = watched([sample(float(t)) for t in range(5)])
    for first in (finder, ResponseFinder(TABLE.regions, TABLE.at, SETTINGS)):
        with pytest.raises(ValueError, match="is not finite"):
            first.step(sample(5.0, **wrong))


def test_numbers_whose_sum_is_beyond_all_are_numbers() -> None:
    finder, seen = watched([sample(float(t), pv=1e308, x=1e308) for t in range(5)])
    assert (finder.region, seen, len(finder.samples)) == (2, [], 5)


def test_a_second_variable_counts_only_where_there_are_two() -> None:
    row = GainTable("row", Regions.along(("cold", "hot"), HEAT), GAINS[:2])
    finder, seen = watched([sample(float(t), x2=NAN) for t in range(5)], row)
    assert (finder.region, seen, len(finder.samples)) == (0, [], 5)


def test_numbers_of_numpy_are_kept_as_plain_ones() -> None:
    finder, _ = watched([sample(float(t))._replace(x2=np.float64(90.0)) for t in range(40)])
    assert finder.region == 1
    assert {type(value) for s in finder.samples for value in s} <= {float, int, LoopMode}
    assert type(finder.scheduled[1]) is float


def test_manual_keeps_the_hysteresis() -> None:
    xs = [48.0, 51.0, 49.0, 51.9, 53.0, 49.0, 47.0]
    finder = ResponseFinder(TABLE.regions, TABLE.at, SETTINGS)
    places = []
    for t, x in enumerate(xs):
        finder.step(sample(float(t), x=x, mode=LoopMode.MANUAL))
        places.append(finder.region)
    assert places == [0, 0, 0, 0, 2, 2, 0]


def test_after_a_gap_the_place_is_taken_anew_where_it_is_known() -> None:
    finder, _ = watched([sample(float(t), x2=90.0) for t in range(5)])
    finder.step(sample(500.0, x=80.0, x2=NAN))
    assert finder.region == 3
    assert finder.scheduled == (80.0, 90.0)


def test_a_memory_taken_while_a_variable_is_unknown_goes_on_alike() -> None:
    samples = [sample(float(t), x2=NAN if 20 <= t < 40 else 20.0 + t) for t in range(80)]
    whole, parts = (Retuner(TABLE, SETTINGS) for _ in range(2))
    for t, s in enumerate(samples):
        whole.observe(s)
        parts.observe(s)
        if t in {5, 25, 60}:
            parts = restore(json.loads(json.dumps(remember(parts), allow_nan=False)), SETTINGS)
    assert remember(parts) == remember(whole)
    assert parts.region == 1


# Where something else may well be behind one record, a loop that behaves waits for a second one that agrees


def first_two(gains: PidGains, doubt: float = ChoiceSettings().doubt) -> list[Decision]:
    """doubt : odds that something else than the models is behind one record."""
    settings = RetunerSettings(1.0, 10.0, Mode.AUTO, choice=ChoiceSettings(doubt=doubt))
    found = Bench(Retuner(table(gains), settings)).exercise(4)
    return [d for d in found if d.estimate is not None][:2]


@pytest.mark.slow
@pytest.mark.uncounted
def test_a_loop_that_behaves_is_moved_when_a_second_record_agrees() -> None:
    first, second = first_two(scaled(0.6, 0.6), doubt=2.0)
    assert first.code == "one_record"
    assert first.action is Action.NONE
    assert first.gains_after is None
    assert "a second record must agree" in first.reason
    assert second.action is Action.WRITE
    assert second.records == 2


@pytest.mark.uncounted
@pytest.mark.parametrize("share", [0.2, 0.6, 2.5])
def test_a_loop_that_is_slow_or_swings_is_moved_at_once_by_a_setpoint_step_from_rest(share: float) -> None:
    assert first_two(scaled(share, share))[0].action is Action.WRITE


# On line, a controller that acts the wrong way is named so, not by what comes of it: a pv far out of its range


def decided(sign: int) -> list[Decision]:
    """After a setpoint step under gains for a process of gain +1, on one of gain `sign`."""
    settings = replace(RetunerSettings(1.0, 10.0, Mode.AUTO), pv_range=(-2.0, 2.0))
    bench = Bench(Retuner(table(scaled(0.3, 0.3)), settings), sign)
    return bench.run(400) + bench.run(300, 1.0) + bench.run(300, 0.0)


@pytest.fixture(scope="module")
def wrong() -> list[Decision]:
    return decided(-1)


def test_it_is_named_with_what_to_do(wrong: list[Decision]) -> None:
    assert wrong[0].code == "wrong_way"
    assert "take the loop to manual" in wrong[0].reason


def test_nothing_is_written_and_nothing_learned(wrong: list[Decision]) -> None:
    assert {(d.action, d.records) for d in wrong} == {(Action.NONE, 0)}


def test_a_loop_that_acts_the_right_way_is_not_called_so() -> None:
    assert "wrong_way" not in {d.code for d in decided(1)}


def test_a_load_that_wanders_is_not_the_wrong_way_where_pv_came_back_from_as_far() -> None:
    bench = Bench(Retuner(table(scaled(0.25, 0.25)), RetunerSettings(1.0, 10.0, Mode.ADVISE)), 1, seed=22)
    load = np.cumsum(np.random.default_rng(22).standard_normal(2175)) * 0.05
    seen = [sample for one in load.tolist() for sample in bench.samples(1, 0.0, one, 10.0)]
    farthest = max(abs(sample.pv) for sample in seen[:-150])
    window, fit = Window.of(seen[-150:]), DiagnosisSettings().fit
    assert acts_wrong_way(window, 1, fit) is not None  # by itself the window looks like it
    assert acts_wrong_way(window, 1, fit, farthest) is None


def test_it_is_named_as_well_where_the_loop_never_was_at_rest() -> None:
    bench = Bench(Retuner(table(scaled(0.3, 0.3)), RetunerSettings(1.0, 10.0, Mode.AUTO)), -1)
    assert [d.code for d in bench.run(1100, 1.0)] == ["wrong_way"]


# A decision runs through the steps that the documentation tells, in its order


PAGE = Path(__file__).resolve().parents[2] / "docs" / "developers" / "how-it-works.md"
ROOM = "/adaptive/supervision/"


def told() -> list[str]:
    """Names of the steps, as documented."""
    text = PAGE.read_text().split("| step | asks | in |")[1].split("\n\n")[0]
    return re.findall(r"^\| ([a-z ]+) \| .+\? \| `[a-z_]+\.py` \|$", text, flags=re.MULTILINE)


def test_a_decision_runs_through_the_steps_that_the_documentation_tells_in_its_order() -> None:
    names, ran = told(), list[str]()

    def noted(frame: FrameType, event: str, _: object) -> None:
        name = frame.f_code.co_name.replace("_", " ")
        if event == "call" and ROOM in frame.f_code.co_filename and name in names and name not in ran:
            ran.append(name)

    bench = Bench(Retuner(table(scaled(0.4, 0.4)), RetunerSettings(1.0, 10.0, Mode.AUTO)), seed=2)
    bench.run(400)
    before = sys.getprofile()
    sys.setprofile(noted)
    try:
        made = bench.run(500, 1.0)
    finally:
        sys.setprofile(before)
    assert made[0].action is Action.WRITE
    assert ran == [name for name in names if name in ran]
    assert set(names) - set(ran) <= {"objection", "proposal by all samples"}  # where there is a book by then


def test_the_documentation_begins_with_the_steps_of_the_findings() -> None:
    assert told()[: len(STEPS)] == [step.__name__.replace("_", " ") for step in STEPS]
