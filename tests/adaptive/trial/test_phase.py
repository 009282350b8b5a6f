"""The table of trial phases over the full product of phases and events."""

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
)

P, E = TrialPhase, TrialEvent


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
