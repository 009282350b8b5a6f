"""[[schedule.axis]]: two scheduling variables, a signal on the bus, cells in any order; mistakes by line and key."""

import pytest

from retuner import Axis, Lookup
from retuner.commands.run import foreseen
from retuner.config.loading import UnusableError, parse_config

HEAD = """schema = 1
[loop]
name = "boiler"
pv_unit = "degC"
pv_min = 20.0
pv_max = 120.0
sample_time_s = 1.0
[schedule]
lookup = "interpolated"
"""
AXES = """[[schedule.axis]]
variable = "sp"
bounds = [70.0]
hysteresis = 2.0
min_stay_s = 30
[[schedule.axis]]
variable = "can"
unit = "%"
range = [20.0, 140.0]
bounds = [70.0]
hysteresis = 4.0
filter_s = 10.0
message = "PLANT"
signal = "aux"
"""
CELLS = ((1, 1), (1, 2), (2, 1), (2, 2))


def region(name: str, kc: float, cell: tuple[int, ...] = ()) -> str:
    text = f'[[schedule.region]]\nname = "{name}"\nkc = {kc}\ntau_i_s = 60.0\n'
    return text + (f"cell = [{', '.join(map(str, cell))}]\n" if cell else "")


REGIONS = "".join(region(f"r{i}", i + 1.0) for i in range(4))
GOOD = HEAD + AXES + REGIONS


def refused(text: str) -> list[tuple[int, str, str]]:
    with pytest.raises(UnusableError) as caught:
        parse_config(text)
    return [tuple(finding) for finding in caught.value.findings]


def test_two_axes_make_a_map_row_by_row() -> None:
    table = parse_config(GOOD).gain_table()
    assert table.lookup is Lookup.INTERPOLATED
    assert table.regions.names == ("r0", "r1", "r2", "r3")
    assert table.regions.axes == (
        Axis("sp", "degC", 20.0, (70.0,), 120.0, 2.0, 30.0),
        Axis("can", "%", 20.0, (70.0,), 140.0, 4.0, 0.0, 10.0, "aux"),
    )
    assert [g.kp for g in table.gains] == [1.0, 2.0, 3.0, 4.0]


def test_cells_put_regions_in_order() -> None:
    shuffled = (2, 0, 3, 1)
    text = HEAD + AXES + "".join(region(f"r{i}", i + 1.0, CELLS[i]) for i in shuffled)
    assert parse_config(text).gain_table() == parse_config(GOOD).gain_table()


def test_one_axis_may_be_written_either_way() -> None:
    rows = region("low", 1.0) + region("high", 2.0)
    simple = HEAD + "bounds = [70.0]\nhysteresis = 2.0\nmin_stay_s = 30.0\nfilter_s = 5.0\n" + rows
    axis = HEAD + AXES[: AXES.index("[[", 2)] + "filter_s = 5.0\n" + rows
    assert parse_config(simple).gain_table() == parse_config(axis).gain_table()


def test_the_output_as_an_axis_has_its_own_unit_and_range() -> None:
    text = GOOD.replace('variable = "sp"', 'variable = "co"')
    assert parse_config(text).regions().axes[0] == Axis("co", "%", 0.0, (70.0,), 100.0, 2.0, 30.0)


