"""Gains in the user's own units: read from the configuration, shown on screens and pages, written back."""

from collections.abc import Iterator
from pathlib import Path

import pytest

from retuner.cli import main
from retuner.config.loading import UnusableError, load_config, parse_config, parse_session
from retuner.decision_page import shown_units
from retuner.decision_page.decision_sentences import moves
from retuner.decision_page.decision_words import settings_text, short_settings
from retuner.decision_page.shown_units import show_units_of, show_units_told
from retuner.schedule.document import to_toml
from retuner.schedule.gains import PidGains

HEAD = """schema = 1
[loop]
name = "cooler"
pv_unit = "degC"
pv_min = 0
pv_max = 200
sample_time_s = 1.0
{loop}
[schedule]
[[schedule.region]]
name = "all"
{region}
"""
PLAIN = "kc = 2.0\ntau_i_s = 30.0"
TRADE = "pb_pct = 25.0\nrepeats_per_min = 2.0  # as on the panel"


@pytest.fixture(autouse=True)
def _default_units() -> Iterator[None]:
    yield
    shown_units._units.clear()


def text(region: str = TRADE, loop: str = "") -> str:
    return HEAD.format(loop=loop, region=region)


def refused(region: str = TRADE, loop: str = "") -> dict[str, str]:
    with pytest.raises(UnusableError) as wrong:
        parse_config(text(region, loop))
    return {finding.key.rpartition(".")[2]: finding.message for finding in wrong.value.findings}


@pytest.mark.parametrize(
    ("region", "loop"),
    [
        (TRADE, ""),
        ("gain = 4.0\ntau_i_min = 0.5", ""),
        ("pb_pct = 25\ntau_i_s = 30\ntau_d_min = 0", 'action = "reverse"'),
    ],
)
def test_the_same_controller_in_other_units(region: str, loop: str) -> None:
    assert parse_config(text(region, loop)).gains() == parse_config(text(PLAIN)).gains()


def test_a_direct_acting_controller_has_positive_numbers() -> None:
    found = parse_config(text(TRADE, 'action = "direct"'))
    assert found.gains() == (PidGains(-2.0, -2.0 / 30),)
    assert found.units.text(found.gains()[0], acting=True) == "PB 25 % reset 2 repeats/min, direct acting"
    assert "give it positive" in refused("pb_pct = -25\ntau_i_s = 30", 'action = "direct"')["pb_pct"]


@pytest.mark.parametrize(
    ("region", "key", "said"),
    [
        ("kc = 2\n" + TRADE, "pb_pct", "conflicts with kc"),
        ("tau_i_s = 30", "kc", "add kc, gain or pb_pct"),
        ("pb_pct = 25", "tau_i_s", "add tau_i_s, tau_i_min or repeats_per_min"),
        ("pb_pct = 0\ntau_i_s = 30", "pb_pct", "would control nothing"),
        ("kc = 2\ntau_i_s = 30\ntau_i_min = 0.5", "tau_i_min", "conflicts with tau_i_s"),
        ("kc = 2\nrepeats_per_min = 120", "repeats_per_min", "must be at least loop.sample_time_s"),
        ("kc = 2\nrepeats_per_min = -1", "repeats_per_min", "0"),
        ("pb_pct = nan\ntau_i_s = 30", "pb_pct", "finite"),
    ],
)
def test_numbers_that_make_no_controller_are_refused(region: str, key: str, said: str) -> None:
    assert said in refused(region)[key]


def test_units_that_there_are_not_are_refused() -> None:
    assert "use kc-s" in refused(loop='controller = "pb-h"')["controller"]
    assert "direct" in refused(loop='action = "cooling"')["action"]


