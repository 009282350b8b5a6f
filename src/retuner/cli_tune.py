"""`retuner tune`: signature and help only, as in cli.py."""

from pathlib import Path
from typing import Annotated

import typer

TYPES = "fopdt, sopdt, integrating, integrating-lag, double-integrating or delay."
Structure = Annotated[str | None, typer.Option("--type", help=TYPES)]
Gain = Annotated[float | None, typer.Option(help="Steady-state gain; slope gain of integrating types.")]
Lag = Annotated[float, typer.Option(help="Lag, s.")]
Lag2 = Annotated[float, typer.Option(help="Second lag, s.")]
DeadTime = Annotated[float, typer.Option(help="Dead time, s.")]
RuleName = Annotated[str, typer.Option(help="Tuning rule; a wrong name shows the list.")]
Kind = Annotated[str | None, typer.Option(help="p, pi or pid; default pi where the rule has it.")]
Form = Annotated[str | None, typer.Option(help="series, ideal or parallel; default the rule's own.")]
TauC = Annotated[float | None, typer.Option(help="Closed-loop time constant (or lambda), s.")]
Ms = Annotated[float | None, typer.Option(help="Demanded Ms (simc rules, optimal).")]
Gm = Annotated[float | None, typer.Option(help="Demanded gain margin (simc rules).")]
C = Annotated[float | None, typer.Option(help="c in tau_I = min(tau1, c (tau_c + theta)); default 4.")]
U0 = Annotated[float | None, typer.Option(help="Largest disturbance, co units (simc-smooth).")]
YMax = Annotated[float | None, typer.Option(help="Deviation allowed, pv units (simc-smooth).")]
Ku = Annotated[float | None, typer.Option(help="Ultimate gain; from the model if left out.")]
Pu = Annotated[float | None, typer.Option(help="Ultimate period, s.")]
Kq = Annotated[float | None, typer.Option(help="Gain at quarter decay.")]
Pq = Annotated[float | None, typer.Option(help="Period at quarter decay, s.")]
Everything = Annotated[bool, typer.Option("--all", help="Every rule that applies, in one table.")]
Explain = Annotated[bool, typer.Option("--explain", help="Also formula, numbers put in and source.")]
Plot = Annotated[
    Path | None,
    typer.Option(metavar="PNG", help="Draw closed-loop responses; for rule optimal the Pareto curve J against Ms."),
]
Json = Annotated[bool, typer.Option("--json", help="Print one JSON document and nothing else.")]


def tune(
    process: Structure = None,
    k: Gain = None,
    tau1: Lag = 0.0,
    tau2: Lag2 = 0.0,
    theta: DeadTime = 0.0,
    rule: RuleName = "simc",
    kind: Kind = None,
    form: Form = None,
    tau_c: TauC = None,
    ms: Ms = None,
    gm: Gm = None,
    c: C = None,
    u0: U0 = None,
    ymax: YMax = None,
    ku: Ku = None,
    pu: Pu = None,
    kq: Kq = None,
    pq: Pq = None,
    everything: Everything = False,
    explain: Explain = False,
    plot: Plot = None,
    json: Json = False,
) -> int:
    """Settings for a known process by a tuning rule, with their margins."""
    from retuner.commands.tune import Process, TuneOptions

    wishes = {
        "tau_c": tau_c,
        "ms": ms,
        "gm": gm,
        "c": c,
        "u0": u0,
        "y_max": ymax,
        "ku": ku,
        "pu": pu,
        "kq": kq,
        "pq": pq,
    }
    described, options = (
        Process(process, k, tau1, tau2, theta),
        TuneOptions(rule, kind, form, wishes, explain, plot, json),
    )
    if everything:
        from retuner.commands.tune_all import tune_all as work
    else:
        from retuner.commands.tune import tune as work
    return work(described, options)
