"""A setpoint step through a valve that sticks or has play: its process is found, and a valve where there is one."""

import numpy as np
import pytest
from test_diagnose import loop

from retuner import LinearProcess, PidGains
from retuner.adaptive.identification.identify import Fits, FitSettings
from retuner.adaptive.signals.sample import Window
from retuner.adaptive.valve.record_through_valve import RecordThroughValve, _searched, valve_believed
from retuner.adaptive.valve.valve_fit import Sticking
from retuner.adaptive.valve.valve_model import Family, StuckValve

PROCESS = LinearProcess(2.0, (20.0,), theta_s=5.0)
GAINS = PidGains(1.0, 0.05)
DT_S, BAND = 0.5, 1.5  # The valve's band is a third of what it travels in the second step
VALVES = (
    StuckValve(Family.KANO, BAND, 0.0),
    StuckValve(Family.KANO, BAND, 0.6 * BAND),
    StuckValve(Family.HE, BAND, 0.6 * BAND),
)
BEFORE, KEPT, AFTER = 200, 40, 400  # Samples before the second step, those of them that are kept, and after it


def stepped(valve: StuckValve | None, load: float = 0.0, seed: int = 1) -> Window:
    """A loop at rest after a step down, and a step up of 10: the valve turns round at its beginning.

    load : of a step that comes amid the response.
    """
    whole = loop(
        GAINS, lambda i: -4.0 if i < BEFORE else 6.0, lambda i: load if i > BEFORE + AFTER // 4 else 0.0, valve=valve,
        noise=0.05, seed=seed, n=BEFORE + AFTER, process=PROCESS,
    )  # fmt: skip
    return Window(*(x[BEFORE - KEPT :] for x in (whole.t_s, whole.sp, whole.pv, whole.co)))


def through(window: Window, sign: int = 1) -> tuple[Fits, RecordThroughValve | None]:
    """The linear fits, and the record through a valve."""
    fits = Fits(window, (sign,), FitSettings())
    return fits, valve_believed(window, sign, fits, FitSettings())


@pytest.mark.slow
@pytest.mark.parametrize("valve", VALVES)
def test_the_process_behind_a_valve_is_found(valve: StuckValve) -> None:
    fits, found = through(stepped(valve))
    assert found is not None
    model, linear = (f.estimate().log.model() for f in (found.fits, fits))
    assert model.k == pytest.approx(PROCESS.k, rel=0.1)
    assert abs(np.log(model.k / PROCESS.k)) < 0.5 * abs(np.log(linear.k / PROCESS.k))
    if not valve.jump:  # of one turn and one slip, band and jump are not told apart
        assert found.seen.valve.stick == pytest.approx(BAND, rel=0.35)
    assert "stiction band" in found.seen.sentence


def test_no_valve_is_found_where_there_is_none() -> None:
    for seed in range(3):
        assert through(stepped(None, seed=seed))[1] is None


def test_a_load_in_the_response_is_no_valve() -> None:
    fits, found = through(stepped(None, load=1.5))
    assert fits.free[0].fit.misfit.loads
    assert found is None


def test_loads_alone_are_not_asked() -> None:
    window = stepped(VALVES[1])
    still = Window(window.t_s, np.full(len(window.t_s), 6.0), window.pv, window.co)
    assert through(still)[1] is None


def test_the_same_valve_turned_round() -> None:
    window = stepped(VALVES[1])
    mirrored = Window(window.t_s, window.sp, window.pv, -window.co)
    _, one = through(window)
    _, other = through(mirrored, -1)
    assert other.fits.estimate().log.model().k == pytest.approx(-one.fits.estimate().log.model().k, rel=0.02)


def test_a_valve_that_never_moves_explains_nothing() -> None:
    """Its band is wider than co's travel: "co stays at 66.223" ended the watching of a loop for good."""
    window, settings = stepped(VALVES[0]), FitSettings()
    asleep = StuckValve(Family.KANO, 20.0 * float(np.ptp(window.co)), 0.0)
    assert np.ptp(asleep.position(window.co)) == 0.0
    linear = Fits(window, (1,), settings).free[0]
    assert _searched(window, 1, Sticking(asleep, linear), settings) is None
