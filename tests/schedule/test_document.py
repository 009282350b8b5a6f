"""The gain table as TOML: exact round trip, readable, strict, and nothing but ValueError for garbage."""

from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from retuner import GainTable, Lookup, PidGains, Regions
from retuner.schedule.document import SCHEMA, from_toml, to_toml

TABLE = GainTable(
    "oven",
    Regions("sp", "degC", ("cold", "hot"), 20.0, (80.5,), 220.0, 2.0, 60.0),
    (PidGains(1.5, 0.01), PidGains(0.1 + 0.2, 0.0, 1e-7)),
    Lookup.HARD,
    3,
)
TEXT = to_toml(TABLE)


def test_the_text_as_people_see_it():
    assert TEXT.split("\n", 3)[3] == (
        """\
schema = 1
loop = "oven"
revision = 3
lookup = "hard"  # hard or interpolated

[schedule]
variable = "sp"
unit = "degC"
low = 20.0
bounds = [80.5]
high = 220.0
hysteresis = 2.0  # each way, in unit
min_stay_s = 60.0

[[region]]  # 20 to 80.5 degC
name = "cold"
kp = 1.5
ki = 0.01
kd = 0.0
form = "parallel"
# ideal form: kc = 1.5, tau_i = 150 s, tau_d = 0 s

[[region]]  # 80.5 to 220 degC
name = "hot"
kp = 0.30000000000000004
ki = 0.0
kd = 1e-07
form = "parallel"
# ideal form: kc = 0.3, no integral action, tau_d = 3.333e-07 s
"""
    )


def test_a_change_of_one_set_is_a_small_diff():
    changed = to_toml(TABLE.with_gains("cold", PidGains(1.6, 0.01)))
    lines = [(a, b) for a, b in zip(TEXT.split("\n"), changed.split("\n"), strict=True) if a != b]

    assert [b.split(" = ")[0] for _, b in lines] == ["revision", "kp", "# ideal form: kc"]


def test_pure_integral_has_no_ideal_form():
    text = to_toml(replace(TABLE, gains=(PidGains(0.0, 0.5), PidGains(0.0, 0.25))))

    assert text.count("# no ideal form") == 2
    assert from_toml(text).gains[0] == PidGains(0.0, 0.5)


def test_whole_numbers_may_be_written_for_numbers():
    assert from_toml(TEXT.replace("kp = 1.5", "kp = 2")).gains[0].kp == 2.0


