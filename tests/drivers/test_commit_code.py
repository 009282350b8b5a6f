"""Commits with a code: nothing runs without the right one, replay and downgrade fail."""

import hashlib
import struct

import pytest
from speaking import FIRST, OWNER, SECOND, acks, commit, device, say, stage, step

from retuner.drivers.controller.virtual_device import VirtualDevice
from retuner.drivers.device import WriteDone, WriteFailed
from retuner.drivers.host.can_settings import CanDeviceSettings
from retuner.drivers.protocol.authentication import code_frames, commit_code
from retuner.drivers.protocol.frames import Abort, Auth, Challenge, Flags, Frame, Heartbeat, Page, Read, Reason

KEY = bytes(range(16))


def code_of(dev: VirtualDevice, seq: int, key: bytes = KEY) -> list[Auth]:
    (challenge,) = say(dev, Read(Page.CHALLENGE, 5))
    assert isinstance(challenge, Challenge)
    return code_frames(commit_code(key, 1, dev.epoch, challenge.nonce, OWNER, seq, dev.running.seq, SECOND), seq)


def attempt(dev: VirtualDevice, seq: int, codes: list[Frame]) -> list[Reason]:
    said = say(dev, *stage(seq, SECOND), *codes, commit(seq, SECOND, dev.running.seq, dev.epoch))
    return acks([*said, *step(dev)])


def test_the_code_is_hmac_sha_256_over_everything_that_counts() -> None:
    right = commit_code(KEY, 1, 2, 3, 4, 5, 6, SECOND)
    said = b"retuner commit 2" + struct.pack("<BHQHHHfff", 1, 2, 3, 4, 5, 6, SECOND.kp, SECOND.ki, SECOND.kd)
    padded = KEY + bytes(48)  # RFC 2104: H((K xor opad) H((K xor ipad) m)), blocks of 64 bytes
    inner = hashlib.sha256(bytes(b ^ 0x36 for b in padded) + said).digest()
    outer = hashlib.sha256(bytes(b ^ 0x5C for b in padded) + inner).digest()
    assert right == int.from_bytes(outer[:12], "little")
    others = [
        commit_code(KEY, *numbers, SECOND)
        for numbers in (
            (2, 2, 3, 4, 5, 6),
            (1, 3, 3, 4, 5, 6),
            (1, 2, 4, 4, 5, 6),
            (1, 2, 3, 5, 5, 6),
            (1, 2, 3, 4, 6, 6),
            (1, 2, 3, 4, 5, 7),
        )
    ]
    others += [commit_code(KEY, 1, 2, 3, 4, 5, 6, FIRST), commit_code(KEY[::-1], 1, 2, 3, 4, 5, 6, SECOND)]
    assert len({right, *others}) == 9


def test_a_wrong_code_is_told_until_the_restart_and_changes_nothing() -> None:
    dev = device(key=KEY)
    assert not next(f for f in step(dev) if isinstance(f, Heartbeat)).flags & Flags.WRONG_CODE
    assert attempt(dev, 1, code_of(dev, 1, b"?" * 16)) == [Reason.WRONG_CODE]
    (beat,) = [f for f in say(dev, Read(Page.IDENTITY, 1)) if isinstance(f, Heartbeat)]
    assert beat.flags & Flags.WRONG_CODE
    dev.restart()
    assert not next(f for f in step(dev) if isinstance(f, Heartbeat)).flags & Flags.WRONG_CODE


def test_a_code_held_back_is_worth_nothing_once_its_number_is_fenced_off_and_has_come_round_again() -> None:
    """Somebody who jams and records a commit, and then drives the numbers round with aborts, which anybody may send."""
    dev = device(key=KEY)
    held_back = code_of(dev, 1)
    assert acks(say(dev, *stage(1, SECOND), Abort(1))) == [Reason.OK]
    assert acks(say(dev, Abort(1 + 32767), Abort((1 + 65534) % 65536))) == [Reason.OK, Reason.OK]
    assert attempt(dev, 1, held_back) == [Reason.WRONG_CODE]
    assert dev.running.gains == FIRST


@pytest.mark.parametrize(
    ("host", "firmware", "reason"),
    [(KEY, KEY, ""), (KEY[::-1], KEY, "wrong code"), (None, KEY, "no code"), (KEY, None, "the device demands no code")],
)
def test_host_and_device_need_the_same_key(make_bench, host, firmware, reason: str) -> None:
    bench = make_bench(host=CanDeviceSettings(key=host), key=firmware)
    bench.run(6)
    bench.host.begin_write(bench.SECOND, bench.now_s)
    (outcome,) = [e for e in bench.run(20) if isinstance(e, (WriteDone, WriteFailed))]
    assert isinstance(outcome, WriteDone) == (reason == "")
    assert isinstance(outcome, WriteDone) or reason in outcome.reason
    assert outcome.running.gains == bench.device.running.gains


def test_keys_do_not_show() -> None:
    assert "key" not in repr(CanDeviceSettings(key=KEY))
    assert "key" not in repr(device(key=KEY).settings)
