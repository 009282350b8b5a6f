"""The worked session of docs/developers/protocol.md and the test vectors, from the virtual device.

python scripts/document_protocol.py

Writes drivers/protocol_vectors.json (frames in, frames out, state at the end) and, between the marks in
docs/developers/protocol.md, the layout hash and the session byte by byte.
"""

import json
from collections.abc import Callable
from dataclasses import fields
from pathlib import Path
from typing import NamedTuple

import can

from retuner.drivers.controller.virtual_device import VirtualDevice, VirtualDeviceSettings
from retuner.drivers.protocol.authentication import code_frames, commit_code
from retuner.drivers.protocol.checksum import commit_crc, lease_stamp, set_crc
from retuner.drivers.protocol.codec import Codec, schema, schema_lines
from retuner.drivers.protocol.frames import (
    NAMES,
    OWNER_TAG,
    PROTOCOL_VERSION,
    Abort,
    Commit,
    Confirm,
    Frame,
    GainBox,
    Item,
    Kind,
    Lease,
    Mode,
    Page,
    PageItem,
    Read,
    Reason,
    Setpoint,
    Stage,
    Store,
)
from retuner.schedule.gains import PidGains

ROOT = Path(__file__).resolve().parents[1]
VECTORS = ROOT / "drivers" / "protocol_vectors.json"
PAGE = ROOT / "docs" / "developers" / "protocol.md"
NODE, EPOCH, OWNER, PV, CO = 1, 7, 0x1234, 50.0, 40.0
FIRST, SECOND = PidGains(1.0, 0.0625, 0.5), PidGains(1.5, 0.125, 0.75)
BOX = GainBox(kp_max=20.0, ki_max=2.0, kd_max=5.0, ratio_max=10.0, direction=1)
KEY = bytes(range(16))
TRIAL = 4
NONCES = (0x0123456789AB, 0xA5A5A5A5A5A5, 0x000000000001, 0xFFFFFFFFFFFF, 0x314159265358, 0x271828182845)
BEFORE = 1  # of them is drawn before the boot at which a case begins
CODEC = Codec(NODE)


class Rest:
    """A plant at rest: pv never moves, so that telemetry is the same in any arithmetic."""

    pv = PV

    def step(self, *_: float) -> float:
        """Nothing happens."""
        return self.pv

    def steady_co(self, *_: float) -> float:
        """The output at rest."""
        return CO


class Step(NamedTuple):
    """One thing that is done, why, and what comes."""

    doing: dict[str, object]
    why: str
    out: list[str]


class Story:
    """A case: what is said to a device, step by step."""

    def __init__(self, name: str, chapter: str, key: bytes | None = None) -> None:
        self.name, self.chapter, self.key = name, chapter, key
        nonces = iter(NONCES)
        settings = VirtualDeviceSettings(FIRST, NODE, box=BOX, sp_min=0.0, sp_max=120.0, trial_samples=TRIAL, key=key)
        self.device = VirtualDevice(settings, Rest(), epoch=EPOCH - 1, nonce=lambda: next(nonces))
        self.device.restart()
        self.steps: list[Step] = []

    def say(self, why: str, *frames: Frame) -> None:
        """Frames to the device."""
        for number, frame in enumerate(frames):
            self.raw(CODEC.encode(frame), why if not number else "")

    def raw(self, message: can.Message, why: str) -> None:
        """Bytes to the device."""
        out = [line_of(reply) for reply in self.device.receive(message)]
        self.steps.append(Step({"frame": line_of(message)}, why, out))

    def sample(self, why: str, count: int = 1) -> None:
        """Controller samples."""
        for number in range(count):
            out = [line_of(message) for message in self.device.step()]
            self.steps.append(Step({"sample": PV}, why if not number else "", out))

    def restart(self, why: str) -> None:
        """Power off and on."""
        self.device.restart()
        self.steps.append(Step({"restart": self.device.epoch}, why, []))

    # what many cases need

    def stamp(self) -> int:
        """Of the device's time."""
        return lease_stamp(self.device.epoch, self.device.sample)

    def own(self, counter: int = 1, samples: int = 600) -> None:
        """Take the lease."""
        self.say("the host takes the lease", Lease(OWNER, self.stamp(), samples, counter))

    def stage(self, seq: int, gains: PidGains = SECOND) -> list[Frame]:
        """The frames that stage a set."""
        values = zip(Item, (gains.kp, gains.ki, gains.kd), strict=True)
        return [Stage(item, OWNER % OWNER_TAG, value, seq) for item, value in values]

    def commit(self, seq: int, gains: PidGains = SECOND, base: int = 0, **wrong: int) -> Commit:
        """A commit; node, epoch and owner under its CRC may be wrong."""
        node, epoch = wrong.get("node", NODE), wrong.get("epoch", self.device.epoch)
        return Commit(seq, base, commit_crc(set_crc(node, epoch, seq, gains), base, wrong.get("owner", OWNER)))

    def written(self, seq: int, gains: PidGains = SECOND, base: int = 0) -> None:
        """A set, from staging to the swap."""
        self.say("a set is staged and committed", *self.stage(seq, gains), self.commit(seq, gains, base))
        self.sample("it runs from this sample on")

    def to_dict(self) -> dict[str, object]:
        """As it stands in the file."""
        device = self.device
        state = {
            "running": [device.running.seq, *gains_of(device.running.gains)],
            "confirmed": [device.pages.confirmed.seq, *gains_of(device.pages.confirmed.gains)],
            "latest": device.pages.latest,
            "owner": device.lease.owner,
            "refused": device.refused,
        }
        steps = [{**step.doing, "out": step.out} for step in self.steps]
        key = None if self.key is None else self.key.hex()
        return {"name": self.name, "chapter": self.chapter, "key": key, "steps": steps, "state": state}