@pytest.mark.parametrize(
    ("old", "new", "key", "told", "line"),
    [
        ('unit = "%"\n', "", "schedule.axis[2].unit", "is missing; give the signal's unit", 15),
        ("range = [20.0, 140.0]\n", "", "schedule.axis[2].range", "as in range = [0.0, 100.0]", 15),
        ('message = "PLANT"\n', "", "schedule.axis[2].message", "name of the message", 15),
        ('signal = "aux"\n', "", "schedule.axis[2].signal", "name of the signal", 15),
        ("range = [20.0, 140.0]", "range = [140.0, 20.0]", "schedule.axis[2].range", "[140, 20] must be two", 18),
        ("range = [20.0, 140.0]", "range = [1.0]", "schedule.axis[2].range", "= [1] must be two numbers", 18),
        ("range = [20.0, 140.0]", "range = [nan, 1.0]", "schedule.axis[2].range[1]", "finite number", 18),
        ("hysteresis = 4.0", "hysteresis = 40.0", "schedule.axis[2].hysteresis", "at most half of the narrowest", 20),
        ("filter_s = 10.0", "filter_s = -1.0", "schedule.axis[2].filter_s", "must be at least 0", 21),
        ("bounds = [70.0]\nhysteresis = 2.0", "bounds = [10.0]", "schedule.axis[1].bounds[1]", "20 and 120 degC", 12),
        ("bounds = [70.0]\nhysteresis = 4.0", "bounds = [10.0]", "schedule.axis[2].bounds[1]", "20 and 140 %", 19),
        ("bounds = [70.0]\nhysteresis = 4.0", "bounds = [9, 3]", "schedule.axis[2].bounds[2]", "greater than", 19),
        (
            'variable = "sp"',
            'variable = "sp"\nsignal = "x"',
            "schedule.axis[1].signal",
            'belongs to variable = "can"',
            12,
        ),
        (
            'variable = "sp"',
            'variable = "sp"\nstale_after_s = 3.0',
            "schedule.axis[1].stale_after_s",
            "leave it out",
            12,
        ),
        ('variable = "sp"', 'variable = "pw"', "schedule.axis[1].variable", "must be 'sp', 'pv', 'co' or 'can'", 11),
        ('lookup = "interpolated"', "bounds = [70.0]", "schedule.bounds", "conflicts with [[schedule.axis]]", 9),
        ("kc = 4.0", "kc = 4.0\ncell = [2, 2]", "schedule.region[1].cell", "is missing; give each region", 24),
        ("kc = 4.0", "kc = -4.0", "schedule.region[4].kc", "acts against", 38),
    ],
)
def test_a_mistake_is_named_with_line_and_key(old: str, new: str, key: str, told: str, line: int) -> None:
    assert old in GOOD
    found = next(finding for finding in refused(GOOD.replace(old, new, 1)) if finding[1] == key)
    assert told in found[2]
    assert found[0] == line


@pytest.mark.parametrize(
    ("cells", "told"),
    [
        (((1, 1), (1, 2), (2, 1), (2, 1)), "= [2, 1] is region 'r2' already"),
        (((1, 1), (1, 2), (2, 1), (2, 3)), "= [2, 3] must be two numbers from 1 to 2, 2"),
        (((1, 1), (1, 2), (2, 1), (2,)), "= [2] must be two numbers"),
    ],
)
def test_cells_that_are_no_map(cells: tuple[tuple[int, ...], ...], told: str) -> None:
    text = HEAD + AXES + "".join(region(f"r{i}", 1.0, cell) for i, cell in enumerate(cells))
    assert [(key, message) for _, key, message in refused(text) if told in message] == [
        ("schedule.region[4].cell", next(m for _, _, m in refused(text) if told in m))
    ]


def test_a_cell_on_one_axis_three_axes_and_too_few_regions_are_refused() -> None:
    one = HEAD + "bounds = [70.0]\n" + region("a", 1.0, (1,)) + region("b", 1.0)
    assert any("no meaning with one axis" in message for _, _, message in refused(one))
    assert "must have at most 2 entries" in refused(HEAD + AXES + AXES + REGIONS)[0][2]
    assert "3 given, but 1 x 1 bounds make 4 regions" in refused(GOOD[: GOOD.rindex("[[")])[0][2]


@pytest.mark.parametrize(
    ("schedule", "warned"),
    [
        ('variable = "pv"', True), ('variable = "pv"\nhysteresis = 1.0', False), ('variable = "sp"', False),
        ('variable = "pv"\nmin_stay_s = 60', False), ('variable = "pv"\nlookup = "interpolated"', False),
    ],
)  # fmt: skip
def test_a_boundary_that_noise_passes_to_and_fro_is_foreseen(schedule: str, *, warned: bool) -> None:
    head = HEAD.replace('lookup = "interpolated"', f"{schedule}\nbounds = [70.0]")
    found = foreseen(parse_config(head + region("low", 1.0) + region("high", 2.0)))
    assert any("over boundaries without hysteresis" in one.text for one in found) is warned
