"""The layer of answers: pages belong to their question, acknowledges tell the epoch, samples come whole."""

import math
import struct

from bus_simulation.layers.seen import Seen, Told
from bus_simulation.layers.sets import Sets
from bus_simulation.layers.wire import (
    ACK,
    CHALLENGE,
    HEARTBEAT,
    IDENTITY,
    ITEM,
    PAGE,
    STATUS,
    TELEMETRY_PV,
    TELEMETRY_SP,
    UNCHECKED,
    Ack,
    broken,
    crc8,
    float32,
    sample_crc,
    set_crc,
    u16,
)
from retuner.drivers.controller.firmware_settings import VirtualDeviceSettings

RUNNING, STAGED, STORED, WHO, CHALLENGED = range(5)
AUTO, STAGED_FLAG, TRIAL, OWNED = 1, 2, 8, 16
VERSION = 3
COUNTED_WITH_LATEST = {3, 4, 5, 6, 7}  # kinds of ACK whose latest is the newest number seen
SENT = {HEARTBEAT: 8, STATUS: 8, TELEMETRY_PV: 8, TELEMETRY_SP: 8, IDENTITY: 8, ITEM: 8, PAGE: 8, ACK: 8, CHALLENGE: 8}


class Answers:
    """What a device says, frame by frame.

    settings : of the device. sets : what its pages should hold.
    """

    def __init__(self, settings: VirtualDeviceSettings, sets: Sets) -> None:
        self._settings, self._sets = settings, sets

    def form(self, id_: int, data: bytes, now: Seen) -> None:
        """Any frame: identifier, length, checksum; an ACK tells the epoch and the newest number."""
        command = id_ & 31
        if id_ >> 5 != self._settings.node or SENT.get(command) != len(data):
            raise broken("frames_are_whole", f"{id_:03X}#{data.hex()} is no frame of this device")
        if command not in UNCHECKED and data[-1] != crc8(id_, data[:-1]):
            raise broken("frames_are_whole", f"{id_:03X}#{data.hex()} has a wrong checksum")
        if command != ACK:
            return
        ack = Ack(data)
        if ack.epoch != now.epoch % 8192:
            raise broken("answers_tell_their_epoch", f"{vars(ack)} in epoch {now.epoch}")

    def latest(self, told: Told) -> None:
        """Answers about sets tell the newest number seen; one that is repeated, that of its time."""
        if told.command not in COUNTED_WITH_LATEST or told.data == self._sets.refused:
            return
        for ack in map(Ack, told.replies):
            if ack.latest != told.after.latest:
                raise broken("numbers_are_burnt", f"{vars(ack)} says the newest number, it is {told.after.latest}")

    def read(self, told: Told, commands: list[int]) -> None:
        """READ: the answers belong to its token."""
        page, token = told.data[0], u16(told.data[1:])
        if page == WHO:
            # Who it is, and a life sign
            if commands != [IDENTITY, HEARTBEAT, STATUS]:
                raise broken("answers_fit_their_question", f"READ of the identity gets {commands}")
            said = told.replies[0]
            right = struct.pack("<f", self._settings.sample_time_s)
            if said[0] != VERSION or said[3:7] != right:
                raise broken("answers_fit_their_question", f"IDENTITY is {said.hex()}")
            self.life(told.replies[1], told.replies[2], told.after)
        elif page == CHALLENGED:
            if commands != [CHALLENGE]:
                raise broken("answers_fit_their_question", f"READ of the challenge gets {commands}")
        else:
            now = told.after
            content = now.running if page == RUNNING else self._sets.stored
            seq, values = content.seq, dict(enumerate((content.gains.kp, content.gains.ki, content.gains.kd)))
            if page == STAGED:
                number, values = self._sets.staged()
                seq = now.latest if number is None else number
                values = dict(sorted(values.items()))
            right = [
                bytes([page | item << 2 | (token & 15) << 4]) + struct.pack("<fH", value, seq)
                for item, value in values.items()
            ]
            is_whole = len(values) == 3
            crc = 0
            if is_whole and _is_pid(tuple(values.values())):
                crc = set_crc(self._settings.node, now.epoch, seq, tuple(values.values()), struct.pack("<H", token))
            right.append(bytes([page | is_whole << 2 | (token & 15) << 4]) + struct.pack("<HI", seq, crc))
            if commands != [ITEM] * len(values) + [PAGE] or [data[:7] for data in told.replies] != right:
                got, should = ([data.hex() for data in said] for said in (told.replies, right))
                raise broken(
                    "answers_fit_their_question", f"READ of page {page}, token {token}: {got}, right is {should}"
                )

    def life(self, beat: bytes, status: bytes, now: Seen) -> None:
        """HEARTBEAT and STATUS say what is."""
        flags = AUTO * now.auto | STAGED_FLAG * now.has_staged | TRIAL * (now.running != now.confirmed)
        flags |= OWNED * (now.owner != 0)
        known = AUTO | STAGED_FLAG | TRIAL | OWNED
        if (int.from_bytes(beat[:4], "little"), u16(beat[4:]), beat[6] & known) != (now.sample, now.epoch, flags):
            raise broken("life_signs_are_true", f"HEARTBEAT {beat.hex()}, {now}")
        said = u16(status), u16(status[2:]), status[4], u16(status[5:])
        if said != (now.running.seq, now.latest, now.refused % 256, now.owner):
            raise broken("life_signs_are_true", f"STATUS {status.hex()}, {now}")

    def sample(self, pv: bytes, sp: bytes, now: Seen) -> None:
        """The two halves of a sample belong together and tell what runs."""
        node = self._settings.node
        if u16(sp[6:]) != sample_crc(node, pv, sp):
            raise broken("samples_are_whole", f"{pv.hex()} {sp.hex()}: crc {sample_crc(node, pv, sp):04x} is right")
        if (pv[0], sp[0]) != (now.sample & 255,) * 2:
            raise broken("samples_are_whole", f"{pv.hex()} {sp.hex()} in sample {now.sample}")
        if sp[5] >> 3 != now.running.seq & 31 or bool(sp[5] & 1) != now.auto:
            raise broken("samples_are_whole", f"{sp.hex()} while {now.running} runs, auto is {now.auto}")
        if float32(sp[1:5]) != struct.unpack("<f", struct.pack("<f", now.sp))[0]:
            raise broken("samples_are_whole", f"{sp.hex()} with the setpoint {now.sp}")


def _is_pid(gains: tuple[float, ...]) -> bool:
    """Whether a PID can run them."""
    return all(map(math.isfinite, gains)) and any(gains) and not min(gains) < 0 < max(gains)
