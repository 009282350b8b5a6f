"""The chapters of the protocol on gain sets: changing, trial, store, codes, restarts, each as an examination."""

from collections.abc import Callable
from dataclasses import replace
from functools import partial

from retuner.adaptive.signals.sample import LoopMode
from retuner.drivers.conformance.conversation import first_ack, reason_of
from retuner.drivers.conformance.examination import Check, Examination, near
from retuner.drivers.conformance.frame_checks import manual, setpoint
from retuner.drivers.protocol import frames as wire
from retuner.drivers.protocol.checksum import page_crc, set_crc
from retuner.schedule.gains import PidGains

LARGEST = 9e11  # nearly the largest gain that a frame can carry; no box is as wide
FACTORS = (1.05, 0.95, 1.01, 0.99)  # of the running set: one of them is in the box


def staging(found: Examination) -> None:
    """A page is staged gain by gain, read back, and dropped by a newer number."""
    talk = found.talk
    seq = talk.fresh_seq()
    empty = talk.page(wire.Page.STAGED).end
    found.expect("READ of the empty stage: complete, crc", (empty.complete, empty.crc), (0, 0))
    frames = talk.stage(seq, found.first)
    found.expect("STAGE is answered by", [f for f in talk.say(*frames[:2]) if isinstance(f, wire.Ack)], [])
    half = talk.page(wire.Page.STAGED)
    found.expect("a page with two gains: items, complete", (sorted(half.items), half.end.complete), ([0, 1], 0))
    talk.say(frames[2])
    token = talk.token()
    whole = talk.page(wire.Page.STAGED, token)
    gains = found.first
    found.expect("the staged page", whole.values, (gains.kp, gains.ki, gains.kd))
    crc = page_crc(set_crc(talk.node, talk.known.epoch, seq, gains), token)
    seen = (whole.end.complete, whole.end.seq, whole.end.token, hex(whole.end.crc))
    found.expect("the end of the staged page", seen, (1, seq, token % wire.PAGE_TAG, hex(crc)))
    talk.look()
    found.holds("HEARTBEAT does not say that a page is staged", talk.known.flags & wire.Flags.STAGED)
    talk.say(talk.stage((seq + 1) % 65536, gains)[0])
    found.expect(
        "STAGE under a newer number begins a new page: its items", sorted(talk.page(wire.Page.STAGED).items), [0]
    )
    found.answers("STAGE under an older number", wire.Reason.STALE, frames[0])


def committing(found: Examination) -> None:
    """A good set runs from one sample on, as a whole, without a bump, and is acknowledged again."""
    talk = found.talk
    for factor in FACTORS:
        gains = near(found.first, factor)
        seq, frames = talk.write(gains)
        answer = first_ack(frames, wire.Kind.COMMIT)
        if answer is not None and wire.Reason(answer.reason) is not wire.Reason.OUTSIDE_BOX:
            break
    found.expect("COMMIT", None if answer is None else wire.Reason(answer.reason), wire.Reason.OK)
    found.runs("after a good COMMIT", gains)
    found.other = talk.known.gains
    found.expect("number of the active gains", talk.known.seq, seq)
    # The acknowledge comes in the sample that runs the set, before its telemetry
    at = next((i for i, f in enumerate(frames) if isinstance(f, wire.Ack) and f.kind == wire.Kind.COMMIT), None)
    if at is not None:
        tag = seq % wire.RUNNING_TAG
        earlier = [f.running for f in frames[:at] if isinstance(f, wire.TelemetrySp)]
        later = [f.running for f in frames[at:] if isinstance(f, wire.TelemetrySp)]
        found.holds("telemetry shows the new set before its acknowledge", tag not in earlier)
        found.expect("running number in the telemetry after the acknowledge", set(later), {tag})
    if next((f for f in frames if isinstance(f, wire.TelemetrySp)), None) is not None and talk.known.seq == seq:
        found.holds(
            "a COMMIT with another crc under the running number is accepted",
            talk.reason(wire.Commit(seq, (seq - 1) % 65536, 1)) is not wire.Reason.OK,
        )
    # In manual co stays exactly as it is; the repeated commit gets the same answer
    manual(talk)
    talk.samples()
    _, held = talk.newest()
    seq = talk.fresh_seq()
    commit = talk.commit(seq, found.first)
    talk.say(*talk.stage(seq, found.first), *talk.codes(seq, found.first), commit)
    talk.samples()
    moved = abs(talk.newest()[1] - held)
    found.holds(f"co jumped by {moved:g} % when the gains were changed in manual", moved < 0.01)
    found.answers("the same COMMIT again", wire.Reason.OK, commit)
    talk.say(wire.Mode(talk.counter(), LoopMode.AUTO, 0.0, talk.owner))
    found.runs("after the repeated COMMIT", found.first)
    found.confirmed()


