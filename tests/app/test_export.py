"""Exported tables: the C header compiled and the structured text run, both against our own lookup; back into a file."""

import random
import re
import shutil
import struct
import subprocess
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import cantools
import pytest
from command_line import printed, refused

from retuner import GainTable, Lookup, PidGains
from retuner.adaptive.guard.step_size import change_factor
from retuner.cli import main
from retuner.config.described import vendor_units
from retuner.config.loading import load_config, load_session
from retuner.drivers.protocol.checksum import to_wire
from retuner.gain_export.numbers import c_header, csv_table, dbc_table, numbers_of, structured_text
from retuner.schedule.document import to_toml
from retuner.schedule.regions import Axis, Regions, choose, enter, values

LOW = Axis("sp", "degC", 20.0, (90.0, 150.0), 220.0, 2.0, 60.0)
SLOW = Axis("pv", "bar", 0.0, (3.3, 7.1), 10.0, 0.5, 5.0, 6.0)
FLOW = Axis("can", "%", 0.0, (40.0,), 100.0, 4.0, 0.0, 0.0, "flow")
ONE = Axis("sp", "rpm", 0.0, (), 1.0)


def made(name: str, lookup: Lookup, first: Axis, second: Axis | None = None) -> GainTable:
    draw = random.Random(7)
    count = len(first) * (len(second) if second else 1)
    names = tuple(f"region {i} */" for i in range(count))
    gains = tuple(PidGains(draw.uniform(0.1, 5), draw.uniform(0.001, 1), draw.uniform(0, 3)) for _ in range(count))
    return GainTable(name, Regions.along(names, first, second), gains, lookup, 3)


TABLES = {
    "hard": made("hard", Lookup.HARD, LOW),
    "mean": made("mean", Lookup.INTERPOLATED, LOW),
    "filtered": made("filtered", Lookup.INTERPOLATED, SLOW),
    "map": made("map", Lookup.HARD, SLOW, FLOW),
    "mixed_map": made("mixed map", Lookup.INTERPOLATED, LOW, FLOW),
    "single": made("1 loop", Lookup.HARD, ONE),
}


def walk(table: GainTable) -> Iterator[tuple[float, float, float]]:
    """Times and values that pass every boundary, back and forth; some land on a boundary or a centre."""
    draw = random.Random(11)
    axes = table.regions.axes
    xs = [axis.low for axis in axes]
    for k in range(600):
        for i, axis in enumerate(axes):
            xs[i] += draw.gauss(0.0, 0.06 * (axis.high - axis.low))
            xs[i] = min(max(xs[i], axis.low - 1.0), axis.high + 1.0)
            if k % 17 == 0:
                xs[i] = draw.choice((*axis.bounds, axis.centre(0), axis.low))
        yield 2.0 * k, xs[0], xs[1] if len(xs) > 1 else 0.0


def ours(table: GainTable) -> list[tuple[int, bytes]]:
    """Region and gains in float32 at every step of the walk."""
    law, state, found = table.regions.law(), None, []
    for t_s, x, x2 in walk(table):
        state = enter(law, x, t_s, x2) if state is None else choose(law, state, x, t_s, x2)
        gains = table.at(state.region, *values(law, state, x, x2))
        found.append((state.region, struct.pack("<fff", gains.kp, gains.ki, gains.kd)))
    return found


MAIN = """
#include <stdio.h>
#include <string.h>
#include "gains.h"
int main(void) {{
    {p}_state_t s;
    double t, x, x2;
    memset(&s, 0, sizeof s);
    while (scanf("%la %la %la", &t, &x, &x2) == 3) {{
        int region = {p}_choose(&s, {args}, t);
        {p}_gains_t g = {p}_lookup(&s, {args}, t);
        unsigned char b[12];
        int i;
        memcpy(b, &g.kp, 4); memcpy(b + 4, &g.ki, 4); memcpy(b + 8, &g.kd, 4);
        printf("%d ", region);
        for (i = 0; i < 12; i++) printf("%02x", b[i]);
        printf("\\n");
    }}
    return 0;
}}
"""
STRICT = ["-std=c99", "-O2", "-Wall", "-Wextra", "-Werror", "-pedantic", "-ffp-contract=off"]