def gains_of(gains: PidGains) -> list[float]:
    """As a list."""
    return [gains.kp, gains.ki, gains.kd]


def line_of(message: can.Message) -> str:
    """A frame as candump -L writes it."""
    return f"{message.arbitration_id:03X}#{bytes(message.data).hex().upper()}"


# The cases


def session() -> Story:
    """The worked session of the page."""
    story = Story("a session from connecting to the stored set", "A session, byte by byte")
    story.say("who is there?", Read(Page.IDENTITY, 1))
    story.say("what runs?", Read(Page.RUNNING, 2))
    story.sample("one controller sample passes")
    story.own()
    story.say("a set is staged, gain by gain", *story.stage(1))
    story.say("as it stands in the device?", Read(Page.STAGED, 3))
    story.say("let it run", story.commit(1))
    story.sample("the swap")
    story.say("what runs now?", Read(Page.RUNNING, 4))
    story.sample("it is watched for some samples")
    story.say("it has proved itself", Confirm(1, OWNER))
    story.say("keep it over a restart", Store(1, OWNER % 256))
    story.say("the lease is given back", Lease(OWNER, story.stamp(), 0, 2))
    return story


def frames_refused() -> Story:
    """What is no frame of the protocol."""
    story = Story("frames that are refused and counted", "Frames")
    good = CODEC.encode(Read(Page.IDENTITY, 1))
    data = bytes(good.data)
    for why, bytes_ in (
        ("a wrong checksum", data[:-1] + bytes([data[-1] ^ 1])),
        ("too short", data[:-1]),
        ("too long", data + b"\0"),
    ):
        message = can.Message(arbitration_id=good.arbitration_id, is_extended_id=False, data=bytes_)
        story.raw(message, why)
    story.raw(can.Message(arbitration_id=2 << 5 | 2, is_extended_id=False, data=data), "another node")
    story.say("the count is in STATUS", Read(Page.IDENTITY, 2))
    return story


def leases() -> Story:
    """Who may command."""
    story = Story("the lease: given, refused, prolonged, run out", "Who may command: the lease")
    story.say("nobody holds it", story.stage(1)[0])
    story.own(samples=6)
    story.say("another host asks", Lease(77, story.stamp(), 6, 1))
    story.say("another host commands", Setpoint(1, 60.0, 77), story.stage(1)[0])
    story.sample("three samples pass", 3)
    story.own(counter=1, samples=6)  # the same again: answered, not prolonged
    story.say("an older counter", Lease(OWNER, story.stamp(), 5, 0))
    story.say("the stamp of another boot", Lease(OWNER, lease_stamp(EPOCH + 1, 0), 6, 2))
    story.sample("it runs out, and what was staged goes", 4)
    story.say("the stage is empty", Read(Page.STAGED, 5), Read(Page.IDENTITY, 6))
    return story


