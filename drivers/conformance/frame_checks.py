"""The chapters of the protocol on frames, samples, connecting, the lease and commands, each as an examination."""

import math
import struct
from collections.abc import Callable
from itertools import pairwise

import can

from retuner.adaptive.signals.sample import LoopMode
from retuner.drivers.conformance.conversation import LEASE_SAMPLES, Conversation, reason_of
from retuner.drivers.conformance.examination import Examination
from retuner.drivers.protocol import frames as wire
from retuner.drivers.protocol.checksum import STAMP_SAMPLES, frame_crc, lease_stamp, page_crc, sample_crc, set_crc
from retuner.drivers.protocol.codec import COMMAND_BITS, schema

READ, STAGE = 2, 4
HEARTBEATS_MAX = 100  # samples between two heartbeats at most
SHORT_LEASE = 2  # samples
SAMPLES_SEEN = 12  # the last ones that came in passing
OTHER = 77  # another host
SAMPLES_TO_STAMP = 4  # samples to the next stamp, within which it may have come by the time that a request is there


def connecting(found: Examination) -> None:
    """Who it is, and what it says about its sets."""
    talk = found.talk
    frames = talk.say(wire.Read(wire.Page.IDENTITY, 1))
    told = [type(f).__name__ for f in frames if isinstance(f, wire.Identity | wire.Heartbeat | wire.Status)]
    begins = told.index("Identity") if "Identity" in told else len(told)  # a sample may have come before the answer
    found.expect("READ of the identity is answered by", told[begins : begins + 3], ["Identity", "Heartbeat", "Status"])
    identity = talk.one(wire.Identity, wire.Page.IDENTITY)
    found.expect("protocol version", identity.protocol, wire.PROTOCOL_VERSION)
    found.expect("layout hash", hex(identity.schema), hex(schema()))
    _read_back(found, wire.Page.RUNNING)
    _read_back(found, wire.Page.STORED)
    first, second = talk.page(wire.Page.RUNNING, 3).end.crc, talk.page(wire.Page.RUNNING, 3 + wire.PAGE_TAG).end.crc
    found.holds("the CRC of PAGE is the same for two tokens: it must cover all 16 bits of the token", first != second)


def _read_back(found: Examination, page: wire.Page) -> None:
    """A complete page: its items, the token's low bits in all of them, and the CRC."""
    talk, token = found.talk, found.talk.token()
    seen, known = talk.page(page, token), talk.known
    name = f"READ of the {page.name.lower()} page"
    found.expect(f"{name}: its items", sorted(seen.items), [0, 1, 2])
    found.expect(f"{name}: complete", seen.end.complete, 1)
    parts: list[wire.PageItem | wire.PageEnd] = [*seen.items.values(), seen.end]
    found.expect(f"{name}: token", {part.token for part in parts}, {token % wire.PAGE_TAG})
    found.expect(f"{name}: sequence numbers", len({part.seq for part in parts}), 1)
    if page is wire.Page.RUNNING:
        crc = page_crc(set_crc(talk.node, known.epoch, seen.end.seq, known.gains), token)
        found.expect(f"{name}: CRC", hex(seen.end.crc), hex(crc))


