"""`from retuner import ...`: every public name, whatever else has been imported before."""

import subprocess
import sys
from inspect import ismodule
from pathlib import Path

import pytest

import retuner

ROOT = Path(__file__).resolve().parents[2]
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


@pytest.mark.parametrize("order", ["", "[::-1]"])
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
