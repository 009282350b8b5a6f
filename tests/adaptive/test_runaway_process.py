"""A process that runs away by itself is told from one that does not, by the gains that hold it, and gets its own."""

import math
from collections.abc import Iterator
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.signal import cont2discrete

from retuner.adaptive.explanations.unstable_pole import RUNAWAYS, UnstablePole, unstable_pole
from retuner.adaptive.guard.proof import Loops
from retuner.adaptive.identification.robust_simc import asks_for_integral
from retuner.adaptive.loop.margins import sensitivity_peak
from retuner.adaptive.loop.most_integral import most_integral
from retuner.adaptive.loop.sampled import SampledLaw
from retuner.adaptive.process.model import LinearProcess, ProcessModel, ProcessType
from retuner.adaptive.region_model.region_curves import lenders
from retuner.adaptive.region_model.update import Agreement, update_region_model
from retuner.adaptive.signals.response import Ending, Peak, Response
from retuner.adaptive.signals.sample import FloatArray, LoopMode, LoopSample, Window
from retuner.adaptive.supervision.decision import Action, Decision, Mode
from retuner.adaptive.supervision.known_processes import KnownProcesses, known_of
from retuner.adaptive.supervision.learning import learned_of_runaway
from retuner.adaptive.supervision.retuner import Retuner
from retuner.adaptive.supervision.retuner_settings import RetunerSettings
from retuner.adaptive.supervision.state_file import region_model_in, region_model_out
from retuner.adaptive.trial.batch_responses import ClosedLoop, Upset, traces
from retuner.adaptive.trial.rollback import less_stable
from retuner.schedule.gains import PidGains
from retuner.schedule.regions import Regions
from retuner.schedule.table import GainTable

DT, THETA, TAU, N, STEP_AT = 0.5, 2.0, 1.0, 400, 10
LAW = SampledLaw(PidGains(0.35, 0.005), DT)
MODEL = ProcessModel(ProcessType.RUNAWAY, 12.5, 12.5, TAU, THETA)  # k' 1, pole 0.08
SETTINGS = RetunerSettings(DT, 100.0, Mode.AUTO)


