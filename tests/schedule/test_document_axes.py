"""The gain table with filtered axes and with two: exact round trip, any order of sets, mistakes with their line."""

from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st

from retuner import GainTable, Lookup, PidGains
from retuner.schedule.document import from_toml, to_toml
from retuner.schedule.regions import CAN, VARIABLES, Axis, Regions

HEAT = Axis("sp", "degC", 20.0, (80.5,), 220.0, 2.0, 60.0)
FLOW = Axis("can", "%", 0.0, (50.0,), 100.0, 5.0, 0.0, 10.0, "flow")
TABLE = GainTable(
    "boiler",
    Regions.along(("a", "b", "c", "d"), HEAT, FLOW),
    tuple(PidGains(1.0 + i, 0.1) for i in range(4)),
    Lookup.INTERPOLATED,
    3,
)
TEXT = to_toml(TABLE)

printable = st.text(st.characters(exclude_categories=("C", "Z")), min_size=1, max_size=20)
sizes = st.just(0.0) | st.floats(1e-300, 1e300)


@st.composite
def some_axes(draw):
    edges = sorted(draw(st.lists(st.floats(-1e300, 1e300), min_size=2, max_size=5, unique=True)))
    variable = draw(st.sampled_from(VARIABLES))
    widest = min(b - a for a, b in pairwise(edges)) / 2
    return Axis(
        variable,
        draw(printable | st.just("")),
        edges[0],
        tuple(edges[1:-1]),
        edges[-1],
        draw(st.floats(0.0, widest)),
        draw(st.floats(0.0, 1e300)),
        draw(st.just(0.0) | st.floats(0.0, 1e300)),
        draw(printable | st.just("")) if variable == CAN else "",
    )


@st.composite
def some_tables(draw):
    """Along one axis or two; plain ones among them, which the text has a shorter form for."""
    axes = draw(st.lists(some_axes(), min_size=1, max_size=2))
    count = len(axes[0]) * len(axes[-1]) ** (len(axes) - 1)
    names = draw(st.lists(printable, min_size=count, max_size=count, unique=True))
    sign = draw(st.sampled_from((1.0, -1.0)))
    gains = tuple(PidGains(*(sign * g for g in draw(st.tuples(sizes, sizes, sizes).filter(any)))) for _ in names)
    regions = Regions.along(tuple(names), *axes)
    return GainTable(draw(printable), regions, gains, draw(st.sampled_from(Lookup)), draw(st.integers(0)))


@given(some_tables())
def test_round_trip_is_exact(table):
    text = to_toml(table)

    assert from_toml(text) == table
    assert to_toml(from_toml(text)) == text


def test_the_text_as_people_see_it():
    assert TEXT.split("\n", 8)[8].startswith(
        """\
[[axis]]
variable = "sp"
unit = "degC"
low = 20.0
bounds = [80.5]
high = 220.0
hysteresis = 2.0  # each way, in unit
min_stay_s = 60.0
filter_s = 0.0

[[axis]]
variable = "can"
signal = "flow"
unit = "%"
low = 0.0
bounds = [50.0]
high = 100.0
hysteresis = 5.0  # each way, in unit
min_stay_s = 0.0
filter_s = 10.0

[[region]]  # 20 to 80.5 degC, flow 0 to 50 %
name = "a"
cell = [1, 1]
kp = 1.0
"""
    )


def test_one_plain_axis_is_written_as_before():
    plain = GainTable("x", Regions.along(("a", "b"), HEAT), TABLE.gains[:2])

    assert "[schedule]\nvariable" in to_toml(plain)
    assert "axis" not in to_toml(plain)
    assert "filter_s" not in to_toml(plain)


def test_sets_may_stand_in_any_order():
    head, *sets = TEXT.split("[[region]]")
    shuffled = "[[region]]".join([head, *reversed([entry.rstrip("\n") + "\n" for entry in sets])])

    assert from_toml(shuffled) == TABLE


def test_a_text_cut_at_any_place_is_refused_or_the_same_table():
    same = 0
    for kept in range(len(TEXT)):
        try:
            table = from_toml(TEXT[:kept])
        except ValueError:
            continue
        assert table == TABLE, TEXT[:kept][-40:]
        same += 1
    assert same < 100, "only within the last comment"


@pytest.mark.parametrize(
    ("old", "new", "what"),
    [
        ("cell = [1, 2]", "cell = [1, 1]", r"line 41, region 1: cell = \[1, 1\] is given twice"),
        ("cell = [1, 2]", "cell = [1, 3]", r"line 41, region 1: cell = .* counted from 1 to 2, 2"),
        ("cell = [1, 2]", "cell = [1.5, 2]", "must be a place on each axis"),
        ("cell = [1, 2]", "cell = [1]", "must be a place on each axis"),
        ("cell = [1, 2]\n", "", "line 39, region 1: cell is missing"),
        ('signal = "flow"\n', "", "line 19, axis 1: signal is missing"),
        ('variable = "sp"', 'variable = "sp"\nsignal = "flow"', "line 11, axis 0: 'signal' is unknown here"),
        ("filter_s = 10.0", "filter_s = -1.0", "line 19, axis 1: filter_s = -1.0"),
        ("bounds = [50.0]", "bounds = []", r"no \[\[region\]\] with|counted from 1 to 2, 1"),
        ("revision = 3", "revision = 3\nschedule = 1", "'schedule' is unknown here"),
    ],
)
def test_a_mistake_is_named_with_its_line(old, new, what):
    assert old in TEXT
    with pytest.raises(ValueError, match=what) as caught:
        from_toml(TEXT.replace(old, new, 1))
    assert "\n" not in str(caught.value)


def test_a_cell_without_a_set_and_a_third_axis_are_refused():
    head, *sets = TEXT.split("[[region]]")
    with pytest.raises(ValueError, match=r"no \[\[region\]\] with cell = \[2, 2\]"):
        from_toml("[[region]]".join([head, *sets[:3]]))
    axis = TEXT[TEXT.index("[[axis]]") : TEXT.index("[[region]]")]
    with pytest.raises(ValueError, match=r"4 sections \[\[axis\]\]; a table has one or 2"):
        from_toml(TEXT.replace(axis, axis * 2))
