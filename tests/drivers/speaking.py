"""Speaking to a virtual device frame by frame, as the owner of its lease."""

from retuner import LinearProcess, PidGains
from retuner.drivers.controller.virtual_device import VirtualDevice, VirtualDeviceSettings
from retuner.drivers.plants.linear_plant import LinearPlant
from retuner.drivers.protocol.checksum import commit_crc, lease_stamp, set_crc
from retuner.drivers.protocol.codec import Codec
from retuner.drivers.protocol.frames import Ack, Commit, Frame, GainBox, Item, Lease, Reason, Stage

CODEC = Codec(1)
OWNER = 9
FIRST, SECOND, THIRD = PidGains(1.0, 0.0625, 0.5), PidGains(1.5, 0.125, 0.75), PidGains(2.0, 0.25, 1.0)


def device(**firmware: object) -> VirtualDevice:
    """A device whose lease is taken, if it is node 1."""
    plant = LinearPlant(LinearProcess(1.2, (30.0,), (), 4.0), start_pv=50.0, start_co=40.0)
    box = GainBox(kp_max=20.0, ki_max=2.0, kd_max=5.0, ratio_max=10.0, direction=1)
    dev = VirtualDevice(VirtualDeviceSettings(**{"gains": FIRST, "box": box, **firmware}), plant)
    if dev.settings.node == CODEC.node:
        take_lease(dev)
    return dev


def take_lease(dev: VirtualDevice, owner: int = OWNER, samples: int = 6000, counter: int = 1) -> Ack:
    (answer,) = say(dev, Lease(owner, lease_stamp(dev.epoch, dev.sample), samples, counter))
    assert isinstance(answer, Ack)
    return answer


def say(dev: VirtualDevice, *frames: Frame) -> list[Frame]:
    """What the device answers."""
    return [CODEC.decode(reply) for frame in frames for reply in dev.receive(CODEC.encode(frame))]


def stage(seq: int, gains: PidGains, owner: int = OWNER) -> list[Frame]:
    values = zip(Item, (gains.kp, gains.ki, gains.kd), strict=True)
    return [Stage(item, owner % 64, value, seq) for item, value in values]


def commit(seq: int, gains: PidGains, base: int = 0, epoch: int = 1, node: int = 1, owner: int = OWNER) -> Commit:
    return Commit(seq, base, commit_crc(set_crc(node, epoch, seq, gains), base, owner))


def write(dev: VirtualDevice, seq: int, gains: PidGains, base: int) -> list[Frame]:
    """Stage, commit, next sample: what it answers."""
    return [*say(dev, *stage(seq, gains), commit(seq, gains, base, dev.epoch)), *step(dev)]


def step(dev: VirtualDevice) -> list[Frame]:
    return [CODEC.decode(message) for message in dev.step()]


def acks(frames: list[Frame]) -> list[Reason]:
    return [Reason(frame.reason) for frame in frames if isinstance(frame, Ack)]
