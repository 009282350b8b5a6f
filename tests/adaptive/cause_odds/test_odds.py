"""Odds of every cause, from one record or several: they sum to one, and what means nothing changes nothing."""

import csv
import math
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from pi_loop import Lag, pi_loop

from retuner import PidGains, ProcessType
from retuner.adaptive.cause_odds import odds
from retuner.adaptive.cause_odds.compared_records import windows_of
from retuner.adaptive.cause_odds.odds import _mixed, diagnose_records
from retuner.adaptive.cause_odds.odds_settings import OddsSettings
from retuner.adaptive.controller_settings.read_off import settings_in_force
from retuner.adaptive.diagnosis.cause import Cause, Diagnosis
from retuner.adaptive.diagnosis.tuning_verdict import RecordVerdict
from retuner.adaptive.explanations.valve_odds import WEIGHT
from retuner.adaptive.explanations.wandering_load import MOST_SAMPLES, Prepared
from retuner.adaptive.rules.rule import Tuning
from retuner.adaptive.signals.sample import Window
from retuner.diagnosing import diagnose, diagnose_windows

PLANT = Path(__file__).parents[2] / "data" / "plant"
GAINS = PidGains(1.0, 0.05)


def recorded(name: str) -> Window:
    with (PLANT / name).open(encoding="utf-8") as lines:
        rows = list(csv.DictReader(lines))
    t, sp, pv, co = (np.array([float(row[key]) for row in rows]) for key in ("t", "sp", "pv", "co"))
    return Window(t, sp, pv, co)


