"""Days in one file, with the controller off at night, are days to identify and audit too, and to schedule by gaps."""

from typing import Any

import numpy as np
import pytest

from retuner import PidGains, ProcessModel, design_schedule, identify, simulate
from retuner.adaptive.signals.sample import Window
from retuner.audit.loop_row import AuditSettings, _LoopRecords
from retuner.drivers.historian.loop_record import LoopRecord
from retuner.drivers.recorded.recording import Recording

MODEL = ProcessModel("fopdt", k=2.0, tau1_s=40.0, theta_s=8.0)
GAINS = PidGains(0.8, 0.02)
DAY, NIGHT = 260, 240


def several(days: int, *, off: bool = True) -> Window:
    """Days with a setpoint step each, and nights in which co is 0 and pv falls to 5, or which are not there."""
    t, sp, pv, co = [], [], [], []
    for day in range(days):
        low = 50.0 + 5.0 * (day % 2)
        steps = [(0.0, low), (40.0, low + 4.0), (150.0, low)]
        made = simulate(MODEL, GAINS, setpoint=steps, until_s=DAY, noise=0.05, seed=day, start_co=25.0)
        t.append(made.t_s + day * (DAY + NIGHT))
        sp.append(made.sp)
        pv.append(made.pv)
        co.append(made.co)
        if off:
            at = np.arange(NIGHT, dtype=float)
            t.append(at + day * (DAY + NIGHT) + DAY)
            sp.append(np.full(NIGHT, low))
            pv.append(5.0 + (made.pv[-1] - 5.0) * np.exp(-at / 90.0) + 0.05 * np.sin(7.0 * at))
            co.append(np.zeros(NIGHT))
    return Window(*(np.concatenate(x) for x in (t, sp, pv, co)))


@pytest.mark.parametrize("off", [True, False])
def test_identify_joins_days_and_leaves_the_nights_out(off: bool) -> None:
    day = several(2, off=off)
    found = identify(day.t_s, day.sp, day.pv, day.co, gains=GAINS)
    assert found.identifiable
    model = found.estimate.log.model()
    assert model.k / (model.tau1_s + model.theta_s) == pytest.approx(2.0 / 48.0, rel=0.1)
    assert model.theta_s == pytest.approx(8.0, abs=2.0)


def test_an_audit_diagnoses_days(monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[Window] = []

    def seen(windows: list[Window]) -> Any:
        asked.extend(windows)
        raise StopIteration

    monkeypatch.setattr("retuner.audit.loop_row.diagnose_windows", seen)
    whole = several(2)
    record = LoopRecord(Recording("days.csv", whole.t_s, whole.pv, whole.co, whole.sp), ())
    with pytest.raises(StopIteration):
        _LoopRecords().add(record, AuditSettings())
    assert len(asked[0].t_s) <= DAY + 1
    assert float(np.min(asked[0].co)) > 5.0


def test_an_audit_screens_the_days_alone() -> None:
    """Nights with the valve shut were a loop at its limit."""
    seen, whole = _LoopRecords(), several(3)
    seen.add(LoopRecord(Recording("d.csv", whole.t_s, whole.pv, whole.co, whole.sp), ()), AuditSettings(stretches=0))
    assert seen.screens[0].samples == 3 * DAY
    assert seen.screens[0].at_limits == 0.0


def test_a_schedule_takes_days_apart_at_gaps(monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[Window] = []

    def seen(windows: tuple[Window, ...], candidates: Any, *_: Any) -> Any:
        assert [len(values) for values in candidates[0].values] == [len(one.t_s) for one in windows]
        asked.extend(windows)
        raise StopIteration

    monkeypatch.setattr("retuner.scheduling.design", seen)
    with pytest.raises(StopIteration):
        design_schedule(several(2, off=False), "pv", name="days")
    assert [len(one.t_s) for one in asked] == [DAY, DAY]
