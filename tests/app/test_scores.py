"""The scores of a run: what they are measured against."""

import numpy as np
import pytest

from retuner.adaptive.process.model import LinearProcess
from retuner.report.scores import Twin, region_scores, twin_steps
from retuner.schedule.gains import PidGains, from_form
from retuner.schedule.regions import Regions
from retuner.schedule.table import GainTable


def table(gains: PidGains) -> GainTable:
    return GainTable("loop", Regions("sp", "u", ("all",), 0.0, (), 100.0, 0.0, 0.0), (gains,))


def test_ms_counts_the_filter_of_the_derivative() -> None:
    gains = from_form("series", 1.0, 50.0, 60.0)  # without a filter |L| never falls below kd / lag = 1.2: unstable
    columns = {name: np.array([0.0, 1.0]) for name in ("t", "sp", "pv", "region")}
    columns["region"] = np.zeros(2)

    def ms(tau_f_s: float) -> float | None:
        scores = region_scores(
            table(gains), table(gains), [], columns, None, lambda _: LinearProcess(1.0, (50.0,), (), 1.0), 1.0, tau_f_s
        )
        return scores[0].ms_after

    assert ms(0.0) == float("inf")
    assert ms(20.0) == pytest.approx(1.1, abs=0.3)


def test_a_load_under_which_the_region_was_only_left_is_no_operating_point() -> None:
    """Four samples until the border is crossed, in less than the dead time: nothing comes back in them."""
    n, gains = 100, from_form("series", 1.0, 50.0, 0.0)
    columns = {name: np.zeros(n) for name in ("sp", "pv", "region")} | {"t": np.arange(float(n))}

    def ms(stayed: int) -> float | None:
        loads = np.where(np.arange(n) >= n - stayed, 1.0, 0.0)

        def true(_: float, load: float = 0.0) -> LinearProcess:
            return LinearProcess(20.0 if load else 1.0, (50.0,), (), 8.0)

        return region_scores(table(gains), table(gains), [], columns, None, true, 1.0, 0.0, loads)[0].ms_after

    assert ms(4) == ms(0)
    assert ms(4) == pytest.approx(1.2, abs=0.2)
    assert ms(20) == float("inf")


@pytest.mark.parametrize("left", [1, 9, 10])
def test_a_step_at_the_very_end_is_no_twin(left: int) -> None:
    sp = np.array([20.0] * 50 + [30.0] * 50 + [20.0] * 50 + [30.0] * 50 + [20.0] * 50 + [30.0] * left)
    columns = {"t": np.arange(len(sp), dtype=float), "sp": sp, "region": np.zeros(len(sp))}
    last = (150, 200) if left < 10 else (250, 260)
    assert twin_steps(columns, []) == [Twin(0, (50, 100), last, "setpoint 20 to 30")]
