"""What a loop could have had: foreseen from a record, beside the same loop simulated anew under the same loads."""

import math
from dataclasses import replace

import numpy as np
import pytest

from retuner import PidGains, ProcessModel, ProcessType
from retuner.adaptive.audit.over_time import spread_over
from retuner.adaptive.audit.verdict import AuditAction, LoopVerdict, VerdictBasis, error_share, with_foreseen
from retuner.adaptive.choice.foreseen import DOUBLED, Foreseen, foreseen
from retuner.adaptive.diagnosis.cause import Cause, Diagnosis
from retuner.adaptive.identification.robust_simc import RobustSettings, robust_simc_on
from retuner.adaptive.signals.sample import Window
from retuner.diagnosing import with_gain
from retuner.drivers.plants.linear_plant import LinearPlant
from retuner.schedule import pid

DT_S = 2.0
SLOW, GOOD = PidGains.from_ideal(0.4, 60.0), PidGains.from_ideal(1.6, 30.0)
MODELS = (
    ProcessModel(ProcessType.FOPDT, 1.5, 30.0, theta_s=7.0),
    ProcessModel(ProcessType.SOPDT, -0.8, 40.0, 11.0, theta_s=3.3),
    ProcessModel(ProcessType.INTEGRATING, 0.03, theta_s=6.0),
    ProcessModel(ProcessType.INTEGRATING_LAG, 0.02, tau2_s=9.0, theta_s=4.0),
)
ONE = [(MODELS[0], 1.0)]


def simulated(model: ProcessModel, gains: PidGains) -> Window:
    """A loop under load steps and a setpoint change; the loads are the same for all settings."""
    plant, law = LinearPlant(model.linear(), start_pv=50.0, start_co=50.0), pid.law(gains)
    state: pid.StateTuple = pid.start(law, 50.0, 50.0, 50.0)
    pv, rows, co = 50.0, [], 50.0
    for i in range(600):
        sp = 50.0 if i < 350 else 52.0
        if i:
            state, co = pid.step(law, state, sp, pv, DT_S)
        rows.append((i * DT_S, sp, pv, co))
        pv = plant.step(co, 4.0 * (50 < i < 200), DT_S)
    return Window(*np.array(rows).T.copy())


def of(model: ProcessModel, gains: PidGains) -> PidGains:
    """Settings for this process's sign and speed."""
    scale = 1 / (model.slope * 20.0)
    return PidGains(gains.kp * scale, gains.ki * scale, gains.kd * scale)


@pytest.mark.parametrize("model", MODELS, ids=lambda m: str(m.type))
def test_what_is_foreseen_is_what_the_other_controller_does(model: ProcessModel) -> None:
    before, after = (simulated(model, of(model, gains)) for gains in (SLOW, GOOD))
    found = foreseen([before], [(model, 1.0)], of(model, GOOD))
    error, travel = (float(np.sum(np.abs(after.sp - after.pv))) * DT_S, float(np.sum(np.abs(np.diff(after.co)))))
    assert found.error[0] == pytest.approx(error, rel=1e-6)
    assert found.travel[0] == pytest.approx(travel, rel=1e-6)
    assert found.saved == pytest.approx(1 - error / found.error[1])
    assert 0.3 < found.saved < 1


def test_the_settings_in_force_change_nothing_and_uneven_times_little() -> None:
    record = simulated(MODELS[0], SLOW)
    same = foreseen([record], ONE, SLOW)
    assert same.saved == pytest.approx(0, abs=1e-9)
    kept = np.sort(np.random.default_rng(5).permutation(len(record.t_s))[:500])
    some = foreseen([Window(record.t_s[kept], record.sp[kept], record.pv[kept], record.co[kept])], ONE, SLOW)
    assert some.saved == pytest.approx(0, abs=0.1)


def test_settings_that_no_model_holds_are_told_by_none_and_doubtful_ones_by_their_range() -> None:
    record = simulated(MODELS[0], SLOW)
    assert foreseen([Window(record.t_s, record.pv, record.pv, record.co)], ONE, GOOD) is None
    other = ProcessModel(ProcessType.FOPDT, 1.5, 30.0, theta_s=14.0)
    found = foreseen([record, record], [(MODELS[0], 3.0), (other, 1.0)], of(MODELS[0], GOOD))
    assert found.least <= found.saved <= found.most
    assert found.most - found.least > 0.01
    assert found.span_s == pytest.approx(2 * 600 * DT_S)
    assert math.isfinite(found.least)
    each = [foreseen([record], [one], of(MODELS[0], GOOD)) for one in ((MODELS[0], 1.0), (other, 1.0))]
    alone = [one.saved for one in each if one is not None]
    assert found.saved == pytest.approx(0.75 * alone[0] + 0.25 * alone[1])
    wild = of(MODELS[0], PidGains.from_ideal(4.0, 30.0))
    held, swings = foreseen([record], ONE, wild), replace(other, theta_s=40.0)
    both = foreseen([record], [(MODELS[0], 1.0), (swings, 1.0)], wild)
    assert both.least < 2.0 * DOUBLED
    assert both.saved == pytest.approx(0.5 * held.saved + 0.5 * DOUBLED)
    assert "least" not in replace(both, least=-math.inf).to_dict()


