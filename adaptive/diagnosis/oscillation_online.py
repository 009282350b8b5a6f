"""On line: is it the tuning at all? What swings, or what the loop by itself does not explain, is put to its rivals.

    swings on without a setpoint step                         the whole diagnosis (diagnose.py) of the stretch
    something else was behind what these gains showed before  the same, of all that they have shown
    a response of which the linear fit leaves too much        rivals alone: stiction or a tone under the response
    otherwise                                                 the model may learn, and its margins decide

A stretch is everything since the gains last changed. Whether its cycles are enough for a verdict is the diagnosis's to
say. Cause before cure: what a rival explains teaches the model nothing.
"""

from collections.abc import Sequence

from retuner.adaptive.diagnosis.cause import Cause, Diagnosis
from retuner.adaptive.diagnosis.diagnose import diagnose_window
from retuner.adaptive.diagnosis.diagnosis_settings import DiagnosisSettings
from retuner.adaptive.diagnosis.rival_fits import linear
from retuner.adaptive.diagnosis.sticking_valve import stiction_or_tone
from retuner.adaptive.identification.structure_choice import too_few
from retuner.adaptive.indexes.screening import screen
from retuner.adaptive.signals.response import Response
from retuner.adaptive.signals.sample import LoopSample, Window
from retuner.schedule.gains import PidGains
from retuner.schedule.late_dataclass import dataclass, replace


@dataclass(frozen=True, slots=True)
class SwingSettings:
    """Settings.

    damping : (E3 - E2)/(E1 - E2) from which a load response of three peaks swings on, or the overshoot of one of two;
        0.3 to 0.9, default 0.5 (a quarter of the amplitude after a period; a well-tuned loop leaves far less).
    most_cycles : cycles of the stretch that are looked at; 5 to 30, default 12.
    most_counted : responses that count at most for what else was found; 1 to 10, default 3.
    unexplained : standard deviations of the noise that a linear fit may leave before its rivals are asked; 1.1 to 3,
        default 1.5.
    lookback : lengths of a response that are looked at with it when its rivals are asked; default 3.
    fewest_loads : load responses that a change needs where no setpoint step was seen; 1 to 5, default 2.
    same_gains : a stretch ends where other gains ran; False for interpolated tables, whose gains move with the loop.
    restless : share of the samples before a setpoint step outside the noise band, from which the loop was not at rest;
        0.02 to 0.5, default 0.1.
    rest : share of a response's length for which the loop must have kept to its noise band to have been at rest; 0.05
        to 1, default 0.25.
    rest_between : the same, for a response to lead from rest to rest; 0.35 to 1, default 0.4 (a sinusoid of 2.2 noise
        bands, the least that is a response, rests for 0.3 of its half waves).
    loads_beside : load steps that a clear setpoint response may need beside; 0 to 3, default 1.
    grows : damping of a setpoint response, or overshoot of one of two peaks, from which the loop runs away; 1 to 1.5,
        default 1.05.
    growth_explained : share of pv's variance that the model must explain of it; 0.9 to 0.999, default 0.99.
    calm : greatest error before a response over the last peak of its swing, up to which the swing began with it;
        0.1 to 0.8, default 0.4.
    dwarfs : the same over the response's largest peak, from which earlier motion is left out of what is looked at;
        2 to 20, default 5 (half a percent of it, which no model explains, would pass for a disturbance).
    unseen_bands : noise bands that a peak by the model must have to be missed; 1 to 10, default 2.
    shown : share of the peak by the model, below which the one that was seen refutes it; 0.2 to 0.8, default 0.5.
    most_lookback : lengths of a response that are looked at before such a change; 2 to 30, default 10.
    alike : by how much the settings that single records give may differ from those of all, to confirm each other; in
        logarithms, 0.05 to 0.4, default 0.2 (a fifth: half of the least change that is worth it).
    alike_records : how many must, two setpoint responses among them or each from rest to rest; 2 to 6, default 3.
    """

    damping: float = 0.5
    most_cycles: float = 12.0
    most_counted: int = 3
    unexplained: float = 1.5
    lookback: float = 3.0
    fewest_loads: int = 2
    same_gains: bool = True
    restless: float = 0.1
    rest: float = 0.25
    rest_between: float = 0.4
    loads_beside: int = 1
    grows: float = 1.05
    growth_explained: float = 0.99
    calm: float = 0.4
    dwarfs: float = 5.0
    unseen_bands: float = 2.0
    shown: float = 0.5
    most_lookback: float = 10.0
    alike: float = 0.2
    alike_records: int = 3