def refusals() -> Story:
    """Every condition of a commit."""
    story = Story("commits that are refused", "Changing gains")
    story.own()
    big, far = PidGains(21.0, 0.0625, 0.5), PidGains(1.0, 0.0625, 0.01)
    story.say("what is not staged", story.commit(9))
    story.say("a wrong base", *story.stage(1), story.commit(1, base=4))
    story.say("its number is burnt", story.stage(1)[0])
    story.say("ki is missing", *story.stage(2)[::2], story.commit(2))
    story.say("kp is outside the box", *story.stage(3, big), story.commit(3, big))
    story.say("kd is changed too far", *story.stage(4, far), story.commit(4, far))
    for seq, wrong in enumerate(({"node": 2}, {"epoch": EPOCH + 1}, {"owner": 77}), 5):
        story.say(f"a CRC over another {next(iter(wrong))}", *story.stage(seq), story.commit(seq, **wrong))
    story.say("all gains are zero", *(Stage(item, OWNER % OWNER_TAG, 0.0, 8) for item in Item), Commit(8, 0, 0))
    story.say("a refused commit again", Commit(8, 0, 0))
    story.say("an old number", story.commit(3))
    story.sample("nothing has changed")
    return story


def fences() -> Story:
    """ABORT."""
    story = Story("the three answers of ABORT, and a commit that comes late", "Changing gains")
    story.own()
    story.say("a commit waits for its sample", *story.stage(1), story.commit(1))
    story.say("nothing is staged meanwhile", story.stage(2)[0])
    story.say("it is fenced off", Abort(1))
    story.sample("so it does not run")
    story.say("a late copy", story.commit(1), story.stage(1)[0], Abort(1))
    story.say("a number to come is fenced off", Abort(5), story.stage(5)[0])
    story.written(6)
    story.say("the running set cannot be", Abort(6))
    story.say("its commit again", story.commit(6))
    return story


def trials() -> Story:
    """CONFIRM or not."""
    story = Story("a set that is not confirmed gives way, one that is stays", "Trial")
    story.own()
    story.written(1)
    story.say("it is not stored before it is confirmed", Store(1, OWNER % 256))
    story.sample("nobody confirms it", TRIAL)
    story.written(2)
    story.say("another number", Confirm(1, OWNER))
    story.say("another host", Confirm(2, 77))
    story.say("confirmed", Confirm(2, OWNER))
    story.sample("it stays", TRIAL + 1)
    return story


def stores() -> Story:
    """STORE and restarts."""
    story = Story("a stored set runs after a restart, and nothing of before it counts", "Storing and restarting")
    story.own()
    story.written(1)
    story.say("confirmed and kept", Confirm(1, OWNER), Store(1, OWNER % 256, 5), Store(0, OWNER % 256))
    story.say("kept", Store(1, OWNER % 256))
    story.written(2, FIRST, 1)
    story.say("staged before the restart", *story.stage(3))
    late, request = story.commit(3, base=1), Lease(OWNER, story.stamp(), 600, 9)
    story.restart("power off and on")
    story.sample("the first sample tells the epoch")
    story.say("what was staged is gone", Read(Page.STAGED, 1), Read(Page.STORED, 2))
    story.say("a request for the lease of before", request)
    story.own(counter=1)
    story.say("a commit of before", *story.stage(3), late)
    return story


def coded() -> Story:
    """Commits with a code."""
    story = Story("commits that need a code", "Authentication of commits", KEY)
    story.own()
    story.say("the challenge", Read(Page.CHALLENGE, 8))
    story.say("no code", *story.stage(1), story.commit(1))
    wrong = commit_code(b"?" * 16, NODE, EPOCH, story.device.code.nonce, OWNER, 2, 0, SECOND)
    story.say("the code of another key", *story.stage(2), *code_frames(wrong, 2), story.commit(2))
    right = commit_code(KEY, NODE, EPOCH, story.device.code.nonce, OWNER, 3, 0, SECOND)
    low, high = code_frames(right, 3)
    forged = code_frames(7, 3)
    story.say("the right one among forged halves", *story.stage(3), low, *forged, high, *forged, story.commit(3))
    story.sample("it runs")
    story.say("another challenge", Read(Page.CHALLENGE, 9))
    return story


