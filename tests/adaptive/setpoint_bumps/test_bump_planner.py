"""Setpoint bumps: when they begin, what ends them, and that the old setpoint always comes back."""

from dataclasses import replace
from itertools import pairwise

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from loop_bench import GOOD, made

from retuner import LoopMode, LoopSample, ProcessModel, ProcessType
from retuner.adaptive.diagnosis.second_opinion import Excitation
from retuner.adaptive.identification.plausible import Plausible
from retuner.adaptive.region_model.sequences import unsure
from retuner.adaptive.setpoint_bumps.bump_planner import (
    COURSE,
    HOLDS,
    SENT_AGAIN_SAMPLES,
    BumpEvent,
    BumpNews,
    BumpPhase,
    BumpPlanner,
    LoopAround,
)
from retuner.adaptive.setpoint_bumps.bump_settings import BumpSettings
from retuner.adaptive.setpoint_bumps.loop_bumps import LoopBumps

ALLOWED = BumpSettings(allowed=True, after_h=1.0, announce_s=60.0, longest_s=600.0)
CALM = LoopAround(at_rest=True, wanted="nothing is known", hour=12.0, band=0.1, low=0.0, high=100.0)


class Bench:
    """A loop whose controller takes every setpoint; pv follows at once."""

    def __init__(self, wanted: BumpSettings = ALLOWED, dt: float = 1.0) -> None:
        self.planner, self.dt = BumpPlanner(wanted, 100.0, dt), dt
        self.t, self.sp, self.news = 0.0, 50.0, list[BumpNews]()
        self.wander = 0.0

    def run(self, samples: int, around: LoopAround = CALM, *, deaf: bool = False, **sample: object) -> None:
        for _ in range(samples):
            self.t += self.dt
            seen = LoopSample(self.t, self.sp, self.sp + self.wander, 30.0, LoopMode.AUTO, False, self.sp)._replace(
                **sample
            )
            news = self.planner.step(seen, around)
            if news is not None:
                self.news.append(news)
            asked = news.setpoint if news is not None else self.planner.again(self.t)
            if asked is not None and not deaf:
                self.sp = asked

    @property
    def causes(self) -> list[BumpEvent]:
        return [news.cause for news in self.news]

    def out(self) -> None:
        """A bump is out."""
        self.run(3600 + 62)
        assert self.planner.phase is BumpPhase.HOLDING
        assert self.sp == 51.0


def around(**changes: object) -> LoopAround:
    return LoopAround(**{name: getattr(CALM, name) for name in LoopAround.__slots__} | changes)


@pytest.fixture
def bench() -> Bench:
    return Bench()


def test_nothing_happens_unless_it_is_allowed() -> None:
    bench = Bench(BumpSettings(after_h=0.001, announce_s=0.0))
    bench.run(5000)
    assert (bench.news, bench.sp) == ([], 50.0)


def test_a_bump_is_announced_made_and_taken_back_when_the_loop_is_at_rest(bench: Bench) -> None:
    bench.run(3600)
    assert bench.news == []
    bench.run(1)
    assert bench.causes == [BumpEvent.DUE]
    assert "in 60 s the setpoint goes from 50 to 51" in bench.news[0].reason
    bench.run(60)
    assert (bench.causes[-1], bench.sp) == (BumpEvent.BEGUN, 51.0)
    bench.run(30, around(at_rest=False))
    assert (bench.planner.phase, bench.sp) == (BumpPhase.HOLDING, 51.0)
    bench.run(1)
    assert (bench.causes[-1], bench.sp) == (BumpEvent.AT_REST, 50.0)
    bench.run(SENT_AGAIN_SAMPLES + 1)
    assert bench.causes == [BumpEvent.DUE, BumpEvent.BEGUN, BumpEvent.TAKEN, BumpEvent.AT_REST, BumpEvent.BACK]


def test_bumps_go_up_and_down_in_turn_and_keep_to_their_budgets() -> None:
    bench = Bench(BumpSettings(allowed=True, after_h=1.0, announce_s=0.0, most_per_day=2, most=3), dt=60.0)
    bench.run(1440)
    assert len(bench.planner.made) == 2
    assert [news.to for news in bench.news if news.cause is BumpEvent.DUE] == [51.0, 49.0]
    bench.run(3 * 1440)
    assert len(bench.planner.made) == 3


@pytest.mark.parametrize("unfit", [{"wanted": ""}, {"at_rest": False}, {"low": 49.5, "high": 50.5}])
def test_no_bump_is_announced_to_a_loop_that_is_not_fit_for_it(bench: Bench, unfit: dict[str, object]) -> None:
    bench.run(5000, around(**unfit))
    assert bench.news == []


