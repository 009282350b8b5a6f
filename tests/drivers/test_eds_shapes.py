"""EDS files of other shapes: records, arrays, plain variables, 8 and 24 bits, limits, PDOs out of the way, damage."""

import random
import struct
from dataclasses import replace
from pathlib import Path

import can
import pytest

from retuner import LinearProcess, PidGains
from retuner.drivers.canopen.canopen_access import CanOpenAccess, NodeSettings
from retuner.drivers.canopen.eds_file import EdsFile, holds, read_eds
from retuner.drivers.canopen.virtual_node import VirtualCanOpenNode
from retuner.drivers.controller.firmware_settings import VirtualDeviceSettings
from retuner.drivers.plants.linear_plant import LinearPlant
from retuner.drivers.profiles.bench_loop import BenchLoop
from retuner.drivers.profiles.controller_access import Acknowledged, Denied, Heard, ProfileError
from retuner.drivers.profiles.mapping import DeviceMapping, GainAt, ObjectOf
from retuner.schedule.vendor_units import Quantity

PROFILES = Path(__file__).parents[2] / "drivers" / "profiles"


def variable(index: str, name: str, kind: int, access: str = "rw", *more: str) -> str:
    lines = [f"[{index}]", f"ParameterName={name}", "ObjectType=0x7", f"DataType=0x{kind:04X}", f"AccessType={access}"]
    return "\n".join([*lines, *more, "PDOMapping=1", "", ""])


def group(index: str, name: str, kind: int, subs: int) -> str:
    return f"[{index}]\nParameterName={name}\nObjectType=0x{kind:X}\nSubNumber={subs}\n\n"


PDO = (
    group("1800", "TPDO", 9, 3)
    + variable("1800sub0", "n", 5, "ro", "DefaultValue=2")
    + variable("1800sub1", "COB-ID", 7, "rw", "DefaultValue=$NODEID+{cob}")
    + variable("1800sub2", "type", 5, "rw", "DefaultValue=255")
    + group("1A00", "map", 9, 3)
    + variable("1A00sub0", "n", 5, "rw", "DefaultValue=2")
    + variable("1A00sub1", "1", 7, "rw", "DefaultValue=0x20000008")
    + variable("1A00sub2", "2", 7, "rw", "DefaultValue=0x20010110")
)
EDS = (
    "[DeviceInfo]\nNrOfTXPDO=1\n\n[OptionalObjects]\nSupportedObjects=8\n1=0x2000\n2=0x2001\n3=0x2002\n4=0x2003\n"
    "5=0x2004\n6=0x2005\n7=0x1800\n8=0x1A00\n\n"
    + variable("2000", "Speed", 2, "ro")
    + group("2001", "Output", 9, 2)
    + variable("2001sub0", "n", 5, "const", "DefaultValue=1")
    + variable("2001sub1", "Torque", 3, "ro")
    + variable("2002", "Kp", 6, "rw", "LowLimit=1", "HighLimit=255")
    + variable("2003", "Ki", 0x10)
    + variable("2004", "Name", 9, "ro")
    + variable("2005", "Long", 0x11)
)
MAPPING = DeviceMapping(
    ObjectOf("2000"),
    ObjectOf("Output:1", 0.1),
    (GainAt(Quantity.KP, ObjectOf("2002"), ObjectOf("2002"), 0.01), GainAt(Quantity.KI, ObjectOf("2003"), scale=0.001)),
)


def read(tmp_path: Path, text: str, node: int = 9) -> EdsFile:
    path = tmp_path / "node.eds"
    path.write_text(text, encoding="latin-1")
    return EdsFile(read_eds(path, node), path.name, node)


def test_limits_are_those_of_the_type_and_of_the_file(tmp_path: Path) -> None:
    file = read(tmp_path, EDS + PDO.format(cob="0x180"))
    kp, ki = holds(file.variable("2002", ())), holds(file.variable("2003", ()))
    assert (kp.low, kp.high, kp.step) == (1.0, 255.0, 1.0)
    assert (ki.low, ki.high) == (-(2.0**23), 2.0**23 - 1)


