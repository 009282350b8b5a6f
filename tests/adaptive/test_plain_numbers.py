"""A repr shows numbers, whatever numbers something was made of; a process type that is none is refused by its list,
and a setting outside its range by its name.
"""

import math
import pkgutil
import subprocess
import sys
from dataclasses import FrozenInstanceError, dataclass, is_dataclass
from importlib import import_module

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import retuner
from retuner import LinearProcess, PidGains, ProcessModel, ProcessType, adaptive, margins, performance
from retuner.adaptive.decision_numbers import NO_NUMBERS, Numbers
from retuner.adaptive.declared_setting import declared
from retuner.adaptive.diagnosis.diagnosis_settings import DiagnosisSettings
from retuner.adaptive.diagnosis.tuning_verdict import _unexplained
from retuner.adaptive.identification.estimate import factors_text
from retuner.adaptive.signals.sample import (
    MOST_KEPT,
    FloatArray,
    distinct,
    kept_of_signal,
    least_squares,
    median,
    quantile,
)
from retuner.adaptive.supervision.admission import AdmissionNumbers
from retuner.drivers import plants

X = np.float64
MODEL = ProcessModel(ProcessType.SOPDT, X(2.0), X(30.0), X(4.0), X(5.0))


@pytest.mark.parametrize(
    "made",
    [
        MODEL,
        MODEL.linear(),
        LinearProcess(X(1.0), (X(3.0),), (X(-1.0),), X(2.0), 0, ((X(1.0), X(2.0)),)),
        LinearProcess(1.0, np.array([3.0, 2.0])),  # type: ignore[arg-type]  # who has arrays gives arrays
        margins(MODEL.linear(), PidGains(X(1.5), X(0.05))),
        performance(MODEL.linear(), PidGains(1.5, 0.05)),
        retuner.tune(MODEL),
        retuner.tune(MODEL).margins,
        retuner.tune(MODEL).tuning,
        retuner.reduce(LinearProcess(X(2.0), (X(30.0), X(5.0), X(3.0)), theta_s=X(2.0))),
    ],
)
def test_no_repr_names_numpy(made: object) -> None:
    assert "np." not in repr(made)
    assert "array" not in repr(made)


def test_a_type_that_is_none_is_refused_with_the_list() -> None:
    with pytest.raises(ValueError, match=r"'banana' is no process type; use one of fopdt, sopdt, integrating, "):
        ProcessModel("banana", k=1)  # type: ignore[arg-type]


def test_a_type_may_be_given_by_its_name() -> None:
    named = ProcessModel("fopdt", 2, 30, theta_s=5)  # type: ignore[arg-type]
    assert named == ProcessModel(ProcessType.FOPDT, 2.0, 30.0, theta_s=5.0)
    assert named.type is ProcessType.FOPDT


# Medians and quantiles without numpy.ma are numpy's to the last digit, and a signal is looked at once.


@pytest.mark.parametrize("n", [1, 2, 3, 10, 101, 1000])
@pytest.mark.parametrize("decimals", [0, 2, 12])
def test_they_are_numpys_to_the_last_digit(n: int, decimals: int) -> None:
    values = np.round(np.random.default_rng(n).normal(0.0, 30.0, n), decimals)
    assert median(values) == np.median(values)
    assert np.array_equal(distinct(values), np.unique(values))
    for share in (0.0, 0.05, 0.5, 0.9, 0.999, 1.0):
        assert quantile(values, share) == np.quantile(values, share), share
    assert np.isnan(median([]))


@pytest.mark.parametrize(("n", "columns", "signals"), [(5, 3, 0), (256, 2, 1), (300, 4, 2), (1600, 20, 0), (30, 30, 3)])
def test_least_squares_by_rows_are_those_of_all_at_once(n: int, columns: int, signals: int) -> None:
    rng = np.random.default_rng(n)
    a, y = rng.normal(size=(n, columns)), rng.normal(size=(n, signals) if signals else n)
    found = least_squares(a, y)
    assert found.shape == ((columns, signals) if signals else (columns,))
    assert found == pytest.approx(np.linalg.lstsq(a, y, rcond=None)[0], rel=1e-9, abs=1e-10)


def test_least_squares_of_columns_that_say_the_same_are_the_shortest() -> None:
    a = np.stack([np.ones(500), np.ones(500), np.arange(500.0)], axis=1)
    y = np.random.default_rng(1).normal(size=500)
    assert least_squares(a, y) == pytest.approx(np.linalg.lstsq(a, y, rcond=None)[0], rel=1e-9)


