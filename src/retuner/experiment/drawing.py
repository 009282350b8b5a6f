"""The picture of an experiment: pv with its limits and what the fitted model makes of the same co, and co below."""

import numpy as np
from matplotlib.figure import Figure

from retuner.adaptive.identification.fitted_curve import fitted_pv
from retuner.adaptive.signals.sample import Window
from retuner.decision_page.drawing_style import FIXED, MARK, PV, SP, time_axis
from retuner.decision_page.svg import settings
from retuner.experiment.findings import ExperimentFindings
from retuner.report.record_plots import ExplainedCurve


@settings()
def experiment_figure(
    window: Window, found: ExperimentFindings, title: str, unit: str, band: tuple[float, float] | None
) -> Figure:
    """The picture.

    window : the record. found : its evaluation. unit : of pv. band : limits of pv, drawn where they are near.
    """
    figure = Figure(figsize=(11, 6))
    top, bottom = figure.subplots(2, 1, sharex=True, height_ratios=(2.4, 1))
    x, x_unit = time_axis(window.t_s)
    top.plot(x, window.pv, color=PV, lw=1.1, label="pv")
    top.plot(x, window.sp, color=SP, lw=0.9, ls="--", label="sp")
    if found.model is not None and found.fit is not None:
        curve = ExplainedCurve.of("fitted model under the same co", window, fitted_pv(window, found.fit.estimate))
        top.plot(np.interp(curve.t_s, window.t_s, x), curve.pv, color=FIXED, lw=1.6, alpha=0.9, label=curve.name)
    # What was read off: the amplitude of a relay's limit cycle and where it was taken
    if found.cycle is not None:
        cycle = found.cycle
        inside = (window.t_s >= cycle.from_s) & (window.t_s <= cycle.to_s)
        for i, level in enumerate((cycle.pv_high, cycle.pv_low)):
            label = f"Ku {cycle.ku:.3g} +- {cycle.ku_std:.1g}, Pu {cycle.pu_s:.4g} +- {cycle.pu_std_s:.1g} s"
            top.plot(x[inside][[0, -1]], [level, level], color=MARK, lw=1.0, label=None if i else label)
    # limits that lie within twice the record's range
    reach = float(np.ptp(window.pv))
    for limit in band or ():
        if float(np.min(window.pv)) - reach < limit < float(np.max(window.pv)) + reach:
            top.axhline(limit, color=MARK, lw=0.8, ls=":")
    bottom.step(x, window.co, where="post", color=PV, lw=0.9)
    top.set_title(title, fontsize=10)
    top.set_ylabel(f"pv, sp [{unit}]")
    bottom.set_ylabel("co [%]")
    bottom.set_xlabel(f"time [{x_unit}]")
    top.legend(loc="upper center", bbox_to_anchor=(0.5, 0.0), ncols=4, fontsize=9, frameon=False)
    for axes in (top, bottom):
        axes.margins(x=0)
        axes.grid(alpha=0.3)
    return figure