def loop(
    kc: float = 1.0, *, seed: int = 1, n: int = 600, step: float = 0.0, sign: int = 1, ramp: float = 0.0
) -> Window:
    """PI on a lag of 20 s with 4 s dead time under a load that wanders, every second."""
    rng = np.random.default_rng(seed)
    drift, noise = np.cumsum(rng.standard_normal(n)) * 0.1 + ramp * np.arange(n), 0.02 * rng.standard_normal(n)
    sp = np.where((np.arange(n) > n // 4) & (np.arange(n) < n // 2), step, 0.0)
    return pi_loop(PidGains(sign * kc, sign * kc / 20.0), Lag(20.0, 4, sign), sp, noise, sign * drift)


def told(window: Window, kc: float = 1.0, sign: int = 1) -> Diagnosis:
    return diagnose_records([window], PidGains(sign * kc, sign * kc / 20.0)).found.diagnosis


@pytest.mark.slow
@pytest.mark.parametrize(
    "window",
    [loop(), loop(4.0, step=4.0), recorded("FIC46002_1102_1.csv"), recorded("LIC42502_0620_1.csv")],
    ids=["walk", "tight", "real", "gaps"],
)
def test_the_odds_sum_to_one_the_largest_is_named(window: Window) -> None:
    gains = settings_in_force(window).gains or GAINS
    found = diagnose_records([window], gains).found.diagnosis
    assert sum(found.causes.values()) == pytest.approx(1.0)
    assert list(found.causes.values()) == sorted(found.causes.values(), reverse=True)
    assert next(iter(found.causes)) == found.cause
    assert found.confidence <= found.causes[str(found.cause)] + 1e-9


@pytest.mark.slow
@pytest.mark.parametrize(("kc", "step", "said"), [(4.0, 4.0, "too much gain"), (2.0, 0.0, "perhaps the tuning")])
def test_a_cause_from_which_nothing_follows_is_said_as_a_perhaps(kc: float, step: float, said: str) -> None:
    found = told(loop(kc, step=step), kc)
    assert found.reason.startswith(said)
    assert (found.confidence < OddsSettings().due_odds) is (step == 0.0)


@pytest.mark.slow
@pytest.mark.parametrize(("kc", "cause"), [(4.2, Cause.AGGRESSIVE), (0.12, Cause.SLUGGISH)])
def test_a_step_of_some_times_the_load_shows_the_tuning(kc: float, cause: Cause) -> None:
    window = loop(kc, step=6.0 if kc > 1 else 40.0, seed=4)
    found = diagnose_windows([window], gains=PidGains(kc, kc / 20.0))
    assert found.cause == cause
    assert (found.recommended.kp < kc) is (cause is Cause.AGGRESSIVE)


def _same(one: Diagnosis, other: Diagnosis, within: float = 0.02) -> None:
    assert other.cause == one.cause
    assert other.causes == pytest.approx(one.causes, abs=within)


@pytest.mark.slow
def test_units_signs_places_and_times_that_mean_nothing_change_nothing() -> None:
    window = loop(seed=2)
    one = told(window)
    moved = Window(window.t_s + 1e6, window.sp + 300.0, window.pv + 300.0, window.co + 40.0)
    _same(one, told(moved))
    thousand = replace(window, sp=window.sp * 1000, pv=window.pv * 1000)
    _same(one, diagnose_records([thousand], PidGains(1e-3, 0.05e-3)).found.diagnosis)
    minutes = replace(window, t_s=window.t_s * 60.0)
    _same(one, diagnose_records([minutes], PidGains(1.0, 0.05 / 60.0)).found.diagnosis)
    turned = replace(window, co=-window.co)
    _same(one, told(turned, sign=-1))


@pytest.mark.slow
def test_records_of_a_loop_add_up() -> None:
    windows = [loop(4.0, seed=seed) for seed in (1, 2, 3)]
    gains = PidGains(4.0, 0.2)
    alone = [diagnose_records([w], gains).found.diagnosis.causes["aggressive"] for w in windows]
    together = diagnose_records(windows, gains)
    assert together.found.diagnosis.causes["aggressive"] >= max(alone) - 0.02
    assert together.found.diagnosis.cause == Cause.AGGRESSIVE


@pytest.mark.slow
def test_records_of_the_same_sticking_valve_are_surer_than_one() -> None:
    window = recorded("FIC20102_1016_12.csv")
    one = diagnose_windows([window])
    both = diagnose_windows([window, window])
    assert one.cause == both.cause == Cause.STICTION
    assert both.diagnosis.causes["stiction"] >= one.diagnosis.causes["stiction"]
    assert both.recommended is None


@pytest.mark.slow
def test_a_tenth_less_of_a_record_leaves_its_cause() -> None:
    """Its end shows most of the valve, and what is left spoke against every one: stiction fell from 75 to 35 %."""
    window = recorded("FIC31102_0628_1.csv")
    n = len(window.t_s)
    for part in (slice(n // 10, None), slice(n - n // 10)):
        assert diagnose_windows([window.part(part)]).cause == Cause.STICTION


@pytest.mark.slow
def test_a_record_of_a_test_in_manual_adds_to_the_odds() -> None:
    window = loop(0.3, seed=9)
    n = 400
    co = np.repeat([0.0, 3.0, 6.0, 3.0, 0.0], n // 5)
    pv = np.zeros(n)
    for i in range(1, n):
        pv[i] = math.exp(-1 / 20.0) * pv[i - 1] + (1 - math.exp(-1 / 20.0)) * (co[i - 5] if i > 4 else 0.0)
    noisy = pv + 0.02 * np.random.default_rng(1).standard_normal(n)
    test = Window(np.arange(float(n)), noisy, noisy, co)
    gains = PidGains(0.3, 0.015)
    before = diagnose_records([window], gains).found.diagnosis.causes
    after = diagnose_records([window, test], gains).found.diagnosis.causes
    assert after["sluggish"] > before["sluggish"]
    assert after["stiction"] < before["stiction"]


def test_a_pv_that_is_not_brought_back_is_said_whatever_the_odds_are() -> None:
    """Of a real pressure that stayed above its setpoint for two hours it was said that it could be much faster only."""
    found = told(loop(0.1, ramp=0.02), 0.1)
    assert found.cause in {Cause.OK, Cause.SLUGGISH}
    assert "pv stays above its setpoint for 100% of the record while co goes one way" in found.reason


def test_a_dead_signal_has_nothing_but_unknown() -> None:
    n = 200
    window = Window(np.arange(float(n)), np.zeros(n), np.zeros(n), np.zeros(n))
    found = diagnose_records([window], GAINS).found.diagnosis
    assert found.causes == {"unknown": 1.0}
    assert diagnose_records([window, loop(4.0, step=4.0)], PidGains(4.0, 0.2)).record == 1


@pytest.mark.slow
def test_open_odds_come_with_a_test_and_sure_ones_without() -> None:
    open_one = told(loop(seed=2))
    assert open_one.confidence < 0.9
    assert open_one.to_dict()["next"] == open_one.next.to_dict()
    sure = diagnose_windows([loop(4.2, step=8.0, seed=4)], gains=PidGains(4.2, 0.21)).diagnosis
    assert sure.confidence > 0.9
    assert sure.next is None


def test_a_change_that_loads_alone_ask_for_comes_with_a_test_however_sure() -> None:
    """One sluggish loop in sixty was told aggressive with 93 %, and its action cut."""
    found = diagnose_records([loop(5.2, seed=3)], PidGains(5.2, 0.26), settings=OddsSettings(undecided=0.75))
    assert found.settings is not None
    assert found.found.diagnosis.confidence > 0.75
    assert found.found.diagnosis.next is not None


def test_a_long_record_is_cut_into_windows_over_all_of_it() -> None:
    window = loop(n=5000)
    parts = windows_of(window, 1.0, 4)
    assert len(parts) == 4
    assert all(len(part.t_s) == MOST_SAMPLES for part in parts)
    assert (parts[0].t_s[0], parts[-1].t_s[-1]) == (0.0, 4999.0)
    assert len(windows_of(loop(n=300), 1.0, 4)) == 1


def test_windows_that_hold_a_record_do_not_overlap() -> None:
    """A record of 1,100 samples had counted twice but for 76 of them, and of every second row once."""
    parts = windows_of(loop(n=MOST_SAMPLES + 76), 1.0, 4)
    assert [len(part.t_s) for part in parts] == [550, 550]
    assert parts[0].t_s[-1] < parts[1].t_s[0]


@pytest.mark.slow
def test_a_list_of_records_is_diagnosed_as_one_loop() -> None:
    paths = [PLANT / "FIC46002_1102_1.csv"] * 2
    found = diagnose(paths)
    assert found.record is not None
    assert sum(found.diagnosis.causes.values()) == pytest.approx(1.0)


@pytest.mark.slow
def test_a_loop_whose_settings_were_changed_is_told_by_those_in_force_now() -> None:
    """In one record, or in one before and one after: what ran under others shows the process only."""
    before, after = loop(4.0, step=4.0), loop(1.0, step=4.0, seed=2)
    sp, pv, co = (np.concatenate([getattr(one, name) for one in (before, after)]) for name in ("sp", "pv", "co"))
    for found in (diagnose(np.arange(1200.0), sp, pv, co), diagnose_windows([before, after])):
        assert (found.cause, found.on) == (Cause.OK, 1)
        assert found.active is not None
        assert found.active.kp == pytest.approx(1.0, abs=0.1)
        assert [own is None for own in found.earlier] == [False, True]


def test_settings_that_make_no_sense_are_refused() -> None:
    with pytest.raises(ValueError, match="must sum to 1"):
        OddsSettings(ok=0.9)
    with pytest.raises(ValueError, match="undecided"):
        OddsSettings(undecided=-1.0)
    with pytest.raises(ValueError, match="the probabilities of the causes sum to"):
        Diagnosis(Cause.OK, 0.5, {}, "", causes={"ok": 0.5})


def test_a_slave_of_a_cascade_is_told_how_it_tracks_its_setpoint() -> None:
    rng, n, dead = np.random.default_rng(7), 400, 4
    sp = np.cumsum(rng.standard_normal(n))
    pole, total, y = math.exp(-1 / 5.0), 0.0, 0.0
    pv, co = np.zeros(n), np.zeros(n)
    for i in range(n):
        y = pole * y + (1 - pole) * (co[i - dead - 1] if i > dead else 0.0)
        pv[i] = y + 0.05 * rng.standard_normal()
        total += 0.1 * (sp[i] - pv[i])
        co[i] = 0.5 * (sp[i] - pv[i]) + total
    found = diagnose_records([Window(np.arange(float(n)), sp, pv, co)], PidGains(0.5, 0.1)).found.diagnosis
    assert found.cause == Cause.OK
    assert dead <= found.evidence["follows_late_s"] <= 3 * dead
    assert 0.0 < found.evidence["tracking_error"] < 1.0
    assert "slave of a cascade" in found.reason


def test_equal_odds_keep_their_order_in_every_process() -> None:
    """Sets of words come in another order in each process: so had equal causes, and sums in the last digit."""
    names: Any = [str(i) for i in range(40)]
    odds = dict.fromkeys(names, 1 / 40)
    assert list(_mixed(odds, odds, 0.5, 0.99)) == names


@pytest.mark.parametrize(
    ("cause", "weight", "rivals"),
    [
        (Cause.AGGRESSIVE, 0.12, 0.0),
        (Cause.EXTERNAL, 0.5, 0.0),
        (Cause.EXTERNAL, 0.018, 4.0),  # a valve behind a load that wanders is a rival of the tone
        (Cause.STICTION, 0.0, 4.0),  # its fit counts among the shapes
    ],
)
def test_steps_that_leave_the_noise_alone_count_by_their_likelihood_and_a_tone_as_much_as_a_walk(
    monkeypatch: pytest.MonkeyPatch, cause: Cause, weight: float, rivals: float
) -> None:
    """A slow swing in noise was too much gain from every second row, where a walk was e^10 times likelier."""
    record = SimpleNamespace(pv=np.zeros(9), sample_time_s=1.0, noise_std=1.0)
    misfit = SimpleNamespace(record=record, loads=2, harmonics=0)
    fit = SimpleNamespace(
        colour=SimpleNamespace(std=0.8), fit=SimpleNamespace(misfit=misfit, at=SimpleNamespace(explained=np.ones(9)))
    )
    found: Any = SimpleNamespace(fits={"linear": fit, "external": fit, "stuck": fit})
    walk: Any = SimpleNamespace(record=record, of_record=np.zeros(1), moved=0.2)
    monkeypatch.setattr(odds, "lead_of_steps", lambda *_: -12.0)
    assert odds._weight_of_steps(cause, found, walk, rivals, OddsSettings()) == pytest.approx(weight, abs=0.01)


@pytest.mark.parametrize(
    ("cause", "loads", "heavy"),
    [
        (Cause.EXTERNAL, 2, True),
        (Cause.SLUGGISH, 0, True),
        (Cause.SLUGGISH, 1, False),  # a slipping valve looks like load steps
    ],
)
def test_what_leaves_the_noise_alone_weighs_as_a_valve_does(monkeypatch, cause, loads, heavy):
    """A triangle from outside, and a process with a lead after a setpoint step, were a sticking valve with 97 %."""
    record = SimpleNamespace(pv=np.zeros(9), sample_time_s=1.0, noise_std=1.0)
    misfit = SimpleNamespace(record=record, loads=loads, harmonics=5)
    fit = SimpleNamespace(
        colour=SimpleNamespace(std=0.8), fit=SimpleNamespace(misfit=misfit, at=SimpleNamespace(explained=np.ones(9)))
    )
    found: Any = SimpleNamespace(fits={"external": fit, "linear": fit})
    walk: Any = SimpleNamespace(record=record, of_record=np.zeros(1), moved=0.2)
    monkeypatch.setattr(odds, "lead_of_steps", lambda *_: 6.0 * 18.0)
    weight = odds._weight_of_steps(cause, found, walk, 2.5 * 14.5, OddsSettings())
    assert (weight > 0.99) is heavy


def test_a_healthy_flow_loop_does_not_bend_where_its_first_tenth_is_cropped() -> None:
    """With the loads that stand beside a valve its gain changed along pv, with 80 %."""
    record = recorded("FIC46002_1102_1.csv")
    found = diagnose_windows([record.part(slice(len(record.t_s) // 10, None))]).diagnosis
    assert found.cause is Cause.OK
    assert found.causes["nonlinear"] < 0.4


def test_a_healthy_flow_loop_has_no_valve_by_every_second_row() -> None:
    """With the valve's likeliest loads on both sides, and not the loop's own, it stuck by 65 %."""
    record = recorded("FIC10201_1018_1.csv")
    assert diagnose_windows([record.part(slice(None, None, 2))]).diagnosis.causes["stiction"] < 0.25


@pytest.mark.slow
@pytest.mark.parametrize("in_time", [1.0, 1.0 / 60.0])
def test_a_valve_that_its_pv_shows_is_a_rival_of_load_steps_in_any_unit_of_time(in_time: float) -> None:
    """Counted in minutes, three load steps and an unstable loop had outvoted it with 70 %."""
    record = recorded("FIC20102_1016_13.csv")
    found = diagnose_windows([Window(record.t_s * in_time, record.sp, record.pv, record.co)]).diagnosis
    assert found.cause is Cause.STICTION
    assert found.causes["stiction"] > 0.8


def test_a_lasting_tone_weighs_less_the_likelier_a_valve_is(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(odds, "_one_tone", lambda *_: 1.0)
    monkeypatch.setattr(odds, "_weight_of_steps", lambda *_: 0.0)
    found: Any = SimpleNamespace(diagnosis=Diagnosis(Cause.UNKNOWN, 0.5, {}, ""), fits={})
    walk: Any = SimpleNamespace()
    for rivals, weight in ((0.0, 1.0), (2.0, math.exp(-2.0))):
        share = {Cause.STICTION: 0.2, Cause.OK: 0.8}
        told = odds._under_steps([(loop(), found)], share, rivals, walk, GAINS, OddsSettings())
        assert told[1] == pytest.approx(weight)


@pytest.mark.parametrize(("moved", "loads", "counts"), [(0.5, 2, True), (0.5, 3, False), (0.0, 2, False)])
def test_load_steps_count_where_they_are_few_and_the_setpoint_moves(moved: float, loads: int, counts: bool) -> None:
    """Three sluggish loops under ramps of another loop were told as in order with 92 to 96 %, by steps."""
    record = SimpleNamespace(pv=np.zeros(9), sample_time_s=1.0, noise_std=1.0)
    misfit = SimpleNamespace(record=record, loads=loads, harmonics=0)
    fit = SimpleNamespace(misfit=misfit, at=SimpleNamespace(explained=np.zeros(9)))
    found: Any = SimpleNamespace(fits={"linear": SimpleNamespace(colour=SimpleNamespace(std=0.9), fit=fit)})
    prepared = Prepared(np.arange(9.0), np.zeros(9), 0.1, 1.0)
    walk: Any = SimpleNamespace(moved=moved, record=prepared, of_record=np.zeros(1))
    assert (odds._weight_of_steps(Cause.OK, found, walk, 0.0, OddsSettings()) > 0.0) == counts


def beside_a_tone(
    cause: Cause, lead: float, *, k: float = 1.0, left: float = 1.0, steps: float = 1.0, period_s: float = 30.0
) -> Any:
    """A verdict where loads are steps, and a tone's fit with k/(20 s + 1) and 4 s dead time beside the tone."""
    record = SimpleNamespace(noise_std=1.0, sample_time_s=1.0, span_s=100.0)
    misfit = SimpleNamespace(type=ProcessType.FOPDT, sign=1, record=record, loads=0)
    fit = SimpleNamespace(misfit=misfit, x=np.log([k / 20.0, 4.0, 20.0]), p=np.log([2.0 * math.pi / period_s]))
    evidence = {"external_lead": lead, "setpoint_steps": steps, "ms": 3.0}
    tone = SimpleNamespace(fit=fit, colour=SimpleNamespace(std=left))
    return SimpleNamespace(diagnosis=Diagnosis(cause, 0.5, evidence, ""), fits={"external": tone})


@pytest.mark.parametrize(
    ("found", "share"),
    [
        (beside_a_tone(Cause.AGGRESSIVE, 60.0), 1.0),
        (beside_a_tone(Cause.UNKNOWN, 60.0), 1.0),
        (beside_a_tone(Cause.OK, 60.0), 0.0),  # whatever swings, nothing is wrong with the loop
        (beside_a_tone(Cause.AGGRESSIVE, 60.0, k=6.0), 0.0),  # a loop too tight beside the tone as well
        (beside_a_tone(Cause.AGGRESSIVE, 60.0, k=6.0, steps=0.0), 1.0),  # loads alone do not show that process
        (beside_a_tone(Cause.AGGRESSIVE, 60.0, left=1.5), 0.0),  # what wanders always holds some sinusoid
        (beside_a_tone(Cause.AGGRESSIVE, 60.0, period_s=50.0), 0.0),  # two cycles: a load like any other
        (beside_a_tone(Cause.AGGRESSIVE, -20.0), 0.0),
    ],
)
def test_a_tone_is_the_cause_where_the_loop_is_robust_beside_it(found: Any, share: float) -> None:
    """A good loop under a sine, too tight by its load steps, had 68 % for the sine and has 97 %."""
    assert odds._tone_instead(found, PidGains(2.0, 0.1), OddsSettings()) == pytest.approx(share, abs=0.01)


def test_a_tone_as_good_as_the_loop_with_load_steps_moves_the_odds_a_little() -> None:
    """A sluggish loop, 95 %, was unknown where the tone's criterion was the smaller one by 4."""
    shares = [
        odds._tone_instead(beside_a_tone(Cause.SLUGGISH, lead), GAINS, OddsSettings()) for lead in (-4.0, 0.0, 4.0)
    ]
    assert shares == sorted(shares)
    assert shares[-1] - shares[0] < 0.1


def test_a_record_in_which_no_slip_is_seen_speaks_a_little_against_those_of_another(monkeypatch):
    slips = iter([6.0, -math.inf])
    monkeypatch.setattr(odds, "log_odds_of_slips", lambda *_: next(slips))
    walk = odds._walk([loop(seed=1, n=200), loop(seed=2, n=200)], PidGains(1.0, 0.05), 1, OddsSettings())
    assert walk.valve == pytest.approx(6.0 * WEIGHT + odds.UNSEEN)


@pytest.mark.parametrize(
    ("causes", "loads", "new", "given"),
    [
        # more gain under less integral action answers a slow swing and a sluggish loop
        ({Cause.SLOW_INTEGRATING: 0.55, Cause.SLUGGISH: 0.32, Cause.STICTION: 0.08}, (), (2.0, 0.05), True),
        ({Cause.SLOW_INTEGRATING: 0.5, Cause.SLUGGISH: 0.32, Cause.STICTION: 0.08}, (), (0.9, 0.05), False),
        ({Cause.SLUGGISH: 0.6, Cause.OK: 0.4}, (), (2.0, 0.2), True),
        ({Cause.SLUGGISH: 0.6, Cause.OK: 0.4}, (True, False), (2.0, 0.2), False),  # loads alone
        ({Cause.SLUGGISH: 0.6, Cause.OK: 0.4}, (True, False), (2.0, 0.09), False),
        ({Cause.AGGRESSIVE: 0.7, Cause.OK: 0.3}, (True, False), (0.5, 0.05), True),
        ({Cause.AGGRESSIVE: 0.7, Cause.OK: 0.3}, (True, True), (0.5, 0.05), False),  # a load that swings may be all
        ({Cause.AGGRESSIVE: 0.8, Cause.OK: 0.2}, (), (2.0, 0.2), False),
        ({Cause.AGGRESSIVE: 0.7, Cause.STICTION: 0.3}, (), (0.5, 0.05), False),  # behind a valve no process is seen
        ({Cause.SLUGGISH: 0.9, Cause.NONLINEAR: 0.1}, (), (2.0, 0.2), False),
    ],
)
def test_settings_go_the_way_that_the_odds_of_the_causes_ask_for(monkeypatch, causes, loads, new, given):
    gains = PidGains(*new)
    monkeypatch.setattr(odds, "worthwhile", lambda _, __, asked: gains if asked(gains) else None)
    monkeypatch.setattr(odds, "swinging_processes", lambda *_: [])
    known, record = cast("Any", SimpleNamespace(gains=PidGains(1.0, 0.1), sample_time_s=1.0)), cast("Any", None)
    found, why = odds._settings(causes, known, record, *(loads or (False, False)), OddsSettings())
    assert (found is gains) is given
    assert bool(why) is not given


def test_a_slow_cycle_of_a_valve_is_seen_in_rows_closer_than_it_needs() -> None:
    """In two windows with half of its cycles each it was no valve. Its dead time of 20 rows is given to co as well:
    where the grid ended at 12 the valve was likelier by e^12.
    """
    n, late, gains, rng = 1600, 40, PidGains(0.4, 0.4 / 60.0), np.random.default_rng(1)
    sp, walk = 2.0 * (np.arange(n) > 100), np.cumsum(0.05 * rng.standard_normal(n))
    pole, total, y, stands = math.exp(-1 / 60.0), 0.0, 0.0, 0.0
    pv, co, at = np.zeros(n), np.zeros(n), np.zeros(n)
    for i in range(n):
        y = pole * y + (1 - pole) * ((at[i - late] if i >= late else 0.0) + walk[i])
        pv[i] = y + 0.1 * rng.standard_normal()
        total += gains.ki * (sp[i] - pv[i])
        co[i] = gains.kp * (sp[i] - pv[i]) + total
        stands = at[i] = co[i] if abs(co[i] - stands) > 4.0 else stands
    found = odds._walk([Window(np.arange(float(n)), sp, pv, co)], gains, 1, OddsSettings())
    assert found.valve > 1.5


@pytest.mark.parametrize(("p", "by_fit"), [(0.5, False), (0.7, True)])
def test_settings_of_a_single_fit_ask_for_the_odds_that_all_settings_do(p: float, by_fit: bool) -> None:
    """A loop in order under real loads was calmed by a fit that had 50 % (12201)."""
    tuning = Tuning("simc", "series", PidGains(1.0, 0.05))
    told = RecordVerdict(Diagnosis(Cause.AGGRESSIVE, 0.9, {}, "by its margins", settled=True), tuning=tuning)
    walk = cast("odds.Walk", SimpleNamespace(moved=0.0, period_s=math.nan))
    causes, window = {Cause.AGGRESSIVE: p, Cause.OK: 1.0 - p}, loop()
    found = odds._verdict(told, causes, 0.9, None, walk, [(window, told)], OddsSettings(), (None, None), sure=True)
    assert (found.found.tuning is not None) is by_fit


@pytest.mark.parametrize(
    ("noise", "dead", "ends", "cause"),
    [(5e-6, 2, 600, Cause.OK), (5e-4, 2, 300, Cause.OK), (5e-3, 2, 600, Cause.OK), (0.0, 0, 600, Cause.SLUGGISH)],
)
def test_a_loop_simulated_without_noise_has_no_valve_and_no_bend(noise, dead, ends, cause):
    """What the grid of lags and gains lacks was a valve by 97 % in two of these, a gain that bends in the others."""
    n, rng, pole, total, y = 600, np.random.default_rng(1), math.exp(-0.1), 0.0, 0.0
    sp = np.where((np.arange(n) >= 50) & (np.arange(n) < ends), 5.0, 0.0)
    pv, co = np.zeros(n), np.zeros(n)
    for i in range(n):
        pv[i] = y + noise * rng.standard_normal()
        total += 0.1 * (sp[i] - pv[i])
        co[i] = sp[i] - pv[i] + total
        y = pole * y + (1 - pole) * (co[i - dead] if i >= dead else 0.0)
    assert diagnose(np.arange(float(n)), sp, pv, co, gains=PidGains(1.0, 0.1)).cause == cause


@pytest.mark.slow
def test_a_sluggish_loop_without_settings_is_told_why() -> None:
    """Loads alone leave it open; with them the gains that are not known surely keep settings away, and that is said."""
    window = loop(0.12, seed=4)
    found = diagnose_windows([window], gains=PidGains(0.12, 0.12 / 20.0))
    assert found.cause == Cause.SLUGGISH
    assert found.recommended is None
    assert "No settings: the setpoint hardly moves" in found.diagnosis.reason
    rough = diagnose_records([window], None, direction=1, rough=PidGains(0.12, 0.12 / 20.0)).found.diagnosis
    assert rough.cause == Cause.SLUGGISH
    assert "No settings: the active settings are only known roughly" in rough.reason


def test_a_loop_that_swings_within_its_noise_is_not_noise_alone() -> None:
    """A level with too little gain for its integral action, k' Kc tau_I 0.23: a fit leaves the swing to the noise."""
    rng, gains, n = np.random.default_rng(7), PidGains(1.0, 0.22), 1000
    load, noise = 0.02 * np.cumsum(rng.standard_normal(n)), rng.standard_normal(n)
    found = diagnose_records([pi_loop(gains, Lag(200.0, 1, 10.0), np.zeros(n), noise, load)], gains).found.diagnosis
    assert found.causes["aggressive"] + found.causes["slow_integrating"] > 0.6
