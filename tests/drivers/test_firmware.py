"""The firmware in C answers as the virtual device does, frame by frame and byte by byte, whatever comes."""

import math
import random
import struct
import subprocess
from collections.abc import Iterator
from pathlib import Path

import can
import pytest
from bus_simulation.device_end import LagPlant
from bus_simulation.firmware import FIRMWARE, FirmwareDevice
from bus_simulation.mutants import MUTANTS_OF_THE_STORE, Mutant
from effort import sized

from retuner.adaptive.process.model import LinearProcess
from retuner.drivers.bus.link_settings import LinkSettings
from retuner.drivers.controller.virtual_device import VirtualDevice, VirtualDeviceSettings
from retuner.drivers.device import CommandDone, DeviceRestarted, Event, LinkState, WriteDone, WriteFailed
from retuner.drivers.host.can_device import CanDevice
from retuner.drivers.host.can_settings import CanDeviceSettings
from retuner.drivers.plants.linear_plant import LinearPlant
from retuner.drivers.protocol.authentication import code_frames, commit_code
from retuner.drivers.protocol.checksum import commit_crc, frame_crc, lease_stamp, set_crc, to_wire
from retuner.drivers.protocol.codec import Codec
from retuner.drivers.protocol.frames import (
    OWNER_TAG,
    STORE_TAG,
    Abort,
    Commit,
    Confirm,
    Frame,
    GainBox,
    Item,
    Lease,
    Load,
    Mode,
    Read,
    Setpoint,
    Stage,
    Store,
)
from retuner.schedule.gains import PidGains

CODEC = Codec(1)
FIRST = PidGains(1.0, 0.0625, 0.25)
BOX = GainBox(kp_max=100.0, ki_max=10.0, kd_max=50.0, ratio_max=10.0, direction=1)
KEY = bytes(range(16))
TELEMETRY = (18, 19)
OWNERS = (5, 64, 0x1700)


Changes = tuple[tuple[str, str], ...]


class SpoiltPlant(LagPlant):
    """Its sensor says something else where it is told to."""

    says: float | None = None

    def step(self, *given: float) -> float:
        pv = super().step(*given)
        return pv if self.says is None else self.says