def record(pole: float, law: SampledLaw = LAW, noise: float = 0.002, load: float = 0.0) -> Window:
    """1 e^(-2 s) / ((s + pole)(1 + s)) under a PI controller, integrated between samples. load : from sample 200."""
    rng, pv, co = np.random.default_rng(1), np.zeros(N), np.zeros(N)
    sp = np.where(np.arange(N) >= STEP_AT, 1.0, 0.0)
    state: FloatArray = np.zeros(2)
    integral, late = 0.0, round(THETA / DT)
    for i in range(N):
        pv[i] = state[1] + noise * rng.standard_normal()
        co[i] = law.gains.kp * (sp[i] - pv[i]) + integral
        integral += law.gains.ki * DT * (sp[i] - pv[i])
        u = (co[i - late] if i >= late else 0.0) + (load if i >= N // 2 else 0.0)

        def moves(_: float, x: FloatArray, u: float = u) -> list[float]:
            return [(u - x[0]) / TAU, x[0] - pole * x[1]]

        state = solve_ivp(moves, (0.0, DT), state, rtol=1e-8, atol=1e-10).y[:, -1]
    return Window(DT * np.arange(N, dtype=np.float64), sp, pv, co)


def shown_by(window: Window) -> UnstablePole:
    found = unstable_pole(window, 1)
    assert found is not None
    return found


def test_a_setpoint_step_shows_its_pole() -> None:
    found = shown_by(record(-0.08))
    assert found.probability(RUNAWAYS) > 0.9
    model = found.log.model()
    assert model.runs_away
    assert model.tau1_s == pytest.approx(12.5, rel=0.1)
    assert model.slope == pytest.approx(1.0, rel=0.1)
    assert model.theta_s + model.tau2_s == pytest.approx(THETA + TAU, rel=0.1)
    std = np.sqrt(np.diag(found.log.p))
    assert np.all(std < 0.3)
    truth = np.log([1.0, THETA, 12.5, TAU])
    assert np.all(np.abs(found.log.x - truth) < 3.0 * std)


@pytest.mark.parametrize("pole", [0.0, 0.03, 0.3])
def test_an_integrator_and_a_lag_do_not_run_away(pole: float) -> None:
    assert shown_by(record(pole)).probability(RUNAWAYS) < 0.1


def test_whatever_made_co_shows_it() -> None:
    """Here a hand catches it three times; no law of a controller is asked for."""
    window = record(-0.08, SampledLaw(PidGains(0.3, 0.0), DT))
    assert shown_by(window).probability(RUNAWAYS) > 0.9


def test_a_load_that_comes_besides_is_no_process() -> None:
    found = shown_by(record(-0.08, load=0.1))
    assert found.probability(RUNAWAYS) > 0.85
    assert abs(found.log.x[2] - math.log(12.5)) < 2.0 * math.sqrt(found.log.p[2, 2])
    assert shown_by(record(0.0, load=0.1)).probability(RUNAWAYS) < 0.1


@pytest.mark.parametrize("seed", range(4))
def test_an_integrator_under_a_load_that_wanders_or_a_tone_does_not_run_away(seed: int) -> None:
    """By a simulation without loads one of these was unstable by 12 standard deviations, under a tone by 16."""
    rng = np.random.default_rng(seed)
    load = np.cumsum(rng.standard_normal(N)) * 0.003 if seed % 2 else 0.05 * np.sin(0.15 * np.arange(N) + seed)
    assert shown_by(under(load, rng)).probability(RUNAWAYS) < 0.5


def under(load: FloatArray, rng: np.random.Generator) -> Window:
    """The integrator under a load at its input, too little gain."""
    sp, y, integral, late = np.where(np.arange(N) >= STEP_AT, 1.0, 0.0), 0.0, 0.0, [0.0] * 5
    pv, co = np.zeros(N), np.zeros(N)
    for i in range(N):
        pv[i] = y + 0.01 * rng.standard_normal()
        co[i] = 0.05 * (sp[i] - pv[i]) + integral
        integral += 0.0005 * (sp[i] - pv[i])
        late.append(co[i])
        y += DT * (late.pop(0) + load[i])
    return Window(DT * np.arange(N, dtype=np.float64), sp, pv, co)


def test_a_record_in_which_nothing_moves_or_that_is_short_says_nothing() -> None:
    window = record(-0.08)
    assert unstable_pole(Window(window.t_s, window.sp, window.pv, np.zeros(N)), 1) is None
    assert unstable_pole(window.part(slice(0, 40)), 1) is None


# A gain may be too small for it as well as too large.


LEAST, MOST = 0.08, 0.53  # kp that hold it, with next to no integral action


def test_its_loop_is_stable_between_two_gains() -> None:
    process = MODEL.linear()
    for kp in np.geomspace(0.03, 1.5, 24).tolist():
        gains = PidGains(kp, 1e-5)
        e = traces([ClosedLoop(process, gains)], [Upset(load_step=1e-3)])[0][0].e
        assert math.isfinite(sensitivity_peak(process, gains)) is (LEAST < kp < MOST), kp
        assert (LEAST < kp < MOST) is bool(abs(e[-100:]).max() < abs(e[-200:-100]).max()), kp
    reverse = LinearProcess(-12.5, (TAU,), theta_s=THETA, grows_s=12.5)
    assert sensitivity_peak(reverse, PidGains(-0.3, -0.004)) == sensitivity_peak(process, PidGains(0.3, 0.004))
    assert math.isinf(sensitivity_peak(process, PidGains(-0.3, -0.004)))
    assert math.isinf(sensitivity_peak(process, PidGains(0.0, 0.004)))


def test_its_ms_is_the_largest_sensitivity() -> None:
    gains, s = PidGains(0.25, 0.004), 1j * np.geomspace(1e-4, 10.0, 20_000)
    g = np.exp(-THETA * s) / ((s - 0.08) * (1 + TAU * s))
    most = float(np.max(1 / np.abs(1 + g * (gains.kp + gains.ki / s))))
    assert sensitivity_peak(MODEL.linear(), gains) == pytest.approx(most, rel=1e-4)


@pytest.mark.parametrize("dead", [0.05, 0.1, 0.2, 0.4, 0.6])
def test_the_rule_holds_it_and_keeps_ms_as_far_as_that_can_be(dead: float) -> None:
    process = LinearProcess(-2.0, (0.3,), theta_s=10.0 * dead, grows_s=10.0)
    gains = most_integral(process, 1.59)
    least = min(
        sensitivity_peak(process, PidGains(kp, kp / tau_i))
        for kp in np.geomspace(-0.5, -20.0, 40).tolist()
        for tau_i in (100.0, 400.0)
    )
    assert sensitivity_peak(process, gains) <= max(1.6, 1.08 * least)
    assert asks_for_integral(MODEL)


def test_what_no_controller_holds_has_no_rule() -> None:
    with pytest.raises(ValueError, match="no PI controller holds"):
        most_integral(LinearProcess(1.0, (0.1,), theta_s=11.0, grows_s=10.0), 1.59)


LETS_GO, WEAKER = PidGains(0.05, 0.0), PidGains(0.02, 0.0)


def test_less_of_everything_is_no_way_out_of_it() -> None:
    loops = Loops([MODEL.linear()])
    assert not loops.safer(LETS_GO, WEAKER, WEAKER)
    assert Loops([LinearProcess(1.0, (50.0,), theta_s=9.0)]).safer(
        PidGains(30, 1), PidGains(20, 0.5), PidGains(20, 0.5)
    )


# What a setpoint step shows of it takes the place of all that was known.


def case(window: Window, known: Any = None, *, setpoint: bool = True, limited: bool = False) -> Any:
    """A record as it is asked of what the last setpoint step shows."""
    rows = zip(*(part.tolist() for part in (window.t_s, window.sp, window.pv, window.co)), strict=True)
    samples = [LoopSample(t, sp, pv, co, int(LoopMode.AUTO), int(limited)) for t, sp, pv, co in rows]
    start_s = STEP_AT * DT if setpoint else N * DT / 2
    response = Response(start_s, samples[-1].t_s, (Peak(start_s + 5, 1.0),), Ending.QUIET, setpoint, 0.01)
    table = GainTable("loop", Regions("pv", "-", ("whole",), -1e6, (), 1e6, 1.0, 0.0), (LAW.gains,))
    return SimpleNamespace(
        response=response, samples=samples, pattern=response, entered_s=-math.inf, in_force=LAW.gains, table=table,
        region=0, region_models={} if known is None else {0: known}, window=window,
    )  # fmt: skip


@pytest.mark.parametrize("setpoint", [True, False])
def test_a_step_from_before_a_load_is_asked_as_well(setpoint: bool) -> None:
    learned = learned_of_runaway(case(record(-0.08, load=0.0 if setpoint else 0.05), setpoint=setpoint), SETTINGS)
    assert learned is not None
    assert learned.region_model is not None
    assert learned.region_model.runs_away
    assert all(one.model.runs_away for one in learned.region_model.plausible)


def test_others_and_an_output_at_its_limit_show_none() -> None:
    assert learned_of_runaway(case(record(0.0)), SETTINGS) is None
    assert learned_of_runaway(case(record(-0.08), limited=True), SETTINGS) is None


def test_the_step_that_cuts_a_response_short_is_not_the_one_that_is_asked() -> None:
    window = record(-0.08)
    window.sp[-1] = 2.0
    assert learned_of_runaway(case(window), SETTINGS) is not None


def later(window: Window) -> Window:
    return Window(window.t_s + 1000.0, window.sp, window.pv, window.co)


def test_another_step_is_one_more_record_of_it_and_the_same_is_none() -> None:
    first = learned_of_runaway(case(record(-0.08)), SETTINGS)
    assert first is not None
    again = learned_of_runaway(case(record(-0.08), first.region_model), SETTINGS)
    assert again is not None
    assert again.agreement is Agreement.SILENT
    assert again.region_model is first.region_model
    second = learned_of_runaway(case(later(record(-0.08)), first.region_model), SETTINGS)
    assert second is not None
    assert second.region_model is not None
    assert (second.agreement, second.region_model.records) == (Agreement.AGREES, 2)
    changed = learned_of_runaway(case(later(record(-0.02)), first.region_model), SETTINGS)
    assert changed is not None
    assert changed.agreement is Agreement.CHANGED
    assert learned_of_runaway(case(later(record(0.05)), first.region_model), SETTINGS) is None, "it does not any more"


def test_it_is_remembered_is_lent_to_nobody_and_kept_out_of_other_fits() -> None:
    learned = learned_of_runaway(case(record(-0.08)), SETTINGS)
    assert learned is not None
    model = learned.region_model
    assert model is not None
    again = region_model_in(region_model_out(model))
    assert again.log.model() == model.log.model()
    assert again.plausible == model.plausible
    assert lenders({0: model}, 1) == {}
    told = update_region_model(model, record(0.05), LAW.gains, SETTINGS.tracker, SETTINGS.fit)
    assert told.agreement in {Agreement.FIRST, Agreement.SILENT}


def test_a_set_that_lets_it_go_does_not_come_back() -> None:
    learned = learned_of_runaway(case(record(-0.08)), SETTINGS)
    assert learned is not None
    assert learned.region_model is not None
    known = known_of(KnownProcesses(case(record(-0.08)).table, {0: learned.region_model}, 200.0, SETTINGS), 0)
    assert less_stable(LETS_GO, LAW.gains, known, SETTINGS.trial.harmless_ms)
    assert not less_stable(PidGains(0.25, 0.003), LAW.gains, known, SETTINGS.trial.harmless_ms)


def streamed(gains: PidGains, steps: int = 4) -> Iterator[Decision]:
    """Decisions on a loop on such a process, setpoint steps to and fro."""
    table = GainTable("loop", Regions("pv", "-", ("whole",), -100.0, (), 100.0, 1.0, 0.0), (gains,))
    retuner, rng = Retuner(table, SETTINGS), np.random.default_rng(2)
    moves = np.array([[0.0, 1.0], [0.08 / TAU, 0.08 - 1 / TAU]])
    a, b, c, *_ = cont2discrete((moves, np.array([[0.0], [1 / TAU]]), np.array([[1.0, 0.0]]), np.zeros((1, 1))), DT)
    x, late, integral = np.zeros(2), [0.0] * round(THETA / DT), 0.0
    for i in range(400 * (steps + 1)):
        sp, running = float((i // 400) % 2), retuner.table.gains_of(0)
        pv = float((c @ x)[0]) + 0.004 * float(rng.standard_normal())
        co = running.kp * (sp - pv) + integral
        integral += running.ki * DT * (sp - pv)
        decision = retuner.observe(LoopSample(i * DT, sp, pv, co, LoopMode.AUTO, 0))
        if decision is not None:
            yield decision
            if decision.action in {Action.WRITE, Action.RESTORE} and decision.gains_after is not None:
                retuner.committed(0, decision.gains_after)
        late.append(co)
        x = a @ x + b[:, 0] * late.pop(0)


@pytest.mark.parametrize("gains", [PidGains(0.42, 0.012), PidGains(0.115, 0.0006)])
def test_on_line_it_gets_settings_that_hold_it_better(gains: PidGains) -> None:
    process = MODEL.seen_by_controller(DT).linear()
    decisions = list(streamed(gains))
    written = [d for d in decisions if d.action is Action.WRITE]
    assert written
    assert not any(d.action is Action.RESTORE and d.gains_after != d.gains_before for d in decisions[:-1])
    last = written[-1].gains_after
    assert last is not None
    assert sensitivity_peak(process, last) < min(2.0, sensitivity_peak(process, gains) / 1.3)
    assert (last.kp > gains.kp) is (gains.kp < 2 * LEAST)
    for decision in written:
        assert decision.gains_after is not None
        assert sensitivity_peak(process, decision.gains_after) < sensitivity_peak(process, decision.gains_before)
