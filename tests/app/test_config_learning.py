"""[adaptation.admission] and [adaptation.pattern]: from the file into the retuner's settings, and what is refused."""

from pathlib import Path

import pytest
from command_line import refused

from retuner.adaptive.supervision.admission import AdmissionSettings
from retuner.adaptive.supervision.decision import Mode
from retuner.adaptive.without_model.proposal_without_model import WithoutModelSettings
from retuner.config.loading import load_config, parse_config
from retuner.session.assembly import retuner_settings

OVEN = Path(__file__).parents[2] / "examples" / "oven.toml"
LOOP = """
schema = 1
loop = { name = "tank", pv_unit = "m", pv_min = 0.0, pv_max = 10.0, sample_time_s = 1.0 }
schedule = { variable = "sp", region = [{ name = "all", kc = 1.0, tau_i_s = 10.0 }] }
"""


def written(tmp_path: Path, text: str) -> Path:
    path = tmp_path / "loop.toml"
    path.write_text(LOOP + text)
    return path


def test_a_file_that_says_nothing_means_the_rooms_own_defaults(tmp_path: Path) -> None:
    settings = retuner_settings(load_config(written(tmp_path, "")))
    assert settings.admission == AdmissionSettings()
    assert settings.without_model == WithoutModelSettings()


def test_what_the_file_says_reaches_the_retuner(tmp_path: Path) -> None:
    text = """
[adaptation.admission]
limited_share = 0.2
moves_most = 7
[adaptation.pattern]
allowed = false
step_up = 1.1
"""
    settings = retuner_settings(load_config(written(tmp_path, text)))
    assert (settings.admission.limited_share, settings.admission.moves_most) == (0.2, 7)
    assert settings.without_model.allowed is False
    assert settings.without_model.pattern.step_up == 1.1


@pytest.mark.parametrize(
    ("text", "named"),
    [
        ("[adaptation.admission]\nexcitation_bands = 1.0\n", "excitation_bands"),
        ("[adaptation.pattern]\nstep_up = 3.0\n", "step_up"),
        ("[adaptation.pattern]\ndead_zone = 0.2\n", "dead_zone"),
        ("[adaptation]\npretune_step_pct = 80.0\n", "pretune_step_pct"),
    ],
)
def test_what_is_out_of_range_is_one_line_with_its_place(text, named, tmp_path):
    error = refused("check", str(written(tmp_path, text)))
    assert named in error
    assert "loop.toml" in error


def test_a_region_has_its_own_mode_and_the_mode_of_a_run_is_the_most_it_may_do() -> None:
    oven = OVEN.read_text()
    assert oven.count('name = "middle"') == 1
    config = parse_config(oven.replace('name = "middle"', 'name = "middle"\nmode = "advise"'))
    configured = retuner_settings(config)
    assert [configured.mode_of(i) for i in range(3)] == [Mode.AUTO, Mode.ADVISE, Mode.AUTO]
    for mode in Mode:
        lowest = min(mode, Mode.ADVISE, key=list(Mode).index)
        given = retuner_settings(config, mode)
        assert [given.mode_of(i) for i in range(3)] == [mode, lowest, mode]