def swapping(found: Examination) -> None:
    """co goes on as the old gains would have led it, in automatic and away from the setpoint."""
    talk, first = found.talk, found.first
    new = replace(first, kp=1.5 * first.kp) if first.kp else first
    dt = talk.one(wire.Identity, wire.Page.IDENTITY).sample_time
    sp, co = talk.newest()
    error = (-10.0 if co > 50.0 else 10.0) / (first.kp or 1.0)
    if new == first or not setpoint(talk, sp + error):
        found.left_out.append("the swap in automatic: it has no kp, or takes no other setpoint")
        return
    talk.samples()
    _, frames = talk.write(new)
    setpoint(talk, sp)
    told = [half for half in frames if isinstance(half, wire.TelemetryPv | wire.TelemetrySp | wire.Ack)]
    at = next((i for i, f in enumerate(told) if isinstance(f, wire.Ack) and f.kind == wire.Kind.COMMIT), len(told))
    before = [half for half in told[:at] if isinstance(half, wire.TelemetryPv)]
    after = [half for half in told[at:] if isinstance(half, wire.TelemetryPv)]
    if talk.known.gains != new or not (before or after):
        found.left_out.append("the swap in automatic: it does not take kp x 1.5")
        return
    # co moves by what I and P do from the sample before the swap to that of the swap, not by the change of P
    seen = talk.last_before(after[0].counter)
    if seen is None:
        found.left_out.append("the swap in automatic: the sample before it was lost")
    else:
        jump = (new.kp - first.kp) * error
        moved = after[0].co - seen.co - (first.ki * error * dt - first.kp * (after[0].pv - seen.pv))
        found.holds(f"co jumped by {moved:.3g} % in the sample of the swap", abs(moved) < 0.5 * abs(jump))
    talk.write(first)
    found.confirmed()


def refusing(found: Examination) -> None:
    """Every condition of a commit that is not met has its reason, burns the number, and changes nothing."""
    talk, good = found.talk, found.other
    up = good.times(1e4)
    far, mixed = (wire.Reason.RATIO, wire.Reason.OUTSIDE_BOX), (wire.Reason.OUTSIDE_BOX,)
    crc = wire.Reason.WRONG_CRC
    for name, reason, wrong in (
        ("a wrong base", wire.Reason.WRONG_BASE, {"base": (talk.known.seq + 9) % 65536}),
        ("a CRC over another node", crc, {"node": talk.node % 63 + 1}),
        ("a CRC over another epoch", crc, {"epoch": (talk.known.epoch + 1) % 65536}),
        ("a CRC over another owner", crc, {"owner": 77}),
    ):
        _refusal(found, name, good, partial(talk.commit, gains=good, **wrong), (reason,))
    other = replace(good, kp=good.kp * 1.001) if good.kp else replace(good, ki=good.ki * 1.001)
    _refusal(found, "a CRC over other gains", good, lambda seq: talk.commit(seq, other), (crc,))
    _refusal(found, "gains 10,000 times as large", up, lambda seq: talk.commit(seq, up), far)
    tiny = PidGains(good.kp / 1e4, good.ki / 1e4, good.kd / 1e4)
    _refusal(found, "gains 10,000 times as small", tiny, lambda seq: talk.commit(seq, tiny), (wire.Reason.RATIO,))
    talk.samples(1)  # a set that was refused and yet waits would run from here on
    found.runs("a sample after refused COMMITs", talk.known.gains)
    # a gain that is off may be switched on by any ratio, so here the largest magnitude alone must hold
    off = replace(good, kd=0.0)
    if off.kp or off.ki:
        talk.write(off)
        found.confirmed()
        huge = replace(off, kd=LARGEST * off.direction)
        _raw_refusal(found, "a kd of 9e11", (huge.kp, huge.ki, huge.kd), (wire.Reason.OUTSIDE_BOX,))
        talk.write(good)
        found.confirmed()
    else:
        found.left_out.append("the largest magnitude of a gain: this device runs kd alone")
    down = PidGains(-good.kp, -good.ki, -good.kd)
    _refusal(found, "gains of the other sign", down, lambda seq: talk.commit(seq, down), far)
    _raw_refusal(found, "gains that are all zero", (0.0, 0.0, 0.0), mixed)
    _raw_refusal(found, "gains of two signs", (good.kp or 1.0, -(good.ki or 1.0), good.kd), mixed)
    _numbers(found)