class Twins:
    """The virtual device and the firmware, told the same. All commands are right in form, many in everything."""

    def __init__(self, seed: int, *, key: bytes | None = None, trial_samples: int = 0, changes: Changes = ()) -> None:
        self.rng = random.Random(seed)
        settings = VirtualDeviceSettings(
            FIRST, box=BOX, key=key, trial_samples=trial_samples, lease_longest_samples=40, sp_min=0.0, sp_max=100.0
        )
        nonces = [random.Random(seed), random.Random(seed)]
        self.ends: bool | None = True
        self.plants = SpoiltPlant(), SpoiltPlant()
        ends = {"keep": lambda: self.ends}
        self.virtual = VirtualDevice(settings, self.plants[0], nonce=lambda: nonces[0].getrandbits(48), **ends)
        self.firmware = FirmwareDevice(
            settings, self.plants[1], nonce=lambda: nonces[1].getrandbits(48), changes=changes, **ends
        )
        for device, chance in zip((self.virtual, self.firmware), nonces, strict=True):
            chance.seed(seed)
            device.restart()
        self.key, self.answers = key, 0

    def tell(self, message: can.Message) -> None:
        virtual, firmware = ([m.data for m in device.receive(message)] for device in (self.virtual, self.firmware))
        assert virtual == firmware, CODEC.decode(message)
        self.answers += len(virtual)

    def say(self, *frames: Frame) -> None:
        for frame in frames:
            self.tell(CODEC.encode(frame))

    def something_fails(self) -> None:
        """The sensor, a fault input, the flash; or it is over."""
        rng, devices = self.rng, (self.virtual, self.firmware)
        kind = rng.randrange(3)
        if kind == 0:
            spoilt = rng.choice((*[None] * 12, math.nan, math.inf, -3e38, 2e9))
            for plant in self.plants:
                plant.says = spoilt
        elif kind == 1:
            fault = rng.random() < 0.3
            for device in devices:
                device.tell_fault(fault=fault)
        else:
            self.ends = rng.choice((True, True, False, None))
            done = rng.random() < 0.7
            told = [[m.data for m in device.stored(done=done)] for device in devices]
            assert told[0] == told[1]

    def step(self) -> None:
        virtual, firmware = self.virtual.step(), self.firmware.step()
        assert [m.arbitration_id for m in virtual] == [m.arbitration_id for m in firmware]
        for ours, theirs in zip(virtual, firmware, strict=True):
            if ours.arbitration_id % 32 not in TELEMETRY:
                assert ours.data == theirs.data
        self.same()

    def same(self) -> None:
        assert self.firmware.running == self.virtual.running
        assert self.firmware.pages.confirmed == self.virtual.pages.confirmed
        assert self.firmware.pages.latest == self.virtual.pages.latest
        assert self.firmware.lease.owner == self.virtual.lease.owner
        assert list(self.firmware.pages.slots) == self.virtual.pages.slots
        assert self.firmware.refused == self.virtual.refused

    def some_commands(self) -> list[Frame]:
        rng, device = self.rng, self.virtual
        owner = device.lease.owner if device.lease.owner and rng.random() < 0.8 else rng.choice(OWNERS)
        seq = (device.pages.latest + rng.choice((0, 0, 1, 1, -1, 2, 33000))) % 65536
        counter, running = rng.randrange(256), device.running.seq
        stamp = lease_stamp(device.epoch, device.sample) if rng.random() < 0.9 else rng.randrange(65536)
        return [
            Lease(owner, stamp, rng.choice((0, 3, 20, 60000)), counter),
            Read(rng.randrange(5), rng.randrange(65536)),
            Abort(seq),
            Stage(rng.randrange(3), owner % OWNER_TAG, rng.uniform(-1, 9), seq),
            Commit(seq, running, rng.randrange(1 << 32)),
            Store(running, owner % STORE_TAG),
            Confirm(running, owner),
            Setpoint(counter, rng.uniform(-10, 110), owner),
            Mode(counter, rng.randrange(2), round(rng.uniform(-5, 105), 4), owner),
            Load(counter, rng.uniform(-5, 5), owner),
        ]

    def whole_set(self) -> list[Frame]:
        rng, device = self.rng, self.virtual
        old, seq, base = device.running.gains, (device.pages.latest + 1) % 65536, device.running.seq
        factors = [rng.choice((0.5, 1.5, 2.0, 1.0, 20.0)) if rng.random() < 0.9 else 0.0 for _ in range(3)]
        values = [factor * (gain or 0.125) for factor, gain in zip(factors, (old.kp, old.ki, old.kd), strict=True)]
        owner = device.lease.owner or 5
        frames: list[Frame] = [Stage(item, owner % OWNER_TAG, values[item], seq) for item in Item]
        rng.shuffle(frames)
        if not any(values):
            return frames
        gains = to_wire(PidGains(*values))
        crc = commit_crc(set_crc(1, device.epoch, seq, gains), base, owner)
        if self.key is not None and rng.random() < 0.9:
            code = commit_code(self.key, 1, device.epoch, device.code.nonce, owner, seq, base, gains)
            frames += code_frames(code ^ rng.choice((0, 0, 0, 1, 1 << 90)), seq)
        commit = Commit(seq, base, crc)
        return [*frames, commit, *([commit] * rng.randrange(2)), Read(1, rng.randrange(65536))]

    def noise(self) -> can.Message:
        rng = self.rng
        id_, data = 32 + rng.randrange(40), bytearray(rng.randbytes(rng.choice((8, 8, 8, rng.randrange(9)))))
        if data and rng.random() < 0.7:
            data[-1] = frame_crc(id_, data[:-1])
        odd = {"is_extended_id": rng.random() < 0.05, "is_fd": rng.random() < 0.05}
        return can.Message(arbitration_id=id_, data=data, **odd)

    def power_fails(self) -> None:
        """While the newest place was written, perhaps."""
        slots = self.virtual.pages.slots
        there = [slot for slot in slots if slot is not None]
        if len(there) == len(slots) and self.rng.random() < 0.5:
            newest = max(there, key=lambda slot: slot.generation)
            place = slots.index(newest)
            slots[place] = newest._replace(crc=newest.crc ^ 1 << self.rng.randrange(32))
            self.firmware.spoil(place, slots[place].crc)

    def run(self, acts: int) -> None:
        for _ in range(acts):
            kind = self.rng.random()
            if kind < 0.35:
                self.say(self.rng.choice(self.some_commands()))
            elif kind < 0.5:
                self.say(*self.whole_set())
            elif kind < 0.65:
                self.tell(self.noise())
            elif kind < 0.655:
                self.something_fails()
            elif kind < 0.66:
                self.power_fails()
                self.virtual.restart()
                self.firmware.restart()
                self.same()
            else:
                self.step()


