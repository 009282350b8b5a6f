"""The table of trial phases over the full product of phases and events."""

import itertools

import pytest

from retuner.adaptive.trial.phase import ABORTS, TRANSITIONS, UNDECIDED, UNDOS, TrialEvent, TrialPhase, after

P, E = TrialPhase, TrialEvent
STEPS = {
    P.IDLE: {E.PROPOSED: P.WRITING, E.URGENT: P.WRITING},
    P.WRITING: {E.WRITTEN: P.TRIAL, E.NOT_WRITTEN: P.IDLE},
    P.TRIAL: {E.LEFT: P.AWAY, E.PASSED: P.IDLE, E.PASSED_FOR_APPROVAL: P.WAITING},
    P.AWAY: {E.ENTERED: P.TRIAL},
    P.RESTORING: {E.RESTORED: P.COOLING},
    P.COOLING: {E.URGENT: P.WRITING, E.TOO_MANY_UNDOS: P.LOCKED, E.COOLED: P.IDLE},
    P.WAITING: {E.APPROVED: P.IDLE, E.ORDERED_BACK: P.RESTORING},
    P.LOCKED: {E.UNLOCKED: P.IDLE},
}
"""Written down once more by hand: everything but the aborts."""
PRODUCT = list(itertools.product(TrialPhase, TrialEvent))


@pytest.mark.parametrize(("phase", "event"), PRODUCT, ids=lambda value: value.name)
def test_every_phase_under_every_event(phase: TrialPhase, event: TrialEvent) -> None:
    expected = P.RESTORING if phase in UNDECIDED and event in ABORTS else STEPS[phase].get(event, phase)
    assert after(phase, event) is expected


def test_the_only_way_out_of_restoring_is_that_the_verified_set_was_read_back() -> None:
    assert {event for phase, event in TRANSITIONS if phase is P.RESTORING} == {E.RESTORED}


def test_only_a_change_that_is_asked_for_leads_to_a_write_and_only_a_read_back_to_a_trial() -> None:
    assert {event for (_, event), now in TRANSITIONS.items() if now is P.WRITING} == {E.PROPOSED, E.URGENT}
    assert {(phase, event) for (phase, event), now in TRANSITIONS.items() if now is P.TRIAL} == {
        (P.WRITING, E.WRITTEN),
        (P.AWAY, E.ENTERED),
    }


def test_an_undecided_phase_is_left_for_a_settled_one_only_by_passing_or_when_nothing_was_written() -> None:
    settled = {P.IDLE, P.WAITING, P.COOLING, P.LOCKED}
    ways = {event for (phase, event), now in TRANSITIONS.items() if phase in UNDECIDED and now in settled}
    assert ways == {E.PASSED, E.PASSED_FOR_APPROVAL, E.NOT_WRITTEN}


def test_a_locked_region_waits_for_a_person() -> None:
    assert {event for phase, event in TRANSITIONS if phase is P.LOCKED} == {E.UNLOCKED}


def test_every_undo_is_an_abort_cause_and_every_phase_can_be_reached() -> None:
    assert set(UNDOS) < set(ABORTS)
    assert set(TRANSITIONS.values()) == set(TrialPhase)
