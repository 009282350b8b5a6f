"""The options of `retuner tune`."""

from pathlib import Path

import typer

from retuner.commands.options import ActionOption, Controller, Json, command, option
from retuner.schedule.late_dataclass import dataclass

app = typer.Typer(add_completion=False)


@dataclass(frozen=True, slots=True, kw_only=True)
class TuneOptions:
    """Compute settings for a known process by a tuning rule, with margins."""

    type: str | None = option(
        None, "fopdt, sopdt, integrating, integrating-lag, double-integrating, delay, sopdt-inverse, topdt."
    )
    k: float | None = option(None, "Steady-state gain; slope gain of integrating types.")
    tau1: float = option(0.0, "Lag, s.")
    tau2: float = option(0.0, "Second lag, s.")
    theta: float = option(0.0, "Dead time, s.")
    inverse: float = option(0.0, "Inverse response b of 1 - b s, s (sopdt-inverse).")
    tau3: float = option(0.0, "Third lag, s (topdt).")
    rule: str = option("simc", "Tuning rule; a wrong name shows the list.")
    kind: str | None = option(None, "p, pi or pid; default pi where the rule has it.")
    form: str | None = option(None, "series, ideal or parallel; default the rule's own.")
    tau_c: float | None = option(None, "Closed-loop time constant (or lambda), s.")
    ms: float | None = option(None, "Demanded Ms (simc rules, optimal).")
    gm: float | None = option(None, "Demanded gain margin (simc rules).")
    c: float | None = option(None, "c in tau_I = min(tau1, c (tau_c + theta)); default 4.")
    u0: float | None = option(None, "Largest disturbance, co units (simc-smooth, averaging).")
    ymax: float | None = option(None, "Deviation allowed, pv units (simc-smooth, averaging).")
    ku: float | None = option(None, "Ultimate gain; from the model if left out.")
    pu: float | None = option(None, "Ultimate period, s.")
    kq: float | None = option(None, "Gain at quarter decay.")
    pq: float | None = option(None, "Period at quarter decay, s.")
    controller: Controller = None
    action: ActionOption = None
    pv_span: float | None = option(None, "Span of pv: also as proportional band, percent, and repeats per minute.")
    everything: bool = option(False, "Every rule that applies, in one table.", "--all")
    explain: bool = option(False, "Also formula, numbers put in and source.", "--explain")
    plot: Path | None = option(
        None, "Draw the responses (.png, .svg); of rule optimal the Pareto curve J against Ms.", metavar="FILE"
    )
    as_json: Json = False


command(
    app,
    TuneOptions,
    "recorded.tune.tune",
    "Example: retuner tune --type fopdt --k 0.361 --tau1 138 --theta 14.2 --rule simc",
)
