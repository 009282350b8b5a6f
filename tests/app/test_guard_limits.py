"""From the configuration to the guard: every limit arrives, and the defaults are the guard's own."""

from dataclasses import fields
from pathlib import Path

import pytest

from retuner.adaptive.guard import KC_ONLY, NO_DERIVATIVE, GuardSettings
from retuner.config import load_config
from retuner.config.adaptation import AdaptationConfig, LimitsConfig
from retuner.errors import UserError
from retuner.session.assembly import guard_settings, retuner_settings

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


def test_a_border_of_ones_own_and_the_usual_limits_stay(tmp_path: Path) -> None:
    path = tmp_path / "oven.toml"
    text = OVEN.read_text().replace("[adaptation]\n", "[adaptation]\nms_worst = 2.5\n")
    path.write_text(f"{text}\n[adaptation.limits]\nms_border = 1.9\n")
    assert retuner_settings(load_config(path)).guard.ms_border == 1.9
    usual = retuner_settings(load_config(OVEN))
    assert usual.cause.ms_high == 1.8
    assert usual.choice.ms_limit == 1.8