def test_what_is_kept_of_a_signal_is_of_its_values_not_of_the_array() -> None:
    asked = []

    @kept_of_signal
    def size(x: FloatArray) -> float:
        asked.append(len(x))
        return float(np.sum(x))

    x = np.arange(5.0)
    assert (size(x), size(x.copy()), size(x[::-1].copy())) == (10.0, 10.0, 10.0)
    x[0] = 7.0  # the array is another signal now
    assert size(x) == 17.0
    assert asked == [5, 5, 5]
    long = np.zeros(MOST_KEPT + 1)
    assert size(long) == size(long) == 0.0
    assert asked[3:] == [len(long), len(long)]  # long ones would take the room


def test_a_diagnosis_loads_neither_numpy_ma_nor_scipy() -> None:
    code = """if True:
        import sys, numpy as np
        from retuner import diagnose
        rng, t = np.random.default_rng(1), np.arange(400.0)
        sp, pv, co, y = np.where(t % 200 < 100, 50.0, 55.0), [], [], 50.0
        for at in sp:
            pv.append(y + 0.02 * rng.normal()); co.append(50.0 + 1.2 * (at - pv[-1])); y += 0.1 * (co[-1] - y)
        diagnose(t, sp, pv, co)
        print([name for name in ("numpy.ma", "scipy", "pandas", "pyarrow") if name in sys.modules])"""
    found = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert found.stdout.strip() == "[]"


# Sentences that name a number and its limit tell them apart.


def test_as_few_digits_as_tell_the_two_apart() -> None:
    assert factors_text(math.log(1.80), math.log(1.35)) == ("1.80", "1.35")
    assert factors_text(math.log(1.3512), math.log(1.35)) == ("1.351", "1.350")
    assert factors_text(50.0, 0.3) == ("over 1000", "1.3")


@given(limit=st.floats(0.05, 1.0), over=st.floats(1e-4, 5.0))
def test_what_is_over_its_limit_is_told_as_larger(limit: float, over: float) -> None:
    known, needed = factors_text(limit + over, limit)
    assert float(known) > float(needed)


@pytest.mark.parametrize(("loads", "left", "said"), [(0, 9.0, "9.0 times the noise"), (9, 1.0, "9 load steps explain")])
def test_what_is_not_explained_is_told_by_what_is_wrong_with_it(loads: float, left: float, said: str) -> None:
    assert said in _unexplained(0.0, loads, left, DiagnosisSettings())
    assert _unexplained(0.0, 0.0, 1.0, DiagnosisSettings()) == ""


# What was weighed: told where it is said, joined without touching either.


@dataclass(frozen=True, slots=True)
class Outer(Numbers):
    peaks: float
    inner: AdmissionNumbers | None = None


def test_what_is_not_said_is_not_told_and_zero_is_said() -> None:
    assert AdmissionNumbers(manual=0.0, limit=0.5).to_dict() == {"manual": 0.0, "limit": 0.5}
    assert NO_NUMBERS.to_dict() == {}


def test_numbers_within_numbers_stand_beside_the_rest() -> None:
    assert Outer(2.0, AdmissionNumbers(kept=7.0)).to_dict() == {"peaks": 2.0, "kept": 7.0}
    assert Outer(2.0).to_dict() == {"peaks": 2.0}


def test_joined_keeps_both_and_changes_neither() -> None:
    first, second = AdmissionNumbers(kept=1.0, manual=0.0), AdmissionNumbers(manual=3.0)
    assert first.joined(second).to_dict() == {"kept": 1.0, "manual": 3.0}
    assert (first.manual, second.kept) == (0.0, None)


def test_nobody_writes_into_them() -> None:
    said = AdmissionNumbers()
    with pytest.raises(FrozenInstanceError):
        said.kept = 1.0


# Settings are held to their declaration: a value outside its range, or no number, is refused by its name


ROOMS = ((adaptive.__path__, "retuner.adaptive."), (plants.__path__, "retuner.drivers.plants."))
MODULES = [import_module(found.name) for path, name in ROOMS for found in pkgutil.walk_packages(path, name)]
SETTINGS = [
    kind
    for module in MODULES
    for kind in vars(module).values()
    if isinstance(kind, type) and is_dataclass(kind) and kind.__module__ == module.__name__ and declared(kind)
]


@pytest.mark.parametrize("settings", SETTINGS, ids=lambda kind: kind.__name__)
def test_a_setting_outside_its_range_is_refused_by_its_name(settings: type) -> None:
    for name, _, _, setting in declared(settings):
        ends = [setting.low - 1, setting.high + 1, *([setting.low] if setting.positive else [])]
        for wrong in (math.nan, *filter(math.isfinite, ends)):
            with pytest.raises(ValueError, match=f"{name} = "):
                settings(**{name: wrong})
