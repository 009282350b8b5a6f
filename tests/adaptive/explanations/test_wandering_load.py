"""The likelihood of a process under a load that wanders, against what it must be by other means."""

import math

import numpy as np
import pytest
from drawn_loop import PRIOR, loop_record
from effort import sized
from scipy.optimize import brentq

from retuner import LinearProcess, PidGains
from retuner.adaptive.explanations.likely_processes import LikelyProcesses
from retuner.adaptive.explanations.process_grid import (
    DEAD_TIMES,
    EVERY_LAG,
    GAINS,
    gain_unit,
    responses_of,
    robustness,
    shapes,
)
from retuner.adaptive.explanations.tuning_odds import CLASSES, TuningLimits, class_of, tuning_odds
from retuner.adaptive.explanations.valve_odds import log_odds_of_valve
from retuner.adaptive.explanations.wandering_load import (
    AT_PV,
    BEHIND_LAGS,
    LOADS,
    LOADS_OF_BOOK,
    SLOPE,
    VALUE,
    LoadModel,
    Prepared,
    UnderLoads,
    impulse_response,
    load_models,
    log_likelihood,
    responses,
    under_loads,
)
from retuner.adaptive.fit import engine
from retuner.adaptive.loop.margins import gain_margin, sensitivity_peak
from retuner.adaptive.signals.sample import FloatArray, Window


@pytest.mark.parametrize("lag", [0.03, 3.0, 33.0, math.inf, -16.0])
@pytest.mark.parametrize("bandwidth", [0.05, 0.4])
@pytest.mark.parametrize("order", [AT_PV, VALUE, SLOPE])
def test_the_filter_factors_the_spectrum_of_load_and_noise(lag: float, bandwidth: float, order: int) -> None:
    """r + A(q) A(1/q) is s C(q) C(1/q), and C has no root on or inside the unit circle."""
    (model,) = load_models(lag, (bandwidth,), order)
    w = np.linspace(0.01, math.pi, 50)
    a, c = (np.abs(np.polyval(side[::-1], np.exp(-1j * w))) ** 2 for side in (model.a, model.c))
    r = abs(np.polyval(model.a[::-1], np.exp(-1j * bandwidth))) ** 2
    assert (r + a) / c == pytest.approx(np.full(50, float(((r + a) / c)[0])), rel=1e-6)
    assert np.all(np.abs(np.roots(model.c)) < 1.0 + 1e-12)


def test_a_filter_by_transforms_is_the_recursion() -> None:
    (model,), n = load_models(10.0, (0.2,), 2), 300
    found = impulse_response(model.a, model.c, n)
    expected = np.zeros(n)
    for i in range(n):
        expected[i] = model.a[i] if i < len(model.a) else 0.0
        expected[i] -= sum(model.c[j] * expected[i - j] for j in range(1, min(i, len(model.c) - 1) + 1))
    assert found == pytest.approx(expected, abs=1e-7)


def test_a_response_through_lags_is_the_recursion() -> None:
    u = np.random.default_rng(1).standard_normal(200)
    found = responses(u, 7.0)
    pole, other = math.exp(-1 / 7.0), math.exp(-1 / (0.4 * 7.0))
    first, second = np.zeros(200), np.zeros(200)
    for i in range(1, 200):
        first[i] = pole * first[i - 1] + (1 - pole) * u[i - 1]
        second[i] = other * second[i - 1] + (1 - other) * first[i]
    assert found[0] == pytest.approx(first, abs=1e-9)
    assert found[2] == pytest.approx(second, abs=1e-2)
    slope = responses(np.ones(50), math.inf)[0]
    assert slope == pytest.approx(np.arange(50.0), abs=1e-6)


