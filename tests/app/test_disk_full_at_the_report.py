"""The disk is full when a run writes what it leaves: each file that is missing is named, and all others are there."""

import errno
import json
import os
from collections.abc import Callable
from pathlib import Path

import pytest
from two_regions import two_regions

from retuner.cli import main
from retuner.files import write_whole

SHORT = two_regions("auto", 40.0, "at_s = 0.0, sp = 2.0", "at_s = 20.0, sp = 3.0")
LEFT = ("trend.csv", "gains.toml", "report.html", "summary.json")


@pytest.fixture
def full(monkeypatch: pytest.MonkeyPatch) -> Callable[..., None]:
    """The disk has no room for files of these names any more."""
    put_on_disk = os.fsync

    def full_for(folder: Path, *names: str) -> None:
        def refusing(handle: int) -> None:
            inode = os.fstat(handle).st_ino
            if any(path.stat().st_ino == inode for name in names for path in folder.glob(f".{name}.*")):
                raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
            put_on_disk(handle)

        monkeypatch.setattr(os, "fsync", refusing)

    return full_for


def test_a_file_that_cannot_be_written_is_named(tmp_path: Path, full: Callable[..., None]) -> None:
    full(tmp_path, "trend.csv")
    with pytest.raises(OSError, match="No space left on device") as refused:
        write_whole(tmp_path / "trend.csv", "1,2,3")
    assert (refused.value.errno, refused.value.filename) == (errno.ENOSPC, str(tmp_path / "trend.csv"))
    assert list(tmp_path.iterdir()) == []


@pytest.mark.slow
@pytest.mark.parametrize("missing", [*[(name,) for name in LEFT], LEFT], ids=lambda names: names[0] * (len(names) < 2))
def test_what_is_missing_is_named_and_the_rest_is_written(missing, tmp_path, full, capsys):
    config, out = tmp_path / "loop.toml", tmp_path / "out"
    config.write_text(SHORT)
    full(out, *missing)
    assert main(["run", str(config), "--out", str(out), "--no-compare"]) == 2
    said = capsys.readouterr()
    lines = said.err.splitlines()
    for name in LEFT:
        assert (out / name).exists() is (name not in missing)
        assert (f"{out / name}: No space left on device" in lines) is (name in missing)
    assert "Traceback" not in said.err
    assert f"retuner report {out}" in lines[-1]
    assert "ledger head" in said.out
    assert json.loads((out / "summary.json").read_text())["folder"] if "summary.json" not in missing else True
    assert main(["ledger", "verify", str(out)]) == 0
