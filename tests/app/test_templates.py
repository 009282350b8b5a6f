"""The templates of CONTRIBUTING.md work as they stand, and are held to what their kind promises."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from cause_contract import assert_keeps_contract, loop
from command_line import run
from templates import FOLDER, template

from retuner.adaptive.signals.sample import Window

ROOT = FOLDER.parents[1]


@pytest.fixture
def at_the_root(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(ROOT)


def spiky() -> Window:
    window = loop(2.5, 30.0, 9)
    pv = window.pv.copy()
    pv[[400, 1200, 2000, 3100]] += 4.0
    return replace(window, pv=pv)


def test_the_template_of_a_cause_keeps_the_contract() -> None:
    assert_keeps_contract(template("cause").spikes, spiky())


def test_the_contract_refuses_a_look_that_sees_its_cause_everywhere() -> None:
    found = template("cause").spikes(spiky())

    with pytest.raises(AssertionError):
        assert_keeps_contract(lambda _: found, spiky())


def test_the_contract_refuses_a_limit_in_units() -> None:
    look = template("cause").spikes

    with pytest.raises(AssertionError):
        assert_keeps_contract(lambda window: look(window) if np.ptp(window.pv) < 100.0 else None, spiky())


@pytest.mark.slow
@pytest.mark.usefixtures("at_the_root")
def test_the_template_of_a_profile_is_short_checked_and_retuned(tmp_path: Path) -> None:
    path = FOLDER / "profile.toml"
    assert len(path.read_text("utf-8").splitlines()) <= 40
    assert run("check", path).returncode == 0

    done = run("run", path, "--out", tmp_path / "run", "--no-compare", "--json")

    assert done.returncode == 0, done.stderr
    assert any(one["action"] == "commit" for one in json.loads(done.stdout)["decisions"])
    assert run("ledger", "verify", tmp_path / "run").returncode == 0


def test_contributing_names_every_template_and_they_are_there() -> None:
    page = (ROOT / "CONTRIBUTING.md").read_text("utf-8")

    for path in FOLDER.iterdir():
        if path.is_file() and path.suffix != ".pyc":
            assert f"docs/templates/{path.name}" in page
