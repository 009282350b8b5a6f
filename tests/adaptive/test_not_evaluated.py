"""Whatever a stage raises closes its question, is told, and the next response is evaluated as ever."""

import logging
import math
import random

import numpy as np
import pytest
from effort import examples, sized
from hypothesis import given, settings
from hypothesis import strategies as st
from loop_bench import Bench, scaled, table

from retuner.adaptive.signals.sample import LoopMode, LoopSample
from retuner.adaptive.supervision import confirmation, decide, findings
from retuner.adaptive.supervision.decision import Action, Decision, Mode
from retuner.adaptive.supervision.question import NOT_EVALUATED
from retuner.adaptive.supervision.retuner import Retuner
from retuner.adaptive.supervision.retuner_settings import RetunerSettings
from retuner.adaptive.trial.phase import TrialPhase
from retuner.pid_controller import PidController
from retuner.schedule.gains import PidGains
from retuner.schedule.regions import Regions
from retuner.schedule.table import GainTable

USUAL = RetunerSettings(1.0, 10.0, Mode.AUTO)
ERRORS = (
    ValueError("co stays at 66.223 in the whole record"),
    np.linalg.LinAlgError("Singular matrix"),
    ZeroDivisionError("float division by zero"),
    FloatingPointError("overflow"),
    OverflowError("math range error"),
    KeyError(3),
    AssertionError(),
    MemoryError(),
)


def break_at(monkeypatch: pytest.MonkeyPatch, error: BaseException, at: str) -> None:
    """Have a step raise in the decisions that a test makes, not in the one that a controller makes beside, at start."""
    monkeypatch.setattr("retuner.pid_controller.warm_up_beside", lambda: None)

    def broken(*_: object) -> None:
        raise error

    broken.__code__ = broken.__code__.replace(co_name=at)
    if hasattr(findings, at):
        steps = tuple(broken if step.__name__ == at else step for step in findings.STEPS)
        monkeypatch.setattr(findings, "STEPS", steps)
    else:
        for module in (confirmation, decide):
            if hasattr(module, at):
                monkeypatch.setattr(module, at, broken)


@pytest.mark.slow
@pytest.mark.parametrize("error", ERRORS, ids=lambda e: type(e).__name__)
def test_what_a_stage_raises_is_the_reason_of_a_decision_and_the_next_response_is_evaluated(error, monkeypatch):
    bench = Bench(Retuner(table(scaled(0.4, 0.4)), USUAL), seed=2)
    break_at(monkeypatch, error, "identification")
    bench.run(400)
    (told,) = bench.run(500, 1.0)
    assert (told.code, told.action, told.gains_after, told.known) == (NOT_EVALUATED, Action.NONE, None, None)
    assert type(error).__name__ in told.reason
    assert bench.retuner.open_question is None
    assert not bench.retuner.region_models
    monkeypatch.undo()
    (next_one,) = bench.run(500, 0.0)
    assert next_one.code not in {NOT_EVALUATED, "passed_over"}
    assert next_one.known is not None


