"""A table along temperature and flow on the virtual device: no bumps, a stale flow holds, a log tells it all."""

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path

import can
import numpy as np
import pytest

from retuner.adaptive.signals.sample import LoopSample
from retuner.adaptive.supervision.decision import Mode
from retuner.adaptive.trial.phase import TrialEvent
from retuner.config.bench_plants import known_plant
from retuner.config.loading import parse_config
from retuner.config.model import Config
from retuner.drivers.bus.bus import CanLink
from retuner.drivers.clock import SimulatedClock
from retuner.drivers.controller.device_process import DeviceOnBus
from retuner.drivers.controller.virtual_device import VirtualDevice
from retuner.drivers.device import VariableChanged
from retuner.drivers.host.connection import CanDevice
from retuner.drivers.recorded.frame_log import Overhearing, read_frames
from retuner.schedule.pid import step
from retuner.session.assembly import (
    device_settings,
    link_settings,
    make_retuner,
    schedule_inputs,
    virtual_device_settings,
)
from retuner.session.ledger_rows import abort_cause
from retuner.session.loop_session import LoopSession
from retuner.session.scenario import ScenarioPlayer

EXAMPLE = (Path(__file__).resolve().parents[2] / "examples" / "boiler_2d.toml").read_text()
SCENARIO = """[scenario]
duration_s = 1500.0
steps = [
    { at_s = 0.0, sp = 55.0 },
    { at_s = 200.0, sp = 75.0 },
    { at_s = 400.0, load = -60.0 },
    { at_s = 700.0, sp = 55.0 },
    { at_s = 1000.0, load = 0.0 },
    { at_s = 1100.0, sp = 75.0, load = -60.0 },
    { at_s = 1300.0, sp = 55.0, load = 0.0 },
]
[output]
"""
BUMP = 1e-9 * 100.0


def config(lookup: str = "hard", derivative: str = "", loop: str = "") -> Config:
    text = EXAMPLE[: EXAMPLE.index("# Each cell")] + SCENARIO
    text = text.replace('lookup = "hard"', f'lookup = "{lookup}"').replace("start_c = 40.0", "start_c = 55.0")
    text = text.replace("tau_i_s = ", f"{derivative}tau_i_s = ")
    return parse_config(text.replace("sample_time_s = 2.0", f"sample_time_s = 2.0\n{loop}"))


@dataclass
class Bench:
    """A session on a virtual device, sample by sample; what it recorded."""

    config: Config
    device: VirtualDevice
    session: LoopSession
    clock: SimulatedClock
    on_bus: DeviceOnBus
    rows: list[tuple[str, Mapping[str, object]]] = field(default_factory=list)

    def turn(self) -> None:
        """One sample."""
        self.clock.advance(self.config.loop.sample_time_s)
        self.on_bus.sample()
        self.session.poll(self.clock.now_s())

    def told(self, kind: str) -> list[Mapping[str, object]]:
        return [body for name, body in self.rows if name == kind]


@contextmanager
def bench(config: Config, channel: str, mode: Mode = Mode.OFF, log: Path | None = None) -> Iterator[Bench]:
    clock = SimulatedClock()
    settings = replace(link_settings(config), channel=channel)
    plant = known_plant(config)
    assert plant is not None
    device = VirtualDevice(virtual_device_settings(config), plant)
    rows: list[tuple[str, Mapping[str, object]]] = []
    with CanLink(settings, clock) as far, CanLink(settings, clock, log) as near:
        host = CanDevice(near, device_settings(config))
        session = LoopSession(
            host,
            make_retuner(config, mode),
            ScenarioPlayer(config.scenario),
            lambda kind, _, body: rows.append((kind, body)),
        )
        yield Bench(config, device, session, clock, DeviceOnBus(device, far), rows)


