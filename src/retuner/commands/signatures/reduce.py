"""The options of `retuner reduce`."""

import typer

from retuner.commands.options import Json, command, option
from retuner.schedule.late_dataclass import dataclass

app = typer.Typer(add_completion=False)


@dataclass(frozen=True, slots=True, kw_only=True)
class ReduceOptions:
    """Reduce a process model to first or second order by the half rule."""

    num_t: list[str] | None = option(None, "Numerator time constants, s; negative: inverse response.", "--num-t")
    den_t: list[str] | None = option(None, "Lags, s, separated by commas.", "--den-t")
    integrators: int = option(0, "Pure integrators.")
    delay: float = option(0.0, "Dead time, s.")
    order: int = option(1, "Order of the model: 1 for PI, 2 for PID.")
    k: float = option(1.0, "Steady-state gain; slope gain per second with an integrator.")
    leads: str = option("auto", "auto; rules: T1 to T3 for all positive numerator time constants; subtract: none.")
    as_json: Json = False


command(
    app,
    ReduceOptions,
    "recorded.reduce.reduce",
    "Example: retuner reduce --num-t 15 --den-t 20,1,0.1,0.1 --k 2 --order 2",
)