@pytest.mark.slow
@pytest.mark.parametrize("at", ["action", "admission", "worth", "expectation", "elsewhere"])
def test_any_stage_may_raise_and_nothing_changes(at: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """All samples, which do without some of them, may change gains at another response: they are silent here."""
    monkeypatch.setattr(decide, "proposal_by_all_samples", lambda *_: None)
    bench = Bench(Retuner(table(scaled(0.4, 0.4)), USUAL), seed=2)
    break_at(monkeypatch, ValueError("for a test"), at)
    told = bench.exercise(3)
    broken = [d for d in told if d.code == NOT_EVALUATED]
    assert broken
    assert all(f"{at!r} failed" in d.reason for d in broken)
    assert bench.retuner.table.gains_of(0) == scaled(0.4, 0.4)


def test_a_response_of_a_trial_that_is_not_evaluated_decides_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    bench = Bench(Retuner(table(scaled(0.4, 0.4)), USUAL), seed=2)
    bench.run(400)
    made = next(d for _ in range(2000) for d in bench.run(1, 1.0) if d.action is Action.WRITE)
    assert bench.retuner.trials.phase(0) is TrialPhase.TRIAL
    break_at(monkeypatch, ValueError("for a test"), "identification")
    told = bench.run(500, 0.0)
    assert told[0].code == NOT_EVALUATED
    assert told[0].judgement.to_dict()["finding"] == "inconclusive"
    assert bench.retuner.table.gains_of(0) == made.gains_after


def test_ctrl_c_in_a_decision_leaves_a_controller_that_goes_on(monkeypatch: pytest.MonkeyPatch) -> None:
    pid = PidController(PidGains(12.0, 0.3), dt_s=1.0, pv_range=(0.0, 10.0), mode="auto")
    break_at(monkeypatch, KeyboardInterrupt(), "identification")
    codes, broken, y, past = [], 0, 0.0, [0.0] * 5
    noise = np.random.default_rng(1)
    for t in range(1800):
        try:
            past.append(pid.step(float(t // 600 % 2), y + 0.001 * float(noise.standard_normal())))
        except KeyboardInterrupt:
            broken += 1
            past.append(past[-1])
            monkeypatch.undo()
        codes += [pid.decision.code] if pid.decision is not None else []
        y += (0.1 * past.pop(0) - y) / 50
    assert broken == 1
    assert codes
    assert "passed_over" not in codes


def test_a_response_that_is_not_evaluated_is_a_warning_in_the_log(caplog, monkeypatch):
    pid = PidController(PidGains(12.0, 0.3), dt_s=1.0, pv_range=(0.0, 10.0), mode="auto")
    break_at(monkeypatch, ValueError("co stays at 66.223"), "identification")
    y, past = 0.0, [0.0] * 5
    with caplog.at_level(logging.INFO, logger="retuner"):
        for t in range(1200):
            past.append(pid.step(float(t // 600), y + 0.001 * ((t * 7919) % 13 - 6)))
            y += (0.1 * past.pop(0) - y) / 50
    warned = [record.getMessage() for record in caplog.records if record.levelno == logging.WARNING]
    assert warned
    assert all("not evaluated" in line and "co stays at 66.223" in line for line in warned)


# No window raises: closed loops round odd actuators, and signals that no loop has made.


def observed(retuner: Retuner, samples: list[LoopSample]) -> list[Decision]:
    """What comes of them; a question is never left open."""
    found = []
    for sample in samples:
        made = retuner.observe(sample)
        assert retuner.open_question is None
        if made is not None:
            found.append(made)
            if made.action is Action.WRITE and made.gains_after is not None:
                retuner.committed(0, made.gains_after)
            elif made.action is Action.RESTORE:
                retuner.restored()
    return found


SIGNAL = st.sampled_from(["constant", "noise", "steps", "many steps", "ramp", "sine", "growing", "spikes", "clipped"])


def signal(kind: str, n: int, rng: np.random.Generator) -> np.ndarray:
    t = np.arange(float(n))
    made = {
        "constant": lambda: np.full(n, 40.0),
        "noise": lambda: 50.0 + rng.standard_normal(n),
        "steps": lambda: 40.0 + 10.0 * (t // 200 % 2),
        "many steps": lambda: 50.0 + np.cumsum(np.where(t % 7 == 0, rng.choice([-0.3, 0.3], n), 0.0)),
        "ramp": lambda: 20.0 + 60.0 * t / n,
        "sine": lambda: 50.0 + 5.0 * np.sin(t / 9.0),
        "growing": lambda: 50.0 + np.clip(0.01 * 1.02**t * np.sin(t / 5.0), -50.0, 50.0),
        "spikes": lambda: np.where(t % 97 == 0, 99.0, 50.0),
        "clipped": lambda: np.clip(50.0 + 100.0 * np.sin(t / 30.0), 0.0, 100.0),
    }[kind]()
    return np.asarray(made, dtype=np.float64)


@settings(max_examples=examples(30))
@given(SIGNAL, SIGNAL, SIGNAL, st.integers(30, 700), st.integers(0, 2**16), st.sampled_from([0.0, 0.02, 0.2]))
def test_no_window_of_any_signals_raises(sp: str, pv: str, co: str, n: int, seed: int, gaps: float) -> None:
    rng = np.random.default_rng(seed)
    sps, pvs, cos = (signal(kind, n, rng) for kind in (sp, pv, co))
    times = np.cumsum(np.where(rng.random(n) < gaps, 3.0, 1.0))
    limited = [0 if 0.0 < u < 100.0 else (1 if u > 50.0 else -1) for u in cos]
    regions = Regions("pv", "pv", ("all",), 0.0, (), 100.0)
    retuner = Retuner(
        GainTable("loop", regions, (PidGains(1.0, 0.1),)),
        RetunerSettings(1.0, 100.0, Mode.AUTO, pv_range=(0.0, 100.0), wait_s=60.0),
    )
    told = observed(
        retuner,
        [
            LoopSample(float(times[i]), float(sps[i]), float(pvs[i]), float(cos[i]), LoopMode.AUTO, limited[i], 50.0, 0)
            for i in range(n)
        ],
    )
    assert NOT_EVALUATED not in {d.code for d in told}


@pytest.mark.slow
@settings(max_examples=sized(3, 3, 400))
@given(
    st.sampled_from([2.0, 5.0, 30.0]),
    st.sampled_from([1, 5, 12]),
    st.floats(0.3, 2.5),
    st.sampled_from([0.0, 1.0, 4.0]),
    st.sampled_from([(0.0, 100.0), (48.0, 52.0), (45.0, 100.0)]),
    st.booleans(),
    st.integers(0, 2**16),
)
def test_no_loop_round_an_odd_valve_raises(tau, dead, share, band, stops, small, seed):
    """A valve that sticks, or has stops of its own, on lags and on mostly dead time, under few or many moves."""
    rng = random.Random(seed)
    kc = share * tau / (2.0 * dead) if tau > dead else share * 0.3
    pid = PidController(PidGains(kc, kc / max(tau, dead / 3.0)), dt_s=1.0, pv_range=(0.0, 100.0), mode="auto")
    x, valve, sp, due, past = 50.0, 50.0, 50.0, 60, [50.0] * dead
    for t in range(900):
        if t >= due:
            sp = sp + rng.choice([-0.3, 0.3, 0.5]) if small else rng.choice([45.0, 50.0, 55.0])
            due = t + rng.choice([5, 20, 60] if small else [100, 200])
        u = pid.step(sp, x + rng.gauss(0.0, 0.03))
        assert pid.retuner.open_question is None
        assert pid.decision is None or pid.decision.code != NOT_EVALUATED, str(pid.decision)
        valve = u if abs(u - valve) > band else valve
        past.append(min(max(valve, stops[0]), stops[1]))
        x += (1.0 - math.exp(-1.0 / tau)) * (past.pop(0) - x)