def compiled(table: GainTable, folder: Path, *more: str) -> list[tuple[int, bytes]]:
    """The walk through the compiled header."""
    compiler = shutil.which("gcc") or shutil.which("cc")
    if compiler is None:
        pytest.skip("no C compiler")
    numbers = numbers_of(table)
    (folder / "gains.h").write_text(c_header(numbers, "gains.toml"))
    args = "x, x2" if len(numbers.axes) > 1 else "x"
    unused = "" if len(numbers.axes) > 1 else "(void)x2;"
    text = MAIN.format(p=numbers.name, args=args).replace("    unsigned char", f"    {unused}\n    unsigned char")
    (folder / "main.c").write_text(text)
    program = folder / "program"
    subprocess.run([compiler, *STRICT, *more, folder / "main.c", "-o", program], check=True)
    lines = "".join(f"{t.hex()} {x.hex()} {x2.hex()}\n" for t, x, x2 in walk(table))
    done = subprocess.run([program], input=lines, capture_output=True, text=True, check=True)
    pairs = (line.split() for line in done.stdout.splitlines())
    return [(int(region), bytes.fromhex(gains)) for region, gains in pairs]


@pytest.mark.parametrize("name", TABLES)
def test_the_compiled_header_has_our_gains_bit_for_bit(name: str, tmp_path: Path) -> None:
    table = TABLES[name]
    theirs = compiled(table, tmp_path)
    assert len({region for region, _ in theirs}) == len(table.gains)  # the walk has been everywhere
    assert theirs == ours(table)


def test_with_single_arithmetic_only_the_last_bits_differ(tmp_path: Path) -> None:
    table = TABLES["mixed_map"]
    worst = 0.0
    for (_, theirs), (_, mine) in zip(compiled(table, tmp_path, "-DRETUNER_REAL=float"), ours(table), strict=True):
        for a, b in zip(struct.unpack("<fff", theirs), struct.unpack("<fff", mine), strict=True):
            worst = max(worst, abs(a / b - 1))
    assert worst < 1e-5


# A very small part of IEC 61131-3, enough for what is exported, turned into Python.


def as_python(text: str) -> tuple[dict[str, Any], str]:
    """Variables with their start values, and the statements, of a function block."""
    variables: dict[str, Any] = {}
    lines: list[str] = []
    declaring, depth = False, 0
    for raw in re.sub(r"\(\*.*?\*\)", "", text, flags=re.S).splitlines():
        line = raw.strip()
        if line.startswith("VAR"):
            declaring = True
        elif line == "END_VAR":
            declaring = False
        elif declaring and line:
            match = re.fullmatch(r"(\w+) : (ARRAY\[0\.\.(\d+)\] OF )?(\w+)( := (.+))?;", line)
            assert match, line
            start = match[6] or "0"
            variables[match[1]] = eval(start.replace("FALSE", "False"))
            assert match[3] is None or len(variables[match[1]]) == int(match[3]) + 1
        elif line and not line.startswith(("FUNCTION_BLOCK", "END_FUNCTION_BLOCK")):
            depth -= line.startswith(("END_IF", "END_FOR", "ELSE"))
            if not line.startswith("END_"):
                lines.append("    " * depth + statement(line))
            depth += line.endswith((" THEN", " DO")) or line == "ELSE"
    assert depth == 0
    return variables, "\n".join(lines)


