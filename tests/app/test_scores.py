"""The scores of a run: what they are measured against."""

import numpy as np
import pytest

from retuner.adaptive.process.model import LinearProcess
from retuner.report.scores import region_scores
from retuner.schedule.forms import from_form
from retuner.schedule.gains import PidGains
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
