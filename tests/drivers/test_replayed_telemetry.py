"""Telemetry and heartbeats of the past sent again: the session's clock never runs ahead of the controller's."""

import random
from collections import deque
from dataclasses import replace

import pytest
from effort import examples
from hypothesis import given, settings
from hypothesis import strategies as st
from speaking import CODEC

from retuner.drivers.device import DeviceConflict
from retuner.drivers.protocol.checksum import sample_crc
from retuner.drivers.protocol.frames import Heartbeat, TelemetryPv, TelemetrySp
from retuner.drivers.telemetry.sample_assembly import SampleJoiner

BEAT = 5
"""Samples between two heartbeats, here."""
LEARNING, KNOWN = 100, 2 * BEAT
"""Samples that the clock may be ahead of the controller: before its rhythm is known, and then."""


def halves(number: int, said: float) -> tuple[TelemetryPv, TelemetrySp]:
    pv = TelemetryPv(number % 256, said, 50.0)
    sp = TelemetrySp(number % 256, 7.0, 1, 0, 1, 0)
    return pv, replace(sp, crc=sample_crc(1, pv, sp))


class Overheard:
    """What a repeater on the bus of a bench has heard, to be sent again."""

    def __init__(self, bench) -> None:
        self.bench = bench
        self.heard = deque(maxlen=4000)
        send = bench.far.send

        def heard(message) -> None:
            if isinstance(CODEC.decode(message), TelemetryPv | TelemetrySp | Heartbeat):
                self.heard.append(message)
            send(message)

        bench.far.send, self.send = heard, send

    def again(self, kinds, samples: int) -> None:
        """All of the kinds from so many samples ago on."""
        for message in list(self.heard)[-samples * 2 - samples // BEAT :]:
            if isinstance(CODEC.decode(message), kinds):
                self.send(message)


@pytest.mark.parametrize("back", [130, 200, 255, 300, 1000])
@pytest.mark.parametrize("kinds", [(TelemetryPv, TelemetrySp), (TelemetryPv, TelemetrySp, Heartbeat)])
def test_a_replay_does_not_move_the_clock(bench, back: int, kinds) -> None:
    repeater = Overheard(bench)
    bench.run(1100)
    ahead = []
    for _ in range(60):
        repeater.again(kinds, back)
        ahead += [round(sample.t_s / 2) - bench.device.sample for sample in bench.samples(bench.run(1))]
    assert max(ahead, default=0) <= KNOWN
    calm = bench.run(2 * LEARNING)
    times = [round(sample.t_s / 2) for sample in bench.samples(calm)]
    assert times[-1] == bench.device.sample
    assert times[-BEAT * 4 :] == list(range(times[-1] - BEAT * 4 + 1, times[-1] + 1))
    assert bench.host.connected


def test_a_replay_is_told(bench) -> None:
    repeater = Overheard(bench)
    bench.run(300)
    told = []
    for _ in range(60):
        repeater.again((TelemetryPv, TelemetrySp, Heartbeat), 200)
        told += bench.run(1)
    assert any(isinstance(event, DeviceConflict) for event in told)


def test_a_counter_that_begins_anew_in_the_same_epoch_is_told_and_moves_no_clock(bench) -> None:
    bench.run(400)
    bench.device.sample = 3
    events = bench.run(60)
    assert not bench.samples(events)
    assert any(isinstance(event, DeviceConflict) for event in events)


@pytest.mark.uncounted
@given(seed=st.integers(0, 2**32), beat=st.sampled_from([1, 2, 5, 20, 100]), start=st.integers(0, 2**20))
@settings(max_examples=examples(100))
def test_no_past_telemetry_however_it_is_sent_again_runs_the_clock_ahead(seed: int, beat: int, start: int) -> None:
    """Samples of the device in time, and between them anything it has said, in any order and as often as one likes."""
    rng, joiner = random.Random(seed), SampleJoiner(1.0)
    joiner.set_reference(start)
    past = [(None, half) for n in range(max(start - 255, 0), start + 1) for half in halves(n, float(n))]
    often, longest, shuffled = rng.random(), rng.choice([1, 8, 64, 400]), rng.random() < 0.3
    newest = start - 1.0
    for number in range(start + 1, start + 700):
        fresh = [(None, half) for half in halves(number, float(number))]
        fresh += [(number, None)] if number % beat == 0 else []
        past += fresh
        sent = list(fresh)
        if rng.random() < often:
            back = rng.randrange(min(len(past), 2000))
            sent += past[-back - 1 :][: rng.randint(1, longest)]
        if shuffled:
            rng.shuffle(sent)
        allowed = max(LEARNING, 2 * beat) if number - start <= 256 else max(2 * beat, 8)
        for heartbeat, half in sent:
            if half is None:
                joiner.set_reference(heartbeat)
            elif (joined := joiner.take(half)) is not None:
                assert newest < joined.sample.t_s <= number + allowed
                newest = joined.sample.t_s
    assert newest >= start + 700 - 2 * max(beat, 8)
