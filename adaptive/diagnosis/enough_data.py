"""What a record lacks for a diagnosis or an identification, and what would be needed, in sentences for people.

Polling at least ten times per time constant and four times in the dead time, and five cycles of an oscillation, are
the field's rules of thumb (Skogestad 2003 on sampling; Thornhill, Huang & Zhang 2003 use ten half periods).
"""

from retuner.adaptive.indexes.condition import Condition
from retuner.adaptive.indexes.doubtful_units import doubtful_units
from retuner.adaptive.indexes.screening import Screening
from retuner.adaptive.process.model import ProcessModel
from retuner.adaptive.signals.sample import Window

FEWEST_SAMPLES = 100  # samples of a record that holds a response or a few cycles, well sampled
FEWEST_CYCLES = 3.0  # cycles of an oscillation below which its cause is a guess
WANTED_CYCLES = 5.0  # cycles that are asked for
SAMPLES_PER_PERIOD = 10.0  # samples in a period below which its shape does not show
SAMPLES_PER_TIME = 4.0  # samples in the dead time and in the lag of a process that are needed to tell them
COMPRESSED = 3.0  # compression from which shapes are the recorder's (Thornhill, Choudhury & Shah 2004)


def shortcomings(window: Window, seen: Screening, model: ProcessModel | None = None) -> tuple[str, ...]:
    """What is wanting, the gravest first; empty when nothing is.

    window : the record. seen : its screening. model : the identified process, where there is one.
    """
    found: list[str] = []
    n, dt = len(window.t_s), window.sample_time_s
    found += doubtful_units(window)
    if seen.condition.condition not in {Condition.NORMAL, Condition.MOVING_SETPOINT}:
        found.append(seen.condition.sentence)
    if n < FEWEST_SAMPLES:
        found.append(f"{n} samples are little: {FEWEST_SAMPLES} or more are needed")
    if seen.period_s is not None:
        period_s, span_s = seen.period_s, float(window.t_s[-1] - window.t_s[0])
        if span_s < FEWEST_CYCLES * period_s:
            found.append(
                f"the record holds {span_s / period_s:.1f} cycles of {period_s:.3g} s: record at least "
                f"{WANTED_CYCLES * period_s:.3g} s"
            )
        if period_s < SAMPLES_PER_PERIOD * dt:
            found.append(
                f"a period of {period_s:.3g} s has {period_s / dt:.1f} samples: sample every "
                f"{period_s / SAMPLES_PER_PERIOD:.2g} s or faster"
            )
    if model is not None:
        times = {"dead time": model.theta_s, "lag": model.tau1_s + model.tau2_s + model.tau3_s}
        name, longest_s = max(times.items(), key=lambda item: item[1])
        if longest_s < SAMPLES_PER_TIME * dt:
            found.append(
                f"the {name} of the process, {longest_s:.3g} s, has {longest_s / dt:.1f} samples: sample every "
                f"{longest_s / SAMPLES_PER_TIME:.2g} s or faster"
            )
    if seen.evidence.get("compression_pv", 1.0) > COMPRESSED:
        found.append(
            f"pv was compressed {seen.evidence['compression_pv']:.0f} times by its recorder: shapes are not to be "
            "trusted; record with exception deviation 0"
        )
    return tuple(found)
