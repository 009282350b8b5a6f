"""What a schedule rests on, in sentences for page and screen."""

import math

from retuner.adaptive.schedule_design.shapes import Shape
from retuner.scheduling import ScheduleDesign

PARAMETERS = ("slope gain k/tau", "dead time", "lag", "second lag")


def why_sentence(found: ScheduleDesign) -> str:
    """What changes along the variable, and how many sets follow."""
    form, places = found.design.curves.form, found.places
    changing = [
        f"{name} (from {math.exp(a):.3g} to {math.exp(b):.3g})"
        for name, shape, a, b in zip(
            PARAMETERS, form.shapes, *found.design.curves.ln(form.axis.grid(2)).tolist(), strict=False
        )
        if shape > Shape.CONSTANT
    ]
    known = sum(place.known for place in places)
    what = f"With {found.variable} change: {', '.join(changing)}." if changing else "Nothing changes with it."
    where = (
        "" if known == len(places) else f" At {len(places) - known} of {len(places)} places the records say too little."
    )
    return f"{found.reason[0].upper()}{found.reason[1:]}. {what}{where}"


def motion_sentences(found: ScheduleDesign) -> list[str]:
    """What a step over the whole range does with the schedule."""
    if not found.design.crossings:
        return ["Motion over the range was not simulated: one set, too little known, or a variable from outside."]
    told = []
    for crossing in found.design.crossings:
        way = "up" if crossing.up else "down"
        ratio = f"{crossing.iae_ratio:.2f} times" if math.isfinite(crossing.iae_ratio) else "without end"
        told.append(
            f"A setpoint step {way} over {crossing.share:.0%} of the range, gains looked up by {crossing.variable}; "
            f"IAE {ratio} that with each place's own gains, "
            f"overshoot {crossing.overshoot:.0%} ({crossing.own_overshoot:.0%})"
            + (": no worse for moving." if crossing.proper else ": WORSE in motion than at rest; ramp such steps.")
        )
    return told


def experiment_sentence(found: ScheduleDesign) -> str:
    """Where to make which experiment next."""
    wanted = found.next_experiment
    told = (
        f"Least is known at {found.variable} {wanted.x:.4g} (Kc to {wanted.gain_std:.0%}). There, a step of "
        f"{wanted.co_step:+.3g} in co (manual) or of {wanted.sp_step:+.3g} in the setpoint, "
        f"held {wanted.hold_s:.3g} s, tells most."
    )
    return told + " The limit of co holds it smaller than noise asks for: repeat it." * wanted.held


def push_sentence(found: ScheduleDesign) -> str:
    """That the variable moves pv by itself, which bands do not count; empty where it is a signal of the loop."""
    if not found.design.curves.form.pushed:
        return ""
    return (
        f"{found.variable} comes from outside and may move pv by itself. How it does so is known only roughly, "
        "and the bands leave that out. Confirm the gains with a setpoint step at each end."
    )


TOLD_AT_LIMITS = 0.02
"""Share of the samples with co at a limit from which it is told."""


def limit_sentence(found: ScheduleDesign) -> str:
    """How long co stood at a limit, where the gains did nothing; empty where it hardly did."""
    if found.at_limits < TOLD_AT_LIMITS:
        return ""
    return (
        f"co stood at a limit for {found.at_limits:.0%} of the records. There the loop is open: "
        "no gains make it faster, and Ms and J hold for moves within the limits only."
    )
