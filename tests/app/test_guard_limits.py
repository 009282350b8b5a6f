"""From the configuration to the guard: every limit arrives, and the defaults are the guard's own."""

from dataclasses import fields
from pathlib import Path

import pytest

from retuner.adaptive.guard import KC_ONLY, NO_DERIVATIVE, GuardSettings
from retuner.config import load_config
from retuner.config.adaptation import AdaptationConfig
from retuner.config.learning import LimitsConfig
from retuner.errors import UserError
from retuner.session.assembly import guard_settings, retuner_settings

OVEN = Path(__file__).resolve().parents[2] / "examples" / "oven.toml"
NOT_SETTABLE = {"corner_std"}
"""What follows from another setting, or stands in where nothing better is known."""


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
