"""Pictures of tuning: closed-loop responses of several rules in one figure, and the Pareto curve of J against Ms."""

import math

import numpy as np
from matplotlib import colormaps
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from retuner.adaptive.loop.margins import sensitivity_peak
from retuner.adaptive.loop.optimum import optimal_pi, references
from retuner.adaptive.loop.performance import performance, weighted_cost
from retuner.adaptive.loop.simulate import StepResponse, step_response
from retuner.adaptive.process.model import ProcessModel
from retuner.adaptive.rules.rule import ControllerKind
from retuner.adaptive.rules.simc import simc, without_second_lag
from retuner.decision_page.drawing_style import AFTER, BEFORE, SETPOINT
from retuner.decision_page.svg import settings
from retuner.report.rule_comparison import RuleRow

SHOWN = 1.8  # largest |pv| that the axes make room for; wilder responses leave the picture
MS_CURVE = (1.2, 1.25, 1.3, 1.4, 1.5, 1.59, 1.7, 1.8, 1.9, 2.0, 2.2, 2.5)
TAU_C_CURVE = (0.2, 0.35, 0.5, 0.75, 1.0, 1.25, 1.5, 2.0, 3.0)
TAU_C_MARKED = (0.5, 1.0, 1.5)


@settings()
def responses_figure(model: ProcessModel, rows: tuple[RuleRow, ...]) -> Figure:
    """Process value (above) and controller output (below) of every stable row, one column for each kind.

    A unit setpoint step at first, then a load step of the size that SIMC answers with about a third of it.
    """
    stable = [row for row in rows if row.result.margins and row.result.margins.stable]
    kinds = [kind for kind in ControllerKind if any(row.result.kind == kind for row in stable)]
    # time to give each of the two steps: the responses of the middle of the rules have settled by then
    resets = sorted(g.kp / g.ki for g in [row.result.tuning.gains for row in stable] if g.ki and g.kp)
    window = 4 * (resets[len(resets) // 2] if resets else 0.0) + 10 * model.theta_s + 2 * model.tau2_s or 1.0
    figure = Figure(figsize=(5.4 * max(len(kinds), 1) + 1, 6.6))
    axes = figure.subplots(2, max(len(kinds), 1), sharex=True, sharey="row", squeeze=False, height_ratios=(2, 1))
    process = model.linear()
    loads = [step_response(process, row.result.tuning.gains, window, load=True) for row in stable]
    peaks = [float(np.max(np.abs(one.pv))) for one in loads]
    middle = sorted(peaks)[len(peaks) // 2] if peaks else 1.0
    size = 1 / (3 * middle) if middle else 1.0
    load = math.copysign(float(f"{size:.1g}"), process.k)
    colours = colormaps["tab20"]
    names = list(dict.fromkeys(row.result.tuning.rule for row in stable))
    lines: dict[str, Line2D] = {}
    for row in stable:
        # A setpoint step at 0 and a load step at window_s, on one time axis
        process = model.linear()
        first = step_response(process, row.result.tuning.gains, 2 * window)
        second = step_response(process, row.result.tuning.gains, window, load=True)
        shift = second.t + window
        pv = first.pv + load * np.interp(first.t, shift, second.pv, left=0.0)
        co = first.co + load * np.interp(first.t, shift, second.co, left=0.0)
        keep = first.t <= 2 * window
        found = StepResponse(first.t[keep], pv[keep], co[keep])
        column, name = kinds.index(row.result.kind), row.result.tuning.rule
        colour = colours(names.index(name) % 20)
        (line,) = axes[0, column].plot(found.t, found.pv, color=colour, lw=1.3)
        lines.setdefault(name, line)
        axes[1, column].plot(found.t, found.co, color=colour, lw=1.0)
    for column, kind in enumerate(kinds):
        axes[0, column].set_title(f"{kind.upper()}: setpoint step, then load step of {load:.3g} co", fontsize=10)
        axes[0, column].axhline(1.0, color=SETPOINT, lw=0.8, ls="--")
        axes[1, column].set_xlabel("time [s]")
        for panel in axes[:, column]:
            panel.grid(alpha=0.3)
            panel.margins(x=0)
    figure.legend(lines.values(), lines.keys(), fontsize=9, loc="center left", bbox_to_anchor=(0.91, 0.5))
    axes[0, 0].set_ylabel("pv")
    axes[1, 0].set_ylabel("co")
    low, high = axes[0, 0].get_ylim()
    axes[0, 0].set_ylim(max(low, 1 - SHOWN), min(high, 1 + SHOWN))
    panel = axes[1, 0]
    sizes = sorted(abs(row.result.tuning.gains.kp) for row in stable)
    if sizes and sizes[len(sizes) // 2]:
        low, high = panel.get_ylim()
        room = 3 * sizes[len(sizes) // 2] + 2
        panel.set_ylim(max(low, -room), min(high, room))
    return figure


@settings()
def pareto_figure(model: ProcessModel) -> Figure:
    """J against Ms: the best PI controllers, and SIMC with tau_c as parameter (Grimholt & Skogestad 2012, figure 9).

    Raises ValueError: the process has no PI controller with Ms = 1.59 to compare with.
    """
    process, best = model.linear(), references(model.linear())
    figure = Figure(figsize=(6.4, 4.6))
    axes = figure.subplots()
    curve = [(ms, optimal_pi(process, ms).cost) for ms in MS_CURVE]
    axes.plot(*zip(*curve, strict=True), color=AFTER, lw=1.8, label="best PI (Pareto)")
    theta = without_second_lag(model).theta_s
    points = []
    for ratio in TAU_C_CURVE:
        gains = simc(model, ratio * theta).gains
        ms = sensitivity_peak(process, gains)
        if ms <= MS_CURVE[-1]:
            points.append((ratio, ms, weighted_cost(performance(process, gains), best.iae_setpoint, best.iae_load)))
    axes.plot([p[1] for p in points], [p[2] for p in points], color=BEFORE, lw=1.4, label="SIMC, tau_c varied")
    for ratio, ms, j in points:
        if ratio in TAU_C_MARKED:
            axes.plot(ms, j, "o", color=BEFORE, ms=6)
            axes.annotate(f"tau_c = {ratio:g} theta", (ms, j), textcoords="offset points", xytext=(7, 5), fontsize=9)
    axes.set_xlabel("Ms (robustness: smaller is more robust)")
    axes.set_ylabel("J (performance: smaller is better)")
    axes.grid(alpha=0.3)
    axes.legend(fontsize=9)
    return figure
