"""One place chooses the engine; an extension that is missing or old is not used, and that is said."""

import importlib
from types import SimpleNamespace

import pytest

from retuner.adaptive.identification import engine


@pytest.fixture(autouse=True)
def fresh() -> None:
    engine._chosen.cache_clear()
    yield
    engine._chosen.cache_clear()


def test_numpy_by_name(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(engine.VARIABLE, "numpy")
    assert engine.compiled() is None
    assert engine.engine_name().startswith("numpy ")


def test_an_unknown_engine_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(engine.VARIABLE, "fortran")
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
    with engine.using("c"), pytest.raises(ValueError, match="version 0; version 1 is needed"):
        engine.compiled()


def test_the_name_for_the_ledger() -> None:
    extension = pytest.importorskip("retuner.adaptive.identification._engine")
    with engine.using("c"):
        assert engine.engine_name() == f"c {extension.version}"
    assert importlib.import_module("retuner.adaptive.identification.compiled").packed
