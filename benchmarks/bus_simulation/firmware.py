"""The firmware in C (drivers/firmware) in the place of the virtual device: the same interface over a shared library."""

import ctypes
import math
import shutil
import subprocess
import tempfile
from collections.abc import Callable
from functools import lru_cache
from pathlib import Path

import can

from retuner import PidGains, drivers
from retuner.drivers.controller.firmware_settings import VirtualDeviceSettings
from retuner.drivers.controller.gain_memory import GainSet, Slot
from retuner.drivers.plants.plant import Plant
from retuner.drivers.protocol.authentication import fresh_nonce
from retuner.drivers.protocol.frames import Item
from retuner.drivers.telemetry.signal_source import plant_message

FIRMWARE = Path(str(drivers.__file__)).parent / "firmware"
HERE = Path(__file__).parent
FLAGS = ("-std=c99", "-O2", "-Wall", "-Wextra", "-Werror", "-Wpedantic", "-shared", "-fPIC")
SOURCES = ("retuner_device.c", "retuner_code.c", "test_library.c")
Nonce = ctypes.CFUNCTYPE(ctypes.c_uint64)
Keep = ctypes.CFUNCTYPE(ctypes.c_int)
ENDS = {True: 1, False: 0, None: -1}  # how the writing of a set ends, as test_library.c has it
Gains = ctypes.Array[ctypes.c_float]
SLOT_BYTES = 24  # of rt_slot


class State(ctypes.Structure):
    """bench_state of test_library.c."""

    _fields_ = (
        *((name, ctypes.c_uint32) for name in ("sample", "refused")),
        *((name, ctypes.c_uint16) for name in ("running", "confirmed", "latest", "epoch", "owner")),
        *((name, ctypes.c_uint8) for name in ("has_staged", "is_auto")),
        *((name, ctypes.c_float * len(Item)) for name in ("running_gains", "confirmed_gains")),
        *((name, ctypes.c_float) for name in ("sp", "co", "load")),
    )


def compiler() -> str | None:
    """The C compiler of this machine, if there is one."""
    return shutil.which("cc") or shutil.which("gcc")


@lru_cache
def library(changes: tuple[tuple[str, str], ...] = ()) -> ctypes.CDLL:
    """The compiled library. changes : texts of retuner_device.c and what stands there instead, for mutants.

    Raises ValueError: a text does not stand there exactly once.
    """
    folder = Path(tempfile.mkdtemp(prefix="firmware-"))
    for name in ("retuner_device.h", *SOURCES):
        text = ((HERE if name == SOURCES[-1] else FIRMWARE) / name).read_text(encoding="ascii")
        if name == SOURCES[0]:
            for old, new in changes:
                if text.count(old) != 1:
                    raise ValueError(f"{old!r} stands {text.count(old)} times in {name}")
                text = text.replace(old, new)
        (folder / name).write_text(text, encoding="ascii")
    flags = FLAGS if not changes else [FLAGS[0], "-O0", *FLAGS[-2:], "-w"]
    target = folder / "firmware.so"
    command = [str(compiler()), *flags, "-o", str(target), *(str(folder / name) for name in SOURCES), "-lm"]
    subprocess.run(command, check=True, capture_output=True)
    loaded = ctypes.CDLL(str(target))
    shutil.rmtree(folder)
    loaded.bench_new.restype = ctypes.c_void_p
    loaded.bench_sent.restype = ctypes.c_uint32
    loaded.bench_refused.restype = ctypes.c_char_p
    return loaded


class _Slots(list[Slot | None]):
    """The two places; one can be spoilt by putting a slot with another crc there."""

    def __init__(self, device: "FirmwareDevice") -> None:
        super().__init__(device.slot(place) for place in (0, 1))
        self._device = device

    def __setitem__(self, place: int, slot: Slot) -> None:
        super().__setitem__(place, slot)
        self._device.spoil(place, slot.crc)


class _Pages:
    """What GainPages shows; equal sets are one object."""

    def __init__(self, device: "FirmwareDevice") -> None:
        self._device = device
        self._sets: dict[tuple[int, bytes], GainSet] = {}

    def _set(self, seq: int, values: Gains) -> GainSet:
        told = (seq, bytes(values))
        if told not in self._sets:
            self._sets[told] = GainSet(seq, PidGains(*values))
        return self._sets[told]

    @property
    def running(self) -> GainSet:
        state = self._device.state
        return self._set(state.running, state.running_gains)

    @property
    def confirmed(self) -> GainSet:
        state = self._device.state
        return self._set(state.confirmed, state.confirmed_gains)

    @property
    def latest(self) -> int:
        return self._device.state.latest

    @property
    def has_staged(self) -> bool:
        return bool(self._device.state.has_staged)

    @property
    def slots(self) -> _Slots:
        return _Slots(self._device)


class _Lease:
    """What LeaseDesk shows."""

    def __init__(self, device: "FirmwareDevice") -> None:
        self._device = device

    @property
    def owner(self) -> int:
        return self._device.state.owner