def test_a_pdo_tells_signed_numbers_of_8_and_16_bits(tmp_path: Path) -> None:
    access = CanOpenAccess(read(tmp_path, EDS + PDO.format(cob="0x180")), MAPPING)
    assert access.on_request == frozenset()
    data = struct.pack("<bh", -3, -250)
    told = access.take(can.Message(arbitration_id=0x189, is_extended_id=False, data=data))
    assert [one for one in told if isinstance(one, Heard)] == [Heard("pv", -3.0), Heard("co", -25.0)]


def test_a_disabled_pdo_is_not_waited_for(tmp_path: Path) -> None:
    access = CanOpenAccess(read(tmp_path, EDS + PDO.format(cob="0x80000180")), MAPPING)
    assert access.on_request == {"pv", "co"}
    access.ask(access.on_request)
    (first,) = access.due(0.0)
    assert first.arbitration_id == 0x609
    assert first.data[0] == 0x40


def test_a_24_bit_number_goes_and_comes_back(tmp_path: Path) -> None:
    access = CanOpenAccess(read(tmp_path, EDS + PDO.format(cob="0x180")), MAPPING)
    numbers = access.units.numbers(PidGains(2.0, 3.0))
    assert numbers == {"kp": 200.0, "ki": 3000.0}
    access.put({"ki": numbers["ki"]})
    (request,) = access.due(0.0)
    assert bytes(request.data) == bytes([0x27, 0x03, 0x20, 0]) + (3000).to_bytes(3, "little") + b"\0"
    answer = can.Message(arbitration_id=0x589, is_extended_id=False, data=bytes([0x60, 3, 0x20, 0, 0, 0, 0, 0]))
    assert Acknowledged("ki") in access.take(answer)
    access.ask(["ki"])
    access.due(0.1)
    upload = bytes([0x47, 3, 0x20, 0]) + (3000).to_bytes(3, "little") + b"\0"
    assert Heard("ki", 3000.0) in access.take(can.Message(arbitration_id=0x589, is_extended_id=False, data=upload))


def test_an_abort_is_told_in_words(tmp_path: Path) -> None:
    access = CanOpenAccess(read(tmp_path, EDS + PDO.format(cob="0x180")), MAPPING)
    access.put({"kp": 20.0})
    access.due(0.0)
    abort = bytes([0x80, 2, 0x20, 0]) + (0x06090030).to_bytes(4, "little")
    told = access.take(can.Message(arbitration_id=0x589, is_extended_id=False, data=abort))
    (denied,) = [one for one in told if isinstance(one, Denied)]
    assert denied == Denied("kp", "object 2002:0: abort 0x06090030, value range of parameter exceeded")


def test_the_host_keeps_its_own_heartbeat(tmp_path: Path) -> None:
    file = read(tmp_path, EDS + PDO.format(cob="0x180"))
    access = CanOpenAccess(file, MAPPING, NodeSettings(heartbeat_s=1.0, own_node=100))
    beats = [frame for k in range(31) for frame in access.due(0.1 * k) if frame.arbitration_id == 0x764]
    assert {bytes(frame.data) for frame in beats} == {b"\5"}
    assert len(beats) in {3, 4}  # in 3 s, with tenths that are no binary fractions


OBJECT_2001 = group("2001", "Output", 9, 2)
OTHER_HANDS = {
    "a byte-order mark": lambda text: ("\ufeff" + text).encode(),
    "UTF-16": lambda text: text.encode("utf-16"),
    "lone carriage returns": lambda text: text.replace("\n", "\r").encode(),
    "the end-of-file mark of DOS": lambda text: (text + "\x1a").encode(),
    "SUB in capitals": lambda text: text.replace("sub", "SUB").encode(),
    "parts of an object without a section": lambda text: text.replace(OBJECT_2001, "").encode(),
    "an empty baud rate": lambda text: text.replace("[DeviceInfo]\n", "[DeviceInfo]\nBaudRate_500=\n").encode(),
    "Latin-1": lambda text: text.replace("=Speed", "=Geschwindigkeit \xfc").encode("latin-1"),
}


