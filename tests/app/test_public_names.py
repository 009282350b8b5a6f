"""`from retuner import ...`: every public name, whatever else has been imported before."""

import subprocess
import sys
from datetime import UTC, datetime, timedelta
from inspect import ismodule
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

import retuner
from retuner.api import window_of

ROOT = Path(__file__).resolve().parents[2]
DATA = ROOT / "tests" / "data"
PROMISED = ["Retuner", "LoopSample", "GainTable", "PidGains", "identify", "diagnose", "tune"]
"""The names that README and the design promise."""


@pytest.mark.parametrize("name", sorted({*PROMISED, *retuner.__all__}))
def test_a_public_name_is_there_and_no_module(name: str) -> None:
    found = getattr(retuner, name)
    assert callable(found)
    assert not ismodule(found)
    assert name in dir(retuner)


def modules() -> list[str]:
    """Every module of the package, by its import name."""
    homes = {"retuner": ROOT / "src" / "retuner"}
    homes |= {f"retuner.{room}": ROOT / room for room in ("schedule", "adaptive", "drivers")}
    found = {
        ".".join([package, *path.relative_to(home).with_suffix("").parts])
        for package, home in homes.items()
        for path in home.rglob("*.py")
    }
    return sorted(name.removesuffix(".__init__") for name in found if not name.endswith("__main__"))


def test_no_import_of_a_module_takes_the_place_of_a_public_name() -> None:
    submodules = {name.split(".")[1] for name in modules() if "." in name}
    assert len(submodules) > 10
    assert not submodules & set(retuner.__all__)


@pytest.mark.slow
@pytest.mark.parametrize("order", ["", pytest.param("[::-1]", marks=pytest.mark.nightly)])
def test_after_every_import_the_names_are_what_they_were(order: str) -> None:
    script = f"""if True:
        from importlib import import_module
        from inspect import ismodule
        import retuner
        for name in {modules()!r}{order}:
            try:
                import_module(name)
            except ImportError as missing:  # the compiled engine is built only where there is a compiler
                assert "_engine" in str(missing), missing
        assert not [name for name in retuner.__all__ if ismodule(getattr(retuner, name))]
        from retuner import {", ".join(PROMISED)}
        from retuner import *"""
    subprocess.run([sys.executable, "-P", "-c", script], check=True)


def test_moments_are_seconds_whatever_their_type() -> None:
    begin = datetime(2024, 3, 14, 12, tzinfo=UTC)
    moments = [begin + timedelta(seconds=10 * i) for i in range(5)]
    naive = [moment.replace(tzinfo=None) for moment in moments]
    expected = np.arange(5) * 10.0
    for t in (expected, moments, naive, np.array(naive, dtype="datetime64[us]"), pd.DatetimeIndex(naive)):
        np.testing.assert_allclose(window_of(t, *[expected] * 3).t_s, expected)
    spans = np.array(naive, dtype="datetime64[us]") - np.datetime64(naive[0])
    np.testing.assert_allclose(window_of(spans, *[expected] * 3).t_s, expected)


def test_a_record_is_taken_as_it_was_read() -> None:
    read = retuner.read(DATA / "raw" / "historian_export_1.txt")
    frame = pd.DataFrame({"PV": read.recording.pv, "SP": read.recording.sp, "OP": read.recording.co})
    again = retuner.read(frame, dt_s=10.0)

    assert np.array_equal(window_of(again).pv, window_of(read).pv)
    assert np.array_equal(window_of(again).t_s, window_of(read).t_s)
    with pytest.raises(ValueError, match="a record brings its own sp, pv and co"):
        window_of(read, [1.0], [1.0], [1.0])
    with pytest.raises(ValueError, match=r"or a record of retuner\.read"):
        window_of([1.0, 2.0])
    with pytest.raises(TypeError, match="colour"):
        retuner.read(frame, colour="red")


def test_what_numpy_would_drop_without_a_word_is_refused() -> None:
    ones = np.ones(4)
    masked = np.ma.masked_array(ones, [False, True, False, False])
    with pytest.raises(ValueError, match=r"pv\[1\] = nan is not a finite number"):
        window_of(np.arange(4.0), ones, masked, ones)
    with pytest.raises(ValueError, match="co is complex; give real numbers"):
        window_of(np.arange(4.0), ones, ones, ones * 1j)
    with pytest.raises(ValueError, match=r"sp has shape \(2,\); give 4 values in one row"):
        window_of(np.arange(4.0), ones[:2], ones, ones)


def test_former_names_still_work() -> None:
    proof: Any = object()
    names = (1, 0.0, "tank", "all", retuner.Mode.AUTO, retuner.Action.NONE, "ok", "")
    made = retuner.Decision(*names, retuner.PidGains(1.0, 0.1), proof=proof)
    assert made.verdict is proof
    assert retuner.PidController.take_back is retuner.PidController.roll_back
    assert retuner.Retuner.taken_back is retuner.Retuner.rolled_back
