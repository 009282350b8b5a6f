"""Trial and undo on the whole stack: every phase under every abort cause ends with the verified set running."""

from collections.abc import Callable

import pytest
from effort import examples, pairs
from hypothesis import given, settings
from hypothesis import strategies as st
from wire import FOREIGN, GOOD, OTHER, PROMISE, Wire, is_telemetry, wires

from retuner import Lookup, PidGains
from retuner.adaptive.supervision.decision import Action, Mode, Outcome
from retuner.adaptive.trial.phase import TrialEvent, TrialPhase
from retuner.drivers.protocol.checksum import to_wire
from retuner.session.running import to_the_end

P = TrialPhase
BAD = {
    "kc x4": PidGains(4 * GOOD.kp, 4 * GOOD.ki),
    "kc /4": PidGains(GOOD.kp / 4, GOOD.ki / 4),
    "tau_i /4": PidGains(GOOD.kp, 4 * GOOD.ki),
    "tau_i x4": PidGains(GOOD.kp, GOOD.ki / 4),
}
NEW = BAD["kc x4"]


make_wire = pytest.fixture(wires)


def into(wire: Wire, phase: TrialPhase) -> None:
    """The way into every phase."""
    if phase is P.IDLE:
        return
    wire.ask(NEW)
    if phase is P.WRITING:
        wire.run(1)
        assert wire.session.writer.open
        return
    wire.until(P.TRIAL)
    if phase is P.AWAY:
        wire.session.device.send_setpoint(70.0, wire.clock.now_s())
        wire.until(P.AWAY)
    elif phase is P.HELD:
        wire.edit(FOREIGN)
        wire.until(P.HELD)
    elif phase is P.WAITING:
        wire.trials.event(0, TrialEvent.PASSED_FOR_APPROVAL, wire.clock.now_s())
    elif phase in {P.RESTORING, P.COOLING, P.LOCKED}:
        wire.trials.event(0, TrialEvent.WORSE, wire.clock.now_s())
        wire.until(phase)
    assert wire.trials.phase(0) is phase


def deaf(wire: Wire, samples: int, hears: Callable[[object], bool]) -> None:
    """Only a part of what the device sends arrives, for a while."""
    before, wire.heard = wire.heard, hears
    wire.run(samples)
    wire.heard = before


def manual(wire: Wire) -> None:
    wire.session.device.send_mode(auto=False, co=50.0, now_s=wire.clock.now_s())
    wire.run(5)
    wire.session.device.send_mode(auto=True, co=50.0, now_s=wire.clock.now_s())


def disturb(wire: Wire) -> None:
    wire.session.device.send_load(10.0, wire.clock.now_s())
    wire.run(80)


def back(wire: Wire) -> None:
    decision = wire.session.retuner.rolled_back(0)
    wire.asked += [decision] if decision else []


def wrecked(wire: Wire) -> None:
    deaf(wire, 12, is_telemetry)
    wire.device.restart()
    wire.run(3)
    deaf(wire, 25, lambda message: False)  # noqa: ARG005
    wire.edit(FOREIGN)


CAUSES: dict[str, Callable[[Wire], object]] = {
    "link lost": lambda wire: deaf(wire, 40, lambda message: False),  # noqa: ARG005
    "telemetry lost": lambda wire: deaf(wire, 12, lambda message: not is_telemetry(message)),
    "answers lost": lambda wire: deaf(wire, 20, is_telemetry),
    "restart": lambda wire: wire.device.restart(),
    "operator edit": lambda wire: wire.edit(FOREIGN),
    "manual": manual,
    "runaway": disturb,
    "the disk is full": lambda wire: wire.session.freeze("the disk is full"),
    "the session ends": lambda wire: wire.session.stop("for a test"),
    "ordered back": back,
    "one after the other": wrecked,
}


EDITED = {"operator edit", "one after the other"}  # Causes after which a person's set runs, and is held


@pytest.mark.parametrize(
    ("phase", "cause"),
    pairs([p for p in TrialPhase if p not in {P.PAUSED, P.ENSURING}], CAUSES),
    ids=lambda one: getattr(one, "name", one),
)
def test_every_phase_under_every_abort_cause_ends_with_the_verified_set_running(make_wire, phase, cause):
    wire = make_wire(lock_out_after=1 if phase is P.LOCKED else 20)
    into(wire, phase)
    CAUSES[cause](wire)
    wire.run(20)
    wire.end()
    retuner = wire.session.retuner
    verified = NEW if phase is P.WAITING and cause != "ordered back" else GOOD
    edited = any(d.code == "edited" and d.region == "low" for d in wire.session.decisions)
    assert edited or cause != "operator edit" or phase is P.AWAY
    assert to_wire(retuner.table.gains_of(0)) == to_wire(FOREIGN if edited else verified)
    assert not wire.trials.busy
    assert "unrestored" not in wire.kinds
    assert retuner.region is not None
    if wire.session.frozen and phase is P.AWAY:
        return  # nothing is written any more; what runs is the other region's verified set
    assert wire.runs == to_wire(retuner.table.gains_of(retuner.region))