def test_a_bump_that_would_drown_in_the_noise_is_not_made_and_that_is_told_once(bench: Bench) -> None:
    bench.run(5000, around(band=0.4))
    assert (bench.causes, bench.sp) == ([BumpEvent.TOO_SMALL], 50.0)
    assert "is 2.5 noise bands, and 4 are needed" in bench.news[0].reason
    assert bench.news[0].reason.endswith("adaptation.bumps.percent = 1.6 would be enough")


@pytest.mark.parametrize("sample", [{"mode": LoopMode.MANUAL}, {"limited": True}, {"pv": 51.0}])
def test_no_bump_is_announced_while_the_loop_does_not_regulate(bench: Bench, sample: dict[str, object]) -> None:
    bench.run(5000, **sample)
    assert bench.news == []


def test_the_other_side_is_taken_where_one_has_no_room(bench: Bench) -> None:
    bench.run(3601, around(high=50.5))
    assert bench.news[0].to == 49.0


@pytest.mark.parametrize(("hour", "due"), [(21.9, False), (22.0, True), (3.0, True), (5.0, False), (12.0, False)])
def test_hours_may_go_over_midnight(hour: float, due: bool) -> None:
    bench = Bench(BumpSettings(allowed=True, after_h=0.1, from_h=22.0, to_h=5.0))
    bench.run(400, around(hour=hour))
    assert bool(bench.news) is due


def test_whoever_moves_the_setpoint_puts_an_announced_bump_off(bench: Bench) -> None:
    bench.run(3610)
    bench.sp = 55.0
    bench.run(200)
    assert (bench.causes, bench.sp) == ([BumpEvent.DUE, BumpEvent.OTHERS], 55.0)


def test_a_setpoint_that_somebody_else_sets_during_a_bump_stays(bench: Bench) -> None:
    bench.out()
    bench.sp = 55.0
    bench.run(100)
    assert (bench.causes[-1], bench.sp, bench.planner.phase) == (BumpEvent.OTHERS, 55.0, BumpPhase.WATCHING)


@pytest.mark.parametrize(
    ("sample", "cause"),
    [
        ({"pv": 46.0}, BumpEvent.EXCURSION),
        ({"limited": True}, BumpEvent.LIMITED),
        ({"mode": LoopMode.MANUAL}, BumpEvent.NOT_IN_AUTO),
    ],
)
def test_trouble_takes_a_bump_back_at_once(bench: Bench, sample: dict[str, object], cause: BumpEvent) -> None:
    bench.out()
    bench.run(1, **sample)
    assert (bench.causes[-1], bench.sp) == (cause, 50.0)


def test_a_loop_that_does_not_come_to_rest_gets_its_setpoint_back_in_time(bench: Bench) -> None:
    bench.out()
    bench.run(602, around(at_rest=False))
    assert (bench.causes[-1], bench.sp) == (BumpEvent.TOO_LONG, 50.0)


def test_the_end_of_a_session_takes_a_bump_back(bench: Bench) -> None:
    bench.out()
    news = bench.planner.end(bench.t)
    assert (news.cause, news.setpoint) == (BumpEvent.ENDED, 50.0)
    assert bench.planner.end(bench.t) is None


def test_a_setpoint_that_is_not_taken_is_sent_again_and_then_given_up(bench: Bench) -> None:
    bench.run(3600)
    bench.run(61 + 45, deaf=True)
    assert bench.causes[-1] is BumpEvent.NOT_TAKEN
    bench.run(60)
    assert (bench.causes[-1], bench.sp) == (BumpEvent.BACK, 50.0)


def test_what_a_session_before_left_out_goes_back_first(bench: Bench) -> None:
    bench.sp = 51.0
    bench.planner.resume_bumped(50.0, 51.0)
    bench.run(3)
    assert (bench.sp, bench.planner.out) == (50.0, True)
    told = [(news.cause, news.phase, news.setpoint, news.before, news.to) for news in bench.news]
    assert told == [(BumpEvent.LEFT_OUT, BumpPhase.RETURNING, 50.0, 50.0, 51.0)]  # a row: it may be killed again
    bench.run(SENT_AGAIN_SAMPLES + 2)
    assert not bench.planner.out


def test_evidence_begins_the_waiting_anew(bench: Bench) -> None:
    bench.run(3000)
    bench.planner.evidence(bench.t)
    bench.run(3000)
    assert bench.news == []


def restless() -> Bench:
    """A loop that is never at rest, with its bump begun."""
    bench = Bench()
    bench.wander = 0.2
    bench.run(3600 + 62, around(at_rest=False))
    return bench