def test_check_shows_what_stands_on_the_panel(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "loop.toml"
    path.write_text(text())
    assert main(["check", str(path)]) == 0
    assert "PB 25 % reset 2 repeats/min" in capsys.readouterr().out
    path.write_text(text(PLAIN, 'controller = "gain-min"'))
    assert main(["check", str(path)]) == 0
    assert "gain 4 %/% tau_I 0.5 min" in capsys.readouterr().out


def test_everything_shown_of_a_loop_is_in_its_units() -> None:
    one, two = PidGains(2.0, 2.0 / 30), PidGains(4.0, 4.0 / 30)
    assert settings_text(one) == "Kc 2 tau_I 30 s"
    show_units_of(parse_session(text()))
    assert settings_text(one) == settings_text(one, "cooler") == "PB 25 % reset 2 repeats/min"
    assert short_settings(one) == "25, 2"
    assert moves(one, two, "cooler") == "PB from 25 to 12.5 % (x 0.5)"
    show_units_told(parse_session(text(PLAIN).replace("cooler", "heater")).summary())
    assert settings_text(one, "heater") == settings_text(one) == "Kc 2 tau_I 30 s"
    assert settings_text(one, "cooler") == "PB 25 % reset 2 repeats/min"


def test_tuned_gains_go_back_in_the_units_in_which_they_came(tmp_path, capsys):
    config, gains = tmp_path / "loop.toml", tmp_path / "gains.toml"
    config.write_text(text(TRADE, 'action = "direct"'))
    table = load_config(config).gain_table().with_gains("all", PidGains(-4.0, -0.2))
    gains.write_text(to_toml(table))
    assert main(["export", str(gains), "--into", str(config)]) == 0
    assert "pb_pct 25 repeats_per_min 2 tau_d_s 0 -> pb_pct 12.5 repeats_per_min 3" in capsys.readouterr().out
    assert "# as on the panel" in config.read_text()
    assert load_config(config).gains() == (PidGains(-4.0, -0.2),)
    gains.write_text(to_toml(table.with_gains("all", PidGains(-4.0, 0.0))))
    assert main(["export", str(gains), "--into", str(config)]) == 0
    assert load_config(config).gains() == (PidGains(-4.0, 0.0),)


PLANT = '[device]\nkind = "virtual"\n[device.plant]\nkind = "linear"\nk = {k}\nlags_s = [50.0]\ntheta_s = 5.0\n'
STEPS = "[scenario]\nduration_s = 100.0\nsteps = [{ at_s = 0, sp = 20.0 }, { at_s = 50.0, sp = 120.0 }]\n"


def checked(path: Path, written: str, capsys: pytest.CaptureFixture[str]) -> tuple[int, str]:
    path.write_text(written)
    status = main(["check", str(path)])
    return status, capsys.readouterr().out


def test_check_compares_the_sign_of_the_gains_with_the_plant(tmp_path, capsys):
    path = tmp_path / "loop.toml"
    assert checked(path, text() + PLANT.format(k=0.5), capsys)[0] == 0
    status, said = checked(path, text() + PLANT.format(k=-0.5), capsys)
    assert status == 1
    assert "needs a direct-acting controller; these gains are reverse acting" in said
    assert checked(path, text(TRADE, 'action = "direct"') + PLANT.format(k=-0.5), capsys)[0] == 0
    assert checked(path, text(TRADE, 'action = "direct"') + PLANT.format(k=0.5), capsys)[0] == 1


def test_check_tells_of_limits_in_the_way(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "loop.toml"
    status, said = checked(path, text() + "[adaptation]\nkc_max = 1.0\n", capsys)
    assert (status, said.count("warning")) == (0, 1)
    assert "kc = 2 (parallel form) is above the limit of [adaptation], 1" in said
    status, said = checked(path, text() + PLANT.format(k=0.5) + STEPS, capsys)
    assert (status, said.count("warning")) == (0, 1)
    assert "from 20 to 120 at 50 s moves the output by 200 % at once" in said
    assert "warning" not in checked(path, text() + STEPS.replace("120.0", "60.0"), capsys)[1]
