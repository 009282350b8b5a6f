"""A session on the whole stack in simulated time: virtual controller, bus, two-phase writes; a linear plant."""

import itertools
from collections.abc import Callable, Iterator, Mapping
from typing import Any

import can
import numpy as np

from retuner.adaptive.fit.structure import parameters_of
from retuner.adaptive.identification.estimate import LogModel
from retuner.adaptive.identification.plausible import Plausible
from retuner.adaptive.process.model import LinearProcess, ProcessModel, ProcessType
from retuner.adaptive.region_model.region_model import RegionModel, StructureModel
from retuner.adaptive.rules.simc import simc
from retuner.adaptive.supervision.decision import Decision, Mode, Outcome
from retuner.adaptive.supervision.retuner import Retuner
from retuner.adaptive.supervision.retuner_settings import RetunerSettings
from retuner.adaptive.trial.phase import TrialPhase
from retuner.adaptive.trial.prediction import predict
from retuner.adaptive.trial.trial_settings import TrialSettings
from retuner.drivers.bus.bus import CanLink
from retuner.drivers.bus.link_settings import LinkSettings
from retuner.drivers.clock import SimulatedClock
from retuner.drivers.controller.device_process import DeviceOnBus
from retuner.drivers.controller.gain_memory import GainSet
from retuner.drivers.controller.virtual_device import VirtualDevice, VirtualDeviceSettings
from retuner.drivers.host.can_device import CanDevice
from retuner.drivers.host.can_settings import CanDeviceSettings
from retuner.drivers.plants.linear_plant import LinearPlant
from retuner.drivers.protocol.checksum import to_wire
from retuner.drivers.protocol.frames import GainBox
from retuner.schedule.gains import PidGains
from retuner.schedule.regions import Regions
from retuner.schedule.table import GainTable, Lookup
from retuner.session.loop_session import LoopSession
from retuner.session.scenario import ScenarioPlayer

CHANNELS = itertools.count()
PLANT = LinearProcess(1.0, (50.0,), (), 5.0)
MODEL = ProcessModel(ProcessType.FOPDT, 1.0, 50.0, 0.0, 5.0)
GOOD = simc(MODEL, 6.0).gains
OTHER = PidGains(0.8 * GOOD.kp, 0.8 * GOOD.ki)
PROMISE = predict([Plausible(MODEL, 0.0)], GOOD, GOOD, 1.0)
FOREIGN = PidGains(0.5 * GOOD.kp, 0.3 * GOOD.ki)
TELEMETRY = (0x12, 0x13)


class Wire:
    """Two regions, low and high, that meet at 60; the loop rests at 50 in the low one."""

    def __init__(
        self,
        *,
        mode: Mode = Mode.AUTO,
        low: PidGains = GOOD,
        first: PidGains | None = None,
        lookup: Lookup = Lookup.HARD,
        probation: int = 5,
        trial_samples: int = 0,
        **trial: Any,
    ) -> None:
        regions = Regions("sp", "-", ("low", "high"), 0.0, (60.0,), 100.0, 0.5, 0.0)
        table = GainTable("loop", regions, (low, OTHER), lookup)
        first = table.at(0, 50.0) if first is None else first
        plant = LinearPlant(PLANT, start_pv=50.0, start_co=50.0)
        firmware = VirtualDeviceSettings(
            gains=first, sample_time_s=1.0, box=GainBox(ratio_max=50.0), trial_samples=trial_samples
        )
        self.device = VirtualDevice(firmware, plant)
        self.clock = SimulatedClock()
        link = LinkSettings(channel=f"wire-{next(CHANNELS)}")
        self.far, self.near = CanLink(link, self.clock), CanLink(link, self.clock)
        self.on_bus = DeviceOnBus(self.device, self.far)
        host = CanDevice(self.near, CanDeviceSettings(sample_time_s=1.0, probation_samples=probation))
        settings = RetunerSettings(1.0, 100.0, mode, band=0.05, trial=TrialSettings(**trial))
        self.rows: list[tuple[str, Mapping[str, object]]] = []
        self.session = LoopSession(host, Retuner(table, settings), ScenarioPlayer(None), self._record)
        self.session.orders = self._ordered
        self.heard: Callable[[can.Message], bool] = lambda message: True  # noqa: ARG005  what of the device arrives
        self.asked: list[Decision] = []
        self.peak = 0.0
        self.run(45)

    @property
    def trials(self) -> Any:
        return self.session.retuner.trials

    @property
    def runs(self) -> PidGains:
        """What the controller truly runs."""
        return self.device.running.gains

    @property
    def kinds(self) -> list[str]:
        return [kind for kind, _ in self.rows]

    def run(self, samples: int) -> None:
        for _ in range(samples):
            self.clock.advance(1.0)
            self.on_bus.answer()
            for message in self.device.step():
                if self.heard(message):
                    self.far.send(message)
            self.session.poll(self.clock.now_s())
            for message in self.far.receive_all():
                for reply in self.device.receive(message):
                    if self.heard(reply):
                        self.far.send(reply)
            self.peak = max(self.peak, abs(self.device.sp - self.device.pv))

    def until(self, phase: TrialPhase, region: int = 0, most: int = 60) -> None:
        for _ in range(most):
            if self.trials.phase(region) is phase:
                return
            self.run(1)
        raise AssertionError(f"{self.trials.phase(region)} after {most} samples, {phase} was to come")

    def know(self) -> None:
        """From now on the process of both regions is known."""
        x = parameters_of(MODEL)
        log = LogModel(x, 1e-4 * np.eye(len(x)), 1, MODEL.type)
        model = RegionModel((StructureModel(log, 0.0),), 1, 0.0, plausible=(Plausible(MODEL, 0.0),))
        self.session.retuner.region_models = {0: model, 1: model}

    def ask(self, gains: PidGains, region: int = 0) -> None:
        """A change with a promise that it may not keep."""
        made = self.session.retuner.ordered(region, Outcome("injected", "for a test"), gains, PROMISE)
        assert made.gains_after is not None, made.reason
        self.asked.append(made)

    def edit(self, gains: PidGains) -> None:
        """Somebody else changes the running set."""
        pages = self.device.pages
        seq = pages.latest + 1
        pages.running = pages.confirmed = GainSet(seq, to_wire(gains))
        pages.latest = seq

    def end(self, most: int = 400) -> None:
        """Let the session come to its end."""
        self.session.stop("the test is over")
        for _ in range(most):
            self.run(1)
            if self.session.finished:
                return
        raise AssertionError("the session does not end")

    def close(self) -> None:
        self.near.close()
        self.far.close()

    def _ordered(self, t_s: float) -> list[Decision]:
        del t_s
        asked, self.asked = self.asked, []
        return asked

    def _record(self, kind: str, t_s: float, body: Mapping[str, object]) -> None:
        del t_s
        self.rows.append((kind, body))


def is_telemetry(message: can.Message) -> bool:
    return message.arbitration_id & 0x1F in TELEMETRY


def wires(**always: Any) -> Iterator[Callable[..., Wire]]:
    """What a fixture gives: makes wires, and closes them. always : arguments of each."""
    made: list[Wire] = []

    def make(**arguments: Any) -> Wire:
        made.append(Wire(**always, **arguments))
        return made[-1]

    yield make
    for wire in made:
        wire.close()
