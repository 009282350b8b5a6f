"""On a map of two axes: inside a square of four cells, and in the corner where they meet, is proved as well."""

import math
import random
from dataclasses import replace

import pytest
from guard_cases import MODEL

from retuner.adaptive.guard import borders_of
from retuner.adaptive.guard.both_sides_of_border import at_border, between_models
from retuner.adaptive.identification.plausible import Plausible
from retuner.adaptive.loop.margins import sensitivity_peak
from retuner.adaptive.process.model import ProcessModel
from retuner.adaptive.rules.simc import simc
from retuner.schedule.gains import PidGains
from retuner.schedule.regions import Axis, Regions
from retuner.schedule.table import GainTable, Lookup

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
    """What the guard finds for keeping cell a as it is, over all its borders; what ran before was tame."""
    table = table_of(models)
    tame = PidGains(1e-3 * table.gains[0].kp, 1e-3 * table.gains[0].ki)
    others = {i: models[i] for i in (1, 2, 3)}
    asked = [at_border(b, models[0], table.gains[0], tame, limit, DT_S) for b in borders_of(table, 0, others)]
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
    borders = borders_of(table, 0, {i: models[i] for i in (1, 2, 3)})
    assert [(b.name, len(b.beside)) for b in borders] == [("b", 0), ("c", 0), ("d", 2)]
    assert [b.reach for b in borders] == pytest.approx([0.6] * 3)
    corner = replace(MODEL, k=MODEL.k * 4.0**0.6, theta_s=MODEL.theta_s + DT_S / 2)
    ms, passed = at_border(borders[2], models[0], table.gains[0], table.gains[0], 1.8, DT_S)
    assert ms == pytest.approx(sensitivity_peak(corner.linear(), table.gains[0]), rel=1e-9)
    assert passed, "no worse than before"


def test_what_is_not_known_beside_is_taken_between_the_corners() -> None:
    models = models_of((1.0, 2.0, 2.0, 4.0))
    table = table_of(models)
    corner = borders_of(table, 0, {3: models[3]})[-1]
    assert [cell.model for cell in corner.beside] == [None, None]
    ms, _ = at_border(corner, models[0], table.gains[0], table.gains[0], 5.0, DT_S)
    assert ms == pytest.approx(max(truth(models, s, s) for s in (0.25, 0.5, 0.75)), rel=1e-9)


def test_a_row_of_regions_has_no_corners() -> None:
    row = GainTable(
        "loop", Regions.along(("a", "b", "c"), Axis("sp", "", 0.0, (10.0, 20.0), 30.0)), (tuned(MODEL),) * 3
    )
    assert [(b.name, b.beside) for b in borders_of(row, 1, {})] == [("a", ()), ("c", ())]