@pytest.mark.parametrize("shape", OTHER_HANDS)
def test_files_as_other_tools_write_them_say_the_same(shape: str, tmp_path: Path) -> None:
    path = tmp_path / "node.eds"
    path.write_bytes(OTHER_HANDS[shape](EDS + PDO.format(cob="0x180")))
    by_number = replace(MAPPING, co=ObjectOf("2001:1", 0.1))
    access = CanOpenAccess(EdsFile(read_eds(path, 9), path.name, 9), by_number)
    told = access.take(can.Message(arbitration_id=0x189, is_extended_id=False, data=struct.pack("<bh", -3, -250)))
    assert [one for one in told if isinstance(one, Heard)] == [Heard("pv", -3.0), Heard("co", -25.0)]


def test_names_keep_their_accents(tmp_path: Path) -> None:
    for code in ("utf-8", "latin-1"):
        path = tmp_path / "node.eds"
        path.write_bytes(EDS.replace("=Speed", "=Vitesse r\xe9elle").encode(code))
        assert EdsFile(read_eds(path, 9), path.name, 9).variable("Vitesse r\xe9elle", ()).index == 0x2000


def test_a_virtual_node_whose_eds_has_a_heartbeat_runs_by_its_samples(tmp_path: Path) -> None:
    text = (EDS + PDO.format(cob="0x180")).replace("SupportedObjects=8", "SupportedObjects=9\n9=0x1017")
    file = read(tmp_path, text + variable("1017", "Producer heartbeat time", 6, "rw", "DefaultValue=1000"))
    settings = VirtualDeviceSettings(PidGains(2.0, 3.0), node=9)
    loop = BenchLoop(settings, LinearPlant(LinearProcess(1.0, (5.0,)), start_pv=50.0))
    node = VirtualCanOpenNode(file, MAPPING, loop)
    node.receive(can.Message(arbitration_id=0, is_extended_id=False, data=[1, 9]))
    beats = [message for _ in range(10) for message in node.step() if message.arbitration_id == 0x709]
    assert [bytes(message.data) for message in beats] == [b"\5", b"\5"]


WRONG = [
    ("2004", "object 2004:0 (Name) is not a number of at most 8 bytes"),
    ("2001", "object 2001 has parts; name one: 2001:1 (Torque)"),
    ("2001:x", "object 2001 has no part 'x'"),
    ("7777", "no object '7777'; there is"),
    ("No such name", "no object 'No such name'"),
]


@pytest.mark.parametrize(("name", "told"), WRONG)
def test_what_cannot_be_used_is_told(name: str, told: str, tmp_path: Path) -> None:
    file = read(tmp_path, EDS)
    with pytest.raises(ProfileError) as wrong:
        file.variable(name, ("pv",))
    assert told in str(wrong.value)
    assert wrong.value.key[0] == "pv"


def test_node_numbers_are_those_of_canopen(tmp_path: Path) -> None:
    with pytest.raises(ProfileError, match="CANopen nodes are 1 to 127"):
        read(tmp_path, EDS, 0)


@pytest.mark.parametrize("seed", range(40))
def test_damaged_files_are_one_line_or_work(seed: int, tmp_path: Path) -> None:
    draw = random.Random(seed)
    raw = bytearray((PROFILES / draw.choice(["cia404.eds", "e35.eds"])).read_bytes())
    for _ in range(draw.randint(1, 30)):
        raw[draw.randrange(len(raw))] = draw.randrange(256)
    cut = raw[: draw.randrange(len(raw))] if seed % 2 else raw
    path = tmp_path / "damaged.eds"
    path.write_bytes(bytes(cut))
    told = ""
    try:
        file = EdsFile(read_eds(path, 5), path.name, 5)
        list(file.tpdos())
        file.variable("6130:1", ())
    except ProfileError as error:
        told = str(error)
    assert "\n" not in told