@pytest.mark.parametrize("cause", [c for c in CAUSES if c not in EDITED | {"answers lost"}])
def test_the_tried_set_runs_no_more_once_it_was_given_up(make_wire: Callable[..., Wire], cause: str) -> None:
    wire = make_wire(lock_out_after=20)
    into(wire, P.TRIAL)
    assert wire.runs == to_wire(NEW)
    CAUSES[cause](wire)
    wire.until(P.COOLING)
    for _ in range(60):
        wire.run(1)
        assert wire.runs != to_wire(NEW)
    assert wire.runs == to_wire(GOOD)


def test_a_set_restored_elsewhere_is_not_told_as_active(make_wire: Callable[..., Wire]) -> None:
    wire = make_wire()
    into(wire, P.AWAY)
    wire.session.stop("the shift is over")
    wire.end()
    restored = dict(wire.rows)["restored"]
    assert restored["regions"] == ["low"]
    assert restored["waits"] == {"low": {"kp": GOOD.kp, "ki": GOOD.ki, "kd": 0.0}}
    assert restored["gains"]["kp"] == pytest.approx(OTHER.kp)


def test_rows_tell_the_whole_story_before_it_happens(make_wire: Callable[..., Wire]) -> None:
    wire = make_wire()
    into(wire, P.TRIAL)
    wire.session.stop("the shift is over")
    wire.end()
    assert [kind for kind in wire.kinds if kind not in {"link", "lease"}] == [
        "decision",
        "intent",
        "committed",
        "trial",
        "abort",
        "decision",
        "restore",
        "intent",
        "committed",
        "restored",
    ]
    bodies = dict(wire.rows)
    assert bodies["abort"]["cause"] == "stopped"
    assert bodies["restore"]["cause"] == "stopped"
    assert bodies["trial"]["verified"] == {"kp": GOOD.kp, "ki": GOOD.ki, "kd": 0.0}
    assert bodies["restored"]["regions"] == ["low"]
    assert wire.session.decisions[-1].action is Action.RESTORE


@pytest.mark.slow
@pytest.mark.parametrize("name", BAD)
@pytest.mark.parametrize("upset", ["setpoint", "load"])
def test_a_deliberately_bad_change_is_rolled_back(make_wire: Callable[..., Wire], name: str, upset: str) -> None:
    wire = make_wire()
    wire.run(200)
    wire.ask(BAD[name])
    wire.until(P.TRIAL)
    wire.run(250)
    if upset == "load":
        wire.session.device.send_load(10.0, wire.clock.now_s())
    else:
        wire.session.device.send_setpoint(55.0, wire.clock.now_s())
    wire.until(P.COOLING, most=2500)
    assert wire.runs == to_wire(GOOD)
    decision = next(d for d in wire.session.decisions if d.action is Action.RESTORE)
    assert decision.code in {"undo_runaway", "undo_worse"}
    assert wire.trials.of(0).rollbacks == 1


def test_a_third_undo_locks_the_region_and_says_so(make_wire: Callable[..., Wire]) -> None:
    wire = make_wire(cool_down_s=0.0)
    for _ in range(3):
        into(wire, P.TRIAL)
        wire.trials.event(0, TrialEvent.WORSE, wire.clock.now_s())
        wire.until(P.COOLING if wire.trials.of(0).rollbacks < 3 else P.LOCKED)
    assert wire.kinds[-1] == "lockout"
    assert wire.session.retuner.trials.may_change(0, 1e12) is False


def test_a_controller_that_gives_an_unconfirmed_set_up_ends_the_trial(make_wire: Callable[..., Wire]) -> None:
    wire = make_wire(probation=1000, trial_samples=20)
    into(wire, P.TRIAL)
    wire.until(P.COOLING)
    assert "reverted" in wire.kinds
    assert wire.runs == to_wire(GOOD)


