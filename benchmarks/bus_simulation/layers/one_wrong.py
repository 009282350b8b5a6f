"""An intruder who knows everything, the key as well, and sends frames with exactly one thing wrong.

So each condition of the protocol stands alone against it once: whatever another layer would have kept out is right.
Nothing that it sends may ever have an effect, but for what an owner may do.
"""

import struct
from collections.abc import Callable
from random import Random

import can

from bus_simulation.bus import STRANGER as NAME
from bus_simulation.bus import Bus
from bus_simulation.layers.wire import (
    ABORT,
    AUTH,
    COMMIT,
    CONFIRM,
    LEASE,
    LOAD,
    MODE,
    SETPOINT,
    STAGE,
    STORE,
    Codes,
    crc8,
    set_crc,
    stamp,
)
from retuner.drivers.controller.virtual_device import VirtualDevice

Gains = tuple[float, float, float]
FLAWS = (
    "checksum", "crc", "node", "epoch", "owner", "base", "seq", "other base", "missing", "zero", "mixed", "sign", "up",
    "down",
)  # fmt: skip
OF_CODES = ("low half", "high half", "nonce", "no code", "codes of before")


class OneWrong:
    """See the head of this file.

    codes : challenges in force.
    """

    def __init__(self, bus: Bus, device: VirtualDevice, rng: Random, codes: Codes) -> None:
        self.bus, self._device, self._rng, self._codes = bus, device, rng, codes
        self._node = device.settings.node
        self._acts: tuple[Callable[[], None], ...] = (
            self._set, self._set, self._set, self._command, self._command, self._store, self._confirm, self._lease,
            self._fenced, self._over, self._repeat,
        )  # fmt: skip

    def act(self) -> None:
        """Send something with one thing wrong."""
        self._rng.choice(self._acts)()

    def _say(self, command: int, payload: bytes, *, checked: bool = True, flaw: int = 0) -> None:
        """A frame; flaw : exclusive-or of its checksum."""
        id_ = self._node << 5 | command
        data = payload + (bytes([crc8(id_, payload) ^ flaw]) if checked else b"")
        self.bus.deliver(NAME, can.Message(arbitration_id=id_, is_extended_id=False, data=data))

    def _gains(self, flaw: str) -> Gains:
        """Gains that may follow the running ones, but for the flaw."""
        old, box = self._device.running.gains, self._device.settings.box
        kp, ki, kd = (k * self._rng.choice((0.5, 0.9, 1.1)) for k in (old.kp, old.ki, old.kd))
        match flaw:
            case "zero":
                return 0.0, 0.0, 0.0
            case "mixed":
                return kp, -(ki or 0.1), kd
            case "sign":
                return -kp, -ki, -kd
            case "box":
                return kp, ki, 1.5 * box.kd_max
            case "up" | "down":
                factor = 1.1 * box.ratio_max if flaw == "up" else 1.0 / (1.1 * box.ratio_max)
                return (factor * old.kp, ki, kd) if old.kp else (kp, factor * old.ki, kd)
            case _:
                return kp, ki, kd

    def _set(self) -> None:
        """A set of the owner's with one thing wrong."""
        kinds = FLAWS + (OF_CODES if self._codes.key is not None else ())
        self._send_set(self._rng.choice((*kinds, "box") if self._device.running.gains.kd == 0.0 else kinds))

    def _send_set(self, flaw: str) -> None:
        """Staged, with its code, and committed, all right but for the flaw."""
        device, node, rng = self._device, self._node, self._rng
        owner, epoch, base = device.lease.owner or 5, device.epoch, device.running.seq
        seq = (device.pages.latest + (-1 if flaw == "seq" else 1)) % 65536
        gains = self._gains(flaw)
        missing = rng.randrange(3) if flaw == "missing" else None
        for item, value in enumerate(gains):
            if item != missing:
                payload = struct.pack("<BfH", item | owner % 64 << 2, value, seq)
                self._say(STAGE, payload, flaw=rng.randrange(1, 256) if flaw == "checksum" else 0)
        named = (base + 9) % 65536 if flaw == "base" else base
        single = struct.unpack("<3f", struct.pack("<3f", *gains))
        if self._codes.key is not None and flaw != "no code":
            nonce = self._codes.nonce
            if flaw in {"nonce", "codes of before"}:
                nonce = self._codes.before if flaw == "codes of before" else nonce ^ 1
            code = self._codes.code(nonce, node, epoch, owner, seq, named, single)
            for part, half in enumerate((code[:6], code[6:])):
                wrong = flaw == ("low half", "high half")[part]
                self._say(AUTH, bytes([part | (seq & 15) << 4, half[0] ^ wrong]) + half[1:])
        wide = (node % 63 + 1 if flaw == "node" else node, (epoch - 1) % 65536 if flaw == "epoch" else epoch)
        said = struct.pack(
            "<HH", (named + 1) % 65536 if flaw == "other base" else named, owner ^ (flaw == "owner") << 8
        )
        crc = set_crc(*wide, seq, single, said) ^ (flaw == "crc")
        self._say(COMMIT, struct.pack("<HHI", seq, named, crc), checked=False)

    def _command(self) -> None:
        """A command of the owner's whose counter is old, or of nobody's with a good one."""
        rng, device = self._rng, self._device
        owner = device.lease.owner or 5
        kind = rng.choice((SETPOINT, MODE, LOAD))
        body = struct.pack("<f", rng.uniform(40.0, 60.0))
        if kind == MODE:
            body = bytes([rng.randrange(2)]) + rng.randrange(400_000, 600_000).to_bytes(3, "little")
        counter = rng.randrange(256)
        for back in (0, rng.randrange(1, 100)):
            self._say(
                kind,
                bytes([(counter - back) % 256]) + body[:-1] + bytes([body[-1] ^ (back > 0)]) + struct.pack("<H", owner),
            )
        self._say(kind, bytes([(counter + 1) % 256]) + body + struct.pack("<H", owner ^ 256 or 1))

    def _store(self) -> None:
        """What runs is to be kept, with a wrong key, another number or another owner."""
        device, flaw = self._device, self._rng.randrange(3)
        seq, owner = device.running.seq, device.lease.owner or 5
        seq = (seq - 1) % 65536 if flaw == 0 else seq
        self._say(STORE, struct.pack("<H4sB", seq, b"sav3" if flaw == 1 else b"save", (owner ^ (flaw == 2)) % 256))

    def _confirm(self) -> None:
        """Another number or another owner."""
        device, flaw = self._device, self._rng.randrange(2)
        seq, owner = device.running.seq, device.lease.owner or 5
        self._say(CONFIRM, struct.pack("<HH", (seq - (flaw == 0)) % 65536, owner ^ (flaw == 1) << 8 or 1))

    def _lease(self) -> None:
        """The lease again, of another time, or by another."""
        rng, device = self._rng, self._device
        owner, sample = device.lease.owner or 5, device.sample
        flaw = rng.randrange(3)
        when = (
            stamp((device.epoch - 1) % 65536, sample)
            if flaw == 0
            else stamp(device.epoch, sample + 64 * (3 if flaw == 1 else 0))
        )
        self._say(LEASE, struct.pack("<HHHB", owner ^ (256 if flaw == 2 else 0) or 1, when, 100, rng.randrange(256)))

    def _fenced(self) -> None:
        """An ABORT behind a commit: what it fences off does not come to life again."""
        device = self._device
        seq = (device.pages.latest + 1) % 65536
        self._send_set(self._rng.choice(("crc", "base", "missing")))
        self._say(ABORT, struct.pack("<H", seq))
        owner = device.lease.owner or 5
        self._say(STAGE, struct.pack("<BfH", owner % 64 << 2, 1.0, seq))

    def _over(self) -> None:
        """One gain more under the number of a page that somebody else has staged, from somebody who may not."""
        device = self._device
        owner = device.lease.owner ^ 1
        self._say(STAGE, struct.pack("<BfH", owner % 64 << 2, 1.0, device.pages.latest))

    def _repeat(self) -> None:
        """The newest request for the lease once more, as it was."""
        asked = [message for message in self.bus.history if message.arbitration_id == self._node << 5 | LEASE]
        for message in asked[-1:]:
            self.bus.deliver(NAME, message)
