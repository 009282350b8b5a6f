"""A configuration is accepted whole or refused with file, line, key, limit and what to do."""

import re
import runpy
import tomllib
from collections.abc import Iterator
from dataclasses import fields
from pathlib import Path
from typing import get_args

import pytest
from hypothesis import given
from hypothesis import strategies as st

from retuner import Lookup, PidGains
from retuner.adaptive.guard.guard_settings import GuardSettings
from retuner.adaptive.guard.request import KC_ONLY, NO_DERIVATIVE
from retuner.config import Config, load_config
from retuner.config.adaptation import AdaptationConfig, LimitsConfig
from retuner.config.loading import LARGEST_FILE, ConfigFlaw, UnusableError, parse_config
from retuner.config.plants import OvenPlantConfig
from retuner.config.section import Section
from retuner.drivers.plants.oven_plant import OvenSettings
from retuner.errors import ConfigError, UserError
from retuner.session.assembly import guard_settings, retuner_settings
from retuner.templates import starter

GOOD = """schema = 1
[loop]
name = "tank"
pv_unit = "m"
pv_min = 0
pv_max = 10
sample_time_s = 0.5
[schedule]
bounds = [4.0]
[[schedule.region]]
name = "low"
kc = 2
tau_i_s = 10.0
tau_d_s = 2.0
[[schedule.region]]
name = "high"
kc = 1.5
tau_i_s = "none"
form = "ideal"
"""
RUN = """[device.plant]
kind = "linear"
k = 0.5
lags_s = [10, 2]
[scenario]
duration_s = 100.0
steps = [
  { at_s = 0, sp = 2.0 },
  { at_s = 50.0, load = -5.0 },
]
"""


def line_of(text: str, part: str) -> int:
    return next(i for i, line in enumerate(text.splitlines(), 1) if part in line)


def refused(text: str) -> list[tuple[int, str, str]]:
    with pytest.raises(UnusableError) as caught:
        parse_config(text)
    return [tuple(finding) for finding in caught.value.findings]


def test_a_small_file_is_complete_with_its_defaults() -> None:
    config = parse_config(GOOD)
    assert config.gains() == (PidGains(2.4, 0.2, 4.0), PidGains(1.5, 0.0, 0.0))
    table = config.gain_table()
    assert (table.loop, table.revision, table.lookup) == ("tank", 0, Lookup.HARD)
    assert (table.regions.names, table.regions.bounds) == (("low", "high"), (4.0,))
    assert (table.regions.low, table.regions.high, table.regions.unit) == (0.0, 10.0, "m")
    assert (config.adaptation.mode, config.bus.interface, config.bus.hop_limit) == ("advise", "virtual", 0)
    assert config.device is None
    assert config.scenario is None


def test_a_run_has_plant_and_scenario() -> None:
    config = parse_config(GOOD + RUN)
    assert config.scenario is not None
    assert config.device.plant.kind == "linear"
    assert [(s.at_s, s.sp, s.load) for s in config.scenario.steps] == [(0.0, 2.0, None), (50.0, None, -5.0)]


def test_the_starter_is_accepted_and_its_comments_show_the_true_defaults() -> None:
    text = starter()
    config = parse_config(text)
    commented = [line.lstrip("# ") for line in text.splitlines() if line.startswith("# ") and " = " in line]
    shown = tomllib.loads("\n".join(line for line in commented if line.split(" = ")[0].isidentifier()))
    optional = {"co_rate_pct_per_s", "controller", "action", "kc_min", "kc_max", "noise_band", "wait_s"}
    sections = (config.loop, config.schedule, config.schedule.regions[0], config.adaptation, config.bus)
    for key, value in shown.items():
        owners = [section for section in sections if key in type(section).model_fields]
        assert owners, key
        expected = None if key in optional else value
        assert [getattr(owner, key) for owner in owners] == [expected] * len(owners), key
    assert len(shown) >= 18


