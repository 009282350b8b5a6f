"""Both sides of a boundary: what is between two processes, and what holds there."""

import math
import random
from dataclasses import replace

import pytest
from guard_cases import BEST, GAINS, MODEL, SETTINGS, known, request, times
from hypothesis import given
from hypothesis import strategies as st

from retuner import Axis, GainTable, Lookup, PidGains, ProcessModel, ProcessType, Regions
from retuner.adaptive.guard.both_sides_of_boundary import at_boundary, between_models, boundaries_of
from retuner.adaptive.guard.guard_settings import GuardSettings
from retuner.adaptive.guard.proof import prove
from retuner.adaptive.guard.request import NeighbourBoundary
from retuner.adaptive.guard.ruling import Ruling
from retuner.adaptive.identification.plausible import Plausible
from retuner.adaptive.loop.margins import sensitivity_peak
from retuner.adaptive.rules.rule import Tuning
from retuner.adaptive.rules.simc import simc

SOPDT = ProcessModel(ProcessType.SOPDT, 2.0, 30.0, 20.0, 5.0)
SWINGS = ProcessModel(ProcessType.SOPDT, 2.0, 20.0, 20.0, 5.0, 0.6)
LEVEL = ProcessModel(ProcessType.INTEGRATING, 0.04, theta_s=5.0)
LAGGED = ProcessModel(ProcessType.INTEGRATING_LAG, 0.04, 0.0, 8.0, 5.0)
KINDS = [MODEL, SOPDT, SWINGS, LEVEL, LAGGED]


@pytest.mark.parametrize("model", KINDS)
def test_between_a_process_and_itself_is_itself(model: ProcessModel) -> None:
    found = between_models(model, model, 0.3)
    assert found.type == model.type
    for name in ("k", "tau1_s", "tau2_s", "theta_s", "zeta"):
        assert getattr(found, name) == pytest.approx(getattr(model, name))


@pytest.mark.parametrize("one", KINDS)
@pytest.mark.parametrize("other", KINDS)
def test_the_ends_are_the_processes_themselves(one: ProcessModel, other: ProcessModel) -> None:
    for share, wanted in ((0.0, one), (1.0, other)):
        found = between_models(one, other, share)
        assert found is not None
        for gains in (GAINS, times(0.3, 0.2)):
            there, here = (sensitivity_peak(m.linear(), gains) for m in (found, wanted))
            assert there == pytest.approx(here, rel=1e-6)


def test_what_has_no_mean_is_not_asked() -> None:
    assert between_models(MODEL, ProcessModel(ProcessType.DELAY, 1.0, theta_s=1.0), 0.5) is None
    assert between_models(MODEL, replace(MODEL, k=-2.0), 0.5) is None


def boundary(
    model: ProcessModel | None, reach: float = 0.5, gains: PidGains = GAINS, mixed: bool = False
) -> NeighbourBoundary:
    return NeighbourBoundary("hot", gains, (Plausible(model, 0.0),) if model else (), reach, mixed)


OWN = (Plausible(MODEL, 0.0),)
HOT = replace(MODEL, k=6.0)


def test_a_hard_boundary_is_met_by_the_new_gains_alone() -> None:
    middle = between_models(MODEL, HOT, 0.5)
    assert middle is not None
    expected = sensitivity_peak(replace(middle, theta_s=5.5).linear(), GAINS)
    ms, passed = at_boundary(boundary(HOT), OWN, GAINS, times(0.5, 0.5), 2.1, 1.0)
    assert ms == pytest.approx(expected)
    assert ms > 2.1
    assert not passed
    near, passed_near = at_boundary(boundary(HOT, 0.1), OWN, GAINS, times(0.5, 0.5), 2.1, 1.0)
    assert near < 2.1
    assert passed_near