def _refusal(
    found: Examination,
    name: str,
    gains: PidGains,
    commit: Callable[[int], wire.Commit],
    reasons: tuple[wire.Reason, ...],
) -> None:
    talk = found.talk
    seq = talk.fresh_seq()
    stage, sent = talk.stage(seq, gains), commit(seq)
    answer = talk.reason(*stage, *talk.codes(seq, gains), sent)
    _judge(found, name, stage[0], answer, reasons)
    found.expect(f"COMMIT with {name} again", talk.reason(sent), answer)


def _raw_refusal(found: Examination, name: str, values: tuple[float, ...], reasons: tuple[wire.Reason, ...]) -> None:
    """The refusal of gains that no PidGains can hold."""
    talk = found.talk
    seq = talk.fresh_seq()
    stage = [wire.Stage(item, talk.owner % 64, values[item], seq) for item in wire.Item]
    _judge(found, name, stage[0], talk.reason(*stage, wire.Commit(seq, talk.known.seq, 0)), reasons)


def _judge(
    found: Examination, name: str, stage: wire.Frame, answer: wire.Reason | None, reasons: tuple[wire.Reason, ...]
) -> None:
    """The reason is one of these, the number is burnt, nothing has changed."""
    talk = found.talk
    if answer not in reasons:
        found.expect(f"COMMIT with {name}", answer, reasons[0])
    before = talk.known.gains
    found.answers(f"STAGE under the number of a COMMIT with {name}", wire.Reason.STALE, stage)
    found.runs(f"after a COMMIT with {name}", before)


def _numbers(found: Examination) -> None:
    """What is not staged, incomplete, or old."""
    talk, good = found.talk, found.other
    seq = talk.fresh_seq()
    far = (seq + 5) % 65536
    found.answers("COMMIT of what is not staged", wire.Reason.NOT_STAGED, talk.commit(far, good))
    staged = talk.reason(*talk.stage(seq, good), *talk.codes(far, good), talk.commit(far, good))
    found.expect("COMMIT under another number than that of the stage", staged, wire.Reason.NOT_STAGED)
    talk.samples(1)
    found.runs("after it", talk.known.gains)
    seq = (seq + 1) % 65536
    missing = talk.ack(*talk.stage(seq, good)[::2], talk.commit(seq, good))
    got = None if missing is None else (wire.Reason(missing.reason), missing.item)
    found.expect("COMMIT of a page without ki", got, (wire.Reason.INCOMPLETE, int(wire.Item.KI)))
    found.answers("COMMIT of an old number", wire.Reason.STALE, talk.commit((talk.known.seq - 1) % 65536, good))


