"""The page of a schedule: what was found, the picture, the sets, the proofs in motion, what to record next."""

import math
from collections.abc import Sequence
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.figure import Figure

from retuner.adaptive.schedule_design.places import OUT
from retuner.adaptive.schedule_design.record_stretches import CurveShape
from retuner.adaptive.signals.sample import FloatArray, Window
from retuner.decision_page.drawing_style import BANDS, FAINT, FIXED, MARK, PV, SP, thinned
from retuner.decision_page.shown_units import chosen_units
from retuner.decision_page.svg import settings, svg
from retuner.schedule.config_section import schedule_section
from retuner.schedule.regions import CAN
from retuner.schedule.table import GainTable, Lookup
from retuner.scheduling import ScheduleDesign
from retuner.templates import rendered

if TYPE_CHECKING:
    from matplotlib.axes import Axes


# ---- What a schedule rests on, in sentences for page and screen

PARAMETERS = ("slope gain k/tau", "dead time", "lag", "second lag")


def changing_with(found: ScheduleDesign, *, second: bool = False) -> list[str]:
    """What changes along a variable, from its low to its high end, the other one in its middle.

    By its own shape, or by what all of it goes through: the installed characteristic bends the gain.
    """
    curves = found.design.curves
    form, two = curves.form, curves.form.second
    if two is None:
        shapes, curve = form.shapes, None if second else curves.ln(form.axis.grid(ALONG))
    elif second:
        shapes, curve = two.shapes, curves.ln(np.full(ALONG, float(form.axis.grid(3)[1])), two.axis.grid(ALONG))
    else:
        shapes, curve = form.shapes, curves.ln(form.axis.grid(ALONG), np.full(ALONG, two.axis.grid(3)[1]))
    if curve is None:
        return []
    return [
        f"{name} (from {math.exp(one[0]):.3g} to {math.exp(one[-1]):.3g})"
        for name, shape, one in zip(PARAMETERS, shapes, np.asarray(curve).T, strict=False)
        if shape > CurveShape.CONSTANT or np.ptp(one) > MOVES
    ]


ALONG = 9  # places at which a curve is looked at
MOVES = 0.05  # range of a curve, as a logarithm, from which its parameter is said to change


HARDLY = 5.0  # nats between two variables below which the records hardly tell them apart


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
        if not crossing.proper:
            moving_words = ". WORSE: ramp such steps."
        elif crossing.own_overshoot > TOO_LARGE:
            moving_words = ". The schedule does no harm, but such a step is too large for any gains here: ramp it."
        else:
            moving_words = ". No worse."
        told.append(
            f"Simulated setpoint step {way} over {crossing.share:.0%} of the range, gains by {crossing.variable}: "
            f"IAE {ratio}, overshoot {crossing.overshoot:.0%}. With the best gains at every point: IAE 1, overshoot "
            f"{crossing.own_overshoot:.0%}" + moving_words
        )
    return told


TOO_LARGE = 0.5
LONG_HOLD_S = 120.0  # from here on in minutes
"""Overshoot with each place's own gains from which a step is too large for any gains."""


def experiment_sentence(found: ScheduleDesign) -> str:
    """Where to make which experiment next."""
    wanted = found.next_experiment
    beside = "" if wanted.x2 is None else f", {found.second} {wanted.x2:.2g}"
    hold = f"{wanted.hold_s / 60.0:.0f} min" if wanted.hold_s >= LONG_HOLD_S else f"{wanted.hold_s:.3g} s"
    return (
        f"Kc is least certain near {found.variable} {wanted.x:.2g}{beside} ({100 * wanted.gain_std:.0f} %). Best next "
        f"test: setpoint {wanted.sp_step:+.2g} (or co {wanted.co_step:+.2g} in manual), hold {hold}."
    ) + " The limit of co makes the step smaller than the noise requires: repeat it." * wanted.held