@pytest.mark.parametrize(
    ("old", "new", "key", "told"),
    [
        ("pv_max = 10", "pv_max = nan", "loop.pv_max", "= nan must be a finite number"),
        ("pv_max = 10", "pv_max = inf", "loop.pv_max", "= inf must be a finite number"),
        ("pv_max = 10", "pv_max = 1e400", "loop.pv_max", "= inf must be a finite number"),
        ("pv_max = 10", "pv_max = true", "loop.pv_max", "= true must be a number"),
        ("pv_max = 10", 'pv_max = "10"', "loop.pv_max", '= "10" must be a number'),
        ("pv_max = 10", f"pv_max = 1{'0' * 400}", "loop.pv_max", "= a huge number must be a number"),
        ("pv_max = 10", "pv_max = 1e10", "loop.pv_max", "must be at most 1e+09"),
        ("pv_max = 10", "pv_max = 0", "loop.pv_max", "= 0 must be greater than pv_min = 0"),
        ("pv_max = 10", "pv_max = [1]", "loop.pv_max", "= [1] must be a number"),
        ("pv_max = 10", "pv_max = 1979-05-27", "loop.pv_max", "must be a number"),
        ("sample_time_s = 0.5", "sample_time_s = 0", "loop.sample_time_s", "must be at least 0.0001"),
        ("sample_time_s = 0.5", "sample_time_s = 11", "schedule.region[1].tau_i_s", "= 10 s must be at least"),
        ("sample_time_s = 0.5", "sample_tme_s = 0.5", "loop.sample_tme_s", "did you mean sample_time_s?"),
        ("sample_time_s = 0.5", "zzz = 1\nsample_time_s = 0.5", "loop.zzz", "known here: name, pv_unit"),
        ('name = "tank"', 'name = ""', "loop.name", "at least 1 character"),
        ('name = "tank"', "name = 3", "loop.name", "must be text in quotes"),
        ("bounds = [4.0]", "bounds = [4.0, 3.0]", "schedule.bounds[2]", "= 3 must be greater than the bound before"),
        ("bounds = [4.0]", "bounds = [40.0]", "schedule.bounds[1]", "= 40 must lie between 0 and 10 m"),
        ("bounds = [4.0]", "bounds = [nan]", "schedule.bounds[1]", "= nan must be a finite number"),
        ("bounds = [4.0]", "bounds = 4.0", "schedule.bounds", "= 4.0 must be an array"),
        ("bounds = [4.0]", "bounds = [4.0]\nhysteresis = 2.1", "schedule.hysteresis", "must be at most half"),
        ("bounds = [4.0]", 'bounds = [4.0]\nvariable = "pw"', "schedule.variable", "must be 'sp', 'pv' or 'co'"),
        ("kc = 2", "kc = 0", "schedule.region[1].kc", "= 0 would control nothing"),
        ("kc = 1.5", "kc = -1.5", "schedule.region[2].kc", "acts against the first region"),
        ("tau_i_s = 10.0", "tau_i_s = 0", "schedule.region[1].tau_i_s", "must be greater than 0 or 'none'"),
        ("tau_i_s = 10.0", 'tau_i_s = "no"', "schedule.region[1].tau_i_s", "must be a number or 'none'"),
        ("tau_d_s = 2.0", "tau_d_s = -1", "schedule.region[1].tau_d_s", "must be at least 0"),
        ('name = "high"', 'name = "low"', "schedule.region[2].name", "is taken by another region"),
        ('form = "ideal"', 'form = "idle"', "schedule.region[2].form", "= \"idle\" must be 'series', 'ideal' or"),
        ("[schedule]", "[adaptation]\nwait_s = 0.1\n[schedule]", "adaptation.wait_s", "= 0.1 s must be at least loop"),
        ("[schedule]", "[adaptation]\nnoise_band = 6\n[schedule]", "adaptation.noise_band", "more than half of the pv"),
        ("[schedule]", "[adaptation]\nms_worst = 1.5\n[schedule]", "adaptation.ms_worst", "at least ms_nominal = 1.75"),
        ("[schedule]", "[adaptation]\nkc_min = 3\nkc_max = 2\n[schedule]", "adaptation.kc_max", "than kc_min = 3"),
        ("pv_max = 10", "pv_max = 10\nco_min_pct = 5\nco_max_pct = 5", "loop.co_max_pct", "than co_min_pct = 5"),
        ("bounds = [4.0]", 'bounds = [400.0]\nvariable = "co"', "schedule.bounds[1]", "must lie between 0 and 100 %"),
        ("sample_time_s = 0.5", "sample_time_s = 200", "scenario.duration_s", "is shorter than one sample"),
        ("k = 0.5", "k = 0", "device.plant.k", "would not move this plant"),
        ("k = 0.5", "k = 0.5\nleads_s = [1, 2, 3]", "device.plant.leads_s", "has 3 leads for 2 lags"),
        ("k = 0.5", "k = 0.5\nintegrators = 1.0", "device.plant.integrators", "must be a whole number"),
        ("k = 0.5", "k = 0.5\npower_w = 3", "device.plant.power_w", "is not a known key; known here: loads, kind, k"),
        ("lags_s = [10, 2]", "lags_s = [10, -2]", "device.plant.lags_s[2]", "= -2 must be at least 0"),
        ('kind = "linear"', 'kind = "oben"', "device.plant", "must have kind = one of 'oven', 'linear'"),
        ("at_s = 50.0", "at_s = 100.0", "scenario.steps[2].at_s", "after the end of the run"),
        ("at_s = 50.0, load = -5.0", "at_s = 50.0", "scenario.steps[2]", "has neither sp nor load"),
        ("at_s = 0, sp = 2.0", "at_s = 60, sp = 2.0", "scenario.steps[2].at_s", "lies before the step above it"),
        ("sp = 2.0", "sp = 12.0", "scenario.steps[1].sp", "= 12 must lie in the pv range, 0 to 10 m"),
    ],
)
def test_one_mistake_gives_one_line_that_names_it(old: str, new: str, key: str, told: str) -> None:
    good = GOOD + RUN
    assert old in good
    text = good.replace(old, new, 1)
    found = refused(text)
    matching = [(line, message) for line, name, message in found if name == key]
    assert len(matching) == 1, found
    line, message = matching[0]
    assert told in message
    leaf = key.rpartition(".")[2].partition("[")[0]
    where = {"schedule.region[2].kc": "kc = -1.5", "scenario.steps[2]": "at_s = 50", "device.plant": "[device.plant]"}
    where |= {"scenario.steps[2].at_s": "load", "schedule.region[2].name": 'form = "ideal"'}
    offset = {"schedule.region[2].name": -3}.get(key, 0)
    assert line == line_of(text, where.get(key, f"{leaf} = ")) + offset


