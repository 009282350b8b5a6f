"""`retuner.PidController`: a loop in ten lines, whose gains change and come back without the caller's help."""

import json
import logging
import math
import subprocess
import sys
from typing import Any

import numpy as np
import pytest

import retuner
from retuner import Action, Axis, GainTable, Mode, PidController, PidGains, Regions
from retuner.schedule.pid import StateTuple, law, start, step

WEAK = PidGains(kp=12.0, ki=0.3)  # A quarter of the right gain for the tank


class Tank:
    """Gain 0.1, lag 50 s, dead time 5 s; its gain may grow."""

    def __init__(self) -> None:
        self.k, self.y, self._past, self._rng = 0.1, 0.0, [0.0] * 5, np.random.default_rng(1)

    def pv(self) -> float:
        return self.y + 0.001 * float(self._rng.standard_normal())

    def take(self, co: float) -> None:
        self._past.append(co)
        self.y += (self.k * self._past.pop(0) - self.y) / 50


def controller(mode: Mode | str = "auto") -> PidController:
    return PidController(WEAK, dt_s=1.0, pv_range=(0.0, 10.0), mode=mode)


def run(pid: PidController, tank: Tank, samples: int, sp: float = 1.0) -> list[retuner.Decision]:
    found = []
    for _ in range(samples):
        tank.take(pid.step(sp, tank.pv()))
        found += [pid.decision] if pid.decision is not None else []
    return found


def changed(pid: PidController, tank: Tank) -> retuner.Decision:
    """Run until the first change is on trial."""
    run(pid, tank, 100, sp=0.0)
    made = run(pid, tank, 600)
    assert [one.action for one in made] == [Action.WRITE]
    return made[0]


def test_the_gains_follow_the_decision_and_the_output_makes_no_bump() -> None:
    pid, tank = controller(), Tank()
    made = changed(pid, tank)
    assert pid.gains == made.gains_after != WEAK
    assert pid.last_decision is made
    assert pid.table.revision == 1


def test_at_the_end_it_is_decided_what_runs_when_nobody_watches() -> None:
    tank = Tank()
    with controller() as pid:
        made = changed(pid, tank)
    last = pid.last_decision
    assert last.code == "kept_stopped"
    assert pid.gains == made.gains_after == last.gains_after
    assert not pid.retuner.trials.restored(0.0)  # it was told that they run


@pytest.mark.slow
def test_a_process_that_runs_away_gets_its_old_gains_back() -> None:
    pid, tank = controller(), Tank()
    changed(pid, tank)
    tank.k *= 6.0
    for _ in range(200):  # it swings 37 samples later; a loop without an end had hung where it was not rolled back
        if any(one.action is Action.RESTORE for one in run(pid, tank, 1, sp=1.5)):
            break
        assert tank.y < 10.0
    assert pid.gains == WEAK


def test_a_proposal_waits_for_approval_and_can_be_taken_back() -> None:
    pid, tank = controller("advise"), Tank()
    with pytest.raises(ValueError, match="no proposal"):
        pid.approve()
    run(pid, tank, 100, sp=0.0)
    advised = run(pid, tank, 600)[0]
    assert (advised.action, pid.gains) == (Action.ADVISE, WEAK)
    assert pid.approve().action is Action.WRITE
    assert pid.gains == advised.gains_after
    with pytest.raises(ValueError, match="not those it was proved from"):
        pid.approve()
    back = pid.take_back()
    assert back is not None
    assert pid.gains == WEAK
    assert pid.take_back() is None


def test_gains_set_by_hand_are_kept() -> None:
    pid, tank, mine = controller(), Tank(), PidGains(14.0, 0.3)
    with pytest.raises(ValueError, match="no step yet"):
        pid.set_gains(mine)
    run(pid, tank, 100, sp=0.0)
    pid.set_gains(mine)
    assert pid.gains == mine
    assert [one.action for one in run(pid, tank, 600)] == [Action.ADVISE]
    assert pid.gains == mine


def test_gains_of_the_other_sign_are_refused() -> None:
    pid = controller()
    pid.step(1.0, 0.0)
    with pytest.raises(ValueError, match="acts in the other direction"):
        pid.set_gains(PidGains(-WEAK.kp, -WEAK.ki))
    assert pid.gains == WEAK


