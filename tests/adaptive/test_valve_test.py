"""The valve test: staircases on simulated valves, read back; what is no valve test."""

from pathlib import Path

import numpy as np
import pytest
from command_line import printed, refused

from retuner.adaptive.experiments.valve_test import STAIRCASE, read_valve_test, valve_positions
from retuner.adaptive.loop.simulate import HeldInput
from retuner.adaptive.process.model import ProcessModel, ProcessType
from retuner.adaptive.signals.sample import Window
from retuner.cli import main

STEP, HOLD = 0.5, 40
LEVELS = STEP * np.concatenate([[0.0], np.cumsum(STAIRCASE)])
FLOW = ProcessModel(ProcessType.FOPDT, 2.0, 10.0, theta_s=3.0)
TANK = ProcessModel(ProcessType.INTEGRATING, 0.05, theta_s=3.0)


def record(dead_band: float, resolution: float, seed: int, model: ProcessModel = FLOW, noise: float = 0.1) -> Window:
    """A test by hand with steps of 0.5 on a valve of that kind, which stands anywhere in its play at first."""
    rng, plant = np.random.default_rng(seed), HeldInput(model.linear(), 1.0)
    co = np.repeat(50.0 + LEVELS, HOLD)
    p = x = 50.0 + rng.uniform(-0.5, 0.5) * dead_band
    pv, moved = [], 0.0
    for u in co.tolist():
        pv.append(20.0 + moved + noise * rng.normal())
        p = min(max(p, u - dead_band / 2), u + dead_band / 2)
        if abs(p - x) >= resolution * (1 - 1e-9):
            x = p
        moved = plant.step(x - 50.0)
    t = np.arange(float(len(co)))
    return Window(t, np.full(len(co), 20.0), np.array(pv), co)


def test_the_staircase_leads_back_and_a_sound_valve_follows_it() -> None:
    assert sum(STAIRCASE) == 0
    assert valve_positions(LEVELS, 0.0, 0.0) == pytest.approx(LEVELS)
    assert np.ptp(valve_positions(LEVELS, 1.0, 0.0)) == pytest.approx(np.ptp(LEVELS) - 1.0)


@pytest.mark.slow
@pytest.mark.parametrize("model", [FLOW, TANK])
@pytest.mark.parametrize(("dead_band", "resolution"), [(0.0, 0.0), (1.0, 0.0), (2.0, 0.0), (0.4, 0.0)])
def test_play_is_read_back_with_its_odds(model: ProcessModel, dead_band: float, resolution: float) -> None:
    for seed in range(6):
        found = read_valve_test(record(dead_band, resolution, seed, model))
        assert found.dead_band == pytest.approx(dead_band, abs=0.26)
        if dead_band:
            assert found.dead_band_odds > 0.9
        else:
            assert found.sound > 0.5


def test_a_valve_that_moves_in_jumps_has_a_resolution() -> None:
    for seed in range(6):
        found = read_valve_test(record(0.0, 1.0, seed))
        assert found.resolution_odds > 0.9
        assert 0.5 < found.resolution <= 1.0


def test_from_a_file_to_the_finding(tmp_path: Path) -> None:
    window = record(1.0, 0.0, 3)
    path = tmp_path / "valve.csv"
    rows = zip(window.t_s, window.pv, window.co, strict=True)
    path.write_text("t,pv,co\n" + "".join(f"{t:g},{pv:.4f},{co:.3f}\n" for t, pv, co in rows), encoding="utf-8")
    told = printed("experiment", "valve", "--from", path)
    assert told.startswith("THE VALVE DOES NOT FOLLOW")
    assert "dead band  1 of co" in told
    assert "+4, 4 x +0.5, 8 x -0.5, -2, 4 x -0.5, 8 x +0.5, -2" in printed("experiment", "valve", "--step", "0.5")
    assert "2 x +0.5, 2 x -0.5" in printed("experiment", "valve", "--step", "0.5", "--short")
    assert main(["experiment", "valve", "--step", "50"]) == 2
    assert "--hold: missing" in refused("experiment", "valve", "loop.toml")


def test_what_is_no_valve_test_is_refused() -> None:
    t, still = np.arange(400.0), np.full(400, 50.0)
    with pytest.raises(ValueError, match="co does not move"):
        read_valve_test(Window(t, still, still, still))
    with pytest.raises(ValueError, match="co is held 2 times"):
        read_valve_test(Window(t, still, still + t, still + 5.0 * (t > 200)))
    window = record(0.0, 0.0, 1)
    with pytest.raises(ValueError, match="pv does not move"):
        read_valve_test(Window(window.t_s, window.sp, np.full(len(window.pv), 20.0), window.co))
