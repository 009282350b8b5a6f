"""The host's client with the real device, every frame in hypothesis' hands: delivered, held back, doubled, dropped."""

import contextlib

from bus_simulation import truth as t
from bus_simulation.device_end import LagPlant
from bus_simulation.truth import Order, Ran, Truth
from effort import examples
from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, precondition, rule

from retuner.adaptive.signals.sample import LoopSample
from retuner.drivers.bus.link_settings import LinkSettings
from retuner.drivers.controller.virtual_device import VirtualDevice, VirtualDeviceSettings
from retuner.drivers.device import (
    DeviceRestarted,
    DeviceSilentError,
    LinkState,
    Reverted,
    RunningChanged,
    WriteDone,
    WriteFailed,
    WriteRefusedError,
)
from retuner.drivers.host.can_device import CanDevice
from retuner.drivers.host.can_settings import CanDeviceSettings
from retuner.drivers.protocol.frames import GainBox
from retuner.schedule.gains import PidGains

FIRST = PidGains(1.0, 0.0625, 0.5)
BOX = GainBox(kp_max=64.0, ki_max=4.0, kd_max=32.0, ratio_max=4.0, direction=1)
COMMIT = 5
CALM = 60 + 5  # samples, and heartbeats of one sample


class End:
    """A link whose frames wait until somebody takes them."""

    settings, state = LinkSettings(), LinkState.UP

    def __init__(self) -> None:
        self.inbox: list = []
        self.outbox: list = []

    def send(self, message) -> bool:
        self.outbox.append(message)
        return True

    def receive_all(self) -> list:
        messages, self.inbox = self.inbox, []
        return messages