@pytest.mark.parametrize(
    ("old", "new", "key", "line"),
    [
        ("sample_time_s = 0.5\n", "", "loop.sample_time_s", "[loop]"),
        ("kc = 1.5\n", "", "schedule.region[2].kc", '"high"'),
        ("schema = 1\n", "", "schema", "[loop]"),
        ('kind = "linear"\n', "", "device.plant", "[device.plant]"),
    ],
)
def test_a_missing_key_is_told_at_its_table(old: str, new: str, key: str, line: str) -> None:
    text = (GOOD + RUN).replace(old, new, 1)
    found = refused(text)
    assert [name for _, name, _ in found] == [key]
    assert "add" in found[0][2]
    assert abs(found[0][0] - line_of(text, line)) <= 1


def test_every_problem_is_told_at_once_in_the_order_of_the_file() -> None:
    text = GOOD.replace("pv_max = 10", "pv_max = true").replace("kc = 2", "kc = nan").replace("[4.0]", '["x"]')
    found = refused(text)
    assert [key for _, key, _ in found] == ["loop.pv_max", "schedule.bounds[1]", "schedule.region[1].kc"]
    assert [line for line, _, _ in found] == sorted(line for line, _, _ in found)


def test_a_region_too_many_and_one_too_few() -> None:
    assert "1 given, but 1 bounds make 2" in refused(GOOD[: GOOD.index('[[schedule.region]]\nname = "high"')])[0][2]
    assert "2 given, but 0 bounds make 1" in refused(GOOD.replace("[4.0]", "[]"))[0][2]


@pytest.mark.parametrize(
    ("raw", "told"),
    [
        (b"schema = ", ":1 is not TOML: invalid value"),
        (b"schema = 1\n[loop\n", ":2 is not TOML: expected ']'"),
        (b"schema = 1\nschema = 1\n", ":2 is not TOML: cannot overwrite"),
        (b'schema = 1\nx = "abc', ":2 is not TOML: unterminated string"),
        (b"\xef\xbb\xbfschema = 1", ":1 starts with a byte order mark"),
        (b"schema = 1\n# \xff", ":2 byte 0xff is not UTF-8"),
        (b"x = " + b"[" * 100_000, ":1 brackets are nested too deeply"),
        (b"x = " + b"1" * 5000, "is not TOML"),
        (b"#" * (LARGEST_FILE + 1), "larger than"),
        (b"schema = 2\nfuture = 1", ":1 schema = 2 is not known"),
        (b"\x00", "is not TOML"),
        (b"", ":1 schema is missing"),
        (b'schema = 1\n"a\\n\\u001b[31mb" = 1', "a\\n\\x1b[31mb is not a known key"),
    ],
)
def test_files_that_are_no_configuration(tmp_path: Path, raw: bytes, told: str) -> None:
    file = tmp_path / "c.toml"
    file.write_bytes(raw)
    with pytest.raises(ConfigError) as caught:
        load_config(file)
    assert any(told in line for line in caught.value.lines), caught.value.lines
    for line in caught.value.lines:
        assert line.startswith(f"{file}:")
        assert line.isprintable()


