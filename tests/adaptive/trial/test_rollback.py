"""What runs after a cause is what is expected to lose least, over the models as what was seen weighs them."""

import itertools
import math
from collections.abc import Iterable
from dataclasses import replace
from functools import cache

import pytest
from effort import examples
from hypothesis import example, given, settings
from hypothesis import strategies as st

from retuner import LinearProcess, LoopMode, LoopSample, PidGains, ProcessModel, ProcessType
from retuner.adaptive.guard.step_size import less_of_everything
from retuner.adaptive.identification.plausible import Plausible
from retuner.adaptive.loop.margins import sensitivity_peak
from retuner.adaptive.trial.phase import ABORTS, ROLLBACK_CAUSES, SILENT, UNDECIDED, TrialEvent, TrialPhase
from retuner.adaptive.trial.prediction import Prediction, predict
from retuner.adaptive.trial.rollback import (
    NOTHING_KNOWN,
    PRICE,
    SetRecord,
    SetsThatRan,
    StillAllowed,
    expected_losses,
    less_stable,
    loss_of,
    rollback,
)
from retuner.adaptive.trial.supervisor import TrialSupervisor
from retuner.adaptive.trial.trial import Trial
from retuner.adaptive.trial.trial_settings import TrialSettings

P, E = TrialPhase, TrialEvent
PROCESS = LinearProcess(1.0, (50.0,), (), 5.5)
SETS = {
    "weak": PidGains(1.0, 0.02),
    "right": PidGains(4.5, 0.1),
    "right too": PidGains(5.0, 0.11),
    "swinging": PidGains(9.5, 0.3),
    "swinging more": PidGains(11.0, 0.4),
    "unstable": PidGains(20.0, 0.5),
}
HARMLESS = TrialSettings().harmless_ms
PAIRS = list(itertools.permutations(SETS, 2))


def ms(gains: PidGains, process: LinearProcess = PROCESS) -> float:
    return sensitivity_peak(process, gains)


def test_the_sets_are_what_they_are_called() -> None:
    found = [ms(gains) for gains in SETS.values()]
    assert found == sorted(found)
    assert found[2] < HARMLESS < found[3]
    assert math.isfinite(found[4])
    assert math.isinf(found[5])


@cache
def said(old: PidGains, tried: PidGains) -> Prediction:
    return predict([Plausible(ProcessModel(ProcessType.FOPDT, 1.0, 50.0, 0.0, 5.0), 0.0)], old, tried, 1.0)


class Bench:
    """A region in a phase, by its state, and the table."""

    def __init__(self, phase: TrialPhase, old: PidGains, tried: PidGains, known: StillAllowed) -> None:
        self.ran = phase is not P.WRITING
        self.table = {0: tried if self.ran else old}
        self.trials = TrialSupervisor(TrialSettings(), 1.0, self.table.__setitem__, lambda _: known, pv_range=(-3, 20))
        trial = Trial(phase, old, tried, said(old, tried), self.ran, cause=E.LOST_TELEMETRY)
        self.trials.resume({"at": 0, "trials": {"0": trial.to_dict()}})


@pytest.mark.parametrize("phase", UNDECIDED, ids=lambda p: p.name)
@pytest.mark.parametrize("cause", ABORTS, ids=lambda c: c.name)
def test_every_undecided_phase_under_every_cause_with_either_set_the_more_robust(phase, cause):
    known = StillAllowed((PROCESS,))
    for one, other in PAIRS:
        old, tried = SETS[one], SETS[other]
        bench = Bench(phase, old, tried, known)
        before = bench.table[0]
        bench.trials.event(0, cause, 1.0)
        now = bench.table[0]
        assert now in {old, tried}
        if not bench.ran:
            assert now == old
        elif cause is E.ORDERED_BACK:
            assert now == (tried if math.isinf(ms(old)) else old), (
                "a person may choose a larger Ms, not an unstable loop"
            )
        elif cause in ROLLBACK_CAUSES and max(ms(old), ms(tried)) <= HARMLESS:
            assert now == old, "both are robust: what was seen decides"
        else:
            assert loss_of(ms(now), HARMLESS) <= loss_of(ms(before), HARMLESS) + PRICE, (one, other)
            assert math.isfinite(ms(now)) or math.isinf(ms(before))
        if cause in SILENT and bench.ran and ms(tried) <= HARMLESS:
            assert now == tried, "nothing speaks against it"
        bench.trials.restored(2.0)
        assert bench.table[0] == now
        assert not bench.trials.restoring


