"""The prepared layout of every frame against cantools, bit for bit, and what it refuses to lay out."""

import math
import random
import struct

import cantools.database
import pytest

from retuner.drivers.protocol.codec import BitLayout, DbcError, _database, plans_of, read_dbc

LAYOUTS = _database().messages
DRAWS = 300


def signals(layout):
    return [signal for signal in layout.signals if signal.name != "CHECKSUM"]


def prepared(layout) -> BitLayout:
    return BitLayout(layout, [signal.name for signal in signals(layout)])


@pytest.mark.parametrize("layout", LAYOUTS, ids=lambda layout: layout.name)
def test_any_bytes_give_cantools_numbers_or_nothing_when_one_is_out_of_range(layout) -> None:
    rng = random.Random(layout.name)
    bits = prepared(layout)
    for _ in range(DRAWS):
        data = rng.randbytes(layout.length)
        reference = layout.decode_simple(data, decode_choices=False)
        expected = [reference[signal.name] for signal in signals(layout)]
        inside = all(s.minimum <= v <= s.maximum for s, v in zip(signals(layout), expected, strict=True))
        got = bits.unpack(data)
        assert (got if got is None else list(got)) == (expected if inside else None)


def test_the_least_sample_time_comes_back_though_its_float_is_a_little_less() -> None:
    (layout,) = [one for one in LAYOUTS if one.name == "IDENTITY"]
    bits = prepared(layout)
    values = [1e-4 if one.name == "sample_time" else 1 for one in signals(layout)]
    back = bits.unpack(bits.pack(values))
    assert back[[one.name for one in signals(layout)].index("sample_time")] == pytest.approx(1e-4)


@pytest.mark.parametrize("layout", LAYOUTS, ids=lambda layout: layout.name)
def test_any_numbers_in_range_give_cantools_bytes(layout) -> None:
    rng = random.Random(layout.name)
    bits = prepared(layout)
    for i in range(DRAWS):
        values = {}
        for signal in signals(layout):
            ends = (signal.minimum, signal.maximum, rng.uniform(signal.minimum, signal.maximum))
            value = ends[min(i, 2)]
            values[signal.name] = value if signal.is_float or signal.scale != 1 else round(value)
        zero = {"CHECKSUM": 0} if len(signals(layout)) < len(layout.signals) else {}
        assert bits.outside(list(values.values())) is None
        data = bits.pack(list(values.values()))
        assert data == layout.encode({**values, **zero}, strict=False)
        assert len(data) == layout.length


def test_what_is_not_finite_is_nothing() -> None:
    layout = _database().get_message_by_name("TELEMETRY_PV")
    pv = next(signal for signal in layout.signals if signal.name == "pv")
    bits = prepared(layout)
    zero = bytearray(bits.pack([max(signal.minimum, 0) for signal in signals(layout)]))
    assert bits.unpack(zero) is not None
    for bad in (math.nan, math.inf, -math.inf):
        data = zero.copy()
        data[pv.start // 8 : pv.start // 8 + 4] = struct.pack("<f", bad)
        assert bits.unpack(data) is None


DBC = """VERSION ""
BU_: A
BO_ 1 F: 8 A
 SG_ s : {signal} "" A
{types}"""


@pytest.mark.parametrize(
    "signal",
    [
        "0|16@1- (0.5,0) [-16384|16383.5]",
        "8|8@1+ (2,10) [10|520]",
        "3|13@1- (1,0) [-4096|4095]",
        "0|1@1+ (1,0) [0|1]",
        "0|40@1+ (0.25,0) [0|1e9]",
        "8|48@1- (1,0) [-1e12|1e12]",
        "0|64@1+ (1,0) [0|1e15]",
        "16|32@1- (1,5) [0|9]",
    ],
)
def test_every_kind_of_whole_number_is_laid_out_as_cantools_does(signal: str) -> None:
    layout = cantools.database.load_string(DBC.format(signal=signal, types=""), "dbc").messages[0]
    bits, rng = BitLayout(layout, ["s"]), random.Random(signal)
    low, high = layout.signals[0].minimum, layout.signals[0].maximum
    for value in (low, high, *(rng.uniform(low, high) for _ in range(50))):
        number = value if layout.signals[0].scale < 1 else round(value)
        data = bits.pack([number])
        assert data == layout.encode({"s": number}, strict=False)
        assert bits.unpack(data)[0] == layout.decode_simple(bytes(data))["s"]


@pytest.mark.parametrize(
    ("signal", "types", "told"),
    [
        ("7|16@0+ (1,0) [0|9]", "", "little-endian"),
        ("0|16@1+ (1,0) [0|0]", "", "no range"),
        ("0|16@1+ (1,0) [0|70000]", "", "does not fit"),
        ("0|16@1- (0.5,0) [-20000|0]", "", "does not fit"),
        ("4|32@1- (1,0) [0|9]", "SIG_VALTYPE_ 1 s : 1;", "byte boundaries"),
        ("0|32@1- (2,0) [0|9]", "SIG_VALTYPE_ 1 s : 1;", "unscaled"),
        ("0|64@1- (1,0) [0|9]", "SIG_VALTYPE_ 1 s : 2;", "float32"),
    ],
)
def test_signals_of_another_kind_are_refused(signal: str, types: str, told: str) -> None:
    database = cantools.database.load_string(DBC.format(signal=signal, types=types), "dbc")
    with pytest.raises(ValueError, match=told):
        BitLayout(database.messages[0], ["s"])


def test_a_limit_with_hundreds_of_digits_is_refused_in_one_line() -> None:
    text = _database().as_dbc_string().replace("[0|255]", f"[0|{'9' * 400}]")
    with pytest.raises(DbcError, match=r"x\.dbc: ") as caught:
        plans_of(read_dbc(text, "x.dbc"), "x.dbc")
    assert len(str(caught.value).splitlines()) == 1