@pytest.mark.parametrize(
    ("sp", "pv", "dt_s", "said"),
    [
        (1.0, math.nan, None, "pv = nan is not a finite number"),
        (1.0, None, None, "pv = None is not a finite number"),
        (None, 0.0, None, "sp = None is not a finite number"),
        (1.0, "Bad", None, "pv = 'Bad' is not a finite number"),
        (1.0, 0.0, math.inf, "dt_s = inf is not a finite number"),
        (1.0, 0.0, 1.76e9, "time since the last step"),
    ],
)
def test_a_sensor_that_failed_is_refused_in_one_line_at_any_sample(sp: Any, pv: Any, dt_s: Any, said: str) -> None:
    fresh, begun = controller(), controller()
    begun.step(1.0, 0.0)
    for pid in (fresh, begun):
        before = repr(pid)
        with pytest.raises(ValueError, match=said):
            pid.step(sp, pv, dt_s)
        assert repr(pid) == before
        pid.step(1.0, 0.0)


@pytest.mark.parametrize("ends", [None, (None, None), (0.0,), (5.0, 5.0), (0.0, math.inf)])
@pytest.mark.parametrize("name", ["pv_range", "co_range"])
def test_limits_that_are_no_limits_are_refused_by_name(name: str, ends: Any) -> None:
    given: dict[str, Any] = {"pv_range": (0.0, 10.0), name: ends}
    with pytest.raises(ValueError, match=f"{name} = .* two finite numbers"):
        PidController(WEAK, dt_s=1.0, **given)


def test_gains_that_are_three_numbers_are_refused_by_what_to_give() -> None:
    three: Any = (1.0, 0.1, 0.0)
    with pytest.raises(TypeError, match="give PidGains"):
        PidController(three, dt_s=1.0, pv_range=(0.0, 10.0))
    pid = controller()
    pid.step(1.0, 0.0)
    with pytest.raises(TypeError, match="give PidGains"):
        pid.set_gains(three)


@pytest.mark.parametrize("key", ["t_s", "co"])
def test_a_memory_with_a_number_that_is_none_is_refused_at_once(key: str) -> None:
    pid = controller()
    pid.step(1.0, 0.0)
    with pytest.raises(ValueError, match=f"memory: {key} = nan"):
        PidController(WEAK, dt_s=1.0, pv_range=(0.0, 10.0), memory={**pid.memory(), key: math.nan})


def test_mode_off_takes_back_what_is_on_trial() -> None:
    pid, tank = controller(), Tank()
    changed(pid, tank)
    assert pid.set_mode("off") is not None
    assert pid.gains == WEAK
    with pytest.raises(ValueError, match="use off, advise, trial, auto"):
        pid.set_mode("on")


def test_the_output_is_that_of_the_law() -> None:
    pid, tank = controller("off"), Tank()
    plain = law(WEAK)
    state: StateTuple = start(plain, 0.0, 0.0, 0.0)
    for i in range(50):
        sp, pv, dt = (3.0 if i > 5 else 1.0), tank.pv(), 0.5 + 0.01 * i
        state, co = step(plain, state, sp, pv, dt)
        assert pid.step(sp, pv, dt) == pytest.approx(co, abs=1e-9)
        tank.take(co)


def test_manual_and_back_makes_no_bump() -> None:
    pid = controller("off")
    pid.step(1.0, 0.5)
    assert pid.step(1.0, 0.5, manual_co=42.0) == 42.0
    assert pid.step(1.0, 0.5) == pytest.approx(42.0)
    assert pid.step(1.0, 0.5, manual_co=400.0) == 100.0


def test_the_region_chooses_the_gains_without_a_bump() -> None:
    regions = Regions("sp", "m", ("low", "high"), 0.0, (5.0,), 10.0)
    table = GainTable("level", regions, (WEAK, PidGains(3.0, 0.1)))
    pid = PidController(table, dt_s=1.0, pv_range=(0, 10), mode="off")
    before = [pid.step(4.0, 4.0) for _ in range(3)][-1]
    assert pid.gains == WEAK
    after = pid.step(6.0, 6.0)
    assert pid.gains == table.gains[1]
    assert after == pytest.approx(before)


