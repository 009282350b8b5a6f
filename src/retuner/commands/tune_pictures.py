"""The pictures of retuner tune, written to a file; apart from tune.py because matplotlib takes time to load."""

from pathlib import Path

from retuner.adaptive.loop.performance import performance
from retuner.adaptive.process.model import ProcessModel
from retuner.errors import UserError, user_input
from retuner.report.rule_comparison import Comparison, RuleRow
from retuner.report.tuning_plots import pareto_png, responses_png
from retuner.tuning import TuneResult


def draw_one(model: ProcessModel | None, result: TuneResult, path: Path) -> None:
    """The responses of one rule, or the Pareto curve for rule optimal.

    Raises
    ------
    UserError
        There is no model, or the loop is unstable.
    """
    if model is None:
        raise UserError("--plot needs the process: give --type, --k, --tau1, --tau2, --theta")
    if result.margins is None or not result.margins.stable:
        raise UserError("--plot: the closed loop would be unstable, so there is no response to draw")
    with user_input("--plot"):
        if result.tuning.rule == "optimal":
            picture = pareto_png(model)
        else:
            picture = responses_png(model, (RuleRow(result, performance(model.linear(), result.tuning.gains), None),))
    path.write_bytes(picture)


def draw_all(model: ProcessModel, found: Comparison, path: Path) -> None:
    """The responses of all rules in one figure."""
    with user_input("--plot"):
        picture = responses_png(model, found.rows)
    path.write_bytes(picture)
