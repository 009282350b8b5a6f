"""The options of `retuner tune`."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import typer

from retuner.commands.options import ActionOption, Controller, Json, command

app = typer.Typer(add_completion=False)


@dataclass(frozen=True, slots=True, kw_only=True)
class TuneOptions:
    """Compute settings for a known process by a tuning rule, with margins."""

    type: Annotated[
        str | None,
        typer.Option(
            help="fopdt, sopdt, integrating, integrating-lag, double-integrating, delay, sopdt-inverse, topdt."
        ),
    ] = None
    k: Annotated[float | None, typer.Option(help="Steady-state gain; slope gain of integrating types.")] = None
    tau1: Annotated[float, typer.Option(help="Lag, s.")] = 0.0
    tau2: Annotated[float, typer.Option(help="Second lag, s.")] = 0.0
    theta: Annotated[float, typer.Option(help="Dead time, s.")] = 0.0
    inverse: Annotated[float, typer.Option(help="Inverse response b of 1 - b s, s (sopdt-inverse).")] = 0.0
    tau3: Annotated[float, typer.Option(help="Third lag, s (topdt).")] = 0.0
    rule: Annotated[str, typer.Option(help="Tuning rule; a wrong name shows the list.")] = "simc"
    kind: Annotated[str | None, typer.Option(help="p, pi or pid; default pi where the rule has it.")] = None
    form: Annotated[str | None, typer.Option(help="series, ideal or parallel; default the rule's own.")] = None
    tau_c: Annotated[float | None, typer.Option(help="Closed-loop time constant (or lambda), s.")] = None
    ms: Annotated[float | None, typer.Option(help="Demanded Ms (simc rules, optimal).")] = None
    gm: Annotated[float | None, typer.Option(help="Demanded gain margin (simc rules).")] = None
    c: Annotated[float | None, typer.Option(help="c in tau_I = min(tau1, c (tau_c + theta)); default 4.")] = None
    u0: Annotated[float | None, typer.Option(help="Largest disturbance, co units (simc-smooth, averaging).")] = None
    ymax: Annotated[float | None, typer.Option(help="Deviation allowed, pv units (simc-smooth, averaging).")] = None
    ku: Annotated[float | None, typer.Option(help="Ultimate gain; from the model if left out.")] = None
    pu: Annotated[float | None, typer.Option(help="Ultimate period, s.")] = None
    kq: Annotated[float | None, typer.Option(help="Gain at quarter decay.")] = None
    pq: Annotated[float | None, typer.Option(help="Period at quarter decay, s.")] = None
    controller: Controller = None
    action: ActionOption = None
    pv_span: Annotated[
        float | None, typer.Option(help="Span of pv: also as proportional band, percent, and repeats per minute.")
    ] = None
    everything: Annotated[bool, typer.Option("--all", help="Every rule that applies, in one table.")] = False
    explain: Annotated[bool, typer.Option("--explain", help="Also formula, numbers put in and source.")] = False
    plot: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE", help="Draw the responses (.png, .svg); of rule optimal the Pareto curve J against Ms."
        ),
    ] = None
    as_json: Json = False


command(
    app,
    TuneOptions,
    "recorded.tune.tune",
    "Example: retuner tune --type fopdt --k 0.361 --tau1 138 --theta 14.2 --rule simc",
)
