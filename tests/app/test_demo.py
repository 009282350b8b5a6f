"""The demo's promise, on another seed: every region robust on the true oven and better than fixed gains."""

from pathlib import Path

import numpy as np
import pytest
from effort import sized

from retuner.adaptive.supervision.decision import Mode
from retuner.config import load_config
from retuner.config.bench_plants import known_plant
from retuner.report.scores import region_scores, twin_steps
from retuner.session.running import Run, nothing

MS_ANYWHERE = 1.85
"""A region is tuned to Ms 1.6 for its mean; one set serves two setpoints, and at the worse of them Ms is 1.79 to 1.81
in the middle region on every seed tried (1, 101 to 106)."""
OVEN = Path(__file__).parents[2] / "examples" / "oven.toml"


@pytest.mark.slow
@pytest.mark.parametrize("seed", sized([101], [101], list(range(101, 107))))
def test_every_region_ends_robust_and_better_than_fixed_gains(seed: int) -> None:
    config = load_config(OVEN)
    assert config.device is not None
    config = config.model_copy(update={"device": config.device.model_copy(update={"seed": seed})})
    retuned = Run(config, nothing).simulated().loops[0]
    fixed = Run(config, nothing, mode=Mode.OFF).simulated().loops[0]
    run, still = retuned.trend.columns(), fixed.trend.columns()
    table = config.gain_table()
    plant = known_plant(config)
    assert plant is not None
    scores = region_scores(table, retuned.table, retuned.commits, run, still, plant.linearise, 2.0)
    assert len(scores) == 3
    for score in scores:
        assert score.changes >= 1
        assert score.ms_after is not None
        assert score.ms_after <= MS_ANYWHERE
        assert score.iae_fixed is not None
        assert score.iae < 0.8 * score.iae_fixed
    # the comparison is fair: with fixed gains the controller did run each region's own set
    assert fixed.table == table
    for region, gains in enumerate(table.gains):
        inside = np.flatnonzero(still["region"] == region)
        assert np.mean(np.abs(still["kp"][inside] / gains.kp - 1) < 1e-6) > 0.99
    assert {twin.region for twin in twin_steps(run, retuned.scenario.played)} == {0, 1, 2}
