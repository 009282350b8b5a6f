"""The firmware in C regulates as the virtual device does; a host works with it as a process under the sanitizers."""

import struct
import subprocess
from collections.abc import Iterator
from pathlib import Path

import can
import pytest
from bus_simulation.device_end import LagPlant
from bus_simulation.firmware import FIRMWARE, FirmwareDevice

from retuner import LinearProcess, PidGains
from retuner.drivers.bus.link_settings import LinkSettings
from retuner.drivers.controller.virtual_device import VirtualDevice, VirtualDeviceSettings
from retuner.drivers.device import CommandDone, DeviceRestarted, Event, LinkState, WriteDone, WriteFailed
from retuner.drivers.host.can_device import CanDevice
from retuner.drivers.host.can_settings import CanDeviceSettings
from retuner.drivers.plants.linear_plant import LinearPlant
from retuner.drivers.protocol.checksum import commit_crc, lease_stamp, set_crc
from retuner.drivers.protocol.codec import Codec
from retuner.drivers.protocol.frames import Commit, Frame, GainBox, Item, Lease, Mode, Setpoint, Stage

CODEC = Codec(1)
FIRST = PidGains(1.0, 0.0625, 0.25)
BOX = GainBox(kp_max=100.0, ki_max=10.0, kd_max=50.0, ratio_max=10.0, direction=1)
KEY = bytes(range(16))


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
