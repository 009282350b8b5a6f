"""One place chooses the engine; an extension that is missing or old is not used, and that is said."""

import importlib
import os
import subprocess
import sys
from types import SimpleNamespace

import pytest

from retuner.adaptive.fit import engine


@pytest.fixture(autouse=True)
def fresh() -> None:
    engine._chosen.cache_clear()
    preferred = engine._preferred[0]
    yield
    engine.prefer(preferred)
    engine._chosen.cache_clear()


def test_numpy_by_name() -> None:
    engine.prefer("numpy")
    assert engine.compiled() is None
    assert engine.engine_name().startswith("numpy ")


def test_the_package_hands_over_what_the_environment_says() -> None:
    code = "import retuner; from retuner.adaptive.fit.engine import engine_name; print(engine_name())"
    said = subprocess.run(
        [sys.executable, "-P", "-c", code],
        env={**os.environ, engine.VARIABLE: "numpy"},
        capture_output=True,
        text=True,
        check=True,
    )
    assert said.stdout.startswith("numpy ")


def test_an_unknown_engine_is_refused() -> None:
    engine.prefer("fortran")
    with pytest.raises(ValueError, match="RETUNER_ENGINE = 'fortran': give one of auto, c, numpy"):
        engine.compiled()


def test_without_the_extension_numpy_computes(monkeypatch: pytest.MonkeyPatch) -> None:
    def missing(name: str) -> None:
        raise ImportError(f"no {name}")

    monkeypatch.setattr(engine, "import_module", missing)
    with engine.using("auto"):
        assert engine.compiled() is None
    with engine.using("c"), pytest.raises(ValueError, match="cannot be loaded"):
        engine.compiled()


def test_an_extension_of_another_version_is_not_used(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(engine, "import_module", lambda _: SimpleNamespace(version="0"))
    with engine.using("auto"):
        assert engine.compiled() is None
    with engine.using("c"), pytest.raises(ValueError, match=f"version 0; version {engine.COMPILED_VERSION} is needed"):
        engine.compiled()


def test_the_name_for_the_ledger() -> None:
    extension = pytest.importorskip("retuner.adaptive.fit._engine")
    with engine.using("c"):
        assert engine.engine_name() == f"c {extension.version}"
    assert importlib.import_module("retuner.adaptive.fit.compiled").packed