def fencing(found: Examination) -> None:
    """ABORT has three answers, and what it fences off never runs."""
    talk, good = found.talk, found.other
    before = talk.known.gains
    found.answers("ABORT of the running number", wire.Reason.ALREADY_RUNNING, wire.Abort(talk.known.seq))
    seq = talk.fresh_seq()
    commit = talk.commit(seq, good)
    codes = talk.codes(seq, good)
    talk.samples(1)
    answer = first_ack(talk.say(*talk.stage(seq, good), *codes, commit, wire.Abort(seq)), wire.Kind.ABORT)
    if answer is not None and wire.Reason(answer.reason) is wire.Reason.ALREADY_RUNNING:
        found.left_out.append("ABORT of a commit that waits for its sample: the samples are too short to try it")
        talk.look()
        return
    found.expect("ABORT of a commit that waits", reason_of(answer), wire.Reason.OK)
    talk.samples(1)
    found.runs("after the ABORT of a commit that waited", before)
    found.answers("the fenced COMMIT, late", wire.Reason.STALE, *codes, commit)
    found.answers("STAGE under a fenced number", wire.Reason.STALE, talk.stage(seq, good)[0])
    found.answers("ABORT of an old number", wire.Reason.STALE, wire.Abort(seq))
    ahead = (seq + 7) % 65536
    found.answers("ABORT of a number to come", wire.Reason.OK, wire.Abort(ahead))
    found.answers("STAGE under it", wire.Reason.STALE, talk.stage(ahead, good)[0])
    talk.look()
    found.expect("newest number seen", talk.known.latest, ahead)


def busy(found: Examination) -> None:
    """While a commit waits for its sample nothing else is staged or committed."""
    talk, good = found.talk, found.other
    seq = talk.fresh_seq()
    codes = talk.codes(seq, good)
    talk.samples(1)
    waits = talk.commit(seq, good)
    other = replace(waits, crc=waits.crc ^ 1)
    frames = talk.say(*talk.stage(seq, good), *codes, waits, talk.stage((seq + 1) % 65536, good)[0], other)
    stage, commit = first_ack(frames, wire.Kind.STAGE), first_ack(frames, wire.Kind.COMMIT)
    if commit is not None and commit.reason == wire.Reason.OK:
        found.left_out.append("STAGE while a commit waits: the samples are too short to try it")
    else:
        found.expect("STAGE while a commit waits", reason_of(stage), wire.Reason.BUSY)
        found.expect("COMMIT while another waits", reason_of(commit), wire.Reason.BUSY)
    talk.samples(1)
    talk.look()
    found.confirmed()


def trial(found: Examination) -> None:
    """A new set is on trial until it is confirmed, and is not stored before."""
    talk = found.talk
    seq, _ = talk.write(found.other if talk.known.gains != found.other else found.first)
    found.holds("HEARTBEAT does not say that the new set is on trial", talk.known.flags & wire.Flags.TRIAL)
    found.answers("STORE on trial", wire.Reason.NOT_CONFIRMED, wire.Store(seq, talk.owner % 256))
    found.answers("CONFIRM of another number", wire.Reason.STALE, wire.Confirm((seq - 1) % 65536, talk.owner))
    found.answers("CONFIRM", wire.Reason.OK, wire.Confirm(seq, talk.owner))
    found.answers("CONFIRM again", wire.Reason.OK, wire.Confirm(seq, talk.owner))
    talk.look()
    found.holds("HEARTBEAT says that a confirmed set is on trial", not talk.known.flags & wire.Flags.TRIAL)


def storing(found: Examination) -> None:
    """What runs and is confirmed is kept, and the stored page shows it."""
    talk = found.talk
    found.confirmed()
    talk.look()
    seq, tag = talk.known.seq, talk.owner % 256
    found.answers("STORE with a wrong key", wire.Reason.WRONG_KEY, wire.Store(seq, tag, 5))
    found.answers("STORE of another number", wire.Reason.STALE, wire.Store((seq - 1) % 65536, tag))
    found.answers("STORE", wire.Reason.OK, wire.Store(seq, tag))
    talk.look()
    found.holds("HEARTBEAT does not say that the active gains is stored", talk.known.flags & wire.Flags.STORED)
    gains, stored = talk.known.gains, talk.page(wire.Page.STORED)
    found.expect("the stored page", (stored.end.seq, *stored.values), (seq, gains.kp, gains.ki, gains.kd))