@pytest.mark.parametrize("order", [AT_PV, VALUE])
def test_least_squares_under_a_load_are_those_of_the_whole_covariance(order: int) -> None:
    """The gain by the filter is that of generalised least squares with the covariance of walk and noise in full."""
    n, lag, rng = 120, 10.0, np.random.default_rng(3)
    u = np.repeat(rng.standard_normal(12), 10)
    load, noise = np.cumsum(rng.standard_normal(n)) * 0.05, 0.3 * rng.standard_normal(n)
    x = responses(u, lag)[0]
    pv = 2.0 * x + (responses(load, lag)[0] if order else 0.1 * load) + noise
    (model,) = load_models(lag, (0.1,), order)
    record = Prepared(pv - pv[0], u - u[0], 0.0, 1.0)
    fit = under_loads(record, record.co[None], lag, [(0.1, order)], (0.0,), through=None if order else 0)
    # in full: A z = w makes z's covariance from w's; its unknown start and the lag's are a column each
    r = abs(np.polyval(model.a[::-1], np.exp(-0.1j))) ** 2
    drive = np.array([np.concatenate([np.zeros(i), impulse_response((1.0,), model.a, n - i)]) for i in range(n)]).T
    inverse = np.linalg.inv(drive @ drive.T + np.eye(n) / r * 1.0)
    pole = math.exp(-1 / lag)
    columns = np.column_stack([responses(record.co, lag)[0], np.ones(n), pole ** np.arange(n)])
    full = np.linalg.solve(columns.T @ inverse @ columns, columns.T @ inverse @ record.pv)[0]
    assert fit.gain[0, 0, 0] == pytest.approx(full, rel=0.02)
    assert fit.gain[0, 0, 0] == pytest.approx(2.0, abs=0.5)


@pytest.mark.parametrize(
    ("kc", "cause"), [(4.2, "aggressive"), (1.6, "ok"), (0.15, "sluggish")], ids=["aggressive", "ok", "sluggish"]
)
def test_the_class_of_a_loop_under_a_walk_and_one_step_is_found(kc: float, cause: str) -> None:
    gains = PidGains(kc, kc / 20.0)
    _, pv, co = loop_record((1.0, 4, 20.0), gains, seed=5, step=4.0)
    record = Prepared(pv - pv[0], co - co[0], 0.0, 1.0)
    found = log_likelihood(record, 1, gain_unit(gains, 1.0))
    odds = tuning_odds(found, gains, 1.0, PRIOR, TuningLimits())
    assert max(odds.classes, key=lambda name: odds.classes[name]) == cause
    assert sum(odds.classes.values()) == pytest.approx(1.0)
    assert float(odds.weights.sum()) == pytest.approx(1.0)


@pytest.mark.parametrize("scale", [1e-3, 40.0])
def test_the_units_of_pv_mean_nothing(scale: float) -> None:
    gains = PidGains(1.6, 0.08)
    _, pv, co = loop_record((1.0, 4, 20.0), gains, seed=6)
    one = log_likelihood(Prepared(pv - pv[0], co - co[0], 0.0, 1.0), 1, gain_unit(gains, 1.0))
    other = log_likelihood(Prepared(scale * (pv - pv[0]), co - co[0], 0.0, 1.0), 1, gain_unit(gains, 1.0) / scale)
    assert other - other.max() == pytest.approx(one - one.max(), abs=1e-6)


@pytest.mark.parametrize(("row", "dead"), [(-1, 4.0), (-3, 8.0), (-5, 0.0)])
def test_a_process_that_runs_away_is_held_between_two_gains(row: int, dead: float) -> None:
    """P control of k e^(-theta s)/(tau s - 1): from k kc = 1 to sqrt(1 + (w tau)^2), w theta = atan(w tau) (De Paor &
    O'Malley 1989).
    """
    every = shapes(EVERY_LAG)
    rows = [i for i, shape in enumerate(every) if shape.lag < 0 and not shape.second]
    places = tuple((rows[row], DEAD_TIMES.index(dead), i) for i in range(len(GAINS)))
    i, j, k = np.array(places).T
    known = LikelyProcesses(places, np.ones(len(places)), responses_of(i, j) * GAINS[k][:, None], 1.0)
    tau, theta = -every[rows[row]].lag, dead + 0.5
    most = math.sqrt(1.0 + (brentq(lambda w: w * theta - math.atan(w * tau), 1e-3, math.pi / theta) * tau) ** 2)
    held = np.isfinite(known.peaks(PidGains(1.0, 0.0)))
    assert held.tolist() == [1.0 < gain < most for gain in GAINS.tolist()]
    assert known.runs_away.all()
    held_by_pi = np.isfinite(known.peaks(PidGains(1.0, 0.1 / tau)))
    assert np.flatnonzero(held_by_pi)[0] >= np.flatnonzero(held)[0]
    assert 0 < held_by_pi.sum() <= held.sum()