def swings(response: Response, settings: SwingSettings) -> bool:
    """Whether a response that no setpoint step began hardly decays: by its damping, or, of two peaks, its overshoot.

    Of a clean decay overshoot and damping are equal; a tone that is slower than was waited has no third peak yet. A
    first peak that is far smaller than the second is the wrong way of an inverse response, and none of the swing's.
    """
    first, second, *_ = (*(abs(peak.e) for peak in response.peaks), 0.0, 0.0)
    own = replace(response, peaks=response.peaks[first < settings.damping * second :])
    decay = own.overshoot if own.damping is None else own.damping
    return not (response.sp_changed or response.taken_over) and decay is not None and decay > settings.damping


def stretch(samples: Sequence[LoopSample], from_s: float, same_gains: bool = True) -> list[LoopSample]:
    """The newest samples from a time on. same_gains : that ran the same set of gains."""
    revision = samples[-1].revision
    kept = []
    for sample in reversed(samples):
        if (same_gains and sample.revision != revision) or sample.t_s < from_s:
            break
        kept.append(sample)
    return kept[::-1]


def whole_cause(
    samples: Sequence[LoopSample],
    response: Response,
    gains: PidGains,
    swing: SwingSettings,
    settings: DiagnosisSettings,
    lasting_s: float | None = None,
) -> Diagnosis:
    """The whole diagnosis of what the gains in force have shown lately.

    samples : kept, the newest last. gains : in force. lasting_s : period of a swing that goes on through several
    responses. Of a swing most_cycles are looked at, of any other response most_lookback lengths before it.
    """
    since_s = response.t_start_s - swing.most_lookback * (response.t_end_s - response.t_start_s)
    period_s = response.period_s if swings(response, swing) else lasting_s
    if period_s is not None:
        since_s = response.t_end_s - swing.most_cycles * period_s
    seen = stretch(samples, since_s, swing.same_gains)
    return diagnose_window(Window.of(seen), gains, settings=settings).diagnosis


def hidden_cause(
    samples: Sequence[LoopSample],
    response: Response,
    gains: PidGains,
    swing: SwingSettings,
    settings: DiagnosisSettings,
) -> tuple[Diagnosis | None, bool]:
    """What hides under a response that the linear fit does not explain: stiction or a tone, or None; and whether it is
    asked for again at the next response.
    """
    length_s = response.t_end_s - response.t_start_s
    window = Window.of(stretch(samples, response.t_start_s - swing.lookback * length_s, swing.same_gains))
    if too_few(window):
        return None, False
    found = linear(window, (gains.direction,), settings.fit.choice, settings.fit.most_samples)
    seen = screen(window, gains, in_auto=settings.in_auto)
    verdict = stiction_or_tone(found[0], seen, settings).verdict
    if verdict is not None and verdict.cause == Cause.EXTERNAL and not seen.oscillates:
        return replace(verdict, reason=RANDOM.format(**verdict.evidence)), False
    return verdict, verdict is not None and verdict.cause != Cause.UNKNOWN


RANDOM = (
    "loads from outside move this loop without a regular period: the model leaves {linear_left:.1f} times the noise; a "
    "larger setpoint step, or setpoint bumps to and fro, would show the process"
)
"""The reason where a tone explains what the model leaves, but nothing swings regularly: any waves fit a random load."""