def frames(found: Examination) -> None:
    """What is no frame of this protocol is counted, and has no other effect."""
    talk = found.talk
    good = talk.codec.encode(wire.Read(wire.Page.IDENTITY, 5))
    id_, data = good.arbitration_id, bytes(good.data)
    owned = talk.owner % wire.OWNER_TAG << 2
    for name, message in {
        "a READ with a wrong checksum": can.Message(arbitration_id=id_, is_extended_id=False, data=flipped(data)),
        "a READ that is too short": can.Message(arbitration_id=id_, is_extended_id=False, data=data[:-1]),
        "a READ that is too long": can.Message(arbitration_id=id_, is_extended_id=False, data=data + b"\0"),
        "a READ of page 5": sealed(talk.node, READ, b"\x05\x00\x00"),
        "a STAGE of item 3": sealed(talk.node, STAGE, struct.pack("<BfH", owned | 3, 1.0, talk.fresh_seq())),
        "a STAGE of NaN": sealed(talk.node, STAGE, struct.pack("<BfH", owned, math.nan, talk.fresh_seq())),
        "a STAGE of infinity": sealed(talk.node, STAGE, struct.pack("<BfH", owned, math.inf, talk.fresh_seq())),
        "a READ as an extended frame": can.Message(arbitration_id=id_, is_extended_id=True, data=data),
        "a remote frame": can.Message(arbitration_id=id_, is_extended_id=False, is_remote_frame=True, dlc=4),
        "an unknown command": sealed(talk.node, 0, b"\x00"),
    }.items():
        talk.look()
        before, latest = talk.known.refused, talk.known.latest
        found.expect(f"{name} is answered by", _told(talk.raw(message)), [])
        talk.look()
        extended = message.is_extended_id or message.is_remote_frame  # a filter may keep them from the firmware
        counts = {(before + 1) % 256} | ({before} if extended else set())
        found.holds(f"{name}: the count of refused frames in STATUS did not grow by one", talk.known.refused in counts)
        found.expect(f"{name}: newest number seen", talk.known.latest, latest)
    talk.look()
    before = talk.known.refused
    found.expect("READ to another node", _told(talk.raw(sealed(talk.node % 63 + 1, READ, b"\x03\x05\x00"))), [])
    talk.look()
    found.expect("frames counted as refused after one to another node", talk.known.refused, before)


def _told(frames_: list[wire.Frame]) -> list[str]:
    """Answers among frames: what is not said by itself."""
    return [type(f).__name__ for f in frames_ if isinstance(f, wire.Identity | wire.PageItem | wire.PageEnd | wire.Ack)]


def flipped(data: bytes) -> bytes:
    """The frame with one bit of the last byte changed."""
    return data[:-1] + bytes([data[-1] ^ 1])


def sealed(node: int, command: int, payload: bytes) -> can.Message:
    """Any bytes as a command with the right checksum."""
    id_ = node << COMMAND_BITS | command
    return can.Message(arbitration_id=id_, is_extended_id=False, data=payload + bytes([frame_crc(id_, payload)]))


def samples(found: Examination) -> None:
    """Telemetry, the last of what came: two halves, one counter, one CRC; heartbeats with the whole counter."""
    talk = found.talk
    talk.samples(max(SAMPLES_SEEN - sum(isinstance(frame, wire.TelemetrySp) for frame in talk.passing), 0))
    told = list(talk.passing)
    pairs = [
        (a, b) for a, b in pairwise(halves(told)) if isinstance(a, wire.TelemetryPv) and isinstance(b, wire.TelemetrySp)
    ][-SAMPLES_SEEN:]
    if not found.holds("fewer than ten samples of two halves came in twelve samples", len(pairs) >= 10):
        return
    for pv, sp in pairs:
        found.expect("counters of the halves of a sample", pv.counter, sp.counter)
        found.expect("CRC-16 of a sample", hex(sp.crc), hex(sample_crc(talk.node, pv, sp)))
    steps = {(b.counter - a.counter) % 256 for (a, _), (b, _) in pairwise(pairs)}
    found.expect("the counter goes from sample to sample by", steps, {1})
    found.expect("low bits of the running number in telemetry", pairs[-1][1].running, talk.known.seq % wire.RUNNING_TAG)
    # A life sign often enough, with the counter of the telemetry
    waited = 0
    while not any(isinstance(frame, wire.Heartbeat) for frame in told) and waited < HEARTBEATS_MAX:
        told += talk.samples(10)
        waited += 10
    if not found.holds(f"no HEARTBEAT in {HEARTBEATS_MAX} samples", any(isinstance(f, wire.Heartbeat) for f in told)):
        return
    at = max(i for i, frame in enumerate(told) if isinstance(frame, wire.Heartbeat))
    beat = told[at]
    before = [frame for frame in told[:at] if isinstance(frame, wire.TelemetrySp)]
    if before and isinstance(beat, wire.Heartbeat):
        ahead = (beat.sample - before[-1].counter) % 256
        found.holds("the counter in HEARTBEAT is not that of the sample before it", ahead <= 1)