class FirmwareDevice:
    """VirtualDevice, with the firmware in C at work; arguments as there. changes : see library."""

    def __init__(
        self,
        settings: VirtualDeviceSettings,
        plant: Plant,
        epoch: int = 1,
        nonce: Callable[[], int] = fresh_nonce,
        keep: Callable[[], bool | None] = lambda: True,
        changes: tuple[tuple[str, str], ...] = (),
    ) -> None:
        self.settings, self.plant, self.epoch = settings, plant, epoch
        self._library, self._nonce = library(changes), Nonce(nonce)
        self._keep = Keep(lambda: ENDS[keep()])
        self.state = State()
        self._slots: dict[bytes, Slot] = {}
        self.pages, self.lease = _Pages(self), _Lease(self)
        self.pv = plant.pv
        s, key = settings, settings.key or b""
        numbers = [s.node, s.sample_time_s, s.gains.kp, s.gains.ki, s.gains.kd]
        numbers += [s.box.kp_max, s.box.ki_max, s.box.kd_max, s.box.ratio_max, s.box.direction, s.sp_min, s.sp_max]
        numbers += [s.co_min, s.co_max, s.co_rate_per_s or 0.0, s.co_fault, s.b, s.tau_f_s]
        numbers += [s.heartbeat_samples, s.lease_longest, s.trial_samples]
        made = (ctypes.c_double * len(numbers))(*numbers)
        begins = (ctypes.c_uint(epoch), ctypes.c_double(self.pv), ctypes.c_double(self._steady()))
        self._bench = ctypes.c_void_p(self._library.bench_new(made, key, len(key), self._nonce, self._keep, *begins))
        refused: bytes | None = self._library.bench_refused(self._bench)
        if refused is not None:
            raise ValueError(f"firmware: {refused.decode()} is outside its range")
        self._look()

    def __del__(self) -> None:
        if hasattr(self, "_bench"):
            self._library.bench_free(self._bench)

    @property
    def running(self) -> GainSet:
        """The set that runs."""
        return self.pages.running

    @property
    def sample(self) -> int:
        """The sample counter."""
        return self.state.sample

    @property
    def refused(self) -> int:
        """Frames refused since the boot."""
        return self.state.refused

    @property
    def co(self) -> float:
        """The output in force."""
        return self.state.co

    @property
    def sp(self) -> float:
        """The setpoint in force."""
        return self.state.sp

    @property
    def load(self) -> float:
        """The load in force."""
        return self.state.load

    @property
    def auto(self) -> bool:
        """Whether it regulates."""
        return bool(self.state.is_auto)

    def restart(self, sp: float = math.nan) -> None:
        """Power off and on; sp : the setpoint that the application has kept, if any."""
        self.epoch = (self.epoch + 1) % 65536
        self.pv = self.plant.pv
        begins = (ctypes.c_uint(self.epoch), ctypes.c_double(self.pv), ctypes.c_double(self._steady()))
        self._library.bench_restart(self._bench, *begins, ctypes.c_double(sp))
        self._look()

    def step(self, dt_s: float | None = None) -> list[can.Message]:
        """One controller sample."""
        dt = self.settings.sample_time_s if dt_s is None else dt_s
        self.pv = self.plant.step(self.co, self.load, dt)
        count = self._library.bench_sample(self._bench, ctypes.c_double(self.pv), ctypes.c_double(dt))
        aux = getattr(self.plant, "aux", None)
        more = [] if aux is None else [plant_message(self.settings.node, aux)]
        return [*more, *self._sent(count)]

    def receive(self, message: can.Message) -> list[can.Message]:
        """A frame; its answers."""
        odd = message.is_extended_id or message.is_remote_frame or message.is_error_frame or message.is_fd
        data = bytes(message.data)
        count = self._library.bench_receive(self._bench, message.arbitration_id, odd, len(data), data)
        return self._sent(count)

    def stored(self, *, done: bool) -> list[can.Message]:
        """A set that was to be kept is there, or could not be written; the answer to STORE."""
        return self._sent(self._library.bench_stored(self._bench, int(done)))

    def tell_fault(self, *, fault: bool) -> None:
        """The fault input changes."""
        self._library.bench_fault(self._bench, int(fault))

    @property
    def alive(self) -> int:
        """How often the watchdog was told that a sample was made."""
        return int(self._library.bench_alive(self._bench))

    def kept(self, place: int) -> bytes:
        """A place as it is written to flash."""
        data = (ctypes.c_uint8 * SLOT_BYTES)()
        self._library.bench_kept(self._bench, place, data)
        return bytes(data)

    def slot(self, place: int) -> Slot | None:
        """A place of the store; None when it was never used."""
        numbers, gains = (ctypes.c_uint32 * 3)(), (ctypes.c_float * len(Item))()
        if not self._library.bench_slot(self._bench, place, numbers, gains):
            return None
        told = bytes(numbers) + bytes(gains)
        if told not in self._slots:
            generation, crc, seq = numbers
            self._slots[told] = Slot(generation, GainSet(seq, PidGains(*gains)), crc)
        return self._slots[told]

    def spoil(self, place: int, crc: int) -> None:
        """Power failed while it was written."""
        self._library.bench_spoil(self._bench, place, ctypes.c_uint32(crc))

    def _sent(self, count: int) -> list[can.Message]:
        self._look()
        messages = []
        data = (ctypes.c_uint8 * 8)()
        for number in range(count):
            head = self._library.bench_sent(self._bench, number, data)
            payload = bytes(data)[: head >> 16]
            messages.append(can.Message(arbitration_id=head & 0x7FF, is_extended_id=False, data=payload))
        return messages

    def _look(self) -> None:
        self._library.bench_look(self._bench, ctypes.byref(self.state))

    def _steady(self) -> float:
        try:
            return self.plant.steady_co(self.pv, self.load if hasattr(self, "_bench") else 0.0)
        except ValueError:
            return self.settings.co_min
