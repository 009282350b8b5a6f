"""What a schedule rests on, in sentences for page and screen."""

import math

import numpy as np

from retuner.adaptive.schedule_choice.crossing import Crossing
from retuner.adaptive.schedule_design.shapes import Shape
from retuner.decision_page.shown_units import chosen_units
from retuner.schedule.axis import CAN
from retuner.scheduling import ScheduleDesign

PARAMETERS = ("slope gain k/tau", "dead time", "lag", "second lag")


def why_sentence(found: ScheduleDesign) -> str:
    """What changes along the variable, and how many sets follow."""
    places = found.places
    known = sum(place.known for place in places)
    told = [(found.variable, changing_with(found)), (found.second, changing_with(found, second=True))]
    what = " ".join(f"The process changes with {name}: {', '.join(changes)}." for name, changes in told if changes)
    what = what or "The process does not change with it."
    where = (
        ""
        if known == len(places)
        else f" At {len(places) - known} of {len(places)} places the records show too little."
    )
    return f"{found.reason[0].upper()}{found.reason[1:]}. {what}{where}"


def changing_with(found: ScheduleDesign, *, second: bool = False) -> list[str]:
    """What changes along a variable, from its low to its high end, the other one in its middle.

    By its own shape, or by what all of it goes through: the installed characteristic bends the gain.
    """
    curves = found.design.curves
    form, two = curves.form, curves.form.second
    if two is None:
        shapes, curve = form.shapes, None if second else curves.ln(form.axis.grid(ALONG))
    elif second:
        middle = float(form.axis.grid(3)[1])
        shapes, curve = two.shapes, curves.ln(np.full(ALONG, middle), two.axis.grid(ALONG))
    else:
        shapes, curve = form.shapes, curves.ln(form.axis.grid(ALONG), np.full(ALONG, two.axis.grid(3)[1]))
    if curve is None:
        return []
    return [
        f"{name} (from {math.exp(one[0]):.3g} to {math.exp(one[-1]):.3g})"
        for name, shape, one in zip(PARAMETERS, shapes, np.asarray(curve).T, strict=False)
        if shape > Shape.CONSTANT or np.ptp(one) > MOVES
    ]


ALONG = 9
"""Places at which a curve is looked at."""
MOVES = 0.05
"""Range of a curve, as a logarithm, from which its parameter is said to change."""


HARDLY = 5.0
"""Nats between two variables below which the records hardly tell them apart."""


def variable_sentence(found: ScheduleDesign) -> str:
    """Which of several variables, and how sure; empty where only one was weighed."""
    weighed = sorted(found.design.candidates, key=lambda e: -e.log_likelihood)
    name = " and ".join(filter(None, (found.variable, found.second)))
    mine = next((e for e in weighed if e.variable == name), None)
    others = [e for e in weighed if e.variable != name]
    if mine is None or not others:
        return ""
    if not mine.changes:
        return f"The process changes with none of {', '.join(e.variable for e in weighed)}."
    behind = [f"{e.variable} by {max(mine.log_likelihood - e.log_likelihood, 0.0):.0f} nats" for e in others]
    sure = mine.log_likelihood - others[0].log_likelihood > HARDLY
    told = f"The evidence favours {name}; behind it: {', '.join(behind)}."
    return told + " The records barely distinguish these: name the one you want." * (not sure)


def motion_sentences(found: ScheduleDesign) -> list[str]:
    """What a step over the whole range does with the schedule."""
    if not found.design.crossings:
        return ["Motion over the range was not simulated: one set, too little known, or a variable from outside."]
    told = []
    for crossing in found.design.crossings:
        way = "up" if crossing.up else "down"
        ratio = f"{crossing.iae_ratio:.2f}" if math.isfinite(crossing.iae_ratio) else "without end"
        told.append(
            f"Simulated setpoint step {way} over {crossing.share:.0%} of the range, gains by {crossing.variable}: "
            f"IAE {ratio}, overshoot {crossing.overshoot:.0%}. With the best gains at every point: IAE 1, overshoot "
            f"{crossing.own_overshoot:.0%}" + _moving_words(crossing)
        )
    return told


TOO_LARGE = 0.5
LONG_HOLD_S = 120.0  # from here on in minutes
"""Overshoot with each place's own gains from which a step is too large for any gains."""


def _moving_words(crossing: Crossing) -> str:
    if not crossing.proper:
        return ". WORSE: ramp such steps."
    if crossing.own_overshoot > TOO_LARGE:
        return ". The schedule does no harm, but such a step is too large for any gains here: ramp it."
    return ". No worse."


def experiment_sentence(found: ScheduleDesign) -> str:
    """Where to make which experiment next."""
    wanted = found.next_experiment
    beside = "" if wanted.x2 is None else f", {found.second} {wanted.x2:.2g}"
    hold = f"{wanted.hold_s / 60.0:.0f} min" if wanted.hold_s >= LONG_HOLD_S else f"{wanted.hold_s:.3g} s"
    told = (
        f"Kc is least certain near {found.variable} {wanted.x:.2g}{beside} ({100 * wanted.gain_std:.0f} %). Best next "
        f"test: setpoint {wanted.sp_step:+.2g} (or co {wanted.co_step:+.2g} in manual), hold {hold}."
    )
    return told + " The limit of co makes the step smaller than the noise requires: repeat it." * wanted.held


def push_sentence(found: ScheduleDesign) -> str:
    """That the variable moves pv by itself, which bands do not count; empty where it is a signal of the loop."""
    form = found.design.curves.form
    pushing = [found.variable] * form.pushed
    if form.second is not None and form.second.pushed:
        pushing.append(found.second)
    if not pushing:
        return ""
    verb = "comes" if len(pushing) == 1 else "come"
    return (
        f"{' and '.join(pushing)} {verb} from outside and may move pv by itself. How it does so is known only "
        "roughly, and the bands leave that out. Confirm the gains with a setpoint step at each end."
    )


def message_sentence(found: ScheduleDesign) -> str:
    """Which entry of the section a person must fill in before it runs; empty where none."""
    axes = () if found.table is None else found.table.regions.axes
    signals = [axis.signal for axis in axes if axis.variable == CAN]
    if not signals:
        return ""
    return (
        f"Put the bus message that carries {' and '.join(signals)} in place of FILL_IN: "
        "until then retuner check refuses the section."
    )


def aim_sentence(found: ScheduleDesign) -> str:
    """The sets that these lead to; empty where these are final."""
    if found.aim is None:
        return ""
    units = chosen_units()
    told = [
        f"{name} {units.short(g)}" if units else f"{name} Kc {g.kp:.4g} tau_I {g.kp / g.ki:.4g} s"
        for name, g in zip(found.aim.regions.names, found.aim.gains, strict=True)
    ]
    return f"Final sets, once the next record confirms: {'; '.join(told)}."


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