def halves(frames_: list[wire.Frame]) -> list[wire.TelemetryPv | wire.TelemetrySp]:
    """The telemetry among frames."""
    return [frame for frame in frames_ if isinstance(frame, wire.TelemetryPv | wire.TelemetrySp)]


def leases(found: Examination) -> None:
    """One host commands: who has no lease is told so, and a lease ends."""
    talk = found.talk
    talk.ack(talk.lease(samples=0))
    seq = talk.fresh_seq()
    found.expect("STATUS without a lease: owner", talk.known.owner, 0)
    found.holds("HEARTBEAT says that the lease is taken when it is not", not talk.known.flags & wire.Flags.OWNED)
    for name, frame in _commands(found, seq, talk.owner):
        found.answers(f"{name} without a lease", wire.Reason.NOT_OWNER, frame)
    found.answers("ABORT of a new number without a lease", wire.Reason.OK, wire.Abort(seq))
    found.answers("ABORT of an old number without a lease", wire.Reason.STALE, wire.Abort(seq))
    answer = talk.ack(talk.lease())
    if not found.holds("LEASE is not answered", answer is not None) or answer is None:
        return
    found.expect("LEASE of a free device", wire.Reason(answer.reason), wire.Reason.OK)
    found.expect("the ACK of LEASE carries as seq the owner, and", answer.seq, talk.owner)
    found.expect("the ACK of LEASE carries as latest the present owner, and", answer.latest, talk.owner)
    found.expect("the ACK's low bits of the epoch", answer.epoch, talk.known.epoch % wire.EPOCH_TAG)
    talk.look()
    found.expect("STATUS: owner", talk.known.owner, talk.owner)
    found.holds("HEARTBEAT does not say that the lease is taken", talk.known.flags & wire.Flags.OWNED)
    for name, frame in _commands(found, seq, OTHER):
        found.answers(f"{name} of another host", wire.Reason.NOT_OWNER, frame)
    refused = talk.ack(talk.lease(owner=OTHER))
    got = None if refused is None else (wire.Reason(refused.reason), refused.latest)
    found.expect("LEASE of another host", got, (wire.Reason.NOT_OWNER, talk.owner))
    # Requests that must not count: an older counter, another time, another boot
    talk.look()
    known = talk.known
    newest = talk.lease()
    found.answers("LEASE again with a newer counter", wire.Reason.OK, newest)
    old = wire.Lease(newest.owner, newest.stamp, newest.samples - 1, (newest.counter - 1) % 256)
    found.answers("LEASE with an older counter", wire.Reason.STALE, old)
    for name, stamp in (
        ("another epoch", lease_stamp((known.epoch + 1) % 65536, known.sample)),
        ("640 samples later", lease_stamp(known.epoch, known.sample + 640)),
    ):
        request = wire.Lease(talk.owner, stamp, 100, talk.counter())
        found.answers(f"LEASE with the stamp of {name}", wire.Reason.STALE, request)
    # It runs out by itself, a repeated request does not prolong it, and what was staged goes with it
    talk.look()
    request = talk.lease(samples=SHORT_LEASE)
    talk.say(request, *talk.stage(talk.fresh_seq(), found.first))
    for _ in range(SHORT_LEASE + 2):
        talk.samples(1)
        talk.say(request)
    talk.look()
    found.expect("a lease that was repeated and has run out: owner in STATUS", talk.known.owner, 0)
    found.expect("after it: complete in the staged page", talk.page(wire.Page.STAGED).end.complete, 0)
    talk.own()