@pytest.mark.parametrize("lookup", ["hard", "interpolated"])
@pytest.mark.parametrize(
    ("derivative", "loop"),
    [("", ""), ("tau_d_s = 3.0\n", "tau_f_s = 1.0\n"), ("tau_d_s = 3.0\n", "b = 0.6\nco_rate_pct_per_s = 0.5\n")],
)
def test_no_crossing_bumps_on_the_device(lookup: str, derivative: str, loop: str) -> None:
    """At every swap of gains co is what the old law would have given at this sample, over both kinds of borders."""
    with bench(config(lookup, derivative, loop), f"map-{lookup}-{len(loop)}") as b:
        swaps, regions, bumps = 0, set(), []
        while not b.session.finished:
            law, state, running = b.device._law, b.device._state, b.device.running.seq
            b.turn()
            regions.add(b.session.retuner.region)
            if b.device.running.seq != running:
                swaps += 1
                _, expected = step(law, state, b.device.sp, b.device.pv, 2.0)
                bumps.append(abs(b.device.co - expected))
    assert regions >= {0, 1, 2, 3}
    assert swaps >= (6 if lookup == "hard" else 20)
    assert max(bumps) <= BUMP


@pytest.mark.uncounted
def test_gains_in_force_follow_temperature_and_flow() -> None:
    with bench(config("interpolated"), "map-follow") as b:
        table = b.session.table
        far = 0.0
        while not b.session.finished:
            b.turn()
            running = b.session.device.running
            if b.session.retuner.region is None or running is None or b.session.samples % 50 < 49:
                continue
            wanted = table.at(b.session.retuner.region, *b.session.retuner.scheduled)
            far = max(far, abs(running.gains.kp / wanted.kp - 1.0))
    assert far < 0.05, "a write at each 2 %, and the flow's noise"
    x2 = b.session.trend.columns()["x2"]
    assert np.percentile(x2, [5, 95]) == pytest.approx([40.0, 100.0], abs=2.0)


def test_a_stale_flow_keeps_the_region_holds_the_adaptation_and_is_told() -> None:
    """The meter falls silent while the loop crosses to little flow: nothing changes; then it is back."""
    with bench(config(), "map-stale", Mode.AUTO) as b:
        plant, send = b.device.plant, b.on_bus.link.send
        silent = False

        def some(message: can.Message) -> bool:
            return True if silent and message.is_extended_id else send(message)

        b.on_bus.link.send = some  # type: ignore[method-assign]  # the meter's frames are lost, the others are not
        while b.session.samples < 150:
            b.turn()
        before = b.session.retuner.region
        silent = True
        plant_flow = []
        while b.session.samples < 300:
            b.turn()
            plant_flow.append(plant.aux)
        assert min(plant_flow) < 45.0
        assert b.session.retuner.region == before
        assert np.isnan(b.session.trend.columns()["x2"][-1])
        assert b.told("variable")[-1]["known"] is False
        assert [d.code for d in b.session.decisions if d.t_s > 320.0] in ([], ["variable_unknown"])
        silent = False
        for _ in range(20):
            b.turn()
        assert b.told("variable")[-1]["known"] is True
        assert b.session.retuner.region != before


def test_before_the_flow_was_ever_heard_nothing_is_scheduled() -> None:
    with bench(config(), "map-never", Mode.AUTO) as b:
        send = b.on_bus.link.send
        b.on_bus.link.send = lambda message: message.is_extended_id or send(message)  # type: ignore[method-assign]
        for _ in range(40):
            b.turn()
        assert b.session.retuner.region is None
        assert b.told("intent") == []
        assert "never heard" in str(b.told("variable")[0]["reason"])


def test_a_change_on_trial_is_taken_back_when_a_variable_becomes_unknown() -> None:
    assert abort_cause(VariableChanged("PLANT.aux", known=False, reason="")) is TrialEvent.LOST_TELEMETRY
    assert abort_cause(VariableChanged("PLANT.aux", known=True, reason="")) is None


@pytest.mark.parametrize("suffix", [".blf", ".asc"])
def test_the_log_of_the_bus_tells_the_same_samples(tmp_path: Path, suffix: str) -> None:
    log = tmp_path / f"bus{suffix}"
    seen: list[LoopSample] = []
    with bench(config(), f"map-log{suffix}", log=log) as b:
        b.session._on_sample = seen.append
        for _ in range(300):
            b.turn()
    heard = Overhearing(1, 2.0, schedule_inputs(b.config))
    again = [joined.sample for message in read_frames(log) if (joined := heard.take(message)) is not None]
    assert again == seen
    assert len({sample.x2 for sample in again}) > 100