@pytest.mark.parametrize("cause", sorted({*ABORTS} - {*ROLLBACK_CAUSES, E.ORDERED_BACK}), ids=lambda c: c.name)
def test_a_cure_stays_and_goes_on_being_tried(cause: TrialEvent) -> None:
    bench = Bench(P.TRIAL, SETS["unstable"], SETS["right"], StillAllowed((PROCESS,)))
    assert bench.trials.event(0, cause, 1.0)
    bench.trials.restored(2.0)
    assert bench.table[0] == SETS["right"]
    assert bench.trials.phase(0) is (P.IDLE if cause is E.TIMED_OUT else P.PAUSED)
    back = bench.trials.of(0).back
    assert back is not None
    assert "previous gains unstable" in back.reason


@pytest.mark.parametrize("cause", ABORTS, ids=lambda c: c.name)
def test_a_cause_that_goes_on_is_put_to_a_region_once(cause: TrialEvent) -> None:
    bench = Bench(P.TRIAL, SETS["unstable"], SETS["right"], StillAllowed((PROCESS,)))
    assert bench.trials.abort(cause, 1.0) == (0,)
    bench.trials.restored(2.0)
    assert bench.trials.abort(cause, 3.0) == ()


def test_the_end_of_a_session_that_waits_is_put_to_a_region_once_whatever_the_samples_say() -> None:
    bench = Bench(P.TRIAL, SETS["unstable"], SETS["right"], StillAllowed((PROCESS,)))
    assert bench.trials.abort(E.STOPPED, 1.0) == (0,)
    bench.trials.restored(2.0)
    for number in range(40):
        mode = LoopMode.AUTO if number % 4 else LoopMode.MANUAL
        sample = LoopSample(3.0 + number, 50.0, 50.0, 50.0, mode, 0, 50.0, 1)
        assert not bench.trials.watch(sample, 0, 0.1, 1.0, 5.0, blended=False)
        assert bench.trials.abort(E.LOST_TELEMETRY, sample.t_s) == ()
        assert bench.trials.abort(E.STOPPED, sample.t_s) == ()
    assert bench.trials.abort(E.DEVICE_REVERTED, 50.0) == (0,), "what runs is to be seen again"


def test_a_cure_whose_write_was_given_up_and_came_through_stays() -> None:
    old, tried = SETS["unstable"], SETS["right"]
    for known in (StillAllowed((PROCESS,)), NOTHING_KNOWN):  # what it was proved on still says so
        bench = Bench(P.WRITING, old, tried, known)
        bench.trials.event(0, E.STOPPED, 1.0)
        assert bench.table[0] == old
        assert bench.trials.written(0, tried, 2.0)
        assert bench.trials.phase(0) is P.ENSURING
    bench = Bench(P.WRITING, SETS["swinging"], tried, NOTHING_KNOWN)
    bench.trials.event(0, E.STOPPED, 1.0)
    assert not bench.trials.written(0, tried, 2.0)
    assert bench.trials.phase(0) is P.RESTORING


def test_evidence_against_a_set_leads_to_what_is_expected_to_lose_least_of_all_that_ran() -> None:
    known, worse = StillAllowed((PROCESS,)), E.WORSE
    old, tried = SETS["swinging more"], SETS["swinging"]
    assert rollback(worse, SetsThatRan(old, tried, swings=0.6), known, TrialSettings()).gains == tried
    assert rollback(worse, SetsThatRan(tried, old, swings=0.1), known, TrialSettings()).gains == tried, "it has worked"
    earlier = (SETS["unstable"], SETS["right"])
    found = rollback(worse, SetsThatRan(old, tried, earlier, swings=0.6), known, TrialSettings())
    assert found.gains == SETS["right"]
    assert "an earlier set" in found.reason
    assert not found.stays