def _commands(found: Examination, seq: int, owner: int) -> list[tuple[str, wire.Frame]]:
    talk, running = found.talk, found.talk.known.seq
    return [
        ("STAGE", wire.Stage(0, owner % wire.OWNER_TAG, found.first.kp, seq)),
        ("CONFIRM", wire.Confirm(running, owner)),
        ("STORE", wire.Store(running, owner % 256)),
        ("SETPOINT", wire.Setpoint(talk.counter(), 0.0, owner)),
        ("MODE", wire.Mode(talk.counter(), LoopMode.AUTO, 0.0, owner)),
    ]


def stamps(found: Examination) -> None:
    """A request counts that was stamped within the last 64 samples, and no older one."""
    talk = found.talk
    talk.own()  # the counters of its requests are the newest from here on
    for _ in range(2 * STAMP_SAMPLES - talk.known.sample):  # switched on lately: more answers are looked at meanwhile
        talk.samples()
        talk.look()
    if talk.known.sample % STAMP_SAMPLES > STAMP_SAMPLES - SAMPLES_TO_STAMP:
        talk.samples(2 * SAMPLES_TO_STAMP)
    talk.look()
    for back, wanted in ((1, wire.Reason.OK), (2, wire.Reason.STALE)):
        stamp = lease_stamp(talk.known.epoch, talk.known.sample - back * STAMP_SAMPLES)
        request = wire.Lease(talk.owner, stamp, LEASE_SAMPLES, talk.counter())
        found.expect(f"LEASE with the stamp of {back * STAMP_SAMPLES} samples before", talk.reason(request), wanted)


def commands(found: Examination) -> None:
    """Setpoint and mode: acted on once, told again, refused when older."""
    talk = found.talk
    sp, _ = talk.newest()
    setpoint(talk, sp)  # the counter is the newest from here on
    newer = talk.counter()
    older, first = (newer - 3) % 256, talk.ack(wire.Setpoint(newer, sp, talk.owner))
    got = None if first is None else (wire.Reason(first.reason), first.seq)
    found.expect("SETPOINT", got, (wire.Reason.OK, newer))
    found.answers("SETPOINT again", wire.Reason.OK, wire.Setpoint(newer, sp, talk.owner))
    stale = talk.ack(wire.Setpoint(older, sp, talk.owner))
    got = None if stale is None else (wire.Reason(stale.reason), stale.latest)
    found.expect("SETPOINT with an older counter", got, (wire.Reason.STALE, newer))
    # Manual holds co where it is
    found.expect("MODE manual", manual(talk), wire.Reason.OK)
    _, co = talk.newest()
    told = halves(talk.samples(2))
    found.expect("mode in telemetry", {h.mode for h in told[-4:] if isinstance(h, wire.TelemetrySp)}, {LoopMode.MANUAL})
    held = max(abs(h.co - co) for h in told[-4:] if isinstance(h, wire.TelemetryPv))
    found.holds(f"co moved by {held:g} % in manual", held < 0.01)
    found.answers("MODE auto", wire.Reason.OK, wire.Mode(talk.counter(), 1, 0.0, talk.owner))


def setpoint(talk: Conversation, sp: float) -> bool:
    """Set the target, whatever counters were used before; whether the device took it."""
    return _took(talk, lambda: wire.Setpoint(talk.counter(), sp, talk.owner)) is wire.Reason.OK


def manual(talk: Conversation) -> wire.Reason | None:
    """Hold co where it is, whatever counters were used before; what the device says."""
    _, co = talk.newest()
    return _took(talk, lambda: wire.Mode(talk.counter(), LoopMode.MANUAL, co, talk.owner))


def _took(talk: Conversation, command: Callable[[], wire.Frame]) -> wire.Reason | None:
    """The answer to a command, said again with the next counter where the first was an old one."""
    answer = talk.ack(command())
    if answer is not None and answer.reason == wire.Reason.STALE:
        talk.counter((answer.latest - talk.counter(0)) % 256)
        answer = talk.ack(command())
    return reason_of(answer)