def commands() -> Story:
    """Setpoint and mode."""
    story = Story("setpoint and mode", "Setpoint, mode, load")
    story.own()
    story.say("a setpoint, twice the same, an older one", Setpoint(5, 50.0, OWNER), Setpoint(5, 50.0, OWNER))
    story.say("an older one", Setpoint(4, 60.0, OWNER))
    story.say("one outside its range", Setpoint(6, 130.0, OWNER))
    story.say("manual", Mode(1, 0, 40.0, OWNER))
    story.sample("co is held")
    story.say("a co outside its range", Mode(2, 0, -5.0, OWNER))
    story.say("auto", Mode(3, 1, 0.0, OWNER))
    story.sample("and goes on without a bump")
    return story


CASES: tuple[Callable[[], Story], ...] = (
    session, frames_refused, leases, refusals, fences, trials, stores, coded, commands
)  # fmt: skip


def vectors() -> str:
    """The file."""
    box = {field.name: getattr(BOX, field.name) for field in fields(BOX)}
    settings = {
        "node": NODE, "epoch": EPOCH, "sample_time_s": 2.0, "gains": gains_of(FIRST), "box": box, "sp_min": 0.0,
        "sp_max": 120.0, "co_min": 0.0, "co_max": 100.0, "b": 1.0, "tau_f_s": 0.0, "heartbeat_samples": 5,
        "lease_longest_samples": 6000, "trial_samples": TRIAL, "pv": PV, "co": CO,
        "challenges_in_order": [f"{nonce:012x}" for nonce in NONCES[BEFORE:]],
    }  # fmt: skip
    whole = {
        "what": "docs/developers/protocol.md: what a device answers, from boot with these settings, in auto, sp = pv",
        "protocol": PROTOCOL_VERSION,
        "layout_hash": f"{schema():#06x}",
        "settings": settings,
        "cases": [make().to_dict() for make in CASES],
    }
    return json.dumps(whole, indent=1) + "\n"


# The page


def told(line: str) -> str:
    """A frame in words."""
    id_, _, data = line.partition("#")
    message = can.Message(arbitration_id=int(id_, 16), is_extended_id=False, data=bytes.fromhex(data))
    frame = CODEC.decode(message)
    parts = []
    for name in frame.__slots__:
        value = getattr(frame, name)
        if isinstance(value, float):
            value = f"{value:g}"
        elif name in {"crc", "mac", "schema", "stamp", "key", "nonce"}:
            value = f"{value:#x}"
        elif name == "kind":
            value = Kind(value).name
        elif name == "reason":
            value = Reason(value).name
        elif name == "page":
            value = Page(value).name.lower()
        elif name == "item" and isinstance(frame, Stage | PageItem):
            value = Item(value).name.lower()
        parts.append(f"{name} {value}")
    name = next(name for name, kind in NAMES.items() if kind is type(frame))
    return f"{name}: {', '.join(parts)}"


def session_text() -> str:
    """The session of the page."""
    lines = []
    for step in session().steps:
        if step.why:
            lines.append(f"    # {step.why}")
        if "frame" in step.doing:
            lines.append(f"    -> {step.doing['frame']:<20}  {told(str(step.doing['frame']))}")
        lines += [f"    <- {line:<20}  {told(line)}" for line in step.out]
    return "\n".join(lines) + "\n"


def layout_text() -> str:
    """What the layout hash is made of."""
    shown = schema_lines()
    lines = [f"    {line}" for line in (*shown[:6], "...", *shown[-2:])]
    return f"The constant is **{schema():#06x}**. The input begins and ends like this:\n\n" + "\n".join(lines) + "\n"


def between(page: str, mark: str, text: str) -> str:
    """The page with this text between the marks."""
    begin, end = f"<!-- {mark}: written by scripts/document_protocol.py -->\n", f"<!-- end of {mark} -->"
    before, _, rest = page.partition(begin)
    _, _, after = rest.partition(end)
    return before + begin + "\n" + text + "\n" + end + after


def page(now: str) -> str:
    """The page as it should be."""
    return between(between(now, "layout", layout_text()), "session", session_text())


def main() -> None:
    """Write both."""
    VECTORS.write_text(vectors(), encoding="ascii")
    PAGE.write_text(page(PAGE.read_text(encoding="utf-8")), encoding="utf-8")


if __name__ == "__main__":
    main()