def test_a_loop_that_is_never_at_rest_is_bumped_to_and_fro() -> None:
    bench = restless()
    assert "goes from 50 to 51 and 49 in turn, 14 times in all, and back" in bench.news[0].reason
    since, seen = bench.t, [bench.sp]
    times = []
    for _ in range(300):
        bench.run(1, around(at_rest=False))
        if bench.sp != seen[-1]:
            seen.append(bench.sp)
            times.append(bench.t - since)
    assert seen == [51.0, 49.0] * 7 + [50.0]
    unit = times[0] / HOLDS[0]
    for held, (a, b) in zip(HOLDS[1:], pairwise(times), strict=True):
        assert abs(b - a - max(held * unit, 5.0)) <= 2.0
    assert len(bench.planner.made) == 1


def test_what_the_evidence_has_left_makes_no_loop_restless(bench: Bench) -> None:
    bench.wander = 0.2
    bench.run(1500, around(at_rest=False))
    bench.wander = 0.0
    bench.run(2200)
    assert "until the loop is at rest, and back" in bench.news[0].reason


def test_to_and_fro_needs_room_on_both_sides(bench: Bench) -> None:
    bench.wander = 0.2
    bench.run(4000, around(at_rest=False, high=50.5))
    assert bench.news == []


@pytest.mark.parametrize("after", [5, 25, 40, 61, 100])
def test_wherever_to_and_fro_ends_the_old_setpoint_comes_back(after: int) -> None:
    bench = restless()
    bench.run(after, around(at_rest=False))
    assert bench.sp in {51.0, 49.0}
    bench.run(1 + (bench.causes[-1] is BumpEvent.NEXT), around(at_rest=False), limited=True)
    assert (bench.causes[-1], bench.sp) == (BumpEvent.LIMITED, 50.0)
    bench.run(SENT_AGAIN_SAMPLES + 2, around(at_rest=False))
    assert not bench.planner.out


def test_every_phase_in_which_the_setpoint_is_out_ends_with_the_session() -> None:
    for phase in BumpPhase:
        after = COURSE.get((phase, BumpEvent.ENDED), phase)
        assert after in {BumpPhase.WATCHING, BumpPhase.RETURNING}


Doing = st.tuples(
    st.integers(1, 80),
    st.booleans(),
    st.booleans(),
    st.sampled_from([LoopMode.AUTO, LoopMode.AUTO, LoopMode.AUTO, LoopMode.MANUAL]),
    st.sampled_from([None, None, None, 55.0]),
    st.booleans(),
)


@settings(max_examples=60)
@given(st.lists(Doing, max_size=12))
def test_whatever_happens_only_two_setpoints_are_ever_asked_for_and_the_old_one_comes_back(doings) -> None:
    bench = Bench(BumpSettings(allowed=True, after_h=0.001, announce_s=5.0, longest_s=40.0, most_per_day=100))
    theirs = 50.0
    for samples, at_rest, limited, mode, moved, deaf in doings:
        if moved is not None:
            bench.sp = theirs = moved
        bench.run(samples, around(at_rest=at_rest), deaf=deaf, mode=mode, limited=limited)
        assert abs(bench.sp - theirs) <= 1.0
    news = bench.planner.end(bench.t)
    if news is not None and news.setpoint is not None:
        bench.sp = news.setpoint
    bench.run(60, around(wanted=""))
    assert bench.sp == theirs


@pytest.mark.parametrize("to_and_fro", [False, True])
def test_a_mode_that_forbids_it_ends_a_bump_at_once(bench: Bench, to_and_fro: bool) -> None:
    bench.wander = 0.3 if to_and_fro else 0.0
    bench.out()
    bench.run(1, around(allowed=False))
    assert bench.causes[-1] is BumpEvent.NOT_ALLOWED
    assert bench.sp == 50.0
    bench.run(20, around(allowed=False))
    assert bench.planner.phase is BumpPhase.WATCHING
    assert bench.sp == 50.0


def test_nor_is_one_sent_that_a_person_has_just_forbidden(bench: Bench) -> None:
    bench.run(3600 + 62, deaf=True)
    assert bench.planner.phase is BumpPhase.GOING
    bench.run(1, around(allowed=False), deaf=True)
    assert bench.causes[-1] is BumpEvent.NOT_ALLOWED
    assert bench.news[-1].setpoint == 50.0


def test_an_error_as_large_as_the_loads_usually_make_it_is_no_excursion() -> None:
    """Loads of full size move a loop by several bumps all the time: that is not the bump's doing."""
    bench, moved = Bench(), around(at_rest=False)
    bench.wander = 3.0
    bench.run(3599, moved)
    bench.wander = 0.2  # pv comes by its setpoint, and the bump begins
    bench.run(64, moved)
    assert bench.planner.phase is BumpPhase.HOLDING
    bench.run(3, moved, pv=bench.sp + 6.0)
    assert BumpEvent.EXCURSION not in bench.causes
    bench.run(1, moved, pv=bench.sp + 13.0)
    assert bench.causes[-1] is BumpEvent.EXCURSION


