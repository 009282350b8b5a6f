"""The table of trial phases over the full product of phases and events."""

import itertools

import pytest

from retuner.adaptive.trial.phase import (
    ABORTS,
    ROLLBACK_CAUSES,
    SILENT,
    TO_BE_SEEN,
    TRANSITIONS,
    UNDECIDED,
    UNSURE,
    TrialEvent,
    TrialPhase,
    after,
)

P, E = TrialPhase, TrialEvent
STEPS = {
    P.IDLE: {E.PROPOSED: P.WRITING, E.URGENT: P.WRITING, E.ORDERED: P.WRITING},
    P.WRITING: {E.WRITTEN: P.TRIAL, E.NOT_WRITTEN: P.IDLE},
    P.TRIAL: {
        E.LEFT: P.AWAY,
        E.PASSED: P.IDLE,
        E.PASSED_FOR_APPROVAL: P.WAITING,
        E.UNDECIDED: P.IDLE,
        E.UNDECIDED_FOR_APPROVAL: P.WAITING,
        E.STAYS: P.PAUSED,
        E.ENSURED: P.ENSURING,
    },
    P.AWAY: {E.ENTERED: P.TRIAL, E.UNDECIDED: P.IDLE, E.UNDECIDED_FOR_APPROVAL: P.WAITING},
    P.PAUSED: {E.LEFT: P.AWAY, E.WATCHED: P.TRIAL, E.ENSURED: P.ENSURING},
    P.ENSURING: {E.RESTORED: P.PAUSED},
    P.RESTORING: {E.RESTORED: P.COOLING, E.ENSURED: P.ENSURING},
    P.COOLING: {E.URGENT: P.WRITING, E.TOO_MANY_UNDOS: P.LOCKED, E.COOLED: P.IDLE},
    P.WAITING: {E.APPROVED: P.IDLE, E.ORDERED_BACK: P.RESTORING},
    P.LOCKED: {E.UNLOCKED: P.IDLE},
    P.HELD: {E.ORDERED: P.WRITING, E.HOLD_OVER: P.IDLE},
}
"""Written down once more by hand: everything but the causes that end a trial, and a person's edit."""
PRODUCT = list(itertools.product(TrialPhase, TrialEvent))


@pytest.mark.parametrize(("phase", "event"), PRODUCT, ids=lambda value: value.name)
def test_every_phase_under_every_event(phase: TrialPhase, event: TrialEvent) -> None:
    expected = P.RESTORING if phase in UNDECIDED and event in ABORTS else STEPS[phase].get(event, phase)
    if event is E.OPERATOR_EDIT and phase is not P.LOCKED:
        expected = P.HELD
    assert after(phase, event) is expected


def test_what_is_to_run_is_left_behind_only_by_a_read_back_or_a_persons_edit() -> None:
    """A write that was given up and came through after all makes it another set that is to run."""
    for waits, to in ((P.RESTORING, {P.COOLING, P.ENSURING, P.HELD}), (P.ENSURING, {P.PAUSED, P.RESTORING, P.HELD})):
        ways = {(event, now) for (phase, event), now in TRANSITIONS.items() if phase is waits}
        assert {now for _, now in ways} == to
        out = {event for event, now in ways if now not in TO_BE_SEEN}
        assert out == {E.RESTORED, E.OPERATOR_EDIT}


def test_only_a_change_that_is_asked_for_leads_to_a_write_and_only_a_read_back_to_a_trial() -> None:
    assert {event for (_, event), now in TRANSITIONS.items() if now is P.WRITING} == {E.PROPOSED, E.URGENT, E.ORDERED}
    assert {(phase, event) for (phase, event), now in TRANSITIONS.items() if now is P.TRIAL} == {
        (P.WRITING, E.WRITTEN),
        (P.AWAY, E.ENTERED),
        (P.PAUSED, E.WATCHED),
    }


def test_an_undecided_phase_is_left_for_a_settled_one_in_few_ways() -> None:
    settled = {P.IDLE, P.WAITING, P.COOLING, P.LOCKED, P.HELD}
    ways = {event for (phase, event), now in TRANSITIONS.items() if phase in UNDECIDED and now in settled}
    assert ways == {
        E.PASSED,
        E.PASSED_FOR_APPROVAL,
        E.UNDECIDED,
        E.UNDECIDED_FOR_APPROVAL,
        E.NOT_WRITTEN,
        E.OPERATOR_EDIT,
    }


def test_a_locked_region_waits_for_a_person() -> None:
    assert {event for phase, event in TRANSITIONS if phase is P.LOCKED} == {E.UNLOCKED}


def test_every_cause_is_of_one_kind_and_every_phase_can_be_reached() -> None:
    assert sorted(ABORTS) == sorted({*ROLLBACK_CAUSES, *SILENT, E.ORDERED_BACK})
    assert len(set(ABORTS)) == len(ABORTS)
    assert set(UNSURE) < set(SILENT)
    assert set(TRANSITIONS.values()) == set(TrialPhase)
