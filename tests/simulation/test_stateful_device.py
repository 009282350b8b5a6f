"""The virtual device against a model of what it promises, step by step as hypothesis likes it."""

from dataclasses import dataclass, field

from bus_simulation.device_end import LagPlant
from effort import examples
from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, precondition, rule

from retuner.drivers.controller.virtual_device import VirtualDevice, VirtualDeviceSettings
from retuner.drivers.protocol.checksum import commit_crc, lease_stamp, set_crc, to_wire
from retuner.drivers.protocol.codec import Codec
from retuner.drivers.protocol.frames import (
    Abort,
    Ack,
    Commit,
    Confirm,
    GainBox,
    Item,
    Kind,
    Lease,
    Reason,
    Stage,
    Store,
    newer,
)
from retuner.schedule.gains import PidGains

CODEC = Codec(1)
BOX = GainBox(kp_max=20.0, ki_max=2.0, kd_max=5.0, ratio_max=4.0, direction=1)
FIRST = PidGains(1.0, 0.0625, 0.5)
OWNERS = st.sampled_from([3, 67, 9])  # 3 and 67 share the six bits that STAGE carries
VALUES = st.sampled_from([0.0, 0.015625, 0.125, 0.5, 1.0, 2.0, 7.0, 30.0, -1.0])
TRIAL, LEASE_MAX = 6, 12


@dataclass
class Model:
    """What a device has to remember, in the simplest words."""

    epoch: int = 1
    running: tuple[int, PidGains] = (0, FIRST)
    confirmed: tuple[int, PidGains] = (0, FIRST)
    stored: tuple[int, PidGains] = (0, FIRST)
    latest: int = 0
    staged_seq: int | None = None
    staged: dict[int, float] = field(default_factory=dict)
    pending: tuple[int, PidGains] | None = None
    trial: int = 0
    owner: int = 0
    left: int = 0
    last_lease: Lease | None = None

    def drop(self) -> None:
        self.staged_seq, self.staged = None, {}

    def boot(self) -> None:
        self.epoch += 1
        self.running = self.confirmed = self.stored
        self.latest = self.running[0]
        self.pending, self.trial, self.owner, self.left, self.last_lease = None, 0, 0, 0, None
        self.drop()

    def legal(self) -> bool:
        new = [self.staged[item] for item in Item]
        old = self.running[1]
        pairs = zip(new, (old.kp, old.ki, old.kd), (BOX.kp_max, BOX.ki_max, BOX.kd_max), strict=True)
        return any(new) and all(
            0 <= value <= largest and (not value or not last or 1 / BOX.ratio_max <= value / last <= BOX.ratio_max)
            for value, last, largest in pairs
        )