def test_what_the_gains_follow_must_be_given() -> None:
    axis = Axis("can", "kg/h", 0.0, (5.0,), 10.0, signal="flow")
    table = GainTable("level", Regions.along(("low", "high"), axis), (WEAK, PidGains(3.0, 0.1)))
    pid = PidController(table, dt_s=1.0, pv_range=(0, 10), mode="off")
    with pytest.raises(ValueError, match="give it as x"):
        pid.step(1.0, 1.0)
    pid.step(1.0, 1.0, x=7.0)
    assert pid.gains == table.gains[1]
    pid.step(1.0, 1.0, x=math.nan)
    assert pid.gains == table.gains[1]


@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        ({"dt_s": 0.0}, "dt_s"),
        ({"dt_s": math.nan}, "dt_s"),
        ({"pv_range": (1.0, 1.0)}, "pv_range"),
        ({"pv_range": (0.0, math.inf)}, "pv_range"),
        ({"mode": "maybe"}, "maybe"),
        ({"co_range": (5.0, 5.0)}, "co_range"),
    ],
)
def test_a_wrong_argument_is_told_by_its_name(wrong: dict[str, Any], said: str) -> None:
    given: dict[str, Any] = {"dt_s": 1.0, "pv_range": (0.0, 1.0), **wrong}
    with pytest.raises(ValueError, match=said):
        PidController(WEAK, **given)


def test_decisions_are_logged_and_nothing_is_shown_by_itself(caplog, capsys):
    pid, tank = controller("advise"), Tank()
    with caplog.at_level(logging.INFO, "retuner"):
        run(pid, tank, 100, sp=0.0)
        run(pid, tank, 600)
    assert "loop, region all" in caplog.text
    assert capsys.readouterr() == ("", "")
    assert any(isinstance(one, logging.NullHandler) for one in logging.getLogger("retuner").handlers)


def test_a_restart_loses_nothing() -> None:
    pid, tank = controller("advise"), Tank()
    run(pid, tank, 100, sp=0.0)
    advised = run(pid, tank, 600)[0]
    pid.approve(advised)
    co = pid.step(1.0, tank.pv())
    saved = json.loads(json.dumps(pid.memory()))
    again = PidController(WEAK, dt_s=1.0, pv_range=(0.0, 10.0), mode="advise", memory=saved)
    assert again.gains == pid.gains == advised.gains_after
    assert again.last_decision.code == "kept_restarted"  # it was on trial
    assert again.step(1.0, tank.pv()) == pytest.approx(co)
    assert len(again.retuner.region_models) == 1
    tank.take(co)
    assert run(again, tank, 300, sp=1.5)


def test_a_memory_of_something_else_is_refused() -> None:
    pid = controller()
    pid.step(1.0, 1.0)
    saved = pid.memory()
    for wrong in ({}, {**saved, "version": 0}, {**saved, "retuner": {}}):
        with pytest.raises(ValueError, match="memory"):
            PidController(WEAK, dt_s=1.0, pv_range=(0.0, 10.0), memory=wrong)
    with pytest.raises(ValueError, match="of loop 'loop'"):
        PidController(WEAK, dt_s=1.0, pv_range=(0.0, 10.0), memory=saved, name="other")


def test_no_library_is_loaded_in_the_middle_of_the_loop() -> None:
    code = (
        "import sys, threading, test_pid_controller as t; pid, tank = t.controller(), t.Tank()\n"
        "t.run(pid, tank, 25, 0.0)\nfor beside in threading.enumerate()[1:]: beside.join()\n"
        "had = set(sys.modules); t.changed(pid, tank); t.run(pid, tank, 600, 0.5); assert 'filterpy.kalman' in had\n"
        "assert not {name for name in set(sys.modules) - had if name.startswith(('scipy', 'filterpy', 'retuner'))}"
    )
    subprocess.run([sys.executable, "-c", code], check=True, cwd=__file__.rpartition("/")[0])