def test_the_filter_of_the_derivative_counts_at_the_boundary_too() -> None:
    gains = PidGains(GAINS.kp, GAINS.ki, 4.0 * GAINS.kp)
    one = boundary(MODEL)
    plain, filtered = (at_boundary(one, OWN, gains, gains, 2.1, 1.0, tau_f)[0] for tau_f in (0.0, 3.0))
    assert filtered == pytest.approx(sensitivity_peak(replace(MODEL, theta_s=5.5).linear(), gains, 3.0))
    assert filtered != pytest.approx(plain, rel=1e-3)
    proposal = Tuning("x", "parallel", gains)
    lagging = replace(request(times(0.6, 0.6, gains=gains), proposal, OWN), boundaries=(one,), filter_s=3.0)
    verdict = prove(lagging, GuardSettings(ms_nominal=3.0, ms_worst=3.0, ms_border=3.0))
    found = {check.name: check.value for check in verdict.checks}
    assert found["ms_border"] == pytest.approx(filtered)
    assert found["ms_nominal"] == pytest.approx(filtered)


def test_what_was_worse_before_does_not_hold_up_what_is_better() -> None:
    ms, passed = at_boundary(boundary(HOT), OWN, GAINS, times(1.2, 1.2), 2.1, 1.0)
    assert ms > 2.1
    assert passed


def test_an_interpolation_is_met_by_the_mean_of_both_sets() -> None:
    hot_gains = times(1 / 3, 1 / 3)
    ms, passed = at_boundary(boundary(HOT, 1.0, hot_gains, mixed=True), OWN, GAINS, times(0.5, 0.5), 2.1, 1.0)
    shares = []
    for w in (0.25, 0.5, 0.75):
        between = between_models(MODEL, HOT, w)
        assert between is not None
        mean = PidGains((1 - w) * GAINS.kp + w * hot_gains.kp, (1 - w) * GAINS.ki + w * hot_gains.ki)
        shares.append(sensitivity_peak(replace(between, theta_s=5.5).linear(), mean))
    assert ms == pytest.approx(max(shares))
    assert passed == (max(shares) <= 2.1)


def test_an_interpolation_into_the_unknown_is_proved_half_way_on_the_own_process() -> None:
    wild = times(8.0, 8.0)
    ms, passed = at_boundary(boundary(None, 1.0, wild, mixed=True), OWN, GAINS, times(0.5, 0.5), 2.1, 1.0)
    mean = PidGains((GAINS.kp + wild.kp) / 2, (GAINS.ki + wild.ki) / 2)
    assert ms == pytest.approx(sensitivity_peak(replace(MODEL, theta_s=5.5).linear(), mean))
    assert not passed
    assert math.isnan(at_boundary(boundary(None), OWN, GAINS, GAINS, 2.1, 1.0)[0])
    assert math.isnan(at_boundary(boundary(HOT), (), GAINS, GAINS, 2.1, 1.0)[0])


def test_every_model_of_both_sides_is_asked() -> None:
    one = NeighbourBoundary("hot", GAINS, (Plausible(MODEL, 0.0), Plausible(HOT, 3.0)), 0.5)
    assert not at_boundary(one, OWN, GAINS, times(0.5, 0.5), 2.1, 1.0)[1]
    two = (Plausible(MODEL, 0.0), Plausible(HOT, 3.0))
    assert not at_boundary(boundary(MODEL), two, GAINS, times(0.5, 0.5), 2.1, 1.0)[1]
    assert at_boundary(boundary(MODEL), OWN, GAINS, times(0.5, 0.5), 2.1, 1.0)[1]


def test_the_boundary_slows_the_change_before_it_refuses_it() -> None:
    warm = replace(MODEL, k=4.0)
    asked = replace(request(times(0.6, 0.6)), boundaries=(boundary(warm, 0.6),))
    verdict = prove(asked, SETTINGS)
    assert verdict.ruling == Ruling.ACCEPTED
    assert verdict.gains.kp < GAINS.kp
    ms, passed = at_boundary(boundary(warm, 0.6), asked.models, verdict.gains, asked.in_force, SETTINGS.ms_border, 1.0)
    assert passed
    assert ms <= SETTINGS.ms_border
    assert prove(asked, GuardSettings(ms_border=3.0)).gains == GAINS


