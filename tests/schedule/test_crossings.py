"""Every border of every kind of map is crossed without a bump: the co that the old gains would have given, to 1e-9."""

import random

import pytest

from retuner.schedule.gains import PidGains
from retuner.schedule.pid import PidState, change, law, start, step
from retuner.schedule.regions import Axis, Regions, choose, enter, values
from retuner.schedule.table import GainTable, Lookup

SPAN = 100.0
BUMP = 1e-9 * SPAN
DT_S = 0.5
HEAT = Axis("pv", "degC", 20.0, (80.0, 150.0), 220.0, 2.0)
FLOW = Axis("can", "%", 0.0, (30.0, 60.0), 100.0, 3.0, 0.0, 2.0, "flow")
GAINS = (
    PidGains(1.0, 0.05, 2.0),
    PidGains(4.0, 0.0, 9.0),
    PidGains(0.3, 0.2),
    PidGains(2.0, 0.01, 0.5),
    PidGains(0.0, 0.1),
    PidGains(8.0, 0.4, 30.0),
    PidGains(1.5, 0.0),
    PidGains(0.7, 0.3, 1.0),
    PidGains(3.0, 0.02, 12.0),
)
MAPS = {
    "one axis": Regions.along(tuple("abc"), HEAT),
    "two axes": Regions.along(tuple("abcdefghi"), HEAT, FLOW),
    "a filtered axis": Regions.along(tuple("abc"), FLOW),
}
RATES = (None, 0.8)


def made(gains, rate):
    return law(gains, b=0.7, tau_f_s=1.5, co_rate_per_s=rate)


def moving(rng, settings, sp):
    """A loop in motion about its setpoint, not at a limit for long."""
    state = start(settings, sp, sp, rng.uniform(20.0, 80.0))
    for _ in range(5):
        state, _ = step(settings, state, sp, sp + rng.gauss(0.0, 0.5), DT_S)
    return state


@pytest.mark.parametrize("name", MAPS)
@pytest.mark.parametrize("lookup", list(Lookup))
@pytest.mark.parametrize("rate", RATES)
def test_a_sweep_over_all_borders(name, lookup, rate):
    """Along both axes to and fro: at each sample the new gains give what those of the sample before would have."""
    regions = MAPS[name]
    table = GainTable("loop", regions, GAINS[: len(regions)], lookup)
    crossed = set()
    changes = 0
    for line in lines(regions):
        region_law, rng = regions.law(), random.Random(5)
        place = enter(region_law, *line[0][:1], 0.0, line[0][1])
        old = made(table.at(place.region, *values(region_law, place, *line[0])), rate)
        sp, state = 100.0, moving(rng, old, 100.0)
        for i, (x, x2) in enumerate(line):
            before, place = place, choose(region_law, place, x, i * DT_S, x2)
            crossed |= {(before.region, place.region)} if before.region != place.region else set()
            new = made(table.at(place.region, *values(region_law, place, x, x2)), rate)
            pv = sp + rng.gauss(0.0, 0.3)
            _, expected = step(old, state, sp, pv, DT_S)
            changes += new != old
            state, co = step(new, change(old, new, PidState(*state), sp, pv, DT_S), sp, pv, DT_S)
            assert abs(co - expected) <= BUMP
            old = new
    assert crossed == {(a, b) for a in range(len(regions)) for b in regions.neighbours(a)}
    assert changes >= len(crossed)


def lines(regions):
    """Straight lines to and fro over the whole map: the first axis in each column, the second in each row."""
    ends = [(axis.low, axis.high) for axis in regions.axes]
    if len(ends) == 1:
        return [[(x, 0.0) for x in ramp(*ends[0])]]
    first = [[(x, regions.axes[1].centre(j)) for x in ramp(*ends[0])] for j in range(regions.shape[1])]
    second = [[(regions.axes[0].centre(i), x2) for x2 in ramp(*ends[1])] for i in range(regions.shape[0])]
    return first + second


def ramp(low, high, steps=150):
    up = [low + (high - low) * i / steps for i in range(steps + 1)]
    return [*up, *[high] * 20, *reversed(up), *[low] * 20]
