"""No signal, object or bit of a device is two things: every pair of roles is refused, and what may be shared is not."""

from dataclasses import replace
from itertools import combinations
from pathlib import Path

import pytest

from retuner.drivers.canopen.canopen_access import CanOpenAccess
from retuner.drivers.canopen.eds_file import EdsFile, read_eds
from retuner.drivers.dbc.dbc_access import DbcAccess
from retuner.drivers.dbc.dbc_file import DbcFile, bits_of, read_dbc_file
from retuner.drivers.profiles.controller_access import ProfileError
from retuner.drivers.profiles.mapping import DeviceMapping, GainAt, ObjectOf, Protection, SignalOf, States
from retuner.schedule.vendor_units import Quantity

SIGNALS = ("Pv", "Co", "Sp", "Mode", "Stop", "Setpoint", "Kp", "Ki", "Count", "Crc", "Spare")
DBC = 'VERSION ""\nNS_ :\nBS_:\nBU_: host drive\n' + "".join(
    f'BO_ {100 + i} {name}Frame: 8 drive\n SG_ {name} : 8|16@1+ (0.01,0) [0|0] "" host\n'
    ' SG_ Fixed : 40|8@1+ (1,0) [0|0] "" host\n\n'
    for i, name in enumerate(SIGNALS)
)
TWINS = """
BO_ 105 Other: 8 drive
 SG_ Low : 0|9@1+ (1,0) [0|0] "" host
 SG_ High : 24|8@1+ (1,0) [0|0] "" host
 SG_ Motorola : 15|4@0+ (1,0) [0|0] "" host

BO_ 200 Pages: 8 drive
 SG_ Id M : 0|8@1+ (1,0) [0|0] "" host
 SG_ A m1 : 8|16@1+ (0.01,0) [0|0] "" host
 SG_ B m2 : 8|16@1+ (0.01,0) [0|0] "" host

"""


def signal(name: str) -> SignalOf:
    return SignalOf(f"{name}Frame", name)


ROLES = {
    "pv": lambda m, at: replace(m, pv=at),
    "co": lambda m, at: replace(m, co=at),
    "sp": lambda m, at: replace(m, sp=at),
    "setpoint": lambda m, at: replace(m, setpoint=at),
    "mode": lambda m, at: replace(m, mode=States(at, (1,))),
    "stop": lambda m, at: replace(m, stops=(States(at, (0,)),)),
    "gains.kp": lambda m, at: replace(m, gains=(GainAt(Quantity.KP, at, at), m.gains[1])),
    "gains.ki": lambda m, at: replace(m, gains=(m.gains[0], GainAt(Quantity.KI, at, at))),
}
SHARED = {frozenset({"sp", "setpoint"}), frozenset({"mode", "stop"})}
PAIRS = [pytest.param(a, b, id=f"{a} and {b}") for a, b in combinations(ROLES, 2)]
MAPPING = DeviceMapping(
    signal("Pv"),
    signal("Co"),
    (GainAt(Quantity.KP, signal("Kp"), signal("Kp")), GainAt(Quantity.KI, signal("Ki"), signal("Ki"))),
    sp=signal("Sp"),
    mode=States(signal("Mode"), (1,)),
    stops=(States(signal("Stop"), (0,)),),
    setpoint=signal("Setpoint"),
)


@pytest.fixture
def file(tmp_path: Path) -> DbcFile:
    path = tmp_path / "drive.dbc"
    path.write_text(DBC + TWINS)
    return DbcFile(read_dbc_file(path), path.name)


def test_the_mapping_itself_is_taken(file: DbcFile) -> None:
    assert DbcAccess(file, MAPPING).reads_back


@pytest.mark.parametrize(("one", "other"), PAIRS)
def test_two_roles_on_one_signal_are_refused(file: DbcFile, one: str, other: str) -> None:
    both = ROLES[other](ROLES[one](MAPPING, signal("Spare")), signal("Spare"))
    if {one, other} in SHARED:
        assert DbcAccess(file, both).telemetry
        return
    with pytest.raises(ProfileError, match=r"SpareFrame\.Spare is both") as refused:
        DbcAccess(file, both)
    assert {one, other} <= {word.strip(",;") for word in str(refused.value).split()}