@given(w=st.floats(0, 1), k=st.floats(0.5, 2.5), theta=st.floats(0.6, 1.6))
def test_a_proved_interpolation_holds_everywhere_between(w: float, k: float, theta: float) -> None:
    """Not only at the weights that were asked: the slack is what a coarse grid may miss."""
    there = ProcessModel(ProcessType.FOPDT, 2.0 * k, 50.0, 0.0, 5.0 * theta)
    gains = simc(replace(there, theta_s=there.theta_s + 0.5)).gains
    limit = 2.1
    _, passed = at_boundary(boundary(there, 1.0, gains, mixed=True), OWN, BEST.gains, BEST.gains, limit, 1.0)
    between = between_models(MODEL, there, w)
    assert between is not None
    mean = PidGains((1 - w) * GAINS.kp + w * gains.kp, (1 - w) * GAINS.ki + w * gains.ki)
    assert (
        not passed or sensitivity_peak(replace(between, theta_s=between.theta_s + 0.5).linear(), mean) <= limit + 0.02
    )


def test_the_table_says_how_far_the_gains_reach() -> None:
    regions = Regions("pv", "C", ("cold", "warm", "hot"), 0.0, (20.0, 60.0), 100.0, 4.0, 0.0)
    table = GainTable("oven", regions, (GAINS, times(0.5, 0.5), times(0.3, 0.3)))
    models = {2: known()}
    below, above = boundaries_of(table, 1, models)
    assert (below.name, below.gains, below.models, below.interpolated) == ("cold", GAINS, (), False)
    assert below.reach == pytest.approx((20 + 4) / 30)
    assert (above.name, above.gains, above.models) == ("hot", times(0.3, 0.3), known())
    assert above.reach == pytest.approx((20 + 4) / 40)
    mixed = boundaries_of(replace(table, lookup=Lookup.INTERPOLATED), 0, models)
    assert [(b.name, b.reach, b.interpolated) for b in mixed] == [("warm", 1.0, True)]


def test_a_boundary_reaches_no_farther_than_the_neighbour() -> None:
    with pytest.raises(ValueError, match="reach"):
        NeighbourBoundary("hot", GAINS, (), 1.1)


@pytest.mark.parametrize("neighbour", [20.0, 100.0])
def test_more_action_is_not_proved_where_the_loop_is_unstable_between_the_knots_before_and_after(neighbour):
    """Infinity is not less than infinity. Less of everything goes the right way for certain."""
    beside = boundary(replace(MODEL, k=1.2 * MODEL.k), 1.0, times(neighbour, neighbour), mixed=True)
    more = replace(request(times(0.5, 0.5)), boundaries=(beside,))
    ms, passed = at_boundary(beside, more.models, GAINS, more.in_force, 2.1, 1.0)
    assert ms == math.inf
    assert not passed
    assert prove(more, SETTINGS).ruling is Ruling.NOT_ROBUST_AT_BORDER
    less = replace(request(GAINS, replace(BEST, gains=times(0.5, 0.5))), boundaries=(beside,))
    assert at_boundary(beside, less.models, times(0.5, 0.5), GAINS, 2.1, 1.0)[1]
    assert prove(less, SETTINGS).accepted


# On a map of two axes: inside a square of four cells, and in the corner where they meet, is proved as well.


REGIONS = Regions.along(
    tuple("abcd"), Axis("sp", "", 0.0, (10.0,), 20.0, 1.0), Axis("can", "", 0.0, (10.0,), 20.0, 1.0)
)
DT_S = 1.0


def models_of(gains: tuple[float, float, float, float]) -> dict[int, tuple[Plausible, ...]]:
    """Best models of four cells that differ in their process gain."""
    return {i: (Plausible(replace(MODEL, k=MODEL.k * gain), 0.0),) for i, gain in enumerate(gains)}


def tuned(model: ProcessModel) -> PidGains:
    return simc(replace(model, theta_s=model.theta_s + DT_S / 2)).gains


def table_of(models: dict[int, tuple[Plausible, ...]], lookup: Lookup = Lookup.INTERPOLATED) -> GainTable:
    """Every cell tuned for its own process."""
    return GainTable("loop", REGIONS, tuple(tuned(models[i][0].model) for i in range(4)), lookup)


def truth(models: dict[int, tuple[Plausible, ...]], u: float, v: float) -> float:
    """Ms at a place inside the square of the four centres: the process bilinear in its logarithms."""
    table = table_of(models)
    near, far = (between_models(models[i][0].model, models[i + 1][0].model, v) for i in (0, 2))
    assert near is not None
    assert far is not None
    process = between_models(near, far, u)
    gains = table.at(0, 5.0 + 10.0 * u, 5.0 + 10.0 * v)
    return sensitivity_peak(replace(process, theta_s=process.theta_s + DT_S / 2).linear(), gains)