@pytest.mark.parametrize("cause", ROLLBACK_CAUSES, ids=lambda c: c.name)
def test_no_evidence_leads_back_to_more_action_that_is_unstable_on_every_model(cause: TrialEvent) -> None:
    """The old gains have worked, then the process changed: what swings under less of them runs away under them."""
    known, old, tried = StillAllowed((PROCESS,)), SETS["unstable"], PidGains(9.5, 0.22)
    assert ms(tried) > HARMLESS
    assert rollback(cause, SetsThatRan(old, tried, swings=0.1), known, TrialSettings()).gains == tried
    earlier = (SETS["swinging more"], SETS["right"], SETS["weak"])
    found = rollback(cause, SetsThatRan(old, tried, earlier, swings=0.1), known, TrialSettings())
    assert found.gains == SETS["right"]


def test_evidence_weighs_the_models_and_strikes_none_out() -> None:
    """Of two that are as likely the one that explains a bad response decides."""
    explains, explains_not = PROCESS, LinearProcess(0.3, (50.0,), (), 5.5)
    old, tried = SETS["right"], SETS["unstable"]
    losses = {
        gains: [1.0 - HARMLESS / max(ms(gains, p), HARMLESS) for p in (explains, explains_not)]
        for gains in (old, tried)
    }
    assert losses[tried][0] == 1.0
    assert losses[tried][1] < 0.1
    table = {gains: [ms(gains, p) for p in (explains, explains_not)] for gains in (old, tried)}
    quiet, unseen = expected_losses(table, (0.5, 0.5), {}, HARMLESS)
    bad, seen = expected_losses(table, (0.5, 0.5), {tried: SetRecord(1, 0)}, HARMLESS)
    assert quiet[tried] < 0.6
    assert bad[tried] > 0.85
    assert seen == pytest.approx(unseen, abs=0.01)  # one of the models explains it: nothing else is looked for
    robust_only = {gains: row[1:] for gains, row in table.items()}
    assert expected_losses(robust_only, (1.0,), {tried: SetRecord(1, 0)}, HARMLESS)[1] > 0.4


def test_an_unlikely_model_counts_for_as_much_as_it_is_likely() -> None:
    old, tried = SETS["right"], SETS["swinging"]
    calm = LinearProcess(0.3, (50.0,), (), 5.5)
    for weights, stays in (((1.0, 0.02), True), ((1.0, 1.0), False)):
        known = StillAllowed((calm, PROCESS), weights=weights)
        assert rollback(E.STOPPED, SetsThatRan(old, tried, swings=0.1), known, TrialSettings()).stays is stays


def test_where_an_unlikely_model_speaks_against_the_set_that_stays_the_words_say_why_it_does() -> None:
    known = StillAllowed((PROCESS, LinearProcess(0.3, (10.0,), (), 14.0)), weights=(1.0, 0.05))
    back = rollback(E.WORSE, SetsThatRan(PidGains(1.0, 0.2), SETS["right"], swings=0.1), known, TrialSettings())
    assert back.stays
    assert "trial gains Ms at most 4.64, previous gains Ms at most 3.98; by how likely each is" in back.reason
    robust = rollback(E.GAP, SetsThatRan(SETS["weak"], SETS["right"], swings=0.1), known, TrialSettings())
    assert robust.stays
    assert "lose less" not in robust.reason


@pytest.mark.parametrize(("weight", "back"), [(0.02, True), (0.5, False)])
def test_a_door_is_closed_by_models_that_are_likely(weight: float, back: bool) -> None:
    """One model of a hundred that calls the set before unstable kept it out, however unlikely it was."""
    calm = LinearProcess(0.3, (50.0,), (), 5.5)
    known = StillAllowed((calm, PROCESS), weights=(1.0, weight))
    assert (less_stable(SETS["unstable"], SETS["right"], known, HARMLESS) == "") is back
    bench = Bench(P.TRIAL, SETS["unstable"], SETS["right"], known)
    assert bool(bench.trials.no_rollback(0)) is not back, "nor does a person's order lead there"


