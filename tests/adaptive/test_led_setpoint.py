"""A setpoint that another loop leads, or that has noise of its own: few rows a day, and no steps to and fro."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import numpy.typing as npt
import pytest
from pi_loop import Lag, pi_loop, samples_of

from retuner.adaptive.signals.noise import MEDIAN_TO_SIGMA, NoiseState, noise_at_least
from retuner.adaptive.signals.sample import LoopMode, LoopSample
from retuner.adaptive.signals.step_sequence import step_sequence
from retuner.adaptive.supervision.admission import AdmissionSettings, Ground
from retuner.adaptive.supervision.decide import decide
from retuner.adaptive.supervision.decision import Decision, Mode
from retuner.adaptive.supervision.findings import Findings, admission
from retuner.adaptive.supervision.response_finder import ResponseFinder
from retuner.adaptive.supervision.retuner import Retuner
from retuner.adaptive.supervision.retuner_settings import RetunerSettings
from retuner.adaptive.supervision.state_file import remember, restore
from retuner.schedule.gains import PidGains
from retuner.schedule.regions import Regions
from retuner.schedule.table import GainTable

GAINS = PidGains(2.0, 0.05)
N = 2000
LED = Ground.SETPOINT_LED.name.lower()
AGAIN_S = 500.0


def made(again_s: float = AdmissionSettings().led_again_s) -> Retuner:
    table = GainTable("loop", Regions("pv", "-", ("all",), -50.0, (), 50.0, 2.0), (GAINS,))
    settings = RetunerSettings(1.0, 10.0, Mode.AUTO)
    return Retuner(table, replace(settings, admission=replace(settings.admission, led_again_s=again_s)))


def samples(sp: npt.NDArray[np.float64], noise: float = 0.01) -> list[LoopSample]:
    """1/(40 s + 1) under PI, and one percent of noise."""
    found = pi_loop(GAINS, Lag(40.0), sp, noise * np.random.default_rng(4).standard_normal(len(sp)))
    return samples_of(found)


def noisy(size: float = 0.1, n: int = N) -> npt.NDArray[np.float64]:
    return size * np.random.default_rng(7).standard_normal(n)


def led(n: int = N) -> npt.NDArray[np.float64]:
    """What a level loop asks of its slave: it swings, and carries the level's noise."""
    return 2.0 * np.sin(2 * np.pi * np.arange(n) / 60.0) + noisy(0.02, n)


def told(retuner: Retuner, seen: list[LoopSample]) -> list[Decision]:
    """Decisions, by admission alone where that refuses: the stages before it are dear, and find nothing here."""
    made = []
    for sample in seen:
        step = retuner.step(sample)
        if step.question is None:
            made.append(step.decision)
            continue
        result = admission(Findings(step.question)).ended or decide(step.question)
        made.append(retuner.enter(step.question, result, retuner.sample_number))
    return [decision for decision in made if decision is not None]


def test_noise_of_the_setpoint_is_no_step_of_it() -> None:
    retuner = made(again_s=0.0)
    decisions = told(retuner, samples(noisy()))
    late = [d for d in decisions if d.t_s > N / 2]
    assert not late
    assert len(decisions) < 60  # until it is known how large the noise is


def test_a_step_that_stands_out_of_the_setpoints_noise_is_still_seen() -> None:
    sp = noisy(0.05, 1000)
    sp[600:] += 3.0
    retuner = made(again_s=0.0)
    late = [d for d in told(retuner, samples(sp)) if d.t_s > 600]
    assert late
    assert late[0].response.t_start_s == 600.0