def statement(line: str) -> str:
    """One statement."""
    looped = re.fullmatch(r"FOR (\w+) := (\d+) TO (\d+) DO", line)
    if looped:
        return f"for {looped[1]} in range({looped[2]}, {looped[3]} + 1):"
    if line == "ELSE":
        return "else:"
    words = line.replace("<>", "!=").replace(" AND ", " and ").replace(" OR ", " or ").replace("NOT ", "not ")
    words = words.replace("TRUE", "True")
    if words.startswith("IF "):
        condition = re.sub(r"(?<![<>!:=])=(?!=)", "==", words[3:-5])
        return f"if {condition}:"
    assert words.endswith(";"), line
    return words[:-1].replace(":=", "=")


def single(value: float) -> float:
    return float(struct.unpack("<f", struct.pack("<f", value))[0])


@pytest.mark.parametrize("name", TABLES)
def test_the_structured_text_has_our_gains(name: str) -> None:
    table = TABLES[name]
    variables, body = as_python(structured_text(numbers_of(table), "gains.toml"))
    code = compile(body, name, "exec")
    block: dict[str, Any] = {**variables, "LREAL_TO_REAL": single}
    found = []
    for t_s, x, x2 in walk(table):
        block.update(x1=x, x2=x2, t_s=t_s)
        exec(code, block)
        now = SimpleNamespace(**{key: block[key] for key in ("region", "kp", "ki", "kd")})
        found.append((now.region, struct.pack("<fff", now.kp, now.ki, now.kd)))
    assert found == ours(table)


def test_the_dbc_starts_at_the_gains_in_float32() -> None:
    table = TABLES["map"]
    database = cantools.database.load_string(dbc_table(table), "dbc", strict=True)
    assert len(database.messages) == len(table.gains)
    for layout, gains in zip(database.messages, table.gains, strict=True):
        starts = [signal.initial for signal in layout.signals]
        assert starts == list(struct.unpack("<fff", struct.pack("<fff", gains.kp, gains.ki, gains.kd)))


def test_the_csv_has_a_line_a_region_that_reads_back() -> None:
    table = TABLES["hard"]
    head, *lines = csv_table(table).splitlines()
    assert head == "region,low1,high1,unit1,kp,ki,kd,kc_ideal,tau_i_s,tau_d_s"
    for line, gains in zip(lines, table.gains, strict=True):
        assert tuple(map(float, line.split(",")[4:7])) == (gains.kp, gains.ki, gains.kd)


def test_gains_are_shown_as_a_controller_has_them(tmp_path: Path) -> None:
    gains = tmp_path / "gains.toml"
    gains.write_text(to_toml(GainTable("x", Regions.along(("all",), ONE), (PidGains(2.0, 0.1, 12.0),))))
    named = ["--controller", "rockwell-pide", "--pv-span", "200"]
    assert printed("export", gains, *named) == "all: PGain 4 IGain 12/min DGain 0.4 min\n"
    head, line = printed("export", gains, "--format", "csv", "--out", "-", *named).splitlines()
    assert head.endswith("kp,ki,kd,PGain,IGain [/min],DGain [min]")
    assert [float(cell) for cell in line.split(",")[-3:]] == pytest.approx([4.0, 12.0, 0.4])
    assert "no series form, which the controller needs" in refused(
        "export", gains, "--format", "csv", "--controller", "deltav-series", "--pv-span", "1"
    )


CONFIG = """# my loop
schema = 1
[loop]
name = "oven" # tag
pv_unit = "degC"
pv_min = 20.0
pv_max = 220.0
sample_time_s = 2.0
[schedule]
bounds = [100.0]
[[schedule.region]]
name = "low"
kc = 0.22        # from the manual
tau_i_s = 260.0  # s
[[schedule.region]]
name = "high"
form = "ideal"   # as on the panel
kc = 0.85
tau_i_s = "none" # a P controller
"""