@pytest.mark.parametrize("gain", [0.5, 2.0, 6.0])
def test_robustness_of_the_grid_is_that_of_the_margins(gain: float) -> None:
    gains = PidGains(gain, gain / 22.0)
    known = robustness(gains, 1.0)
    row = next(i for i, shape in enumerate(shapes()) if shape.lag == 22.0 and not shape.second)
    column, middle = DEAD_TIMES.index(4.0), len(GAINS) // 2
    process = LinearProcess(1.0 / gain, (22.0,), (), 4.5)  # half a sample for the hold
    assert known.ms[row, column, middle] == pytest.approx(sensitivity_peak(process, gains), rel=0.03)
    assert known.gain_margin[row, column, middle] == pytest.approx(gain_margin(process, gains), rel=0.03)
    w = np.geomspace(3e-3, 3.0, 3000)
    away = np.abs(1.0 + process.response(w) * (gains.kp + gains.ki / (1j * w)))
    assert known.swing[row, column, middle] == pytest.approx(w[np.argmin(away)], rel=0.11)  # the next frequency


@pytest.mark.parametrize("seed", range(3))
def test_the_grid_is_stable_where_the_margins_say_so(seed: int) -> None:
    """A level loop with more integral action than gain, for one, is unstable whatever its gain.

    Not asked of half a sample of dead time alone: there a lag's limit lies beyond the grid's frequencies, unseen.
    """
    rng = np.random.default_rng(seed)
    gains = PidGains(1.0, 10 ** rng.uniform(-2.0, -0.3))
    known, count = robustness(gains, 1.0), 0
    for i, j, k in rng.integers((0, 1, 0), known.ms.shape, (150, 3)).tolist():
        shape = shapes()[i]
        lags = (() if shape.integrates else (shape.lag,)) + ((shape.second,) if shape.second else ())
        loop_gain = float(GAINS[k]) * known.scale * shape.unit
        ms = sensitivity_peak(LinearProcess(loop_gain, lags, (), DEAD_TIMES[j] + 0.5, int(shape.integrates)), gains)
        if not 0.9 < known.gain_margin[i, j, k] < 1.1:
            assert math.isfinite(known.ms[i, j, k]) == math.isfinite(ms), (shape, DEAD_TIMES[j], loop_gain)
            few = LikelyProcesses(
                ((i, j, k),), np.ones(1), responses_of(np.array([i]), np.array([j])) * loop_gain / shape.unit, 1.0
            )
            assert few.stable(gains)[0] == math.isfinite(ms)
            count += 1
    assert count > 100


@pytest.mark.parametrize("seed", [0, 2, 4])
def test_a_level_behind_a_short_lag_of_its_valve_is_not_taken_for_a_lag_alone(seed: int) -> None:
    """It swings slowly; behind second lags of 6 and more, a lag of 10 to 22 samples was e^4 to e^13 likelier."""
    rng, ki, pole = np.random.default_rng(seed), (2 * math.pi / 80.0) ** 2, math.exp(-1 / 2.5)
    gains, noise, moves = PidGains(math.sqrt(0.15 * ki), ki), *rng.standard_normal((2, 800))
    pv, co, x, v, total, load = np.zeros(800), np.zeros(800), 0.0, 0.0, 0.0, 0.0
    for k in range(800):
        pv[k] = x + 0.05 * noise[k]
        total -= ki * pv[k]
        co[k], load = total - gains.kp * pv[k], load + 0.03 * moves[k]
        v = pole * v + (1 - pole) * (co[k] + load)
        x += v
    told = log_likelihood(Prepared(pv - pv[0], co - co[0], 0.0, 1.0), 1, gain_unit(gains, 1.0))
    level = np.array([shape.integrates for shape in shapes()])
    assert told[level].max() > told[~level].max() - 0.5


def test_every_process_has_one_class_and_an_unstable_one_is_too_tight() -> None:
    gains = PidGains(2.0, 0.1)
    known = robustness(gains, 1.0)
    classes = class_of(known, gains, 1.0, TuningLimits())
    assert set(np.unique(classes)) <= set(range(len(CLASSES)))
    tight = {CLASSES.index("aggressive"), CLASSES.index("slow_integrating")}
    assert set(np.unique(classes[np.isinf(known.ms)])) <= tight