def proved(models: dict[int, tuple[Plausible, ...]], limit: float) -> tuple[float, bool]:
    """What the guard finds for keeping cell a as it is, over all its boundaries; what ran before was tame."""
    table = table_of(models)
    tame = PidGains(1e-3 * table.gains[0].kp, 1e-3 * table.gains[0].ki)
    others = {i: models[i] for i in (1, 2, 3)}
    asked = [at_boundary(b, models[0], table.gains[0], tame, limit, DT_S) for b in boundaries_of(table, 0, others)]
    return max(ms for ms, _ in asked), all(passed for _, passed in asked)


def test_the_excess_of_two_ways_multiplies_and_is_seen() -> None:
    """Gains 1, 1/5, 1/5, 1/25: fair on every side, too much inside."""
    models = models_of((1.0, 0.2, 0.2, 0.04))
    sides = max(truth(models, u, v) for u, v in ((0.5, 0.0), (0.0, 0.5), (0.5, 1.0), (1.0, 0.5)))
    inside = truth(models, 0.5, 0.5)
    limit = (sides + inside) / 2
    assert inside > sides + 0.3

    ms, passed = proved(models, limit)
    assert ms >= inside - 1e-6
    assert not passed
    assert proved(models, inside + 0.05)[1]


def test_what_is_proved_holds_everywhere_between_the_points() -> None:
    """Random maps whose cells differ by up to 8: the largest Ms of a fine grid is met by the proof to 5 %."""
    rng = random.Random(3)
    short = []
    for _ in range(25):
        models = models_of(tuple(math.exp(rng.uniform(-1.04, 1.04)) for _ in range(4)))
        grid = max(truth(models, i / 8, j / 8) for i in range(9) for j in range(9) if i + j <= 14)
        own_sides = proved(models, 10.0)[0]
        far_sides = max(truth(models, 0.5, 1.0), truth(models, 1.0, 0.5))  # proved when those cells change
        centres = max(truth(models, u, v) for u in (0.0, 1.0) for v in (0.0, 1.0))
        short.append(grid / max(own_sides, far_sides, centres))
    assert max(short) < 1.05


def test_a_corner_of_hard_cells_is_met_by_the_new_gains_alone() -> None:
    models = models_of((1.0, 2.0, 2.0, 4.0))
    table = table_of(models, Lookup.HARD)
    boundaries = boundaries_of(table, 0, {i: models[i] for i in (1, 2, 3)})
    assert [(b.name, len(b.cells_between)) for b in boundaries] == [("b", 0), ("c", 0), ("d", 2)]
    assert [b.reach for b in boundaries] == pytest.approx([0.6] * 3)
    corner = replace(MODEL, k=MODEL.k * 4.0**0.6, theta_s=MODEL.theta_s + DT_S / 2)
    ms, passed = at_boundary(boundaries[2], models[0], table.gains[0], table.gains[0], 1.8, DT_S)
    assert ms == pytest.approx(sensitivity_peak(corner.linear(), table.gains[0]), rel=1e-9)
    assert passed, "no worse than before"


def test_what_is_not_known_beside_is_taken_between_the_corners() -> None:
    models = models_of((1.0, 2.0, 2.0, 4.0))
    table = table_of(models)
    corner = boundaries_of(table, 0, {3: models[3]})[-1]
    assert [cell.model for cell in corner.cells_between] == [None, None]
    ms, _ = at_boundary(corner, models[0], table.gains[0], table.gains[0], 5.0, DT_S)
    assert ms == pytest.approx(max(truth(models, s, s) for s in (0.25, 0.5, 0.75)), rel=1e-9)


def test_a_row_of_regions_has_no_corners() -> None:
    row = GainTable(
        "loop", Regions.along(("a", "b", "c"), Axis("sp", "", 0.0, (10.0, 20.0), 30.0)), (tuned(MODEL),) * 3
    )
    assert [(b.name, b.cells_between) for b in boundaries_of(row, 1, {})] == [("a", ()), ("c", ())]