def test_tuned_gains_go_back_and_every_comment_stays(tmp_path: Path) -> None:
    path = tmp_path / "loop.toml"
    path.write_text(CONFIG)
    before = load_config(path).gain_table()
    tuned = before.with_gains("low", PidGains(1.5, 0.01)).with_gains("high", PidGains(2.0, 0.04, 10.0))
    gains = tmp_path / "gains.toml"
    gains.write_text(to_toml(tuned))
    assert "low: kc 0.22 tau_i_s 260 tau_d_s 0 -> kc 1.5 tau_i_s 150 tau_d_s 0 (series)" in printed(
        "export", gains, "--into", path
    )
    text = path.read_text()
    assert re.findall("#.*", text) == re.findall("#.*", CONFIG)
    for gains_now, wanted in zip(load_config(path).gains(), tuned.gains, strict=True):
        assert change_factor(gains_now, wanted) < 1 + 1e-12
    changed = [line for line in text.splitlines() if line not in CONFIG.splitlines()]
    assert len(changed) == 5  # kc and tau_i_s twice, and a tau_d_s that was not there
    assert main(["export", str(gains), "--into", str(path)]) == 0
    assert path.read_text() == text


def test_numbers_go_back_in_the_fewest_digits_that_the_controller_tells_apart(tmp_path: Path) -> None:
    path, gains = tmp_path / "loop.toml", tmp_path / "gains.toml"
    path.write_text(CONFIG)
    tuned = (
        load_config(path)
        .gain_table()
        .with_gains("low", to_wire(PidGains(0.3, 0.3 / 70.0)))
        .with_gains("high", PidGains(1.234567890123, 0.04321098765, 3.0))
    )
    gains.write_text(to_toml(tuned))
    assert main(["export", str(gains), "--into", str(path)]) == 0
    assert "kc = 0.3 " in path.read_text()
    assert "tau_i_s = 70.0 " in path.read_text()
    numbers = re.findall(r"= ([0-9.]+)", path.read_text()[path.read_text().index("[[schedule.region]]") :])
    assert max(len(number.replace(".", "").strip("0")) for number in numbers) <= 9
    assert [to_wire(one) for one in load_config(path).gains()] == [to_wire(one) for one in tuned.gains]


def test_a_drive_of_whole_numbers_gets_the_shortest_number_that_rounds_to_its_own(tmp_path: Path) -> None:
    path, gains = tmp_path / "loop.toml", tmp_path / "gains.toml"
    path.write_text((Path(__file__).parents[2] / "examples" / "cia402.toml").read_text())
    config = load_config(path)
    units = vendor_units(config)
    held = units.rounded(PidGains(0.98765, 0.7123456))
    gains.write_text(to_toml(config.gain_table().with_gains("all", held)))
    assert main(["export", str(gains), "--into", str(path)]) == 0
    assert units.rounded(load_config(path).gains()[0]) == held
    assert len(re.findall(r"\ntau_i_s = ([0-9.]+)", path.read_text())[0]) <= 6


def test_tuned_gains_against_the_action_are_refused_by_their_key(tmp_path):
    path, gains = tmp_path / "loop.toml", tmp_path / "gains.toml"
    path.write_text(CONFIG)
    gains.write_text(to_toml(load_config(path).gain_table()))
    direct = CONFIG.replace("[loop]", '[loop]\naction = "direct"', 1)
    path.write_text(direct)
    assert "would be refused: schedule.region[1].kc = -0.22: loop.action = 'direct'" in refused(
        "export", gains, "--into", path
    )
    assert path.read_text() == direct


def test_a_set_without_the_form_takes_the_ideal_one(tmp_path: Path) -> None:
    path, gains = tmp_path / "loop.toml", tmp_path / "gains.toml"
    path.write_text(CONFIG)
    tuned = load_config(path).gain_table().with_gains("low", PidGains(1.0, 0.1, 5.0))  # Ti 10 s, Td 5 s: no series form
    gains.write_text(to_toml(tuned))
    assert main(["export", str(gains), "--into", str(path)]) == 0
    assert load_config(path).schedule.regions[0].form == "ideal"
    assert load_config(path).gains()[0] == tuned.gains[0]