@pytest.mark.parametrize(("tau_i", "cause"), [(2.0, "slow_integrating"), (50.0, "aggressive")])
def test_a_swing_far_slower_than_the_integral_time_is_too_much_integral_action(tau_i: float, cause: str) -> None:
    gains = PidGains(1.0, 1.0 / tau_i)
    known = robustness(gains, 1.0)
    tight = (class_of(known, gains, 1.0, TuningLimits()) == CLASSES.index("aggressive")) & (known.gain_margin > 1.1)
    one = next(i for i in np.argwhere(tight).tolist() if shapes()[i[0]].lag > 10 and DEAD_TIMES[i[1]] > 3)
    likelihood = np.full(known.ms.shape, -1e3)
    likelihood[tuple(one)] = 0.0
    assert tuning_odds(likelihood, gains, 1.0, PRIOR, TuningLimits()).classes[cause] > 0.99


def test_a_load_without_noise_is_differenced_only() -> None:
    assert load_models(math.inf, (math.inf,), 1) == (LoadModel((1.0, 1.0), (1.0, 0.0, 0.0)),)


def both_engines(record: Prepared, inputs: FloatArray, lag: float, dead_times: tuple[float, ...]) -> list[UnderLoads]:
    found = []
    for name in ("c", "numpy"):
        with engine.using(name):
            found.append(under_loads(record, inputs, lag, LOADS, dead_times))
    return found


def drawn_record(seed: int) -> Prepared:
    """Any length; a load that wanders, noise, co in steps and with noise, coarse or not."""
    rng = np.random.default_rng(seed)
    n = int(rng.integers(60, 1025))
    co = np.cumsum(rng.standard_normal(n) * (rng.random(n) < rng.choice([0.02, 0.3]))) + 0.05 * rng.standard_normal(n)
    pv = responses(co, float(rng.choice([2.0, 20.0, 200.0])))[0] + 0.1 * np.cumsum(rng.standard_normal(n))
    pv += rng.choice([0.01, 0.3]) * rng.standard_normal(n)
    if rng.random() < 0.3:
        co, pv = np.round(co, 1), np.round(pv, 1)
    return Prepared(pv - pv[0], co - co[0], float(rng.choice([1e-3, 0.1])), 1.0)


@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize(
    ("lag", "close"), [(0.5, 1e-9), (3.0, 1e-9), (22.0, 1e-9), (250.0, 1e-7), (math.inf, 1e-8), (-33.0, 1e-9)], ids=str
)
def test_the_compiled_least_squares_are_those_of_numpy(seed: int, lag: float, close: float) -> None:
    """close : what numpy's transforms leave of a digit where the starts of long second lags look alike."""
    pytest.importorskip("retuner.adaptive.fit.compiled", reason="the compiled engine was not built: no compiler")
    record = drawn_record(seed)
    inputs = np.array([record.co, np.roll(record.co, 3) - record.co[-3]]) if seed % 2 else record.co[None]
    c, numpy = both_engines(record, inputs, lag, DEAD_TIMES)
    for name in ("gain", "information", "left"):
        one, other = getattr(c, name), getattr(numpy, name)
        largest = np.max(np.abs(other), axis=(1, 2), keepdims=True)
        assert np.max(np.abs(one - other) / largest) < close, name
    assert np.array_equal(c.freedom, numpy.freedom)


@pytest.mark.parametrize("seed", range(3))
def test_the_compiled_least_squares_of_a_load_through_both_lags_are_those_of_numpy(seed: int) -> None:
    """A second lag that is in the load adds no start: the round-off of one had taken up to a third of what is left."""
    pytest.importorskip("retuner.adaptive.fit.compiled", reason="the compiled engine was not built: no compiler")
    record, found = drawn_record(seed + 10), []
    for lag in (1.0, 22.0, 80.0, 250.0, -16.0):
        for name in ("c", "numpy"):
            with engine.using(name):
                given = (record, record.co[None], lag, LOADS_OF_BOOK if lag > 0 else BEHIND_LAGS, DEAD_TIMES)
                found.append(under_loads(*given, through=1).left)
        largest = np.max(found[-1], axis=(1, 2), keepdims=True)
        assert np.max(np.abs(found[-2] - found[-1]) / largest) < 1e-7, lag