def codes(found: Examination) -> None:
    """No set runs without its code where there is a key, and strangers' codes harm nobody."""
    talk, good = found.talk, found.other
    challenge = talk.one(wire.Challenge, wire.Page.CHALLENGE)
    found.expect("whether a code is demanded", bool(challenge.demanded), talk.key is not None)
    if talk.key is None:
        return
    found.expect("CHALLENGE asked again", talk.one(wire.Challenge, wire.Page.CHALLENGE).nonce, challenge.nonce)
    seq = talk.fresh_seq()
    without = talk.reason(*talk.stage(seq, good), talk.commit(seq, good))
    found.expect("COMMIT without a code", without, wire.Reason.NO_CODE)
    for part in (0, 1, None, None):  # many codes of another key, or right by half, lock nobody out
        seq = talk.fresh_seq()
        told = talk.codes(seq, good, b"?" * 16 if part is None else None)
        auths = [frame for frame in told if isinstance(frame, wire.Auth)]
        sent = [frame if part in {None, frame.part} else replace(frame, mac=frame.mac ^ 1) for frame in auths]
        got = talk.reason(*talk.stage(seq, good), *sent, talk.commit(seq, good))
        name = "the code of another key" if part is None else f"only half {part} of its code right"
        found.expect(f"COMMIT with {name}", got, wire.Reason.WRONG_CODE)
    seq = talk.fresh_seq()
    forged: list[wire.Frame] = [wire.Auth(part, seq % 16, 7) for part in (0, 1)]
    right = talk.codes(seq, good)
    talk.say(*talk.stage(seq, good), *forged, *right, *forged, talk.commit(seq, good))
    talk.samples(2)
    found.runs("after a COMMIT with the right code among forged halves", good)
    found.confirmed()
    renewed = talk.one(wire.Challenge, wire.Page.CHALLENGE).nonce
    found.holds("CHALLENGE is the same after an accepted code", renewed != challenge.nonce)
    talk.say(wire.Abort(talk.fresh_seq()))
    found.holds("CHALLENGE is the same after a fence", talk.one(wire.Challenge, wire.Page.CHALLENGE).nonce != renewed)


def restarting(found: Examination) -> None:
    """A restart takes a new epoch, and nothing of before it counts."""
    talk, good = found.talk, found.other
    before, stored = talk.known.epoch, talk.page(wire.Page.STORED)
    seq = talk.fresh_seq()
    talk.say(*talk.stage(seq, good))
    commit, request = talk.commit(seq, good), talk.lease()
    if not talk.far.restart():
        found.left_out.append("a restart: nobody switched the device off and on")
        return
    talk.samples(2)
    talk.look()
    found.holds("the epoch is the same after a restart", talk.known.epoch != before)
    found.holds("the sample counter goes on over a restart", talk.known.sample < 1000)
    found.expect("owner after a restart", talk.known.owner, 0)
    kept = PidGains(*stored.values)
    found.expect("what runs after a restart", (talk.known.seq, talk.known.gains), (stored.end.seq, kept))
    found.expect("complete in the staged page after a restart", talk.page(wire.Page.STAGED).end.complete, 0)
    found.answers("LEASE of before the restart", wire.Reason.STALE, request)
    talk.own()
    late = talk.reason(*talk.stage(seq, good), commit)
    found.holds("a COMMIT of before the restart is accepted", late is not wire.Reason.OK and late is not None)
    talk.samples(1)
    found.runs("after it", kept)


def reverting(samples: int) -> Check:
    """The check of a trial time of so many samples."""

    def check(found: Examination) -> None:
        """A set that is not confirmed in time gives way, and says so."""
        talk = found.talk
        before = (talk.known.seq, talk.known.gains)
        seq, _ = talk.write(found.other if before[1] != found.other else found.first)
        told = first_ack(talk.samples(samples + 2), wire.Kind.CONFIRM)
        got = None if told is None else (told.seq, wire.Reason(told.reason))
        found.expect("after the trial time", got, (seq, wire.Reason.REVERTED))
        talk.look()
        found.expect("what runs after the trial time", (talk.known.seq, talk.known.gains), before)

    return check