WRONG = [
    ([], "--format: give one of c, st, dbc, csv"),
    (["--format", "pdf"], "--format pdf: give one of c, st, dbc, csv"),
    (["--into", "nowhere.toml"], "nowhere.toml: no such file"),
    (["--format", "c", "--out", "no/such/folder/x.h"], "cannot be written"),
    (["--format", "c", "--controller", "px4"], "--format c carries kp, ki and kd"),
]


@pytest.mark.parametrize(("arguments", "told"), WRONG)
def test_what_is_wrong_is_one_line(arguments, told, tmp_path):
    gains = tmp_path / "gains.toml"
    gains.write_text(to_toml(TABLES["hard"]))
    (line,) = refused("export", gains, *arguments).splitlines()
    assert told in line


def test_a_session_of_several_loops_names_its_tables(tmp_path: Path) -> None:
    for loop in ("drum", "steam"):
        gains = tmp_path / "loops" / loop / "gains.toml"
        gains.parent.mkdir(parents=True)
        gains.write_text(to_toml(TABLES["hard"]))
    (line,) = refused("export", tmp_path, "--format", "csv").splitlines()
    assert str(Path("loops") / "drum" / "gains.toml") in line
    assert str(Path("loops") / "steam" / "gains.toml") in line
    assert main(["export", str(tmp_path / "loops" / "drum"), "--format", "csv"]) == 0


def test_a_table_of_other_regions_changes_nothing(tmp_path: Path) -> None:
    path, gains = tmp_path / "loop.toml", tmp_path / "gains.toml"
    path.write_text(CONFIG)
    gains.write_text(to_toml(TABLES["hard"]))
    assert "gains go back only where they came from" in refused("export", gains, "--into", path)
    assert path.read_text() == CONFIG


def test_regions_of_the_same_names_at_other_places_change_nothing(tmp_path):
    path, gains = tmp_path / "loop.toml", tmp_path / "gains.toml"
    path.write_text(CONFIG)
    table = load_session(path)[0].loops[0].gain_table()
    tuned = to_toml(table.with_gains("low", PidGains(1.5, 0.01)))
    (bound,) = table.regions.bounds
    assert f"[{bound!r}]" in tuned
    gains.write_text(tuned.replace(f"[{bound!r}]", f"[{bound + 1.0!r}]"))
    assert "its boundaries or its lookup are not the table's" in refused("export", gains, "--into", path)
    assert path.read_text() == CONFIG


def test_of_several_loops_the_one_that_the_table_names_is_written(tmp_path):
    schedule = CONFIG[CONFIG.index("[schedule]") :].replace("schedule", "loop.schedule")
    one = CONFIG[CONFIG.index("[loop]") : CONFIG.index("[schedule]")].replace("[loop]", "[[loop]]") + schedule
    path, gains = tmp_path / "loops.toml", tmp_path / "gains.toml"
    other = one.replace('"oven"', '"kiln"') + "[loop.bus]\nnode = 2\n"
    path.write_text("schema = 1\n" + one + other)
    session, text = load_session(path)
    tuned = session.loops[1].gain_table().with_gains("low", PidGains(1.5, 0.01))
    gains.write_text(to_toml(tuned))
    assert main(["export", str(gains), "--into", str(path)]) == 0
    changed = [
        i for i, (a, b) in enumerate(zip(text.splitlines(), path.read_text().splitlines(), strict=True)) if a != b
    ]
    assert len(changed) == 2
    assert min(changed) > len(one.splitlines())
    gains.write_text(to_toml(TABLES["hard"]))  # of a loop that is none of these
    (line,) = refused("export", gains, "--into", path).splitlines()
    assert "has the loops oven, kiln, the table is of" in line
    assert "--loop" not in line