@pytest.mark.parametrize("lag", [3.0, 250.0])
def test_loads_whitened_together_are_those_of_each_by_itself(lag: float) -> None:
    pytest.importorskip("retuner.adaptive.fit.compiled", reason="the compiled engine was not built: no compiler")
    given = drawn_record(21)
    with engine.using("c"):
        together = under_loads(given, given.co[None], lag, LOADS_OF_BOOK, DEAD_TIMES, through=1)
        for i, load in enumerate(LOADS_OF_BOOK):
            alone = under_loads(given, given.co[None], lag, [load], DEAD_TIMES, through=1)
            if load[1] or load == LOADS_OF_BOOK[-1]:  # a load at pv adds a start to all that are asked for with it
                assert np.array_equal(alone.left[0], together.left[i]), load
                assert np.array_equal(alone.gain[0], together.gain[i]), load


@pytest.mark.parametrize("lag", [3.0, math.inf])
def test_the_compiled_least_squares_beside_tones_are_those_of_numpy(lag: float) -> None:
    pytest.importorskip("retuner.adaptive.fit.compiled", reason="the compiled engine was not built: no compiler")
    record, found = drawn_record(12), []
    turned = np.outer([0.05, 0.051, 0.4], np.arange(len(record.pv)))
    tones = np.vstack([np.cos(turned), np.sin(turned)])
    for name in ("c", "numpy"):
        with engine.using(name):
            given = (record, record.co[None], lag, (*LOADS_OF_BOOK[3:5], *LOADS_OF_BOOK[-3:]), DEAD_TIMES)
            found.append(under_loads(*given, through=1, tones=tones, ends=(0, 1, 6)))
    for name in ("gain", "information", "left"):
        one, other = (getattr(fits, name) for fits in found)
        assert np.max(np.abs(one - other) / np.max(np.abs(other), axis=(1, 2), keepdims=True)) < 1e-7, name
    assert found[0].freedom[:3] == pytest.approx(found[0].freedom[0] - np.array([0, 1, 6]))
    with engine.using("c"):
        without = under_loads(*given, through=1)
        twice = under_loads(*given, through=1, tones=np.vstack([tones[:1], tones]), ends=(1, 7))
    assert np.array_equal(without.left, found[0].left[::3])
    assert np.all(found[0].left[2::3] <= without.left)
    beside = twice.left[1::2] - found[0].left[2::3] + record.resolution**2  # a tone that is there already adds nothing
    assert np.max(np.abs(beside)) < 1e-9 * np.max(without.left)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(sized(1, 1, 3)))
def test_the_compiled_likelihood_is_that_of_numpy(seed: int) -> None:
    pytest.importorskip("retuner.adaptive.fit.compiled", reason="the compiled engine was not built: no compiler")
    record, found = drawn_record(seed + 10), []
    for name in ("c", "numpy"):
        with engine.using(name):
            found.append((log_likelihood(record, 1, 0.7), log_odds_of_valve([record], 1)))
    assert found[0][0] == pytest.approx(found[1][0], abs=1e-8)
    assert found[0][1] == pytest.approx(found[1][1], abs=1e-8)


def test_a_record_whose_process_does_nothing_is_answered_by_both_engines() -> None:
    """co that never moves says nothing of a gain: no information, and the same likelihood for every gain."""
    record = Prepared(np.sin(np.arange(100.0)), np.zeros(100), 0.01, 1.0)
    for name in ("c", "numpy"):
        with engine.using(name):
            found = log_likelihood(record, 1, 1.0)
        assert np.all(np.isfinite(found))
        assert np.ptp(found, axis=2) == pytest.approx(0.0, abs=1e-12)


def test_rows_that_are_missing_or_fall_anywhere_stand_at_their_times() -> None:
    rng, t = np.random.default_rng(1), np.arange(600.0)
    whole = Window(t, np.where(t < 300, 0.0, 1.0), np.sin(t / 30.0), np.cos(t / 30.0))
    rows = np.sort(rng.choice(600, 400, replace=False))
    rows[0], rows[-1] = 0, 599
    some = Window(*(one[rows] for one in (whole.t_s, whole.sp, whole.pv, whole.co)))
    found, wanted = Prepared.at(some, 1.0), Prepared.at(whole, 1.0)
    assert found.pv == pytest.approx(wanted.pv, abs=0.02)
    assert found.co == pytest.approx(wanted.co, abs=0.3)
    assert Prepared.at(whole, 1.0).pv == pytest.approx(whole.pv - whole.pv[0])
