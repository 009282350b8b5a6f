"""The excitation that goes with a region model: it changes hands when the region model does, and only then."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from retuner.adaptive.decision_numbers import NO_NUMBERS
from retuner.adaptive.diagnosis.cause import Cause, Diagnosis
from retuner.adaptive.diagnosis.second_opinion import Excitation
from retuner.adaptive.guard import Ruling
from retuner.adaptive.region_model.update import Agreement
from retuner.adaptive.signals.response import Ending
from retuner.adaptive.supervision import confirmation, decide, findings
from retuner.adaptive.supervision.decision import Outcome
from retuner.adaptive.supervision.findings import Findings
from retuner.adaptive.supervision.question import Question
from retuner.adaptive.supervision.retuner_settings import RetunerSettings
from retuner.adaptive.trial.trial import Trial
from retuner.schedule.table import Lookup

SETTINGS = RetunerSettings(1.0, 100.0)
BEFORE = Excitation(setpoints=0, loads=3, clear=0, alternative=1)
NEW: Any = SimpleNamespace(log=None, reason="", records=2, identifiable=True)
"""A region model that the record has led to."""


def weighed(
    monkeypatch: pytest.MonkeyPatch,
    agreement: Agreement,
    doubt: Cause | None,
    *,
    clear: bool = False,
    ready: bool = True,
    setpoint: bool | None = None,
    contested: bool = False,
) -> Outcome:
    """What follows from one response, with what comes before them given. setpoint : as clear."""
    verdict: Any = SimpleNamespace(
        accepted=True,
        ruling=Ruling.ACCEPTED,
        allowed=(),
        urgent=True,
        ms_before=2.0,
        gains=None,
        sentence="",
        code="accepted",
    )
    cause = Diagnosis(Cause.AGGRESSIVE, 0.9, {}, "")
    given: dict[str, Any] = {
        "unambiguous": lambda *_: clear,
        "prediction_of_proof": lambda *_: None,
        "wanted_of": lambda *_: SimpleNamespace(ready=ready, tuning=None, diagnosis=cause),
        "proved": lambda *_: verdict,
        "worth": lambda *_: (SimpleNamespace(index=1, numbers=NO_NUMBERS, reason=""), verdict),
        "refutation": lambda *_: None,
        "stands": lambda *_: False,
        "exempt_from_confirmation": lambda *_: False,
        "is_known": lambda *_: False,
        "step_without_model": lambda *_: SimpleNamespace(sentence="", numbers=NO_NUMBERS, tuning=None),
        "doubt_of": lambda *_: Diagnosis(doubt, 0.9, {}, "") if doubt else None,
    }
    for name, value in given.items():
        for module in (findings, confirmation, decide):
            if hasattr(module, name):
                monkeypatch.setattr(module, name, value)
    record: Any = SimpleNamespace(
        excitation=BEFORE,
        foreign=1,
        samples=[],
        in_force=None,
        region_models={},
        region=0,
        table=SimpleNamespace(lookup=Lookup.HARD),
        crossed=False,
        at=(0.0, None),
        pattern=None,
        response=SimpleNamespace(
            sp_changed=clear if setpoint is None else setpoint, peaks=(), ending=Ending.COMPLETE, taken_over=False
        ),
        window=SimpleNamespace(t_s=np.array([0.0, 1.0])),
    )
    learned: Any = SimpleNamespace(
        region_model=NEW,
        agreement=agreement,
        estimate=SimpleNamespace(load_times_s=()),
        valve=None,
        contested=contested,
    )
    found = findings.region_model(Findings(Question(record, SETTINGS, 1, Trial()), learned=learned, unexplained=1.0))
    return decide.without_a_model(found) or decide.by_model(found)


def test_a_rival_that_takes_over_brings_what_it_rests_on(monkeypatch: pytest.MonkeyPatch) -> None:
    found = weighed(monkeypatch, Agreement.CHANGED, None)
    assert found.region_model is NEW
    assert found.excitation == Excitation(setpoints=1, loads=1, clear=1)


@pytest.mark.parametrize("agreement", [Agreement.CHANGED, Agreement.FIRST, Agreement.OPENED])
def test_a_model_that_is_not_taken_leaves_the_old_one_with_its_own(monkeypatch, agreement):
    found = weighed(monkeypatch, agreement, Cause.STICTION)
    assert found.region_model is None
    assert (found.excitation.setpoints, found.excitation.loads, found.excitation.clear) == (0, 4, 0)


@pytest.mark.parametrize("agreement", [Agreement.FIRST, Agreement.AGREES])
@pytest.mark.parametrize(
    ("cause", "counted"), [(Cause.EXTERNAL, 2), (Cause.STICTION, 2), (Cause.NOISE, 1), (Cause.UNKNOWN, None)]
)
def test_what_the_whole_diagnosis_finds_behind_a_response_is_counted_as_what_a_swing_shows(
    monkeypatch: pytest.MonkeyPatch, agreement: Agreement, cause: Cause, counted: int | None
) -> None:
    """Three setpoint steps under a tone were each told to be external, and the fourth one changed the gains."""
    assert weighed(monkeypatch, agreement, cause).foreign == counted


@pytest.mark.parametrize("clear", [True, False])
@pytest.mark.parametrize("ready", [True, False])
def test_an_odd_record_is_remembered_by_whether_it_was_clear(monkeypatch, clear, ready):
    found = weighed(monkeypatch, Agreement.CONTRADICTS, None, clear=clear, ready=ready)
    assert found.excitation.alternative == int(clear)


def test_a_first_record_rests_on_itself_ready_or_not(monkeypatch: pytest.MonkeyPatch) -> None:
    for ready in (True, False):
        found = weighed(monkeypatch, Agreement.FIRST, None, ready=ready)
        assert found.excitation == Excitation(loads=1)


def test_a_response_that_cannot_tell_is_nothing_that_a_model_rests_on(monkeypatch: pytest.MonkeyPatch) -> None:
    assert weighed(monkeypatch, Agreement.SILENT, Cause.NOISE).excitation == BEFORE


@pytest.mark.parametrize(("doubt", "setpoint", "clear"), [(None, True, 1), (None, False, 0), (Cause.UNKNOWN, True, 0)])
def test_a_setpoint_response_that_the_whole_diagnosis_confirms_counts_as_clear(monkeypatch, doubt, clear, *, setpoint):
    found = weighed(monkeypatch, Agreement.AGREES, doubt, setpoint=setpoint)
    assert found.excitation.clear == clear


def test_a_response_that_a_model_without_loads_explains_in_another_way_does_not(monkeypatch):
    found = weighed(monkeypatch, Agreement.AGREES, None, setpoint=True, contested=True)
    assert found.excitation.clear == 0


@pytest.mark.parametrize(("agreement", "code"), [(Agreement.CONTRADICTS, "unconfirmed"), (Agreement.AGREES, "ok")])
def test_ok_is_not_said_over_a_response_that_contradicts_the_model(agreement: Agreement, code: str) -> None:
    learned: Any = SimpleNamespace(agreement=agreement, valve=None)
    tuning: Any = SimpleNamespace(diagnosis=Diagnosis(Cause.OK, 0.9, {}, "Ms 1.67"))
    asked: Any = SimpleNamespace(settings=SETTINGS)
    outcome = decide.by_model(Findings(asked, learned=learned, in_use=NEW, wanted=tuning))
    assert outcome.code == code
    assert "Ms 1.67" in outcome.reason
    assert (str(Agreement.CONTRADICTS) in outcome.reason) is (code != "ok")


@pytest.mark.parametrize(("agreement", "since"), [(Agreement.CHANGED, 41.0), (Agreement.AGREES, 0.0)])
def test_a_change_of_the_process_is_confirmed_by_what_came_after_it(monkeypatch, agreement, since):
    seen: list[Any] = []
    monkeypatch.setattr(confirmation, "unconfirmed", lambda samples, *_: seen.extend(samples))
    samples = [SimpleNamespace(t_s=float(t)) for t in range(100)]
    points = tuple(SimpleNamespace(t_s=t_s) for t_s in (20.0, 40.0, 70.0))  # the last one contradicted
    record: Any = SimpleNamespace(
        samples=samples,
        response=SimpleNamespace(sp_changed=False),
        in_force=None,
        region=0,
        region_models={0: SimpleNamespace(points=points)},
        table=SimpleNamespace(lookup=Lookup.HARD),
    )
    learned: Any = SimpleNamespace(agreement=agreement)
    confirmation.doubt_of(Findings(Question(record, SETTINGS, 1, Trial()), learned=learned))
    assert seen[0].t_s == since
    assert seen[-1].t_s == 99.0
