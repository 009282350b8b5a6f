"""docs/developers/protocol.md and the test vectors: they are what the code does, and the firmware in C does it too."""

import json
import runpy
from importlib.resources import files
from pathlib import Path
from typing import Any

import can
import pytest
from bus_simulation.firmware import FIRMWARE, FirmwareDevice

from retuner.drivers.controller.virtual_device import VirtualDevice, VirtualDeviceSettings
from retuner.drivers.protocol.checksum import crc8
from retuner.drivers.protocol.codec import schema
from retuner.drivers.protocol.frames import PROTOCOL_VERSION, GainBox
from retuner.schedule.gains import PidGains

ROOT = Path(__file__).resolve().parents[2]
SCRIPT = runpy.run_path(str(ROOT / "scripts" / "document_protocol.py"), run_name="script")
VECTORS = json.loads(files("retuner.drivers").joinpath("protocol_vectors.json").read_text(encoding="ascii"))


def device(make: Any, case: dict[str, Any]) -> Any:
    """As the file says it is set up; the challenges come one by one, from the first boot on."""
    told = dict(VECTORS["settings"])
    epoch, pv, co = (told.pop(name) for name in ("epoch", "pv", "co"))
    challenges = [int(text, 16) for text in told.pop("challenges_in_order")]
    nonces = iter(challenges if make is FirmwareDevice else [0, *challenges])  # it boots before it restarts
    plant = type("Rest", (), {"pv": pv, "step": lambda *_: pv, "steady_co": lambda *_: co})()
    given = {**told, "gains": PidGains(*told["gains"]), "box": GainBox(**told["box"])}
    key = None if case["key"] is None else bytes.fromhex(case["key"])
    if make is VirtualDevice:
        made = make(VirtualDeviceSettings(**given, key=key), plant, epoch - 1, lambda: next(nonces))
        made.restart()
        return made
    return make(VirtualDeviceSettings(**given, key=key), plant, epoch, lambda: next(nonces))


def state_of(device: Any) -> dict[str, Any]:
    def plain(content: Any) -> list[float]:
        return [content.seq, content.gains.kp, content.gains.ki, content.gains.kd]

    return {
        "running": plain(device.running),
        "confirmed": plain(device.pages.confirmed),
        "latest": device.pages.latest,
        "owner": device.lease.owner,
        "refused": device.refused,
    }


@pytest.mark.parametrize("make", [VirtualDevice, FirmwareDevice])
@pytest.mark.parametrize("case", VECTORS["cases"], ids=lambda case: case["name"])
def test_every_vector_is_answered_byte_by_byte(make: Any, case: dict[str, Any]) -> None:
    dev = device(make, case)
    for number, step in enumerate(case["steps"]):
        if "frame" in step:
            id_, _, data = step["frame"].partition("#")
            out = dev.receive(can.Message(arbitration_id=int(id_, 16), is_extended_id=False, data=bytes.fromhex(data)))
        elif "sample" in step:
            out = dev.step()
        else:
            dev.restart()
            assert dev.epoch == step["restart"]
            out = []
        assert [(m.arbitration_id, bytes(m.data).hex().upper()) for m in out] == [
            (int(line[:3], 16), line[4:]) for line in step["out"]
        ], f"step {number}: {step}"
    assert state_of(dev) == case["state"]


def test_the_file_is_in_step_with_the_code() -> None:
    assert json.loads(SCRIPT["vectors"]()) == VECTORS, "run: python scripts/document_protocol.py"


def test_the_page_is_in_step_with_the_code() -> None:
    page = (ROOT / "docs" / "developers" / "protocol.md").read_text(encoding="utf-8")
    assert SCRIPT["page"](page) == page, "run: python scripts/document_protocol.py"


def test_version_and_layout_are_the_same_everywhere() -> None:
    header = (FIRMWARE / "retuner_device.h").read_text(encoding="ascii")
    assert f"#define RT_PROTOCOL_VERSION {PROTOCOL_VERSION}u" in header
    assert f"#define RT_LAYOUT_HASH {schema():#06x}u" in header
    assert (VECTORS["protocol"], VECTORS["layout_hash"]) == (PROTOCOL_VERSION, f"{schema():#06x}")
    page = (ROOT / "docs" / "developers" / "protocol.md").read_text(encoding="utf-8")
    assert f"# The CAN protocol, version {PROTOCOL_VERSION}\n" in page


def test_every_chapter_of_a_vector_is_one_of_the_page() -> None:
    page = (ROOT / "docs" / "developers" / "protocol.md").read_text(encoding="utf-8")
    assert {case["chapter"] for case in VECTORS["cases"]} <= {
        line.removeprefix("## ") for line in page.splitlines() if line.startswith("## ")
    }


def test_check_values_of_the_page() -> None:
    import binascii
    import zlib

    nine = b"123456789"
    assert (crc8(nine), binascii.crc_hqx(nine, 0xFFFF), zlib.crc32(nine)) == (0x4B, 0x29B1, 0xCBF43926)