def test_without_a_model_what_was_seen_decides() -> None:
    less = PidGains(SETS["right"].kp / 2, SETS["right"].ki / 2)
    for swung, tried, stays in (
        (1.0, less, True),
        (0.4, less, False),
        (None, less, False),
        (1.0, PidGains(1.2 * SETS["right"].kp, 1.2 * SETS["right"].ki), False),
    ):
        ran = SetsThatRan(SETS["right"], tried, swung=swung)
        assert rollback(E.STOPPED, ran, NOTHING_KNOWN, TrialSettings()).stays is stays
        assert not rollback(E.RUNAWAY, ran, NOTHING_KNOWN, TrialSettings()).stays


def test_a_person_is_told_when_the_rollback_leads_to_an_unstable_loop() -> None:
    for old, tried, said in (
        ("unstable", "right", True),
        ("swinging", "right", False),
        ("unstable", "unstable", False),
    ):
        bench = Bench(P.TRIAL, SETS[old], SETS[tried], StillAllowed((PROCESS,)))
        assert bool(bench.trials.no_rollback(0)) is said


GAINS = st.builds(PidGains, st.floats(0.3, 30.0), st.floats(0.003, 2.0))
PROCESSES = st.builds(
    lambda k, tau, theta: LinearProcess(k, (tau,), (), theta), st.floats(0.3, 3.0), st.floats(5, 200), st.floats(1, 20)
)


@settings(max_examples=examples(60))
@given(
    st.sampled_from([c for c in ABORTS if c is not E.ORDERED_BACK]),
    st.lists(GAINS, min_size=2, max_size=4, unique=True),
    st.lists(PROCESSES, min_size=1, max_size=3),
)
def test_whatever_is_known_and_ran_a_set_robust_on_all_models_never_gives_way_to_one_unstable_on_all(
    cause: TrialEvent, sets: list[PidGains], processes: list[LinearProcess]
) -> None:
    """Where nothing speaks against it: neither was it bad, nor does it act more in everything than what was."""
    old, tried, *earlier = sets
    found = rollback(
        cause, SetsThatRan(old, tried, tuple(earlier), swings=1.0), StillAllowed(tuple(processes)), TrialSettings()
    )
    assert found.gains in sets
    first = old if cause in ROLLBACK_CAUSES else tried
    worst = {gains: [ms(gains, p) for p in processes] for gains in sets}
    if max(worst[first]) <= HARMLESS and not (cause in ROLLBACK_CAUSES and less_of_everything(old, tried)):
        assert not all(map(math.isinf, worst[found.gains]))
    if cause in SILENT and max(worst[tried]) <= HARMLESS:
        assert found.stays


def test_a_swing_under_calmer_gains_is_no_reason_to_go_back_to_more_action() -> None:
    """A loop whose gain had grown in the meantime was made unstable by that."""
    swung = SetsThatRan(SETS["unstable"], SETS["right"], swings=0.0)
    for cause in ROLLBACK_CAUSES:
        back = rollback(cause, swung, StillAllowed((PROCESS,)), TrialSettings())
        assert back.gains == SETS["right"]
        assert "previous gains unstable" in back.reason


def test_what_swung_on_and_is_unstable_on_every_model_does_not_come_back() -> None:
    """Tried gains that act less in kp alone had gone back to a swing that grew: no model was left that said why not."""
    before, acts_more = PidGains(18.0, 0.1), PidGains(4.5, 0.11)
    assert math.isinf(ms(before))
    assert ms(acts_more) <= HARMLESS
    assert not less_of_everything(before, acts_more)
    grew, worked = (SetsThatRan(before, acts_more, swung=s, swings=s) for s in (1.3, 0.1))
    for cause in ROLLBACK_CAUSES:
        assert rollback(cause, grew, StillAllowed((PROCESS,)), TrialSettings()).stays
        assert rollback(cause, worked, StillAllowed((PROCESS,)), TrialSettings()).stays