def push_sentence(found: ScheduleDesign) -> str:
    """Words where the variable moves pv by itself, which bands do not count; empty where it is a signal of the loop."""
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


TOLD_AT_LIMITS = 0.02  # share of the samples with co at a limit from which it is told


def limit_sentence(found: ScheduleDesign) -> str:
    """How long co stood at a limit, where the gains did nothing; empty where it hardly did."""
    if found.at_limits < TOLD_AT_LIMITS:
        return ""
    return (
        f"co stood at a limit for {found.at_limits:.0%} of the records. There the loop is open: "
        "no gains make it faster, and Ms and J hold for moves within the limits only."
    )


# ---- The picture of a schedule: records, the process over the variable, gains, Ms and J before and after

FINE = 201
SHOWN_MS, SHOWN_J = 3.0, 3.0  # Largest values that the axes make room for
MOST_POINTS = 2400  # points of a record that are drawn
CURVES = (("k", "process gain k"), ("tau", "lag [s]"), ("theta", "dead time [s]"))


SHOWS = "records, process, gains, Ms and J over the variable"


@settings()
def schedule_figure(found: ScheduleDesign, windows: Sequence[Window]) -> Figure:
    """Draw it."""
    figure = Figure(figsize=(14, 11))
    along = " and ".join(filter(None, (found.variable, found.second)))
    figure.suptitle(f"{along}: {found.reason.partition(';')[0]}", x=0.06, ha="left", fontsize=14, weight="bold")
    grid = figure.add_gridspec(
        4, 2, height_ratios=(1.15, 1, 1, 1), hspace=0.28, wspace=0.14, left=0.06, right=0.955, top=0.94, bottom=0.05
    )
    axes = figure.add_subplot(grid[0, :])
    begin = 0.0
    for i, window in enumerate(windows):
        hours = (begin + window.t_s - window.t_s[0]) / 3600.0
        axes.plot(*thinned(hours, window.pv, MOST_POINTS), color=PV, lw=0.8, label=None if i else "pv")
        axes.plot(*thinned(hours, window.sp, MOST_POINTS), color=SP, lw=0.8, ls="--", label=None if i else "setpoint")
        begin += float(window.t_s[-1] - window.t_s[0]) * 1.02
    if found.table is not None and found.variable in {"sp", "pv"}:
        for i, (low, high) in enumerate(pairwise([-1e9, *found.layout.edges[1:-1], 1e9])):
            axes.axhspan(low, high, color=BANDS[i % len(BANDS)], lw=0, zorder=0)
    every_pv = np.concatenate([window.pv for window in windows])
    room = 0.05 * float(np.ptp(every_pv))
    axes.set_ylim(float(every_pv.min()) - room, float(every_pv.max()) + room)
    axes.margins(x=0)
    axes.set_xlabel("time [h]")
    told = ", coloured by the regions that follow from them" if found.table is not None else ""
    axes.set_title(f"the records{told}", loc="left", fontsize=10)
    axes.legend(loc="lower right", bbox_to_anchor=(1.0, 0.985), fontsize=8, frameon=False, ncols=2)
    first: Axes | None = None
    for i, (name, label) in enumerate(CURVES):
        axes = figure.add_subplot(grid[1 + i, 0], sharex=first)
        first = first or axes
        # One parameter with its band of two standard deviations
        x = np.linspace(found.places[0].x, found.places[-1].x, FINE)
        top = 1e-300
        for x2, style in zip(found.slices, STYLES, strict=False):
            value, std = _parameter(found, name, x, x2)
            axes.fill_between(x, value * np.exp(-OUT * std), value * np.exp(OUT * std), color=PV, alpha=0.2, lw=0)
            axes.plot(x, value, color=PV, lw=1.6, ls=style, label=_at(found, x2))
            top = max(float(np.max(value)), top)
        if found.second:
            axes.legend(loc="upper right", fontsize=8, frameon=False, ncols=3)
        axes.set_ylim(0, 1.35 * top)
        axes.set_ylabel(label)
        # where the records have been: a tick for every stretch's mean at the foot
        means = [float(np.mean(stretch.x)) for stretch in found.design.curves.joint.stretches]
        axes.plot(means, np.full(len(means), 0.03), "|", color=SP, ms=8, transform=axes.get_xaxis_transform())
        if name == "tau":
            axes.set_ylabel("lag [s], cut where it\nacts as an integrator", fontsize=9)
    panels = [figure.add_subplot(grid[1 + i, 1], sharex=first) for i in range(3)]
    _gains(panels[0], found)
    _judged(panels[1], found, "ms")
    _judged(panels[2], found, "j")
    for axes in figure.axes[1:]:
        _dress(axes, found)
    for axes in (figure.axes[3], figure.axes[6]):
        unit = found.table.regions.unit if found.table is not None else ""
        named = f"{found.variable} [{unit}]" if unit else found.variable
        middle = found.slices[len(found.slices) // 2]
        axes.set_xlabel(named if middle is None else f"{named}; on the right at {_at(found, middle)}")
    return figure


def _dress(axes: "Axes", found: ScheduleDesign) -> None:
    axes.grid(alpha=0.3)
    axes.set_xlim(found.places[0].x, found.places[-1].x)
    middle = found.slices[len(found.slices) // 2]
    for a, b in pairwise([place for place in found.places if place.x2 == middle]):
        if not (a.known and b.known):
            axes.axvspan(a.x, b.x, color=FAINT, alpha=0.15, lw=0, zorder=0)
    if found.table is None:
        return
    hard = found.table.lookup is Lookup.HARD
    edges = found.layout.edges
    for x in edges[1:-1] if hard else [(a + b) / 2 for a, b in pairwise(edges)]:
        axes.axvline(x, color=MARK, lw=0.8, ls="--" if hard else ":")


STYLES = ("-", "--", ":")  # line styles at the low end, the middle and the high end of a second variable


def _at(found: ScheduleDesign, x2: float | None) -> str:
    """Where the second variable stands; empty where there is none."""
    return "" if x2 is None else f"{found.second} {x2:.4g}"


def _parameter(found: ScheduleDesign, name: str, x: FloatArray, x2: float | None) -> tuple[FloatArray, FloatArray]:
    models = [found.model_at(float(v), x2) for v in x]
    values = {
        "k": [abs(m.k) for m in models],
        "tau": [m.tau1_s + m.tau2_s for m in models],
        "theta": [m.theta_s for m in models],
    }[name]
    row = {"theta": (0, 1, 0), "tau": (0, 0, 1), "k": (1, 0, 1)}[name]
    way = np.array([*row, *[0] * (len(found.places[0].ln_std) - 3)], dtype=np.float64)
    std = [float(np.sqrt(way @ found.design.curves.ln_covariance(float(v), x2) @ way)) for v in x]
    return np.array(values), np.array(std)


def _gains(axes: "Axes", found: ScheduleDesign) -> None:
    x = np.linspace(found.places[0].x, found.places[-1].x, FINE)
    middle = found.slices[len(found.slices) // 2]
    known = [place for place in found.places if place.known and place.x2 == middle]
    axes.plot([p.x for p in known], [p.own.kp for p in known], color=SP, lw=0.9, ls=":", label="Kc, best at each place")
    if found.table is not None:
        for x2, style in zip(found.slices, STYLES, strict=False):
            if x2 != middle:
                axes.plot(x, [found.gains_at(float(v), x2).kp for v in x], color=PV, lw=1.0, ls=style)
        sets = [found.gains_at(float(v), middle) for v in x]
        axes.plot(x, [g.kp for g in sets], color=PV, lw=1.8, label="Kc of the schedule")
        twin = axes.twinx()
        twin.plot(x, [g.kp / g.ki for g in sets], color=MARK, lw=1.2, label="tau_I of the schedule [s]")
        twin.set_ylim(bottom=0)
        twin.tick_params(axis="y", colors=MARK)
        twin.legend(loc="lower right", fontsize=8, frameon=False)
    before = [found.before_at(float(v)) for v in x]
    if all(g is not None for g in before):
        axes.plot(x, [g.kp for g in before if g is not None], color=FIXED, lw=1.2, label="Kc before")
    axes.set_ylabel("Kc")
    axes.set_ylim(bottom=min(0.0, axes.get_ylim()[0]))
    axes.legend(loc="upper left", fontsize=8, frameon=False)


def _judged(axes: "Axes", found: ScheduleDesign, what: str) -> None:
    middle = found.slices[len(found.slices) // 2]
    known = [place for place in found.places if place.known and place.x2 == middle]
    x = [place.x for place in known]
    most = SHOWN_MS if what == "ms" else SHOWN_J
    if found.table is not None:
        after = [place.judged(found.gains_at(place.x, place.x2)) for place in known]
        axes.plot(x, [min(getattr(a, what), most) for a in after], color=PV, lw=1.8, label="with the schedule")
        if what == "ms":
            worst = [min(a.ms_worst, most) for a in after]
            axes.plot(x, worst, color=PV, lw=0.8, ls="--", label="worst that the records allow")
    before = [(p.x, p.judged(g)) for p in known if (g := found.before_at(p.x)) is not None]
    if before:
        axes.plot(
            [v for v, _ in before],
            [min(getattr(b, what), most) for _, b in before],
            color=FIXED,
            lw=1.4,
            label="before",
        )
    limit = found.limits.ms if what == "ms" else found.limits.j
    axes.axhline(limit, color=MARK, lw=0.9, label=f"limit {limit:g}")
    axes.set_ylabel("Ms" if what == "ms" else "J over the place's own")
    axes.set_ylim(1.0 if what == "ms" else 0.0, most)
    axes.legend(loc="upper left", fontsize=8, frameon=False, ncols=2)


# ---- The page of a schedule


def page(found: ScheduleDesign, windows: Sequence[Window], name: str) -> str:
    """The page as text."""
    along = " and ".join(filter(None, (found.variable, found.second)))
    # What changes along the variable, and how many sets follow
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
    return rendered(
        "schedule.html.jinja",
        title=f"{name}: gain schedule",
        along=along,
        lead=f"{found.reason[0].upper()}{found.reason[1:]}. {what}{where}",
        drawing=svg(schedule_figure(found, windows), SHOWS),
        sets=None if found.table is None else _sets(found.table),
        section="" if found.table is None else schedule_section(found.table),
        aim=aim_sentence(found),
        motion=(push_sentence(found), limit_sentence(found), *motion_sentences(found)),
        experiment=experiment_sentence(found),
        variable=variable_sentence(found),
        candidates=(
            ("variable", "evidence over a constant process [nats]", "changes with it", "ln likelihood"),
            [
                (e.variable, f"{e.ln_evidence:.0f}", "yes" if e.changes else "no", f"{e.log_likelihood:.0f}")
                for e in found.design.candidates
            ],
        ),
    )


def _sets(table: GainTable) -> tuple[Sequence[str], Sequence[Sequence[str]]]:
    units, rows = chosen_units(), []
    heads = ("Kc", "tau_I [s]") if units is None else (units.heads,)
    for i, (name, gains) in enumerate(zip(table.regions.names, table.gains, strict=True)):
        tau_i = f"{gains.kp / gains.ki:.4g}" if gains.ki else "none"
        dialled = (f"{gains.kp:.4g}", tau_i) if units is None else (units.short(gains),)
        parallel = f"{gains.kp:.5g}, {gains.ki:.5g}, {gains.kd:.5g}"
        rows.append((name, table.regions.text(i), *dialled, parallel))
    return ("region", "range", *heads, "kp, ki, kd (parallel)"), rows
