"""A repr shows numbers, whatever numbers something was made of; a process type that is none is refused by its list."""

import numpy as np
import pytest

import retuner
from retuner import LinearProcess, PidGains, ProcessModel, ProcessType, margins, performance

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