@pytest.mark.parametrize("seed", range(sized(6, 20, 1000)))
def test_the_firmware_answers_as_the_virtual_device_does(seed: int) -> None:
    twins = Twins(seed, key=KEY if seed % 2 else None, trial_samples=(0, 9)[seed // 2 % 2])
    twins.run(1500)
    assert twins.answers > 500


@pytest.mark.parametrize("mutant", MUTANTS_OF_THE_STORE, ids=lambda mutant: mutant.name)
def test_a_store_that_is_wrong_is_found(mutant: Mutant) -> None:
    def found(seed: int) -> bool:
        try:
            Twins(seed, changes=((mutant.old, mutant.new),)).run(2000)
        except AssertionError:
            return True
        return False

    assert any(map(found, range(20)))


def test_swaps_and_stores_happen_in_that() -> None:
    """What the comparison above would say nothing about is seen to happen in it."""
    twins = Twins(3, key=KEY, trial_samples=9)
    ran = set()
    for _ in range(300):
        twins.run(10)
        ran.add(twins.virtual.running)
    assert len(ran) > 20
    assert all(twins.virtual.pages.slots)


def loop(make) -> list[tuple[float, float]]:
    """A setpoint step under a rate limit, manual, and back, with other gains on the way."""
    settings = VirtualDeviceSettings(FIRST, box=BOX, co_rate_per_s=2.0, b=0.7, tau_f_s=3.0)
    device = make(settings, LinearPlant(LinearProcess(1.2, (30.0,), (), 4.0), start_pv=50.0, start_co=40.0))

    def say(*frames: Frame) -> None:
        for frame in frames:
            device.receive(CODEC.encode(frame))

    say(Lease(5, lease_stamp(1, 0), 6000, 1), Setpoint(1, 62.0, 5))
    seen = []
    gains = PidGains(2.0, 0.125, 1.0)
    for t in range(400):
        if t == 60:
            crc = commit_crc(set_crc(1, 1, 1, gains), 0, 5)
            values = zip(Item, (gains.kp, gains.ki, gains.kd), strict=True)
            say(*(Stage(item, 5, value, 1) for item, value in values), Commit(1, 0, crc))
        if t in {150, 200}:
            say(Mode(t % 256, t == 200, 70.0, 5))
        if t == 250:
            say(Setpoint(2, 300.0, 5))
        device.step()
        seen.append((device.pv, device.co))
    assert device.running == (1, gains)
    return seen


def test_the_loop_is_regulated_alike_in_float32() -> None:
    ours, theirs = loop(VirtualDevice), loop(FirmwareDevice)
    for (pv, co), (pv_c, co_c) in zip(ours, theirs, strict=True):
        assert pv_c == pytest.approx(pv, abs=1e-3)
        assert co_c == pytest.approx(co, abs=2e-3)
    assert max(co for _, co in theirs) == 100.0


@pytest.mark.parametrize("pv", [float("nan"), float("inf")])
def test_a_reading_that_is_no_number_is_passed_over(pv: float) -> None:
    device = FirmwareDevice(VirtualDeviceSettings(FIRST), LagPlant())
    device.step()
    before = device.co
    device.plant = type("Broken", (), {"step": lambda *_: pv})()
    messages = device.step()
    assert device.co == before
    (half,) = [m for m in messages if m.arbitration_id == 50]
    assert struct.unpack("<f", half.data[1:5])[0] == pytest.approx(50.0, abs=0.1)


# ---- The firmware in C as a process, over a pipe in lock-step and under the sanitizers: host and device share
# nothing

SECOND = PidGains(1.5, 0.125, 0.75)


@pytest.fixture(scope="session")
def program(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("firmware")
    subprocess.run(["make", "-s", "-C", str(FIRMWARE), f"BUILD={folder}", "check"], check=True, timeout=120)
    return folder / "retuner-firmware-checked"


class Piped:
    """The process as a link of the host: what is sent is answered at once, time goes on with tick()."""

    settings, state = LinkSettings(), LinkState.UP

    def __init__(self, program: Path, *options: str) -> None:
        self._command = [str(program), "-p", *options]
        self.waiting: list[can.Message] = []
        self._now_s = 0.0
        self.start(1)

    def start(self, epoch: int) -> None:
        command = [*self._command, "-e", str(epoch)]
        self.process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)

    def stop(self) -> None:
        self.process.stdin.close()
        assert self.process.wait(timeout=60) == 0
        self.process.stdout.close()

    def say(self, line: str) -> None:
        stdin, stdout = self.process.stdin, self.process.stdout
        assert stdout is not None
        stdin.write(line + "\n")
        stdin.flush()
        while (answer := stdout.readline().strip()) != "":
            id_, _, data = answer.partition("#")
            message = can.Message(arbitration_id=int(id_, 16), is_extended_id=False, data=bytes.fromhex(data))
            self.waiting.append(message)

    def send(self, message: can.Message) -> bool:
        self.say(f"{message.arbitration_id:03X}#{bytes(message.data).hex()}")
        return True

    def receive_all(self) -> list[can.Message]:
        messages, self.waiting = self.waiting, []
        return messages

    def run(self, host: CanDevice, samples: int) -> list[Event]:
        events: list[Event] = []
        for _ in range(samples):
            self._now_s += 2.0
            self.say("sample")
            events += host.poll(self._now_s)
        return events

    @property
    def now_s(self) -> float:
        return self._now_s


@pytest.fixture
def piped(program: Path, tmp_path: Path) -> Iterator[Piped]:
    made = Piped(program, "-s", str(tmp_path / "store"))
    yield made
    made.stop()


def written(link: Piped, host: CanDevice, gains: PidGains) -> WriteDone | WriteFailed:
    host.begin_write(gains, link.now_s)
    (outcome,) = [event for event in link.run(host, 20) if isinstance(event, WriteDone | WriteFailed)]
    return outcome


def test_a_set_is_written_stored_and_outlasts_the_process(piped: Piped) -> None:
    host = CanDevice(piped, CanDeviceSettings())
    piped.run(host, 8)
    assert host.connected
    assert isinstance(written(piped, host, SECOND), WriteDone)
    host.store(piped.now_s)
    assert [e.command for e in piped.run(host, 5) if isinstance(e, CommandDone)] == ["store"]
    piped.stop()
    piped.start(2)
    events = piped.run(host, 12)
    (restarted,) = [event for event in events if isinstance(event, DeviceRestarted)]
    assert restarted.running.gains == SECOND
    assert isinstance(written(piped, host, PidGains(900.0, 0.125, 0.75)), WriteFailed)
    assert host.running.gains == SECOND


def test_with_a_key_only_its_holder_writes(program: Path, tmp_path: Path) -> None:
    (tmp_path / "key").write_text(KEY.hex())
    link = Piped(program, "-k", str(tmp_path / "key"))
    for key, kind in ((KEY, WriteDone), (KEY[::-1], WriteFailed)):
        host = CanDevice(link, CanDeviceSettings(key=key))
        link.run(host, 8)
        assert type(written(link, host, SECOND if key == KEY else PidGains(1.0, 0.1, 0.5))) is kind
        host.release(link.now_s)
        link.run(host, 3)
    link.stop()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("options", "message"),
    [
        ([], "give -i INTERFACE or -p"),
        (["-p", "-n", "64"], "-n 1 to 63"),
        (["-p", "-k", "/nowhere"], "/nowhere: cannot be read"),
        (["-i", "nocan0"], "nocan0: no"),
    ],
)
def test_what_cannot_be_is_one_line_and_status_2(program: Path, options: list[str], message: str) -> None:
    ended = subprocess.run([str(program), *options], capture_output=True, text=True, timeout=60, check=False)
    assert ended.returncode == 2
    assert message in ended.stderr
    assert ended.stderr.count("\n") == 1