class ClientMachine(RuleBasedStateMachine):
    @initialize(trial=st.sampled_from([0, 8]))
    def connect(self, trial: int) -> None:
        self.device = VirtualDevice(
            VirtualDeviceSettings(FIRST, box=BOX, trial_samples=trial, heartbeat_samples=1), LagPlant()
        )
        self.truth = Truth(Ran(0, 1, 0, FIRST), BOX, authentic=False, forged=False)
        self.replies: list = []
        self.now_s, self.turn, self.lives, self.late = 0.0, 0, 0, []
        self.new_host()
        self.flow(6)

    @rule()
    def new_host(self) -> None:
        """The host's process ends, another begins."""
        self.lives += 1
        self.link = End()
        self.host = CanDevice(self.link, CanDeviceSettings(owner=100 + self.lives, connect_samples=1e6))
        self.order: Order | None = None
        self.asked = [self.turn]
        self.t_s = float("-inf")

    @rule(samples=st.integers(1, 8))
    def flow(self, samples: int) -> None:
        """Everything arrives."""
        for _ in range(samples):
            self.sample()
            self.to_host(0, 99)
            self.poll()
            self.to_device(0, 99)

    @rule()
    def sample(self) -> None:
        """One controller sample."""
        self.turn += 1
        self.replies += self.device.step()
        self.look()

    @rule()
    def poll(self) -> None:
        """The host's turn."""
        self.now_s += 2.0
        before = len(self.link.outbox)
        with contextlib.suppress(DeviceSilentError):
            events = self.host.poll(self.now_s)
        asked = self.asked[-1]
        if any(m.arbitration_id & 31 == 2 and m.data[0] == 0 for m in self.link.outbox[before:]):
            self.asked.append(self.turn)
        for event in events:
            if isinstance(event, LoopSample):
                t.time_goes_forward(self.t_s, event.t_s)
                self.t_s = event.t_s
            elif isinstance(event, WriteDone | WriteFailed):
                t.reported_is_what_ran(self.truth, event.running, asked)
                t.done_is_what_was_ordered(event, self.order)
                if isinstance(event, WriteFailed):
                    self.truth.dead.add(self.order.gains)
                self.order = None
            elif isinstance(event, DeviceRestarted | RunningChanged | Reverted):
                t.reported_is_what_ran(self.truth, event.running, asked)
        if self.order is not None and self.host.write_seq not in {None, self.order.seq}:  # under another number
            self.order = self.order._replace(seq=self.host.write_seq)
            self.truth.ordered(self.order)

    @rule(first=st.integers(0, 6), count=st.integers(1, 9))
    def to_device(self, first: int, count: int) -> None:
        """Some of the host's frames arrive, those before them stay on their way."""
        arriving = self.link.outbox[first : first + count]
        del self.link.outbox[first : first + count]
        self.deliver(arriving)

    def deliver(self, messages: list) -> None:
        for message in messages:
            self.replies += self.device.receive(message)
            if self.device.pages.confirmed.gains not in {gains for _, gains in self.truth.confirmed}:
                self.truth.confirmed.add(tuple(self.device.pages.confirmed))
        self.look()

    @rule(first=st.integers(0, 6), count=st.integers(1, 9))
    def to_host(self, first: int, count: int) -> None:
        """Some of the device's frames arrive."""
        self.link.inbox += self.replies[first : first + count]
        del self.replies[first : first + count]

    @precondition(lambda self: self.link.outbox)
    @rule(which=st.integers(0, 30), doubled=st.booleans())
    def hold_back(self, which: int, doubled: bool) -> None:
        """A frame of the host comes much later, perhaps a second time."""
        index = which % len(self.link.outbox)
        self.late.append(self.link.outbox[index])
        if not doubled:
            del self.link.outbox[index]

    @precondition(lambda self: self.host.writing)
    @rule(samples=st.sampled_from([2, 4, 9, 12]))
    def flow_without_commit(self, samples: int) -> None:
        """Everything arrives but the commit, which is late."""
        for _ in range(samples):
            self.sample()
            self.to_host(0, 99)
            self.poll()
            self.late += [m for m in self.link.outbox if m.arbitration_id & 31 == COMMIT]
            self.link.outbox = [m for m in self.link.outbox if m.arbitration_id & 31 != COMMIT]
            self.to_device(0, 99)

    @precondition(lambda self: self.late)
    @rule(which=st.integers(0, 30))
    def late_one_arrives(self, which: int) -> None:
        self.deliver([self.late[which % len(self.late)]])

    @rule(out=st.booleans(), back=st.booleans())
    def drop(self, out: bool, back: bool) -> None:
        """What is on its way is lost."""
        self.link.outbox[:] = [] if out else self.link.outbox
        self.replies[:] = [] if back else self.replies

    @rule()
    def restart_device(self) -> None:
        """Power off and on."""
        self.device.restart()
        t.restarted(self.truth)
        self.turn += 1
        self.truth.began(Ran(self.turn, self.device.epoch, *self.device.pages.running))

    @precondition(lambda self: self.host.connected and not self.host.writing)
    @rule(kp=st.integers(1, 4000), ki=st.sampled_from([0.5, 1.0, 2.0]))
    def write(self, kp: int, ki: float) -> None:
        """Order another set; kp tells it from every other."""
        running = self.host.running
        gains = PidGains(kp / 1024.0, running.gains.ki * ki, running.gains.kd)
        if any(gains == order.gains for orders in self.truth.orders.values() for order in orders):
            return
        try:
            seq = self.host.begin_write(gains, self.now_s)
        except WriteRefusedError:
            return
        self.order = Order(self.host.epoch, seq, running.seq, gains, 100 + self.lives, f"life {self.lives}")
        self.truth.ordered(self.order)

    def look(self) -> None:
        """Every other set that runs must be one that was meant to."""
        running, before = self.device.pages.running, self.truth.ran[-1]
        if (self.device.epoch, running.seq, running.gains) == before[1:]:
            return
        now = Ran(self.turn, self.device.epoch, *running)
        if running == self.device.pages.confirmed:
            t.reverted_to_the_confirmed_set(self.truth, now)
        else:
            order = t.running_set_is_a_committed_one(self.truth, now, self.device.lease.owner)
            t.built_on_what_ran(order, before)
            t.finite_and_inside_the_box(self.truth, now, before)
            t.sequence_is_monotonic(self.truth, now)
            t.failed_sets_stay_dead(self.truth, now)
        self.truth.began(now)

    @invariant()
    def a_write_is_open_or_told(self) -> None:
        assert self.host.writing == (self.order is not None)

    def teardown(self) -> None:
        """In the calm everything becomes known."""
        if not hasattr(self, "host"):
            return
        self.late.clear()
        self.flow(CALM)
        t.known_after_calm(
            connected=self.host.connected, writing=self.host.writing, running=self.host.running, truth=self.truth
        )


TestClient = ClientMachine.TestCase
TestClient.settings = settings(max_examples=examples(100), stateful_step_count=40)
