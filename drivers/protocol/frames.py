"""What travels on the bus, as values: one frozen dataclass a frame, with the fields of drivers/retuner.dbc.

codec.py turns them into bytes and back and holds every value to the DBC's ranges; docs/developers has the protocol.
"""

import math
from enum import IntEnum, IntFlag

from retuner.schedule.gains import PidGains
from retuner.schedule.late_dataclass import dataclass, fields

PROTOCOL_VERSION = 3
STORE_KEY = 0x65766173  # "save" in ASCII, low byte first: the signature of CANopen 1010h
HIGHEST_NODE = 63  # 11-bit ids: 6 bits of node, 5 bits of command
OWNER_TAG, STORE_TAG = 64, 256  # STAGE carries the owner modulo the former, STORE modulo the latter
REFUSED_WRAP = 256  # STATUS counts refused frames modulo this
RUNNING_TAG, EPOCH_TAG = 32, 8192  # telemetry carries the running sequence, ACK the boot epoch modulo these
TOKENS, PAGE_TAG, CHALLENGE_TAG = 65536, 16, 128  # of questions; ITEM and PAGE, CHALLENGE repeat them modulo these


class Page(IntEnum):
    """Where a gain set stands in the device; IDENTITY and CHALLENGE are asked for in the same way."""

    RUNNING = 0
    STAGED = 1
    STORED = 2
    IDENTITY = 3
    CHALLENGE = 4


class Item(IntEnum):
    """One gain of a set."""

    KP = 0
    KI = 1
    KD = 2


class Kind(IntEnum):
    """What an acknowledge is about: the command's number."""

    LEASE = 1
    ABORT = 3
    STAGE = 4
    COMMIT = 5
    STORE = 6
    CONFIRM = 7
    SETPOINT = 8
    MODE = 9
    LOAD = 10


class Reason(IntEnum):
    """The device's answer to a command."""

    OK = 0
    STALE = 1
    WRONG_BASE = 2
    WRONG_CRC = 3
    INCOMPLETE = 4
    NOT_FINITE = 5
    OUTSIDE_BOX = 6
    RATIO = 7
    BUSY = 8
    ALREADY_RUNNING = 9
    OUT_OF_RANGE = 10
    WRONG_KEY = 11
    NOT_STAGED = 12
    NOT_OWNER = 13
    NOT_CONFIRMED = 14
    REVERTED = 15
    NO_CODE = 16
    WRONG_CODE = 17
    NOT_STORED = 18


class Flags(IntFlag):
    """State bits of the heartbeat."""

    AUTO = 1
    STAGED = 2
    STORED = 4
    TRIAL = 8
    OWNED = 16
    WRONG_CODE = 32
    BLIND = 64
    FAULT = 128


@dataclass(frozen=True, slots=True)
class Lease:
    """Host asks to be the one that commands for so many samples (0: no longer); stamp as checksum.lease_stamp."""

    owner: int
    stamp: int
    samples: int
    counter: int


@dataclass(frozen=True, slots=True)
class Read:
    """Host asks for a page; its answers belong to the token."""

    page: int
    token: int


@dataclass(frozen=True, slots=True)
class Abort:
    """Host discards the staged page and fences seq off for ever."""

    seq: int


@dataclass(frozen=True, slots=True)
class Stage:
    """Host puts one gain of set seq into the staged page; owner is the low OWNER_TAG bits of the lease's."""

    item: int
    owner: int
    value: float
    seq: int


@dataclass(frozen=True, slots=True)
class Commit:
    """Host lets set seq run, built on set base; crc as checksum.commit_crc."""

    seq: int
    base: int
    crc: int


@dataclass(frozen=True, slots=True)
class Store:
    """Host keeps running set seq over a restart."""

    seq: int
    owner: int
    key: int = STORE_KEY


@dataclass(frozen=True, slots=True)
class Confirm:
    """Host says that running set seq has proved itself."""

    seq: int
    owner: int


@dataclass(frozen=True, slots=True)
class Auth:
    """Half of the code (authentication.py) of the commit that follows; seq is the low 4 bits of the commit's."""

    part: int
    seq: int
    mac: int


@dataclass(frozen=True, slots=True)
class Setpoint:
    """Host gives the target, pv unit."""

    counter: int
    sp: float
    owner: int


@dataclass(frozen=True, slots=True)
class Mode:
    """Host takes over with co percent (mode 0) or lets the controller work (mode 1)."""

    counter: int
    mode: int
    co: float
    owner: int


@dataclass(frozen=True, slots=True)
class Load:
    """Host disturbs a simulated plant, percent of co."""

    counter: int
    load: float
    owner: int


@dataclass(frozen=True, slots=True)
class Heartbeat:
    """Life sign: full sample counter, boot epoch, Flags."""

    sample: int
    epoch: int
    flags: int


@dataclass(frozen=True, slots=True)
class Status:
    """Sequence numbers (running set, newest seen), the count of refused frames, the lease's owner (0: nobody)."""

    running: int
    latest: int
    refused: int
    owner: int


@dataclass(frozen=True, slots=True)
class TelemetryPv:
    """First half of a sample: process value, controller output in percent."""

    counter: int
    pv: float
    co: float