def test_places_that_are_no_file(tmp_path: Path) -> None:
    for path, told in [(tmp_path, "is a folder"), (tmp_path / "x", "no such file"), ("a\0b", "cannot be read")]:
        with pytest.raises(ConfigError, match=told) as caught:
            load_config(path)
        assert len(caught.value.lines) == 1


def outcome(text: str) -> Config | list[ConfigFlaw]:
    try:
        return parse_config(text)
    except UnusableError as error:
        return error.findings


@given(st.integers(0, len(GOOD + RUN)))
def test_a_file_cut_anywhere_is_refused_or_says_the_same(at: int) -> None:
    found = outcome((GOOD + RUN)[:at])
    assert found
    assert not isinstance(found, Config) or found.loop == parse_config(GOOD).loop


@given(st.binary(max_size=40), st.integers(0, len(GOOD)))
def test_any_garbage_gives_findings_and_nothing_else(garbage: bytes, at: int) -> None:
    text = GOOD[:at] + garbage.decode("utf-8", errors="replace") + GOOD[at:]
    found = outcome(text)
    assert isinstance(found, Config) or all(1 <= finding.line <= text.count("\n") + 1 for finding in found)


def sections(model: type[Section]) -> Iterator[type[Section]]:
    yield model
    for field in model.model_fields.values():
        yield from inner_sections(field.annotation)


def inner_sections(annotation: object) -> Iterator[type[Section]]:
    if isinstance(annotation, type) and issubclass(annotation, Section):
        yield from sections(annotation)
    for inner in get_args(annotation):
        yield from inner_sections(inner)


def test_every_setting_has_meaning_unit_source_and_numbers_a_range() -> None:
    found = list(sections(Config))
    assert len(found) >= 10
    for section in found:
        for name, field in section.model_fields.items():
            extra = field.json_schema_extra
            assert field.description, name
            assert extra["unit"], name
            assert extra["source"], name
            if field.annotation in {float, int}:
                assert field.metadata, f"{section.__name__}.{name} has no range"


def test_the_oven_section_knows_every_setting_of_the_plant() -> None:
    assert OvenPlantConfig(kind="oven").settings() == OvenSettings()
    assert set(OvenPlantConfig.model_fields) - {"kind", "start_c", "loads"} == {
        field.name for field in fields(OvenSettings)
    }


def test_the_reference_page_is_in_step_with_the_models() -> None:
    root = Path(__file__).resolve().parents[2]
    page = runpy.run_path(str(root / "scripts" / "document_config.py"))["page"]()
    assert (root / "docs" / "configuration.md").read_text() == page, "run: python scripts/document_config.py"


def test_the_trial_time_leaves_room_for_the_probation(tmp_path: Path) -> None:
    oven = (Path(__file__).resolve().parents[2] / "examples" / "oven.toml").read_text()
    path = tmp_path / "oven.toml"
    path.write_text(oven)
    assert load_config(path).confirm_within_s == 120.0  # on by default: 60 samples
    path.write_text(oven.replace('kind = "virtual"', 'kind = "virtual"\nconfirm_within_s = 30.0'))
    assert load_config(path).device.confirm_within_s == 30.0
    path.write_text(oven.replace('kind = "virtual"', 'kind = "virtual"\nconfirm_within_s = 20.0'))
    with pytest.raises(ConfigError, match=r"confirm_within_s = 20 s must be 0, or 30 to 131070 s: the 5 samples"):
        load_config(path)


@pytest.mark.parametrize("text", ["\\u001b[2Joven", "oven\\u0007", "a\\u202eb", "two\\nlines"])
def test_names_that_a_terminal_would_act_on_are_refused(tmp_path: Path, text: str) -> None:
    path = tmp_path / "oven.toml"
    path.write_text(re.sub(r'name = "[^"]*"', f'name = "{text}"'.replace("\\", "\\\\"), GOOD, count=1))
    with pytest.raises(ConfigError, match="cannot be printed"):
        load_config(path)