@pytest.mark.parametrize(
    ("before", "furthest", "swung", "back"),
    [
        ("swinging more", 2.0, None, True),
        ("swinging more", 30.0, None, False),
        ("swinging more", 2.0, 1.1, False),
        ("unstable", 2.0, None, False),
    ],
)
def test_pv_that_leaves_its_range_leads_back_to_a_set_that_kept_it_there_whatever_models_say(
    before: str, furthest: float, swung: float | None, back: bool
) -> None:
    """A process that runs away swings far to one side, and no model has an unstable pole: less gain looks safer."""
    old, tried = SETS[before], SETS["right"]
    bench = Bench(P.TRIAL, old, tried, StillAllowed((PROCESS,)))
    promise = replace(said(old, tried), furthest=furthest, decay_seen=swung)
    bench.trials.resume({"at": 0, "trials": {"0": replace(bench.trials.of(0), prediction=promise).to_dict()}})
    for i, pv in enumerate([0.0, 1.0, 1.0, -6.0, -6.0, 1.0, 1.0, -6.0, 1.0]):
        bench.trials.watch(LoopSample(float(i), 0.0, pv, 0.0), 0, 0.1, 1.0, 5.0, blended=False)
    assert (bench.table[0] == old) is back


# One door: whatever is put to it, nothing comes back that is less stable than what runs.

NEXT_TO_UNSTABLE = [PidGains(1.0, 1.0), PidGains(6.0, 1.0)], [(LinearProcess(1.0, (8.0,), (), 2.0), 1.0)]
"""Ms 730 ran: its loss is next to that of the unstable set before."""


def expected(known: StillAllowed, each: Iterable[float]) -> float:
    return sum(weight * one for weight, one in zip(known.likely(), each, strict=True))


@example(E.WORSE, P.TRIAL, *NEXT_TO_UNSTABLE, None)
@settings(max_examples=examples(150))
@given(
    st.sampled_from(ABORTS),
    st.sampled_from(UNDECIDED),
    st.lists(GAINS, min_size=2, max_size=4, unique=True),
    st.lists(st.tuples(PROCESSES, st.floats(0.02, 1.0)), min_size=1, max_size=4),
    st.sampled_from([None, 0.1, 0.5, 1.2]),
)
def test_every_abort_ends_on_a_set_that_is_no_less_stable_than_what_ran(cause, phase, sets, models, swung):
    old, tried, *earlier = sets
    known = StillAllowed(tuple(p for p, _ in models), weights=tuple(w for _, w in models))
    bench = Bench(phase, old, tried, known)
    trial = replace(bench.trials.of(0), earlier=tuple(earlier), prediction=replace(said(*STEADY), decay_seen=swung))
    bench.trials.resume({"at": 0, "trials": {"0": trial.to_dict()}})
    ran = bench.table[0]
    bench.trials.event(0, cause, 1.0)
    bench.trials.restored(2.0)
    now = bench.table[0]
    assert now in sets
    each = [known.ms(gains) for gains in (ran, now)]
    ran_unstable, now_unstable = (expected(known, map(math.isinf, row)) for row in each)
    ran_loses, now_loses = (expected(known, [loss_of(ms, HARMLESS) for ms in row]) for row in each)
    assert now_unstable <= ran_unstable + PRICE
    assert cause is E.ORDERED_BACK or now_loses <= ran_loses + PRICE
    if cause is not E.ORDERED_BACK and all(map(math.isinf, each[1])):
        assert now == ran or not less_of_everything(now, ran), "of two lost sets never the one that acts more"


STEADY = (SETS["right"], SETS["right too"])


@pytest.mark.parametrize("cause", [*ROLLBACK_CAUSES, E.ORDERED_BACK, *SILENT], ids=lambda c: c.name)
def test_a_rescued_loop_stays_rescued_after_every_cause_with_models_and_without(cause: TrialEvent) -> None:
    """kc 4.5, tau_I / 4 and worse: unstable on all 11 models; a tone made the judge and the watch speak."""
    old, tried = PidGains(16.0, 1.6), SETS["right"]
    eleven = tuple(LinearProcess(1.0 + 0.03 * i, (50.0,), (), 5.5) for i in range(-5, 6))
    assert all(math.isinf(ms(old, one)) and ms(tried, one) < HARMLESS for one in eleven)
    for known in (StillAllowed(eleven), NOTHING_KNOWN):
        bench = Bench(P.TRIAL, old, tried, known)
        bench.trials.event(0, cause, 1.0)
        bench.trials.restored(2.0)
        assert bench.table[0] == tried
        back = bench.trials.of(0).back
        assert back is not None
        assert "unstable" in back.reason or cause is E.TIMED_OUT