@dataclass(frozen=True, slots=True)
class TelemetrySp:
    """Second half of a sample: setpoint, LoopMode, limit of co, RUNNING_TAG of the running set, checksum.sample_crc."""

    counter: int
    sp: float
    mode: int
    limited: int
    running: int
    crc: int


@dataclass(frozen=True, slots=True)
class Identity:
    """Who answers: protocol version, layout hash of the frames, sample time in s."""

    protocol: int
    schema: int
    sample_time: float


@dataclass(frozen=True, slots=True)
class PageItem:
    """One gain as it stands in a page."""

    page: int
    item: int
    token: int
    value: float
    seq: int


@dataclass(frozen=True, slots=True)
class PageEnd:
    """End of a page: whether all gains are there, its sequence, the device's CRC-32 (checksum.page_crc)."""

    page: int
    complete: int
    token: int
    seq: int
    crc: int


@dataclass(frozen=True, slots=True)
class Ack:
    """The device's answer: Kind, sequence or counter, Reason, newest number seen, Item concerned, epoch (EPOCH_TAG)."""

    kind: int
    seq: int
    reason: int
    latest: int
    item: int = 0
    epoch: int = 0


@dataclass(frozen=True, slots=True)
class Challenge:
    """What the code of the next commit must be worked out over, and whether this device demands a code (0 or 1)."""

    token: int
    demanded: int
    nonce: int


HostFrame = Lease | Read | Abort | Stage | Commit | Store | Confirm | Auth | Setpoint | Mode | Load
DeviceFrame = Heartbeat | Status | TelemetryPv | TelemetrySp | Identity | PageItem | PageEnd | Ack | Challenge
Frame = HostFrame | DeviceFrame

NAMES: dict[str, type[Frame]] = {
    "LEASE": Lease, "READ": Read, "ABORT": Abort, "STAGE": Stage, "COMMIT": Commit, "STORE": Store,
    "CONFIRM": Confirm, "AUTH": Auth, "SETPOINT": Setpoint, "MODE": Mode, "LOAD": Load, "HEARTBEAT": Heartbeat,
    "STATUS": Status, "TELEMETRY_PV": TelemetryPv, "TELEMETRY_SP": TelemetrySp, "IDENTITY": Identity,
    "ITEM": PageItem, "PAGE": PageEnd, "ACK": Ack, "CHALLENGE": Challenge,
}  # fmt: skip


def newer(seq: int, than: int, bits: int = 16) -> bool:
    """Whether a wrapping number is newer than another: less than half the circle ahead (serial numbers, RFC 1982)."""
    half = 1 << (bits - 1)
    return 0 < (seq - than) % (2 * half) < half


def reason_text(ack: Ack) -> str:
    """A refusal in words."""
    try:
        reason = Reason(ack.reason)
    except ValueError:
        return f"reason {ack.reason}"
    text = reason.name.lower().replace("_", " ")
    about = {Reason.OUTSIDE_BOX, Reason.RATIO, Reason.NOT_FINITE, Reason.INCOMPLETE}
    return f"{text} ({Item(ack.item).name.lower()})" if reason in about else text


# ---- The box that a device certifies by itself: whatever a host asks for, nothing outside it ever runs


@dataclass(frozen=True, slots=True)
class GainBox:
    """Limits of the gains that a device accepts.

    kp_max, ki_max, kd_max : largest magnitudes, in the units of PidGains.
    ratio_max : largest factor, up or down, by which one write may change a gain. Generous: a change of operating region
        is one write, too; the host's guard is the narrow one.
    direction : +1 or -1 for the only sign that gains may have, 0 for either.

    Raises ValueError: a limit is not positive and finite, the ratio is below 1, or the direction is none.
    """

    kp_max: float = 1e6
    ki_max: float = 1e6
    kd_max: float = 1e9
    ratio_max: float = 50.0
    direction: int = 0

    def __post_init__(self) -> None:
        for field in fields(self):
            value: float = getattr(self, field.name)
            if field.name != "direction" and not 0 < value < math.inf:
                raise ValueError(f"gain box: {field.name} = {value}; give a positive finite number")
        if self.ratio_max < 1:
            raise ValueError(f"gain box: ratio_max = {self.ratio_max}; give 1 or more")
        if self.direction not in {-1, 0, 1}:
            raise ValueError(f"gain box: direction = {self.direction}; give +1, -1 or 0 for either")

    def refusal(self, gains: tuple[float, float, float], running: PidGains) -> tuple[Reason, Item]:
        """Why these gains (kp, ki, kd) may not follow the running ones: (Reason, first Item at fault), or (OK, KP)."""
        old = (running.kp, running.ki, running.kd)
        limits = (self.kp_max, self.ki_max, self.kd_max)
        for item in Item:
            if not math.isfinite(gains[item]):
                return Reason.NOT_FINITE, item
            if abs(gains[item]) > limits[item] or gains[item] * self.direction < 0:
                return Reason.OUTSIDE_BOX, item
        if not any(gains) or min(gains) < 0 < max(gains):
            return Reason.OUTSIDE_BOX, Item.KP
        for item in Item:
            was, now = old[item], gains[item]  # switching a gain on or off is held by the box alone
            if was and now and not 1 / self.ratio_max <= now / was <= self.ratio_max:
                return Reason.RATIO, item
        return Reason.OK, Item.KP
