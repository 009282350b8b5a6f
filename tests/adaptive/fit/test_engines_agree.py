"""The compiled engine and numpy compute the same: at random points of every structure, step by step, and as a whole."""

import math
from collections.abc import Iterator
from dataclasses import replace
from itertools import permutations

import numpy as np
import pytest
from effort import sized
from scipy.linalg import expm

from retuner.adaptive.diagnosis.unstable_process import UnstableProcess, _answer
from retuner.adaptive.fit import engine
from retuner.adaptive.fit.dynamics import told_apart
from retuner.adaptive.fit.misfit import Misfit, changes_of, colour
from retuner.adaptive.fit.record import Record
from retuner.adaptive.fit.refine import Prior, bounds, refine
from retuner.adaptive.fit.search import SearchGrid, _searched
from retuner.adaptive.fit.structure import SIZE, dynamics_at
from retuner.adaptive.identification.candidate import judged
from retuner.adaptive.identification.loads import linear_gains
from retuner.adaptive.identification.structure_choice import _ramps
from retuner.adaptive.loop.sampled import SampledLaw
from retuner.adaptive.process.model import LinearProcess, ProcessType, exponentials
from retuner.adaptive.signals.sample import FloatArray, Window
from retuner.adaptive.trial.batch_responses import ClosedLoop, Upset, traces
from retuner.adaptive.valve.plateaus import as_steps
from retuner.adaptive.valve.slips import Co, Slips, _greedy, explained_by
from retuner.adaptive.valve.valve_fit import Nodes, _moved, _through, valve_costs, valves_tried
from retuner.adaptive.valve.valve_model import Family, StuckValve
from retuner.schedule.gains import PidGains

compiled = pytest.importorskip("retuner.adaptive.fit.compiled", reason="the compiled engine was not built: no compiler")
POINTS = sized(40, 40, 1000)  # Random points of every structure
CLOSE = 1e-9  # Largest difference, as a share of the largest value
DEPENDENT = 1e8
"""Above this condition of the columns, the coefficients are not told from each other in double precision."""