class DeviceMachine(RuleBasedStateMachine):
    @initialize()
    def power_on(self) -> None:
        settings_ = VirtualDeviceSettings(FIRST, box=BOX, trial_samples=TRIAL, lease_longest_samples=LEASE_MAX)
        self.device, self.model = VirtualDevice(settings_, LagPlant()), Model()
        self.counter = 0
        self.committed: set[tuple[int, PidGains]] = {(0, FIRST)}

    def say(self, frame) -> Reason | None:
        answers = [CODEC.decode(reply) for reply in self.device.receive(CODEC.encode(frame))]
        assert len(answers) <= 1
        for answer in answers:
            assert isinstance(answer, Ack)
            assert answer.epoch == self.model.epoch
            return Reason(answer.reason)
        return None

    @rule(
        owner=OWNERS,
        samples=st.sampled_from([0, 3, 8, 100]),
        age=st.sampled_from([1, 1, 1, 0, -1]),
        epoch=st.sampled_from([0, 0, 0, -1]),
    )
    def lease(self, owner: int, samples: int, age: int, epoch: int) -> None:
        self.counter += max(age, 0)
        stamp = lease_stamp(self.model.epoch + epoch, self.device.sample)
        frame = Lease(owner, stamp, samples, (self.counter + min(age, 0)) % 256)
        m, last = self.model, self.model.last_lease
        if epoch:
            expected = Reason.STALE
        elif m.owner not in {0, owner}:
            expected = Reason.NOT_OWNER
        elif last and last.owner == owner and frame != last and not newer(frame.counter, last.counter, 8):
            expected = Reason.STALE
        else:
            expected = Reason.OK
        if expected is Reason.OK and frame != last:
            m.last_lease, m.left = frame, min(samples, LEASE_MAX)
            before, m.owner = m.owner, owner if samples else 0
            if before != m.owner and m.pending is None:
                m.drop()
        assert self.say(frame) is expected

    @rule(owner=OWNERS, item=st.sampled_from(Item), value=VALUES, ahead=st.sampled_from([0, 0, 0, 1, -1]))
    def stage(self, owner: int, item: Item, value: float, ahead: int) -> None:
        m = self.model
        base = m.staged_seq if m.staged_seq is not None else m.latest + 1
        seq = (base + ahead) % 65536
        answer = self.say(Stage(item, owner % 64, value, seq))
        if not m.owner or owner % 64 != m.owner % 64:
            assert answer is Reason.NOT_OWNER
        elif m.pending is not None:
            assert answer is Reason.BUSY
        elif seq != m.staged_seq and not newer(seq, m.latest):
            assert answer is Reason.STALE
        else:
            assert answer is None
            if seq != m.staged_seq:
                m.staged_seq, m.staged, m.latest = seq, {}, seq
            m.staged[item] = value

    @precondition(lambda self: self.model.owner)
    @rule(kp=VALUES, ki=VALUES, kd=VALUES)
    def stage_all(self, kp: float, ki: float, kd: float) -> None:
        for item, value in zip(Item, (kp, ki, kd), strict=True):
            self.stage(self.model.owner, item, value, 0)

    @precondition(lambda self: self.model.owner and self.model.pending is None)
    @rule(factor=st.sampled_from([0.5, 2.0, 4.0]))
    def stage_legal(self, factor: float) -> None:
        gains = self.model.running[1]
        self.stage_all(gains.kp * factor, gains.ki * factor, gains.kd * factor)

    @precondition(lambda self: self.model.staged_seq is not None)
    @rule(owner=OWNERS, wrong=st.sampled_from(["", "", "", "crc", "base", "epoch"]))
    def commit(self, owner: int, wrong: str) -> None:
        m, seq = self.model, self.model.staged_seq
        base = m.running[0] + (wrong == "base")
        try:
            gains = to_wire(PidGains(*(m.staged.get(item, 0.0) for item in Item)))
            crc = commit_crc(set_crc(1, m.epoch - (wrong == "epoch"), seq, gains), base, owner) ^ (wrong == "crc")
        except ValueError:
            gains, crc = None, 0
        answer = self.say(Commit(seq, base, crc))
        if m.pending is not None:
            assert answer in {None, Reason.BUSY}  # the same commit again, or another one
            return
        right = not wrong and owner == m.owner and len(m.staged) == 3 and gains is not None and m.legal()
        assert (answer is None) == right
        assert answer is not Reason.OK
        if right:
            m.pending = (seq, gains)
            self.committed.add(m.pending)
        else:
            m.drop()

    @rule(ahead=st.integers(-2, 3))
    def abort(self, ahead: int) -> None:
        m, seq = self.model, (self.model.latest + ahead) % 65536
        answer = self.say(Abort(seq))
        if seq == m.running[0]:
            assert answer is Reason.ALREADY_RUNNING
        elif seq == m.staged_seq or newer(seq, m.latest):
            assert answer is Reason.OK
            m.pending, m.latest = None, seq
            m.drop()
        else:
            assert answer is Reason.STALE

    @rule(owner=OWNERS, right=st.booleans())
    def confirm(self, owner: int, right: bool) -> None:
        m = self.model
        answer = self.say(Confirm((m.running[0] + (not right)) % 65536, owner))
        if owner != m.owner:
            assert answer is Reason.NOT_OWNER
        elif not right:
            assert answer is Reason.STALE
        else:
            assert answer is Reason.OK
            m.confirmed = m.running

    @rule(owner=OWNERS)
    def store(self, owner: int) -> None:
        m = self.model
        answer = self.say(Store(m.running[0], owner))
        if owner != m.owner:
            assert answer is Reason.NOT_OWNER
        elif m.running != m.confirmed:
            assert answer is Reason.NOT_CONFIRMED
        else:
            assert answer is Reason.OK
            m.stored = m.running

    @rule()
    def sample(self) -> None:
        m = self.model
        acks = [f for f in map(CODEC.decode, self.device.step()) if isinstance(f, Ack)]
        if m.pending is not None:
            m.running, m.pending, m.trial = m.pending, None, TRIAL
            m.drop()
            assert [(a.kind, a.reason) for a in acks] == [(Kind.COMMIT, Reason.OK)]
        elif m.running != m.confirmed and m.trial == 1:
            m.running, m.trial = m.confirmed, 0
            assert [(a.kind, a.reason) for a in acks] == [(Kind.CONFIRM, Reason.REVERTED)]
        else:
            m.trial -= m.running != m.confirmed
            assert acks == []
        if m.owner:
            m.left -= 1
            if not m.left:
                m.owner = 0
                m.drop()

    @rule()
    def restart(self) -> None:
        self.device.restart()
        self.model.boot()

    @invariant()
    def it_is_as_the_model_says(self) -> None:
        m, pages = self.model, self.device.pages
        assert (pages.running.seq, pages.running.gains) == m.running
        assert (pages.confirmed.seq, pages.confirmed.gains) == m.confirmed
        assert pages.latest == m.latest
        assert pages.has_staged == (m.staged_seq is not None)
        assert self.device.lease.owner == m.owner
        assert self.device.epoch == m.epoch
        assert m.running in self.committed


TestDevice = DeviceMachine.TestCase
TestDevice.settings = settings(max_examples=examples(150), stateful_step_count=40)