def test_what_the_controller_makes_of_a_set_is_no_persons_edit_and_the_verified_set_runs_again(make_wire):
    wire = make_wire()
    pages, swap = wire.device.pages, wire.device.pages.swap

    def rounding() -> object:
        answer = swap()
        kp = max(pages.running.gains.kp // 8 * 8, 1.0) if pages.running.gains == to_wire(NEW) else None
        if kp is not None:
            pages.running = pages.running._replace(gains=to_wire(PidGains(kp, NEW.ki)))
        return answer

    pages.swap = rounding
    wire.ask(NEW)
    wire.until(P.COOLING)
    assert wire.runs == to_wire(GOOD)
    (refused,) = (body["reason"] for kind, body in wire.rows if kind == "refused")
    assert "it rounds or limits gains" in refused
    assert "foreign" not in wire.kinds


def test_in_an_interpolated_table_leaving_the_region_ends_the_trial(make_wire: Callable[..., Wire]) -> None:
    wire = make_wire(lookup=Lookup.INTERPOLATED)
    into(wire, P.TRIAL)
    wire.session.device.send_setpoint(70.0, wire.clock.now_s())
    wire.until(P.COOLING)
    assert wire.session.retuner.table.gains == (GOOD, OTHER)


def test_in_an_interpolated_table_the_mean_is_written_and_the_region_stores_its_set(make_wire):
    wire = make_wire(lookup=Lookup.INTERPOLATED)
    before = wire.runs
    new = PidGains(1.2 * GOOD.kp, 1.2 * GOOD.ki)
    wire.ask(new)
    wire.until(P.TRIAL)
    table = wire.session.retuner.table
    assert table.gains == (new, OTHER)
    assert wire.runs == to_wire(table.at(0, 50.0))
    assert before.kp < wire.runs.kp < new.kp
    committed = next(body for kind, body in wire.rows if kind == "committed")
    assert committed["stored"] == {"kp": new.kp, "ki": new.ki, "kd": new.kd}
    wire.end()
    assert wire.session.retuner.table.gains == (GOOD, OTHER)
    assert abs(wire.runs.kp / before.kp - 1) < 0.02


def test_a_passed_change_waits_for_a_person_in_mode_trial_and_stays(make_wire: Callable[..., Wire]) -> None:
    wire = make_wire(mode=Mode.TRIAL)
    wire.run(200)
    better = PidGains(1.1 * GOOD.kp, 1.1 * GOOD.ki)
    wire.ask(better)
    wire.until(P.TRIAL)
    wire.run(200)
    wire.session.device.send_load(10.0, wire.clock.now_s())
    wire.until(P.WAITING, most=400)
    assert "judged" in wire.kinds
    wire.end()
    assert wire.runs == to_wire(better)


def test_when_the_link_stays_lost_the_session_ends_and_says_what_is_open(make_wire: Callable[..., Wire]) -> None:
    wire = make_wire()
    into(wire, P.TRIAL)
    wire.heard = lambda message: False  # noqa: ARG005
    wire.end()
    assert wire.kinds[-1] == "unrestored"
    assert "has not reported" in wire.session.left_open
    assert wire.rows[-1][1]["regions"] == ["low"]
    assert wire.session.retuner.table.gains_of(0) == GOOD


def test_the_verified_set_is_written_again_and_again_until_it_runs(make_wire: Callable[..., Wire]) -> None:
    wire = make_wire()
    into(wire, P.TRIAL)
    box, wire.device.pages._box = wire.device.pages._box, type(wire.device.pages._box)(ratio_max=1.001)
    wire.trials.event(0, TrialEvent.WORSE, wire.clock.now_s())
    wire.run(60)
    assert wire.runs == to_wire(NEW)
    refused = [body for kind, body in wire.rows if kind == "refused"]
    assert len(refused) >= 3
    assert {body["why"] for body in refused} == {"restore"}
    wire.device.pages._box = box
    wire.until(P.COOLING)
    assert wire.runs == to_wire(GOOD)


STORY = st.lists(
    st.tuples(st.sampled_from(["ask", "pass", "cool", *CAUSES]), st.integers(1, 40)), min_size=1, max_size=6
)


@settings(max_examples=examples(12))
@given(STORY)
def test_any_story_ends_on_the_verified_old_or_the_confirmed_new_set(story: list[tuple[str, int]]) -> None:
    wire = Wire(lock_out_after=20, cool_down_s=0.0)
    verified, number = {to_wire(GOOD)}, 0
    try:
        for event, samples in story:
            if event == "ask" and wire.trials.may_change(0, wire.clock.now_s()) and not wire.asked:
                number += 1
                wire.ask(PidGains((2 + number) * GOOD.kp, (2 + number) * GOOD.ki))
            elif event == "pass" and wire.trials.event(0, TrialEvent.PASSED, wire.clock.now_s()):
                verified = {wire.runs}
            elif event == "cool":
                wire.trials.event(0, TrialEvent.HOLD_OVER, wire.clock.now_s())
                wire.trials.event(0, TrialEvent.COOLED, wire.clock.now_s())
            elif event in CAUSES:
                CAUSES[event](wire)
            wire.run(samples)
        wire.run(20)
        wire.end()
        edited = {to_wire(FOREIGN)} if EDITED & dict(story).keys() else set()
        assert to_wire(wire.session.retuner.table.gains_of(0)) in verified | edited
        assert not wire.trials.busy
        assert wire.runs in verified | edited
    finally:
        wire.close()


def test_ctrl_c_takes_the_change_back_first_and_a_second_one_does_not_wait(make_wire: Callable[..., Wire]) -> None:
    for times, ends_on in ((1, GOOD), (2, NEW)):
        wire = make_wire()
        into(wire, P.TRIAL)
        left = [times]

        def once(wire: Wire = wire, left: list[int] = left) -> None:
            if left[0]:
                left[0] -= 1
                raise KeyboardInterrupt
            wire.run(1)

        with pytest.raises(KeyboardInterrupt):
            to_the_end(wire.session, once)
        assert wire.runs == to_wire(ends_on)
        if times > 1:  # and the trial is told as open
            assert wire.kinds[-1] == "unrestored"
            assert wire.rows[-1][1]["regions"] == ["low"]
            assert wire.session.left_open


TURNED = (P.IDLE, P.WRITING, P.TRIAL, P.RESTORING)


def turn(wire: Wire, phase: TrialPhase) -> PidGains:
    """A switch of direct and reverse action thrown at the controller in a phase: the same numbers, the other sign."""
    into(wire, phase)
    ran = wire.runs
    wire.edit(PidGains(-ran.kp, -ran.ki))
    return ran


@pytest.mark.parametrize("phase", TURNED)
def test_a_turned_action_holds_the_loop_and_is_told_once(make_wire: Callable[..., Wire], phase: TrialPhase) -> None:
    """Nothing is written over it and nothing learned from it, not even the way back: a person has to look."""
    wire = make_wire()
    turn(wire, phase)
    wire.run(3)  # what was on its way ends
    table, models = wire.session.retuner.table, dict(wire.session.retuner.region_models)
    intents, decided = wire.kinds.count("intent"), len(wire.session.decisions)
    wire.device.sp = 55.0
    wire.run(300)
    assert wire.runs.kp < 0.0
    assert [decision.code for decision in wire.session.decisions].count("action_turned") == 1
    assert len(wire.session.decisions) == decided
    assert wire.kinds.count("action") == 1
    assert wire.kinds.count("intent") == intents
    assert not {"restored", "trial"} & set(wire.kinds[wire.kinds.index("action") :])
    assert wire.session.retuner.table is table
    assert wire.session.retuner.region_models == models
    assert {gains.direction for gains in table.gains} == {1}


@pytest.mark.parametrize("phase", TURNED)
def test_after_the_action_is_right_again_the_loop_goes_on(make_wire: Callable[..., Wire], phase: TrialPhase) -> None:
    wire = make_wire()
    ran = turn(wire, phase)
    wire.run(40)
    wire.edit(ran)
    wire.run(60)
    assert [row for kind, row in wire.rows if kind == "action"][-1]["turned"] is False
    assert wire.runs == to_wire(wire.session.retuner.table.gains_of(0))
    assert not wire.trials.busy
    assert wire.session.writer.free
    wire.end()
    assert not wire.session.left_open


def test_a_session_that_ends_with_a_turned_action_says_so(make_wire: Callable[..., Wire]) -> None:
    """It does not wait for what cannot come: it writes nothing."""
    wire = make_wire()
    turn(wire, P.IDLE)
    wire.run(10)
    wire.end(most=5)
    assert "other sign" in wire.session.left_open
    assert wire.kinds[-1] == "unrestored"


def test_gains_of_the_other_sign_are_found_at_the_start(make_wire: Callable[..., Wire]) -> None:
    """They were there before the session: the schedule does not write over them."""
    wire = make_wire(first=PidGains(-GOOD.kp, -GOOD.ki))
    wire.run(100)
    assert wire.session.retuner.action_reversed
    assert wire.kinds.count("action") == 1
    assert "intent" not in wire.kinds


@pytest.mark.parametrize("order", ["ask", "revert"])
def test_nobody_orders_a_change_while_the_action_is_turned(make_wire: Callable[..., Wire], order: str) -> None:
    wire = make_wire()
    turn(wire, P.IDLE)
    wire.run(5)
    retuner, outcome = wire.session.retuner, Outcome("injected", "for a test")
    made = retuner.ordered(0, outcome, NEW, PROMISE if order == "ask" else None)
    assert made.code == "held_action_turned"
    assert made.gains_after is None