@pytest.mark.parametrize("name", ["Low", "Motorola"])
def test_signals_of_two_messages_of_one_identifier_that_share_bits_are_refused(file: DbcFile, name: str) -> None:
    at = SignalOf("Other", name)
    with pytest.raises(ProfileError, match="share bits"):
        DbcAccess(file, ROLES["gains.kp"](MAPPING, at))
    assert DbcAccess(file, ROLES["gains.kp"](MAPPING, SignalOf("Other", "High"))).reads_back


def test_pages_of_a_multiplexed_message_are_places_of_their_own(file: DbcFile) -> None:
    a, b = SignalOf("Pages", "A"), SignalOf("Pages", "B")
    assert DbcAccess(file, ROLES["gains.ki"](ROLES["gains.kp"](MAPPING, a), b)).reads_back
    with pytest.raises(ProfileError, match="both"):
        DbcAccess(file, ROLES["gains.ki"](ROLES["gains.kp"](MAPPING, a), a))


def test_a_fixed_value_counter_or_checksum_where_a_number_is_written_is_refused(file: DbcFile) -> None:
    assert DbcAccess(file, replace(MAPPING, fixed={"KpFrame.Fixed": 1.0})).reads_back
    with pytest.raises(ProfileError, match=r"KpFrame\.Kp is both gains\.kp and fixed"):
        DbcAccess(file, replace(MAPPING, fixed={"KpFrame.Kp": 1.0}))
    for protection in (
        Protection("KpFrame", counter="Kp"),
        Protection("KpFrame", "", "Kp", "crc16_ccitt"),
        Protection("SpareFrame", "Spare", "Spare", "crc16_ccitt"),
    ):
        with pytest.raises(ProfileError):
            DbcAccess(file, replace(MAPPING, protected=(protection,)))


def test_the_bits_of_a_signal_are_those_that_it_writes(file: DbcFile) -> None:
    for layout in (file.layout("Other", ()), file.layout("KpFrame", ())):
        for one in layout.signals:
            most = {other.name: 0.0 for other in layout.signals}
            most[one.name] = one.offset + one.scale * ((1 << one.length) - 1)
            data = int.from_bytes(layout.encode(most), "little")
            assert {bit for bit in range(64) if data >> bit & 1} == set(bits_of(one))


def variable(index: int, name: str) -> str:
    return f"[{index:X}]\nParameterName={name}\nObjectType=0x7\nDataType=0x0004\nAccessType=rw\nPDOMapping=0\n\n"


def test_two_roles_on_one_object_are_refused(tmp_path: Path) -> None:
    names = (*SIGNALS[:8], "Spare")
    objects = "".join(f"{i + 1}=0x{0x2000 + i:X}\n" for i in range(len(names)))
    path = tmp_path / "drive.eds"
    path.write_text(
        f"[DeviceInfo]\nNrOfTXPDO=0\n\n[OptionalObjects]\nSupportedObjects={len(names)}\n{objects}\n"
        + "".join(variable(0x2000 + i, name) for i, name in enumerate(names))
    )
    eds = EdsFile(read_eds(path, 1), path.name, 1)
    at = {name: ObjectOf(name) for name in names}
    plain = DeviceMapping(at["Pv"], at["Co"], (GainAt(Quantity.KP, at["Kp"]), GainAt(Quantity.KI, at["Ki"])))
    for role, name in (("sp", "Sp"), ("setpoint", "Setpoint"), ("mode", "Mode"), ("stop", "Stop")):
        plain = ROLES[role](plain, at[name])
    assert CanOpenAccess(eds, plain).reads_back
    for one, other in combinations(ROLES, 2):
        both = ROLES[other](ROLES[one](plain, at["Spare"]), ObjectOf("2008"))
        if {one, other} in SHARED:
            assert CanOpenAccess(eds, both).reads_back
            continue
        with pytest.raises(ProfileError, match=r"2008:0 is both"):
            CanOpenAccess(eds, both)
