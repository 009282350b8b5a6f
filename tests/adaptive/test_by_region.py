"""A level whose gain rises with the level: one model for each region, where one for all is wrong everywhere."""

from pathlib import Path

import numpy as np
import pytest
from command_line import answer, printed
from pi_loop import pi_loop

from retuner.adaptive.identification.by_region import by_region
from retuner.adaptive.signals.sample import Window
from retuner.api import identify_by_region
from retuner.cli import main
from retuner.schedule.gains import PidGains

LOW, HIGH, BOUNDARY = 0.01, 0.03, 50.0  # Slope gains below and above the boundary, per second


def level(noise: float = 0.05) -> Window:
    """PI on a tank that is three times as narrow above the boundary, two setpoint steps on either side of it."""
    sp, h, past = np.repeat([30.0, 34.0, 30.0, 70.0, 74.0, 70.0], 400), 30.0, [0.0] * 7

    def process(u: float, _load: float) -> float:
        nonlocal h
        past.append(u)
        h += (LOW if h < BOUNDARY else HIGH) * past.pop(0)
        return h

    return pi_loop(PidGains(1.5, 0.004), process, sp, noise * np.random.default_rng(4).standard_normal(len(sp)))


def test_each_region_has_its_own_gain() -> None:
    window = level()
    low, high = identify_by_region(window, window.pv, [BOUNDARY])
    for region, gain in ((low, LOW), (high, HIGH)):
        assert region.found.estimate.identifiable, region.found.estimate.reason
        model = region.found.estimate.log.model()
        assert model.slope == pytest.approx(gain, rel=0.05)
        assert model.theta_s == pytest.approx(8.0, rel=0.15)
        assert region.found.settings is not None
    assert (low.high, high.low) == (BOUNDARY, BOUNDARY)


def test_every_sample_of_a_long_stretch_lies_in_its_region_and_noise_crosses_no_boundary() -> None:
    t = np.arange(400.0)
    pv = np.where(t < 200, 10.0, 30.0) + 0.1 * np.random.default_rng(1).standard_normal(400)
    window = Window(t, pv, pv, pv)
    found = by_region(window, pv, [10.0, 20.0])
    assert [len(r.stretches) for r in found] in ([1, 0, 1], [0, 1, 1])  # 10 lies on the boundary: on one side of it
    assert sum(len(w.t_s) for r in found for w in r.stretches) == 400
    assert [(r.low, r.high) for r in found] == [(-np.inf, 10.0), (10.0, 20.0), (20.0, np.inf)]


@pytest.mark.parametrize("bounds", [[], [1.0, 1.0], [2.0, 1.0], [np.nan]])
def test_boundaries_that_are_none_are_refused(bounds: list[float]) -> None:
    window = level()
    with pytest.raises(ValueError, match="boundaries"):
        by_region(window, window.pv, bounds)


def test_a_region_that_nothing_moved_in_has_no_model() -> None:
    window = level()
    *_, empty = identify_by_region(window, window.pv, [BOUNDARY, 95.0])
    assert empty.found is None
    assert empty.to_dict()["identifiable"] is False


@pytest.mark.slow
def test_the_command(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path, window = tmp_path / "level.csv", level()
    rows = np.stack([window.t_s, window.sp, window.pv, window.co], axis=1)
    np.savetxt(path, rows, delimiter=",", header="t,sp,pv,co", comments="")
    low, high = answer("identify", path, "--region-by", "pv", "--bounds", "50")["regions"]
    assert low["gains"]["kc"] > 2 * high["gains"]["kc"] > 0
    assert "pv 50 to inf" in printed("identify", path, "--region-by", "pv", "--bounds", "50")
    for wrong in (["--bounds", "50"], ["--region-by", "level", "--bounds", "50"], ["--region-by", "pv"]):
        assert main(["identify", str(path), *wrong]) == 2
        assert len(capsys.readouterr().err.strip().splitlines()) == 1


def tank(clipped: float = np.inf) -> Window:
    """In manual: a gain that rises from 1.6 to 3.3 with the level, and a sensor that may end."""
    rng = np.random.default_rng(0)
    h, u, rows = 4.0, 40.0, []
    for i in range(3000):
        u = rng.uniform(25.0, 75.0) if i % 250 == 0 else u
        rows.append((min(10.0 * h + rng.normal(0.0, 0.15), clipped), u))
        for _ in range(5):
            h = max(h + 0.4 * (0.05 * u / 40.0 - 0.025 * np.sqrt(max(h, 0.0))), 0.01)
    pv, co = np.array(rows).T
    return Window(np.arange(3000) * 5.0, np.full(3000, 40.0), pv, co)


def test_in_manual_no_load_is_bought_in_any_region() -> None:
    """It had been fitted with the closed loop's settings, and processes were invented."""
    window = tank()
    found = identify_by_region(window, window.pv, [40.0, 80.0], open_loop=True)
    for region in found:
        assert region.found.estimate.load_times_s == ()
    gains = [region.found.estimate.log.model().k for region in found if region.found is not None]
    assert gains == sorted(gains)
    assert gains[-1] > 1.5 * gains[0]


def test_what_a_sensor_cuts_off_is_in_no_region() -> None:
    whole, cut = tank(), tank(clipped=90.0)
    known = identify_by_region(whole, whole.pv, [80.0], open_loop=True)[-1]
    found = identify_by_region(cut, cut.pv, [80.0], open_loop=True)[-1]
    assert found.samples < known.samples
    standing = [w for w in by_region(cut, cut.pv, [80.0])[-1].stretches if np.mean(w.pv == 90.0) > 0.2]
    assert standing == []