@pytest.mark.parametrize(
    ("old", "new", "what"),
    [
        ("schema = 1", "schema = 2", "line 4: schema = 2 is unknown; this version reads schema = 1"),
        ("schema = 1", "schema = true", "line 4: schema = True must be a whole number"),
        ("schema = 1\n", "", "schema is missing"),
        ('loop = "oven"', "loop = 1979-05-27", "line 5: loop = datetime.date"),
        ('loop = "oven"', 'loop = ""', "loop = '' must be a name"),
        ("revision = 3", "revision = 3.0", "line 6: revision = 3.0 must be a whole number"),
        ("revision = 3", "revision = -3", "revision = -3 must be 0 or more"),
        ('"hard"', '"soft"', "line 7: lookup = 'soft' is unknown; use hard or interpolated"),
        ("[schedule]", "[schedules]", "line 9, schedules|'schedules' is unknown here"),
        ('"sp"', '"temperature"', "line 9, schedule: variable = 'temperature' is unknown"),
        ("bounds = [80.5]", "bounds = 80.5", "line 13, schedule: bounds = 80.5 must be a list of numbers"),
        ("bounds = [80.5]", "bounds = ['a']", r"line 13, schedule: bounds = \['a'\] must be a number"),
        ("bounds = [80.5]", "bounds = [nan]", "line 13, schedule: bounds = nan is not a finite number"),
        ("bounds = [80.5]", "bounds = []", "line 9, schedule: 0 bounds make 1 regions, not 2"),
        ("hysteresis = 2.0", "hysteresis = 40", "line 9, schedule: hysteresis = 40.0 must be 0 to half"),
        ("hysteresis = 2.0", "hysterisis = 2.0", "line 15, schedule: 'hysterisis' is unknown here; known are variable"),
        ("min_stay_s = 60.0", "", "line 9, schedule: min_stay_s is missing"),
        ('name = "cold"', 'name = "hot"', "line 9, schedule: names = .* must be different"),
        ("kp = 1.5", "kp = nan", "line 20, region 0: kp = nan is not a finite number"),
        ("kp = 1.5", "kp = -1.5", "line 18, region 0: kp = -1.5, ki = 0.01, kd = 0.0 have different signs"),
        ("kp = 1.5", "kp = false", "line 20, region 0: kp = False must be a number"),
        ("kp = 1.5", "kp = 1" + "0" * 400, "line 20, region 0: kp = 10+... is not a finite number"),
        ("kp = 0.3", "kc = 0.3", "line 28, region 1: 'kc' is unknown here; known are name, form, kp, ki, kd"),
        ("ki = 0.0\n", "", "line 26, region 1: ki is missing"),
        ('form = "parallel"', 'form = "ideal"', "line 23, region 0: form = 'ideal': a gain table holds 'parallel'"),
        ("kp = 1.5", "kp = ", r"not TOML: Invalid value \(at line 20, column 6\)"),
        ("kp = 1.5", "kp = 1.5\nkp = 2", r"not TOML: Cannot overwrite a value \(at line 21"),
    ],
)
def test_a_mistake_is_named_with_its_line(old, new, what):
    assert old in TEXT
    with pytest.raises(ValueError, match=what) as caught:
        from_toml(TEXT.replace(old, new, 1))

    assert "\n" not in str(caught.value)


def test_a_direction_that_differs_is_a_mistake():
    with pytest.raises(ValueError, match="act in different directions"):
        from_toml(TEXT.replace("kp = 1.5\nki = 0.01", "kp = -1.5\nki = -0.01"))


@pytest.mark.parametrize(
    "text",
    [
        "",
        "a = 1",
        "[[[",
        "x = " + "[" * 100_000,
        "schema = " + "9" * 10_000,
        f"schema = {SCHEMA}",
        f"schema = {SCHEMA}\nregion = 1",
        f"schema = {SCHEMA}\nregion = [1]",
        f"schema = {SCHEMA}\nregion = []",
        f"schema = {SCHEMA}\nschedule = 1\n[[region]]\nname = 'a'\nform = 'parallel'\nkp = 1\nki = 0\nkd = 0",
        f"schema = {SCHEMA}\n[region]\nname = 'a'",
        "\ud800",
        "\x00",
    ],
)
def test_garbage_is_refused_with_one_line(text):
    with pytest.raises(ValueError, match=r"\S") as caught:
        from_toml(text)

    assert "\n" not in str(caught.value)
    assert len(str(caught.value)) < 300


@given(st.text())
def test_any_text_is_refused_with_value_error(text):
    with pytest.raises(ValueError, match=r"\S"):
        from_toml(text)


values = st.recursive(
    st.none().map(lambda _: "nan")
    | st.integers().map(str)
    | st.floats().map(repr)
    | st.sampled_from(("true", '"parallel"', "'hard'", "1979-05-27", "07:32:00", '"""\n[[region]]\n"""')),
    lambda inner: st.lists(inner, max_size=3).map(lambda v: f"[{', '.join(v)}]") | inner.map(lambda v: f"{{a = {v}}}"),
    max_leaves=4,
)


@given(st.sampled_from([line for line in TEXT.splitlines() if " = " in line and line[0] != "#"]), values)
def test_any_value_for_any_key_is_a_table_or_a_value_error(line, value):
    text = TEXT.replace(line, f"{line.split(' = ')[0]} = {value}", 1)
    try:
        table = from_toml(text)
    except ValueError as error:
        message = str(error)
    else:
        message = ""
        assert from_toml(to_toml(table)) == table
    assert "\n" not in message
    assert len(message) < 500