def held(slow: bool) -> list[float]:
    """How long the setpoints of two sequences were held; slow : at first the error takes 20 samples to halve."""
    bench, moved = Bench(replace(ALLOWED, most_per_day=5)), around(at_rest=False)
    times: list[float] = []
    bench.wander = 0.2
    bench.run(3600 + 62, moved)
    bench.run(20 if slow else 0, moved, pv=bench.sp + 0.9)
    while len(times) < 2 * len(HOLDS) + 1:
        before = bench.sp
        bench.run(1, moved)
        times += [bench.t] if bench.sp != before else []
    return [b - a for a, b in pairwise(times)]


def test_a_load_that_halves_the_error_sooner_does_not_shorten_the_next_sequence() -> None:
    quick, slow = held(slow=False), held(slow=True)
    assert slow[0] > 1.5 * quick[0]
    assert slow[: len(HOLDS) - 1] == pytest.approx(slow[-len(HOLDS) + 1 :], abs=1.0)


def test_a_slow_controller_is_not_taken_for_a_quick_loop_by_a_load_that_helps() -> None:
    bench = restless()
    slow = around(at_rest=False, reset_s=80.0)
    for _ in range(60):
        bench.run(1, slow)
    assert bench.causes[-1] is not BumpEvent.NEXT
    assert BumpEvent.NEXT in _causes_after(bench, slow)


def _causes_after(bench: Bench, moved: LoopAround) -> list[BumpEvent]:
    bench.run(60, moved)
    return bench.causes


def test_a_step_to_the_other_side_is_no_excursion_by_itself() -> None:
    """To and fro, pv stands two bumps from a setpoint that has just moved: what counts is how far it went."""
    bench, moved = Bench(), around(at_rest=False)
    bench.wander = 3.0
    bench.run(3599, moved)
    bench.wander = 0.2
    bench.run(64, moved)
    far = 4.0 * (1 + 3.0**2) ** 0.5
    bench.run(1, moved, pv=50.0 - (far - 0.6))
    assert BumpEvent.EXCURSION not in bench.causes
    bench.run(1, moved, pv=50.0 - (far + 0.4))
    assert bench.causes[-1] is BumpEvent.EXCURSION


# ---- What a bump would teach: where loads never rest, single responses are not enough however many agree

SOON = BumpSettings(allowed=True, percent=5.0, after_h=0.1, announce_s=0.0)


def news(load: float) -> list[BumpNews]:
    """Of a loop whose process two setpoint steps have shown, under loads of that size to both sides."""
    bench = made(GOOD)
    bench.run(400)
    bench.run(400, 1.0)
    bench.run(400, 0.0)
    known = bench.retuner.region_models[0]
    assert known.identifiable
    assert known.records > 1
    bumper, found = LoopBumps(SOON, bench.retuner), []
    for i in range(40):
        for sample in bench.samples(20, 0.0, load if i % 2 else -load, 10.0):
            bench.retuner.observe(sample)
            bench.retuner.region_models[0] = known
            bench.retuner.excitation[0] = replace(Excitation(), setpoints=2)
            found.append(bumper.step(sample))
    return [one for one in found if one is not None]


def test_a_loop_that_rests_and_is_known_from_two_records_needs_no_bump() -> None:
    assert news(0.0) == []


@pytest.mark.slow
@pytest.mark.uncounted
def test_where_loads_never_rest_what_single_responses_say_is_not_enough() -> None:
    first = news(1.0)[0]
    assert first.cause is BumpEvent.DUE
    assert 'the model of region "a" rests on single responses' in first.reason


def test_bumps_go_on_until_they_have_told_the_settings_well() -> None:
    """Not a count of them decides, but how far apart the settings are that the models still ask for."""
    rough = Plausible(ProcessModel(ProcessType.FOPDT, 1.0, 50.0, 0.0, 5.0), 0.0)
    steep = Plausible(ProcessModel(ProcessType.FOPDT, 1.6, 50.0, 0.0, 5.0), 2.0)
    bench = made(GOOD)
    bench.run(400)
    bench.run(400, 1.0)
    known = replace(bench.retuner.region_models[0], records=6)
    assert unsure(replace(known, plausible=(rough, rough)), 1.0) == ""
    assert "known within a factor of" in unsure(replace(known, plausible=(rough, steep)), 1.0)