def test_without_settings_it_is_what_the_best_save_and_never_less_than_nothing() -> None:
    best = robust_simc_on(MODELS[0], (), DT_S, RobustSettings()).tuning.gains
    slow, tight = simulated(MODELS[0], SLOW), simulated(MODELS[0], PidGains(1.2 * best.kp, 1.6 * best.ki))
    found, expected = foreseen([slow], ONE, None, SLOW), foreseen([slow], ONE, best)
    assert found.saved == expected.saved
    assert found.due
    assert not found.given
    nothing = foreseen([tight], ONE, None)
    assert nothing.saved == 0.0
    assert not nothing.due
    assert foreseen([slow], [], None) is None


@pytest.mark.parametrize(("saved", "due"), [(0.04, False), (0.4, True)])
def test_the_sentence_says_where_nothing_is_due(saved: float, due: bool) -> None:
    found = replace(told(saved, 0.0, 0.0), given=False)
    slow = Diagnosis(Cause.SLUGGISH, 0.9, {}, "slow")
    words = with_gain(slow, found).reason
    assert ("nothing is due" in words) is not due
    assert f"{100 * saved:.0f} % of the error" in words
    assert "nothing is due" not in with_gain(replace(slow, cause=Cause.OK), found).reason
    tight = replace(slow, cause=Cause.AGGRESSIVE)
    assert with_gain(tight, found) == tight
    assert with_gain(slow, told(saved, 0.0, 0.0)).retune is due  # and settings that gain next to nothing are not given


def test_parts_stand_for_the_whole_record_and_hold_no_gap() -> None:
    n = 40_000
    t_s = np.arange(n) * 5.0 + 4_000.0 * (np.arange(n) >= 17_500)
    record = Window(t_s, np.zeros(n), np.arange(n) * 1.0, np.ones(n))
    parts = spread_over(record)

    assert 6 <= len(parts) <= 8
    assert all(np.max(np.diff(part.t_s)) < 6 for part in parts)
    assert parts[0].pv[0] == 0
    assert parts[-1].pv[-1] == n - 1
    assert spread_over(record.part(slice(0, 5_000)))[0].t_s.shape == (5_000,)


SLUGGISH = LoopVerdict(Cause.SLUGGISH, 0.8, AuditAction.RETUNE, "slow", 0.0, 2, 2, 0.9, 0.72, VerdictBasis.HARRIS)


def told(saved: float, least: float, calmer: float) -> Foreseen:
    return Foreseen(100.0, (1.0, 2.0), (3.0, 4.0), saved, least, max(saved, 0.9), calmer)


def test_the_benefit_of_a_retune_is_what_was_foreseen() -> None:
    found = with_foreseen(SLUGGISH, told(0.4, 0.3, -2.0), proposed=True)
    assert (found.avoidable, found.basis, found.action) == (0.4, VerdictBasis.SIMULATED, AuditAction.RETUNE)
    assert found.rank == pytest.approx(0.8 * 0.4)
    calmer = with_foreseen(SLUGGISH, told(-0.1, -0.2, 0.6), proposed=True)
    assert calmer.avoidable == 0.0
    assert calmer.rank == pytest.approx(0.8 * 0.3)
    assert with_foreseen(SLUGGISH, told(-0.1, -0.2, 0.0), proposed=True).rank > 0


def test_what_is_not_sure_enough_to_be_proposed_counts_by_the_worst_model_and_asks_for_a_step() -> None:
    found = with_foreseen(SLUGGISH, told(0.4, 0.3, 0.9), proposed=False)
    assert (found.avoidable, found.basis, found.action) == (0.3, VerdictBasis.SIMULATED, AuditAction.STEP)
    for unknown in (None, told(0.4, -math.inf, 0.9)):
        found = with_foreseen(SLUGGISH, unknown, proposed=False)
        assert (found.avoidable, found.basis, found.action) == (0.9, VerdictBasis.HARRIS, AuditAction.STEP)
        assert 0 < found.rank < SLUGGISH.rank
    assert error_share(0.75) == pytest.approx(0.5)