def drawn_record(rng: np.random.Generator) -> Record:
    """A record of any clock, with or without a gap, at rest or in motion."""
    n, dt = int(rng.integers(60, 300)), 10 ** rng.uniform(-2, 2)
    t = np.cumsum(rng.uniform(0.3, 1.7, n)) * dt if rng.random() < 0.4 else np.arange(n) * dt
    if rng.random() < 0.3:
        t[rng.integers(n // 4, n - 5) :] += dt * rng.uniform(6, 30)
    co = np.cumsum(rng.standard_normal(n) * (rng.random(n) < 0.05)) + 0.05 * rng.standard_normal(n)
    pv = 0.02 * np.cumsum(co) + 0.1 * rng.standard_normal(n)
    if rng.random() < 0.5:
        pv += 5 * np.exp(-8 * (t - t[0]) / (t[-1] - t[0]))
    return Record.of(Window(t, np.zeros(n), pv, co))


def drawn(rng: np.random.Generator, type_: ProcessType) -> tuple[Misfit, FloatArray]:
    """A misfit with any of its parts, and a point."""
    record, loads = drawn_record(rng), int(rng.integers(0, 4))
    misfit = Misfit(
        record,
        type_,
        int(rng.choice([-1, 1])),
        loads,
        float(rng.uniform(0.3, 2)) * record.noise_std,
        0.3,
        ar=tuple(rng.uniform(-0.4, 0.4, rng.integers(0, 3))),
        harmonics=int(rng.integers(1, 4)) if rng.random() < 0.15 else 0,
        ramp=bool(rng.random() < 0.3),
        rounded=bool(loads and rng.random() < 0.4),
        corners=int(rng.integers(0, loads + 1)) if rng.random() < 0.4 else 0,
    )
    low, high = bounds(misfit)
    d, span = SIZE[type_], record.span_s
    p = np.log(span) + rng.uniform(-6, 0, misfit.size)
    p[0] = math.log(record.pv_range / record.co_range / span) + 1.5 * rng.standard_normal()
    p[d : d + loads] = rng.uniform(0, 1, loads) * (span - record.sample_time_s)
    if misfit.harmonics:
        p[-1] = rng.uniform(low[-1], high[-1])
    return misfit, np.clip(p, low, high)


def points(type_: ProcessType) -> Iterator[tuple[Misfit, FloatArray]]:
    rng = np.random.default_rng(SIZE[type_] + 10 * len(type_))
    for _ in range(POINTS):
        yield drawn(rng, type_)


def off(found: FloatArray, expected: FloatArray) -> float:
    """Largest difference as a share of the largest value."""
    return float(np.max(np.abs(found - expected)) / max(float(np.max(np.abs(expected))), 1e-300))


@pytest.mark.slow
@pytest.mark.uncounted
@pytest.mark.parametrize("type_", SIZE)
def test_columns_residuals_costs_and_derivatives_at_random_points(type_: ProcessType) -> None:
    for misfit, p in points(type_):
        with engine.using("numpy"):
            at = misfit.solve(p)
            sizes = [np.max(np.abs(misfit.whitened(change))) / misfit.sigma for change in changes_of(misfit, at)]
            jacobian = misfit.jacobian(at)
        q, r, c, moved, columns, triangle = compiled.projected(misfit, p)
        assert off(columns, at.columns) < CLOSE
        assert off(moved, at.moved) < CLOSE
        if np.linalg.cond(triangle) > DEPENDENT:
            continue
        assert off(r, at.r) < CLOSE
        assert off(c, at.c) < CLOSE
        assert abs(float(r @ r) / at.cost - 1) < CLOSE
        assert abs(compiled.costs(misfit, [p])[0] / at.cost - 1) < CLOSE
        assert off(q @ triangle, at.q @ at.triangle) < CLOSE
        worst = np.max(np.abs(compiled.jacobian(misfit, p) - jacobian), axis=0)
        stride = np.ones(misfit.size)
        stride[SIZE[type_] : SIZE[type_] + misfit.loads] = misfit.record.span_s
        rates = [s for s, _ in told_apart(dynamics_at(misfit.type, p)).modes()]
        if misfit.rounded:
            rates.append(complex(math.exp(-p[SIZE[misfit.type] + misfit.loads])))
        allowed = (
            CLOSE + max((1e-15 / max(abs(1 - a / b), 1e-5) ** 3 for a, b in permutations(rates, 2) if b), default=0.0)
        ) * np.maximum(np.array(sizes) * stride, 1.0)
        assert np.all(worst * stride <= allowed)


@pytest.mark.slow
@pytest.mark.parametrize("type_", SIZE)
@pytest.mark.parametrize("with_prior", [False, True])
def test_a_refinement_ends_in_the_same_optimum(type_: ProcessType, with_prior: bool) -> None:
    rng = np.random.default_rng(7)
    for _ in range(6):
        misfit, p = drawn(rng, type_)
        misfit = replace(misfit, harmonics=0, rounded=False, corners=0, loads=min(misfit.loads, 1))
        start, d = p[: misfit.size], SIZE[type_]
        prior = Prior.of(start[:d] + 0.1, 0.3 * np.eye(d)) if with_prior else None
        with engine.using("numpy"):
            expected = refine(misfit, start, prior, evaluations=6)
        found = refine(misfit, start, prior, evaluations=6)
        assert found.deviance == pytest.approx(expected.deviance, rel=1e-6)
        assert off(found.explained, expected.explained) < 1e-4


def test_the_coarse_search_finds_the_same_nodes() -> None:
    rng = np.random.default_rng(3)
    for type_ in (ProcessType.FOPDT, ProcessType.INTEGRATING):
        for _ in range(5):
            record = drawn_record(rng)
            misfit = Misfit(record, type_, 1, 0, record.noise_std, 0.3)
            grid = SearchGrid.of(misfit)
            expected, found = list(_searched(grid, misfit, 2)), list(compiled.searched(grid, misfit.sigma, 2))
            assert [(n.lag_s, n.theta_s, n.loads) for n in found] == [(n.lag_s, n.theta_s, n.loads) for n in expected]
            assert off(np.array([n.deviance for n in found]), np.array([n.deviance for n in expected])) < CLOSE
            assert off(np.array([n.slope for n in found]), np.array([n.slope for n in expected])) < 1e-7


def test_the_coarse_search_finds_the_same_nodes_where_load_steps_are_barred() -> None:
    rng = np.random.default_rng(3)
    for type_ in (ProcessType.FOPDT, ProcessType.INTEGRATING):
        record = drawn_record(rng)
        record = replace(record, barred_s=(0.2 * record.span_s, 0.61 * record.span_s))
        misfit = Misfit(record, type_, 1, 0, record.noise_std, 0.3)
        grid = SearchGrid.of(misfit)
        parts = list(grid.parts(record))
        assert len(parts) > len(grid.lags_s)  # a longer dead time bars others
        found = [node for part in parts for node in compiled.searched(part, misfit.sigma, 2)]
        expected = {(n.lag_s, n.theta_s, len(n.loads)): n for n in _searched(grid, misfit, 2)}
        assert len(found) == len(expected)
        for node in found:
            other = expected[node.lag_s, node.theta_s, len(node.loads)]
            assert node.loads == other.loads
            assert node.deviance == pytest.approx(other.deviance, rel=1e-7)


@pytest.mark.parametrize("places", [0, 1])
def test_fewer_places_than_load_steps_are_searched_with_what_there_is(places: int) -> None:
    record = drawn_record(np.random.default_rng(3))
    misfit = Misfit(record, ProcessType.FOPDT, 1, 0, record.noise_std, 0.3)
    grid = SearchGrid.of(misfit)
    few = replace(grid, at_s=grid.at_s[3 : 3 + places])
    expected = list(_searched(few, misfit, places))
    found = list(compiled.searched(few, misfit.sigma, 2))
    assert [node.loads for node in found] == [node.loads for node in expected]
    assert [node.deviance for node in found] == pytest.approx([node.deviance for node in expected], rel=1e-7)


def test_the_colour_of_a_remainder_is_the_same() -> None:
    rng = np.random.default_rng(4)
    for order in range(5):
        r = rng.standard_normal(400)
        for i in range(order, 400):
            r[i] += 0.6 * r[i - 1] - 0.2 * r[i - order]
        with engine.using("numpy"):
            expected = colour(r, 1e-3)
        found = colour(r, 1e-3)
        assert found.std == pytest.approx(expected.std, rel=CLOSE)
        assert found.ar == pytest.approx(expected.ar, rel=1e-7)


def test_a_further_load_step_brings_the_same() -> None:
    rng = np.random.default_rng(5)
    for type_ in SIZE:
        misfit, p = drawn(rng, type_)
        at = judged(refine(misfit, p, evaluations=3))
        instants = np.linspace(0, misfit.record.span_s, 32)[1:-1]
        steps = dynamics_at(type_, at.fit.p).step(misfit.record.t_s[:, None] - instants[None, :])
        steps = misfit.lagged(at.fit.p, steps)
        expected = linear_gains(at, steps / np.max(np.abs(steps), axis=0))
        found = compiled.load_gains(misfit, at.fit.p, instants)
        np.testing.assert_allclose(found, expected, atol=1e-7 * np.max(expected) + 1e-9)


def test_a_further_corner_of_a_load_brings_the_same() -> None:
    rng = np.random.default_rng(7)
    for type_ in SIZE:
        misfit, p = drawn(rng, type_)
        at = judged(refine(misfit, p, evaluations=3))
        instants = np.linspace(0, misfit.record.span_s, 32)[1:-1]
        found = compiled.load_gains(misfit, at.fit.p, instants, corner=True)
        expected = linear_gains(at, _ramps(at, instants))
        np.testing.assert_allclose(found, expected, atol=1e-6 * np.max(expected) + 1e-9)


def test_sticking_valves_move_and_explain_alike() -> None:
    rng = np.random.default_rng(6)
    for _ in range(6):
        record = drawn_record(rng)
        period = record.span_s / 8
        valves = valves_tried(record, period)[1][::31]
        nodes = Nodes.of(record, period)
        fit = refine(Misfit(record, ProcessType.FOPDT, 1, 0, record.noise_std, 0.3), np.log([1, period / 9, period]))
        with engine.using("numpy"):
            left, gain = _through(record, valves, nodes)
            costs, moved = valve_costs(fit, valves), [_moved(record, v) for v in valves]
        for valve, expected in zip(valves, moved, strict=True):
            np.testing.assert_allclose(compiled.valve_travel(valve.numbers(), record.co), expected, atol=1e-12)
        found = compiled.valves_scanned(record, [v.numbers() for v in valves], nodes)
        told = np.isfinite(left)
        assert np.array_equal(told, np.isfinite(found[0]))
        assert off(found[0][told], left[told]) < CLOSE
        assert off(found[1], gain) < 1e-7
        np.testing.assert_allclose(
            compiled.valve_costs(fit.misfit, fit.p, [v.numbers() for v in valves]), costs, rtol=1e-8
        )


def test_a_slipping_valve_moves_and_explains_alike() -> None:
    rng = np.random.default_rng(9)
    for type_ in (ProcessType.FOPDT, ProcessType.SOPDT):
        record = drawn_record(rng)
        misfit, n = Misfit(record, type_, 1, 0, record.noise_std, 0.3), len(record.pv)
        rows = sorted(rng.choice(np.arange(1, n), 6, replace=False).tolist())
        each = [Slips(tuple(rows[:many]), share, float(record.co[0])) for many in (0, 1, 6) for share in (-0.2, 0.4)]
        p = np.log([0.7, record.span_s / 90, record.span_s / 20, record.span_s / 60][: SIZE[type_]])
        with engine.using("numpy"):
            expected = explained_by(misfit, p, Co(record.co), each)
        np.testing.assert_allclose(explained_by(misfit, p, Co(record.co), each), expected, rtol=1e-7)


def test_a_valve_that_stands_still_says_nothing() -> None:
    record = drawn_record(np.random.default_rng(8))
    valve = StuckValve(Family.KANO, 1e6, 0.0)
    left, gain = compiled.valves_scanned(record, [valve.numbers()], Nodes.of(record, record.span_s / 8))
    assert np.all(np.isinf(left))
    assert not np.any(gain)


@pytest.mark.parametrize("seed", range(4))
def test_steps_of_a_signal_are_found_alike(seed: int) -> None:
    rng = np.random.default_rng(seed)
    n = int(rng.integers(150, 500))
    places = np.sort(rng.choice(np.arange(5, n - 5), 7, replace=False))
    pv = sum(rng.standard_normal() * -np.expm1(-np.maximum(np.arange(n) - at, 0) / 6.0) for at in places)
    pv = np.asarray(pv + 0.05 * rng.standard_normal(n), dtype=np.float64)
    found = []
    for name in ("c", "numpy"):
        with engine.using(name):
            found.append((as_steps(pv), [_greedy(pv, lag, second) for lag in (0.5, 9.0) for second in (0.0, 0.2)]))
    (c, c_greedy), (other, other_greedy) = found
    assert (c.jumps, c.lag) == (other.jumps, other.lag)
    assert c.criterion == pytest.approx(other.criterion, rel=CLOSE)
    assert [rows for _, rows in c_greedy] == [rows for _, rows in other_greedy]
    assert [left for left, _ in c_greedy] == pytest.approx([left for left, _ in other_greedy], rel=CLOSE)


def test_closed_loops_answer_alike() -> None:
    loops = [
        ClosedLoop(LinearProcess(2.0, (10.0, 3.0), theta_s=theta), PidGains(kp, kp / 12, kp / 2), b=0.5)
        for theta in (0.0, 2.0, 5.3)
        for kp in (0.3, 1.0, 8.0)
    ]
    upsets = [Upset(setpoint=1.0), Upset(load_step=1.0), Upset(pulse=1.0)]
    held = [UnstableProcess(0.2, pole, 4.0, theta) for pole in (0.05, 0.0, -0.02, -0.3) for theta in (0.0, 3.0, 4.7)]
    law = SampledLaw(PidGains(0.4, 0.02, 0.1), 1.0, 0.7, 2.0)
    found = []
    for name in ("c", "numpy"):
        with engine.using(name):
            responses = [trace for each in traces(loops, upsets) for trace in each]
            found.append(
                ([(trace.e, trace.u) for trace in responses], [_answer(process, law, 300) for process in held])
            )
    for c, other in zip(*found, strict=True):
        np.testing.assert_allclose(c, other, rtol=1e-12, atol=1e-12)
    assert np.isnan(found[0][1]).any()  # one of them has run away


def test_exponentials_of_matrices_are_those_of_scipy() -> None:
    rng = np.random.default_rng(1)
    drawn = rng.normal(size=(20, 4, 4))
    stiff = np.diag([-1.0, -3e3, -0.1, 0.0]) + np.triu(np.ones((4, 4)), 1)
    for a in (drawn, drawn / 1e3, stiff[None], np.zeros((2, 3, 3))):
        np.testing.assert_allclose(exponentials(a), expm(a), rtol=1e-10, atol=1e-12)
    assert np.isnan(exponentials(np.full((1, 2, 2), np.inf))).all()
