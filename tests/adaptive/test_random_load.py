"""What any waves would explain is no oscillation: a load that moves at random is told as that, and not
asked for again."""

from types import SimpleNamespace

import pytest

from retuner.adaptive.diagnosis import oscillation_online
from retuner.adaptive.diagnosis.cause import Cause, Diagnosis
from retuner.adaptive.diagnosis.diagnosis_settings import DiagnosisSettings
from retuner.adaptive.diagnosis.oscillation_online import SwingSettings, hidden_cause
from retuner.adaptive.signals.response import Ending, Peak, Response
from retuner.adaptive.signals.sample import LoopSample
from retuner.schedule.gains import PidGains

TONE = Diagnosis(Cause.EXTERNAL, 0.8, {"linear_left": 1.62}, "an external oscillation explains the record")
SAMPLES = [LoopSample(float(i), 0.0, 0.1 * (i % 7), 50.0 + i % 5) for i in range(60)]
RESPONSE = Response(10.0, 59.0, (Peak(20.0, 1.0),), Ending.QUIET, False, 0.1)


@pytest.mark.parametrize("regular", [True, False])
def test_only_a_regular_swing_is_asked_for_again(regular: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(oscillation_online, "linear", lambda *_: [None])
    monkeypatch.setattr(oscillation_online, "stiction_or_tone", lambda *_: SimpleNamespace(verdict=TONE))
    seen = SimpleNamespace(oscillates=regular, period_s=12.0)
    monkeypatch.setattr(oscillation_online, "screen", lambda *_, **__: seen)
    found, again = hidden_cause(SAMPLES, RESPONSE, PidGains(1.0, 0.1), SwingSettings(), DiagnosisSettings())
    assert found.cause is Cause.EXTERNAL
    assert again is regular
    assert ("without a regular period: the model leaves 1.6 times the noise" in found.reason) is not regular
