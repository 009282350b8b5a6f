"""`retuner identify` and `retuner diagnose`: signatures and help only, as in cli.py."""

from pathlib import Path
from typing import Annotated

import typer

RecordFile = Annotated[Path, typer.Argument(metavar="FILE", help="CSV or Parquet with columns t, sp, pv, co.")]
AtRest = Annotated[bool, typer.Option("--open-loop", help="A step in manual that begins at rest.")]
Manual = Annotated[bool, typer.Option("--open-loop", help="The loop was in manual.")]
Columns = Annotated[str, typer.Option(help="Other names: t=time,pv=temp,co=out,sp=target.")]
Kc = Annotated[float | None, typer.Option(help="Gain of the controller in force.")]
KcOrReadOff = Annotated[float | None, typer.Option(help="Gain of the controller in force; else read off the record.")]
TauI = Annotated[float | None, typer.Option(help="Its integral time, s.")]
TauD = Annotated[float, typer.Option(help="Its derivative time, s.")]
Form = Annotated[str, typer.Option(help="Form of these: series, ideal or parallel.")]
CoMin = Annotated[float | None, typer.Option(help="Lower limit of co, in its own unit.")]
CoMax = Annotated[float | None, typer.Option(help="Upper limit of co.")]
Plot = Annotated[Path | None, typer.Option(metavar="PNG", help="Draw the record and what was found.")]
Json = Annotated[bool, typer.Option("--json", help="Print one JSON document and nothing else.")]


def identify(
    file: RecordFile,
    open_loop: AtRest = False,
    columns: Columns = "",
    kc: Kc = None,
    tau_i: TauI = None,
    tau_d: TauD = 0.0,
    form: Form = "series",
    co_min: CoMin = None,
    co_max: CoMax = None,
    plot: Plot = None,
    json: Json = False,
) -> int:
    """Find the process behind a record: model, standard deviations, and the settings that follow."""
    from retuner.commands.identify import identify as work
    from retuner.commands.recorded_loop import RecordOptions

    return work(file, RecordOptions(open_loop, columns, kc, tau_i, tau_d, form, co_min, co_max, plot, json))


def diagnose(
    file: RecordFile,
    open_loop: Manual = False,
    columns: Columns = "",
    kc: KcOrReadOff = None,
    tau_i: TauI = None,
    tau_d: TauD = 0.0,
    form: Form = "series",
    co_min: CoMin = None,
    co_max: CoMax = None,
    plot: Plot = None,
    json: Json = False,
) -> int:
    """Say what is behind a loop's behaviour, with evidence, and what to do about it."""
    from retuner.commands.diagnose import diagnose as work
    from retuner.commands.recorded_loop import RecordOptions

    return work(file, RecordOptions(open_loop, columns, kc, tau_i, tau_d, form, co_min, co_max, plot, json))