def test_a_setpoint_without_noise_leaves_the_band_as_it_was() -> None:
    sp = np.where(np.arange(N) // 200 % 2, 1.0, 0.0)
    finder, plain = (ResponseFinder(made().table.regions, lambda *_: GAINS, made().settings) for _ in range(2))
    for a in samples(sp):
        finder.step(a)
        plain.step(a._replace(sp=0.0))
        assert finder.band == plain.band


def test_the_noise_of_a_signal_is_found_however_long_it_stood_still() -> None:
    least, rng = 0.001, np.random.default_rng(5)
    state = NoiseState(least, 0.0, 0.0)
    for _ in range(5000):
        state = noise_at_least(state, 0.0, least)
    assert state.median == least
    for _ in range(800):
        state = noise_at_least(state, float(rng.standard_normal()), least)
    assert state.median * MEDIAN_TO_SIGMA == pytest.approx(1.0, rel=0.25)


@pytest.mark.slow
@pytest.mark.uncounted
def test_that_a_setpoint_is_led_is_said_once_and_then_with_a_count() -> None:
    every, few = told(made(again_s=0.0), samples(led())), told(made(AGAIN_S), samples(led()))
    rows = [d for d in few if d.code == LED]
    assert len([d for d in every if d.code == LED]) > 20
    assert 2 <= len(rows) <= N / AGAIN_S + 1
    assert all(later.t_s - sooner.t_s >= AGAIN_S for sooner, later in pairwise(rows))
    assert "skipped" not in rows[0].reason
    assert rows[0].numbers.to_dict().get("passed_over") is None
    count = int(rows[1].numbers.to_dict()["passed_over"])
    assert count > 5
    assert f"{count} such responses" in rows[1].reason


def test_once_a_person_sets_the_setpoint_again_the_loop_learns_again() -> None:
    sp = np.concatenate((led(1000), np.zeros(400), np.full(600, 3.0)))
    late = [d for d in told(made(), samples(sp)) if d.t_s > 1500]
    assert [d.code for d in late if d.estimate is not None]


@pytest.mark.slow
@pytest.mark.uncounted
def test_what_else_is_wrong_is_said_while_the_setpoint_is_led() -> None:
    def uneven(s: LoopSample) -> LoopSample:
        return s._replace(t_s=s.t_s + (0.8 if s.t_s > 1000 and s.t_s % 4 == 0 else 0.0))

    decisions = told(made(), [uneven(s) for s in samples(led())])
    assert Ground.IRREGULAR.name.lower() in {d.code for d in decisions}


@pytest.mark.slow
@pytest.mark.uncounted
def test_a_response_that_ends_at_a_limit_is_asked() -> None:
    limited = [s._replace(limited=int(s.t_s > 1000)) for s in samples(led())]
    assert len([d for d in told(made(), limited) if d.t_s > 1000]) > 5


@pytest.mark.slow
def test_over_a_restart_it_counts_on() -> None:
    seen = samples(led(1300))
    whole = told(made(AGAIN_S), seen)
    first = made(AGAIN_S)
    parts = told(first, seen[:900])
    second = restore(remember(first), first.settings)
    assert second.band == first.band
    parts += told(second, seen[900:])
    assert [(d.t_s, d.reason) for d in parts] == [(d.t_s, d.reason) for d in whole]


def test_a_pause_in_manual_keeps_the_noise_of_the_setpoint() -> None:
    retuner = made()
    seen = samples(noisy())
    told(retuner, seen[:1500])
    before = retuner.band
    told(retuner, [s._replace(mode=LoopMode.MANUAL) for s in seen[1500:1600]])
    assert retuner.band > 0.5 * before


def moved(levels: list[float], hold: int) -> list[LoopSample]:
    sp = [level for level in levels for _ in range(hold)]
    return [LoopSample(float(i), value, 0.0, 0.0) for i, value in enumerate(sp)]


TO_AND_FRO = [0.0, 1.0, -1.0]


def test_moves_of_a_sample_each_do_not_stand() -> None:
    assert step_sequence(moved([0.0] * 40 + TO_AND_FRO, 20)) is not None
    assert step_sequence(moved([0.0] * 40 + TO_AND_FRO, 2)) is None


def test_a_setpoint_that_is_led_at_even_times_does_not_go_to_and_fro() -> None:
    rng = np.random.default_rng(2)
    wander = [float(x) for x in rng.uniform(-3, 3, 30)]
    assert step_sequence(moved([*wander, *TO_AND_FRO], 20)) is None


def test_two_series_of_steps_one_after_the_other_are_both_seen() -> None:
    series = [0.0, 1.0, -1.0, 1.0, -1.0, 1.0, 0.0]
    found = step_sequence(moved([*series, *series], 20))
    assert found.opened == 20 * (len(series) + 1)
