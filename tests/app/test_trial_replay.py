"""A run that ends in mid-trial: the change is taken back, told everywhere, and a replay decides it again."""

import json
from pathlib import Path

import can
import pytest
from command_line import printed
from two_regions import two_regions

from retuner.cli import main
from retuner.drivers.controller.gain_memory import GainSet
from retuner.drivers.controller.virtual_device import VirtualDevice
from retuner.ledger import LedgerReader
from retuner.schedule.gains import PidGains

SHORT = two_regions("auto", 50.0, "at_s = 0.0, sp = 2.0", "at_s = 20.0, sp = 3.0")
"""A sluggish loop: its first response ends three seconds before the run does."""


@pytest.mark.slow
@pytest.mark.uncounted
def test_an_undecided_change_that_is_robust_stays_at_the_end_and_is_decided_again_by_a_replay(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "short.toml").write_text(SHORT, encoding="utf-8")
    assert "Session ended during the trial; trial gains kept" in printed("run", "short.toml", "--no-compare")
    with LedgerReader(tmp_path / "out" / "ledger.sqlite") as reader:
        rows = [(row.kind, json.loads(row.text)) for row in reader.rows()]
        assert reader.verify().ok
    bodies = dict(rows)
    told = [kind for kind, _ in rows if kind in {"trial", "abort", "restore", "restored"}]
    assert told == ["trial", "abort", "restored"]
    assert bodies["restored"]["gains"] == bodies["trial"]["gains"]
    assert bodies["decision"]["code"] == "kept_stopped"
    assert bodies["decision"]["gains_after"] == bodies["trial"]["gains"]
    summary = json.loads((tmp_path / "out" / "summary.json").read_text())
    assert summary["scores"][0]["after"] != summary["scores"][0]["before"]
    assert "identical" in printed("replay", "out")


@pytest.mark.parametrize("back", [pytest.param(False, marks=[pytest.mark.slow, pytest.mark.uncounted]), True])
def test_a_turned_action_is_an_alarm_in_the_run_and_is_decided_again_by_a_replay(tmp_path, monkeypatch, capsys, back):
    """Someone turns the action at the controller in the middle of a trial; and back again, or not."""
    step = VirtualDevice.step

    def turns(device: VirtualDevice, dt_s: float | None = None) -> list[can.Message]:
        if device.sample == 480 or (back and device.sample == 490):
            pages, gains = device.pages, device.pages.running.gains
            pages.latest += 1
            pages.running = pages.confirmed = GainSet(pages.latest, PidGains(-gains.kp, -gains.ki, -gains.kd))
        return step(device, dt_s)

    monkeypatch.setattr(VirtualDevice, "step", turns)
    monkeypatch.chdir(tmp_path)
    (tmp_path / "short.toml").write_text(SHORT, encoding="utf-8")
    assert main(["run", "short.toml", "--no-compare"]) == (0 if back else 2)
    told = capsys.readouterr()
    assert "other sign" in told.out
    assert back or "other sign" in told.err
    with LedgerReader(tmp_path / "out" / "ledger.sqlite") as reader:
        rows = [(row.kind, row.body) for row in reader.rows()]
    turned = [body["turned"] for kind, body in rows if kind == "action"]
    assert turned == ([True, False] if back else [True])
    after = [kind for kind, _ in rows[[kind for kind, _ in rows].index("action") :]]
    assert back or "intent" not in after
    assert "identical" in printed("replay", "out")