# From the configuration to the guard: every limit arrives, and the defaults are the guard's own


OVEN = Path(__file__).resolve().parents[2] / "examples" / "oven.toml"
NOT_SETTABLE = {"corner_std"}  # What follows from another setting, or stands in where nothing better is known


def configured(tmp_path: Path, limits: str) -> GuardSettings:
    text = OVEN.read_text()
    assert "[adaptation]\n" in text
    path = tmp_path / "oven.toml"
    path.write_text(f"{text}\n[adaptation.limits]\n{limits}\n")
    return guard_settings(load_config(path))


def test_every_limit_of_the_guard_can_be_set() -> None:
    known = set(AdaptationConfig.model_fields) | set(LimitsConfig.model_fields)
    assert {field.name for field in fields(GuardSettings)} - known == NOT_SETTABLE
    assert set(LimitsConfig.model_fields) <= {field.name for field in fields(GuardSettings)}


def test_the_defaults_are_the_guards_own(tmp_path: Path) -> None:
    assert configured(tmp_path, "") == GuardSettings()


@pytest.mark.parametrize("name", LimitsConfig.model_fields)
def test_what_is_set_arrives(name: str, tmp_path: Path) -> None:
    value = 2 if name == "records_min" else 1.75
    assert getattr(configured(tmp_path, f"{name} = {value}"), name) == value


def test_limits_that_leave_no_room_are_refused_with_their_place(tmp_path: Path) -> None:
    with pytest.raises(UserError, match=r"tau_i_max_s.*greater than tau_i_min_s"):
        configured(tmp_path, "tau_i_min_s = 20.0\ntau_i_max_s = 10.0")
    with pytest.raises(UserError, match="total_ratio_max"):
        configured(tmp_path, "total_ratio_max = 0.5")


def test_locked_parameters_arrive_for_the_loop_and_for_single_regions(tmp_path: Path) -> None:
    text = OVEN.read_text().replace("[adaptation]\n", '[adaptation]\nlocked = ["tau_d"]\n')
    first, head, rest = text.partition("[[schedule.region]]\n")
    path = tmp_path / "oven.toml"
    path.write_text(f'{first}{head}locked = ["tau_i", "tau_d"]\n{rest}')
    settings = retuner_settings(load_config(path))
    assert settings.locks_of(0) == KC_ONLY
    assert settings.locks_of(1) == NO_DERIVATIVE
    path.write_text(text.replace('["tau_d"]', '["tau_x"]'))
    with pytest.raises(UserError, match="locked"):
        load_config(path)


@pytest.mark.parametrize(("nominal", "worst"), [(2.0, 3.0), (1.3, 1.5)])
def test_every_limit_of_robustness_follows_from_the_persons_two(nominal: float, worst: float, tmp_path: Path) -> None:
    path = tmp_path / "oven.toml"
    limits = f"[adaptation]\nms_nominal = {nominal}\nms_worst = {worst}\n"
    path.write_text(OVEN.read_text().replace("[adaptation]\n", limits))
    found, usual = retuner_settings(load_config(path)), retuner_settings(load_config(OVEN))
    for one, was in (
        (found.cause.ms_high, usual.cause.ms_high),
        (found.diagnosis.cause.ms_high, usual.diagnosis.cause.ms_high),
        (found.robust.ms_nominal, usual.robust.ms_nominal),
        (found.choice.ms_limit, usual.choice.ms_limit),
        (found.book.ms_high, usual.book.ms_high),
    ):
        assert one / was == pytest.approx(nominal / 1.75)
    assert found.guard.ms_border == found.trial.harmless_ms == pytest.approx(worst)
    assert (found.cause.ms_high > 1.83) is (nominal > 1.75)


def test_a_boundary_of_ones_own_and_the_usual_limits_stay(tmp_path: Path) -> None:
    path = tmp_path / "oven.toml"
    text = OVEN.read_text().replace("[adaptation]\n", "[adaptation]\nms_worst = 2.5\n")
    path.write_text(f"{text}\n[adaptation.limits]\nms_border = 1.9\n")
    assert retuner_settings(load_config(path)).guard.ms_border == 1.9
    usual = retuner_settings(load_config(OVEN))
    assert usual.cause.ms_high == 1.8
    assert usual.choice.ms_limit == 1.8
