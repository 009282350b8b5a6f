"""The rules of admission in a running retuner: what is not admitted teaches nothing and says why."""

from collections.abc import Callable

import numpy as np
import pytest
from pi_loop import Lag, pi_loop, samples_of

from retuner import Action, Decision, GainTable, LoopMode, LoopSample, Mode, PidGains, Regions, Retuner, RetunerSettings
from retuner.adaptive.supervision.admission import Ground

GAINS = PidGains(5.0, 5.0 / 40)
STEP_AT, N = 80, 420
Fault = Callable[[LoopSample], LoopSample]


def heard(fault: Fault, sp: Callable[[int], float] = lambda i: float(i >= STEP_AT)) -> tuple[Retuner, list[Decision]]:
    """e^-5s/(50 s + 1) under good PI gains and one percent of noise; the fault is in what telemetry says."""
    table = GainTable("loop", Regions("pv", "-", ("low", "high"), -50.0, (20.0,), 50.0, 2.0), (GAINS, GAINS))
    retuner, noise = Retuner(table, RetunerSettings(1.0, 10.0, Mode.AUTO)), np.random.default_rng(4).standard_normal(N)
    window = pi_loop(GAINS, Lag(50.0, 5), np.array([sp(i) for i in range(N)]), 0.01 * noise)
    heard = [retuner.observe(fault(sample)) for sample in samples_of(window)]
    return retuner, [decision for decision in heard if decision is not None]


def limited(s: LoopSample) -> LoopSample:
    return s._replace(co=100.0, limited=1)


def rewritten(s: LoopSample) -> LoopSample:
    return s._replace(revision=int(s.t_s > STEP_AT + 15))


def uneven(s: LoopSample) -> LoopSample:
    return s._replace(t_s=s.t_s + (0.8 if s.t_s % 4 == 0 else 0.0))


def stuck() -> Fault:
    kept: list[LoopSample] = []

    def fault(s: LoopSample) -> LoopSample:
        if s.t_s == STEP_AT + 3:
            kept.append(s)
        return kept[0]._replace(t_s=s.t_s) if kept and s.t_s < STEP_AT + 120 else s

    return fault


@pytest.mark.parametrize(
    ("ground", "fault"),
    [
        (Ground.SATURATED, limited),
        (Ground.GAINS_CHANGED, rewritten),
        (Ground.IRREGULAR, uneven),
        (Ground.REPEATED, stuck()),
    ],
)
def test_what_is_not_admitted_teaches_nothing_and_says_why(ground: Ground, fault: Fault) -> None:
    retuner, decisions = heard(fault)
    assert decisions[0].code == ground.name.lower()
    assert decisions[0].action is Action.NONE
    assert decisions[0].estimate is None
    assert "limit" in decisions[0].numbers.to_dict()
    assert all(d.code != "ok" for d in decisions) == (not retuner.region_models)


def test_the_slave_of_a_cascade_is_not_learned_from_while_its_master_moves() -> None:
    rng = np.random.default_rng(9)
    led = np.cumsum(np.where(np.arange(N) % 3 == 0, 0.01 * rng.standard_normal(N), 0.0)) + (np.arange(N) >= STEP_AT)
    retuner, decisions = heard(lambda s: s, lambda i: float(led[i]))
    assert decisions
    assert {d.code for d in decisions} <= {Ground.SETPOINT_LED.name.lower(), Ground.LOW_EXCITATION.name.lower()}
    assert Ground.SETPOINT_LED.name.lower() in {d.code for d in decisions}
    assert not retuner.region_models


@pytest.mark.parametrize("manual", [0, 1, STEP_AT - 8])
def test_a_step_made_soon_after_manual_teaches(manual: int) -> None:
    """The last sample in manual is no part of the record that begins then."""
    retuner, decisions = heard(lambda s: s._replace(mode=LoopMode(s.t_s >= manual)))
    assert 0 in retuner.region_models
    assert decisions[0].estimate is not None
