"""A short recorded session for the tests of replay, approve and the ledger's commands, and ways to forge it."""

import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from once import once

from retuner.cli import main
from retuner.commands import left_by_run
from retuner.ledger import Ledger, LedgerReader
from retuner.ledger.chain import Row

SHORT = """
schema = 1
[loop]
name = "short"
pv_unit = "bar"
pv_min = 0.0
pv_max = 10.0
sample_time_s = 0.1
[schedule]
variable = "sp"
[[schedule.region]]
name = "all"
kc = 5.0
tau_i_s = 4.0
[adaptation]
mode = "advise"  # the command line may say more
[device]
seed = 3
[device.plant]
kind = "linear"
k = 0.1
lags_s = [5.0, 0.1]
theta_s = 0.4
start_pv = 2.0
start_co_pct = 30.0
noise = 0.01
[scenario]
duration_s = 80.0
steps = [{ at_s = 0.0, sp = 2.0 }, { at_s = 10.0, sp = 3.0 }, { at_s = 45.0, sp = 2.0 }]
"""


def run_short(folder: Path, *arguments: str, text: str = SHORT) -> Path:
    """The session of a run of it; without its report, which other tests look at and which takes longest of all."""
    (folder / "short.toml").write_text(text)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(left_by_run, "render", lambda data: f"{len(data.decisions)} decisions")
        command = ["run", str(folder / "short.toml"), "--out", str(folder / "run"), "--no-compare", *arguments]
        assert main(command) == 0
    return folder / "run"


def short_session(tmp_path_factory: pytest.TempPathFactory, *arguments: str) -> Path:
    """The session of run_short, run once for all who only read it; its configuration lies beside it."""
    name = "".join(("short", *arguments))
    return once(tmp_path_factory, name, lambda folder: run_short(folder, *arguments)) / "run"


def rewritten(session: Path, to: Path, change: Callable[[Row], dict[str, Any] | None]) -> Path:
    """A copy of a session whose ledger is whole, but tells another story: change gives a row's body, None drops it."""
    shutil.copytree(session, to)
    for path in to.glob("ledger.sqlite*"):
        path.unlink()
    with LedgerReader(session / "ledger.sqlite") as old, Ledger(to / "ledger.sqlite") as new:
        for row in old.rows():
            body = change(row)
            if body is not None:
                new.append(row.kind, body, row.clock_s)
    return to


def bodies(session: Path, kind: str) -> list[dict[str, Any]]:
    """Bodies of the rows of a kind."""
    with LedgerReader(session / "ledger.sqlite") as ledger:
        return [json.loads(row.text) for row in ledger.rows() if row.kind == kind]
