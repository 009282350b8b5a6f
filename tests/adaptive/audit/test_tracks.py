"""What loops have in common: swings that keep their phase, setpoints that are another loop's output."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from retuner.adaptive.audit.common_swing import Swinging, common_swings, interactions
from retuner.adaptive.audit.tracks import (
    SwingTrack,
    TrendTrack,
    by_chance,
    cascades,
    coherence,
    damped_track,
    swing_track,
    trend_track,
    twins,
)

T = np.arange(30_000) * 10.0
RNG = np.random.default_rng(8)


def swing(period_s: float, later_s: float = 0.0, wander: float = 0.0, t_s: np.ndarray = T) -> np.ndarray:
    """A swing whose phase may wander on its own."""
    walk = np.cumsum(RNG.normal(size=len(t_s))) * wander
    return np.sin(2 * np.pi * (t_s - later_s) / period_s + walk) + 0.3 * RNG.normal(size=len(t_s))


def track(error: np.ndarray, period_s: float, t_s: np.ndarray = T) -> SwingTrack:
    return swing_track(t_s, error, period_s)


@given(st.floats(150, 900), st.floats(0.05, 0.45), st.floats(0.97, 1.03))
def test_one_swing_is_coherent_and_tells_which_is_later(period_s: float, part: float, mistaken: float) -> None:
    a, b = swing(period_s), swing(period_s, part * period_s)
    told = coherence(track(a, period_s), track(b, period_s * mistaken))

    assert told[0] > 0.9
    assert told[1] == pytest.approx(part, abs=0.03)


def test_swings_of_one_period_by_chance_are_not_coherent() -> None:
    told = coherence(track(swing(400.0, wander=0.02), 400.0), track(swing(400.0, wander=0.02), 400.0))

    assert told[0] < 0.5


def test_records_of_other_times_say_nothing() -> None:
    a = track(swing(400.0), 400.0)
    b = track(swing(400.0, t_s=T + 1e7), 400.0, T + 1e7)

    assert coherence(a, b) is None


def test_gaps_are_left_out_and_tracks_survive_their_plain_form() -> None:
    kept = (np.arange(len(T)) < 9_000) | (np.arange(len(T)) > 21_000)
    a, b = swing(400.0), swing(400.0, 80.0)
    plain = [SwingTrack.of_dict(track(x[kept], 400.0, T[kept]).to_dict()) for x in (a, b)]
    told = coherence(*plain)

    assert told[0] > 0.9
    assert told[1] == pytest.approx(0.2, abs=0.03)


def test_the_setpoint_of_a_slave_is_its_masters_output() -> None:
    def walk() -> np.ndarray:
        return np.cumsum(RNG.normal(size=len(T)))

    still, output = np.full(len(T), 5.0), walk()
    loops = {"master": (still, output), "slave": (3 - 0.2 * output, walk()), "other": (still, walk())}
    tracks = {tag: trend_track(T, sp, co) for tag, (sp, co) in loops.items()}
    tracks["elsewhere"] = trend_track(T + 1e6, walk(), walk())
    again = {tag: TrendTrack.of_dict(one.to_dict()) for tag, one in tracks.items()}

    assert cascades(tracks) == {"slave": "master"} == cascades(again)


def test_groups_are_made_by_phase_and_not_by_period() -> None:
    valve, upset = swing(400.0, wander=0.01), swing(405.0, wander=0.02)
    walk = np.roll(valve, 5)
    loops = [
        Swinging("valve", 400.0, 0.02, sticks=0.8, track=track(valve, 400.0)),
        Swinging("follower", 404.0, 0.2, track=track(walk, 404.0)),
        Swinging("stranger", 405.0, 0.3, track=track(upset, 405.0)),
    ]
    groups = common_swings(loops)

    assert [group.tags for group in groups] == [("valve", "follower")]
    assert groups[0].coherence is not None


def test_two_tunings_or_two_straight_loops_swing_against_each_other() -> None:
    a, b = swing(300.0), swing(300.0, 70.0)
    both = [Swinging(tag, 300.0, 0.01, track=track(x, 300.0)) for tag, x in (("A", a), ("B", b))]
    (group,) = common_swings(both)

    assert (group.root, group.interaction) == (None, True)
    own = [Swinging(one.tag, 300.0, 0.01, own=True, track=one.track) for one in both]
    assert common_swings(own)[0].interaction


def rings(seed: int, phase: float, times: np.ndarray) -> np.ndarray:
    """An error that rings at 300 s after upsets at these times, and a drift that is its own."""
    rng = np.random.default_rng(seed)
    error = 0.02 * np.cumsum(rng.standard_normal(len(T))) + 0.3 * rng.standard_normal(len(T))
    for at in times:
        since = np.maximum(T - at, 0.0)
        error += 5 * np.exp(-since / 400) * np.sin(2 * np.pi * since / 300 + phase) * (since > 0)
    return error


def test_two_loops_that_act_on_each_other_ring_together_after_every_upset() -> None:
    rng = np.random.default_rng(12)
    upsets = [rng.uniform(0, T[-1], 25) for _ in range(4)]
    errors = [rings(1, 0.0, upsets[0]), rings(2, 1.6, upsets[0])] + [rings(i, 0.0, upsets[i]) for i in (1, 2, 3)]
    own_s = (330.0, 280.0, 300.0, 300.0, 310.0)
    loops = [
        Swinging(str(i), period_s, 0.0, own=True, track=damped_track(T, error, period_s))
        for i, (error, period_s) in enumerate(zip(errors, own_s, strict=True))
    ]
    groups = interactions(loops)
    assert [group.tags for group in groups] == [("0", "1")]
    assert groups[0].interaction
    assert groups[0].root is None
    plain = SwingTrack.of_dict(loops[0].track.to_dict()) if loops[0].track else None
    assert plain is not None
    assert by_chance(plain, damped_track(T[:50], errors[1][:50], 280.0)) == 1.0


def test_a_record_that_was_exported_twice_is_told_and_coherence_is_at_most_one() -> None:
    t_s, rng = np.arange(5_000) * 10.0, np.random.default_rng(8)
    co, sp = np.cumsum(rng.normal(size=5_000)), np.full(5_000, 50.0)
    tracks = {tag: trend_track(t_s, sp, co) for tag in ("B", "A")}
    tracks |= {"C": trend_track(t_s, sp, co + 1e-3), "still": trend_track(t_s, sp, sp), "too": trend_track(t_s, sp, sp)}
    assert twins(tracks) == {"B": "A"}
    for seed in range(20):
        wave = np.random.default_rng(seed).normal(size=5_000)
        one = swing_track(t_s, wave, 300.0)
        told = coherence(one, one)
        assert told[0] <= 1.0
        assert 0.0 <= by_chance(one, one) < 1e-6
