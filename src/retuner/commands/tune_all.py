"""retuner tune --all: every rule that applies, in one table."""

import json
import sys

from retuner.commands.tune import Process, TuneOptions
from retuner.errors import UserError, user_input
from retuner.report.rule_comparison import Comparison, RuleRow, compare_rules

HEADINGS = ("rule", "kind", "form", "Kc", "tau_I", "tau_D", "Ms", "GM", "PM", "J", "IAE sp", "IAE load")


def tune_all(process: Process, options: TuneOptions) -> int:
    """Show all rules; the exit status: 0, or 1 when none of them gives a stable loop.

    Raises
    ------
    UserError
        There is no model, no rule has an answer, or an option is out of its range.
    """
    model = process.model()
    if model is None:
        raise UserError("--all needs the process: give --type, --k, --tau1, --tau2, --theta")
    with user_input("retuner tune --all"):
        found = compare_rules(model, kind=options.kind, form=options.form, **options.wishes)
    if options.plot is not None:
        from retuner.commands.tune_pictures import draw_all  # noqa: PLC0415  matplotlib only when a picture is wanted

        draw_all(model, found, options.plot)
    if options.as_json:
        shown = {"model": model.to_dict(), **found.to_dict(), "plot": str(options.plot) if options.plot else None}
        sys.stdout.write(json.dumps(shown, indent=2, allow_nan=False) + "\n")
    else:
        sys.stdout.write("\n".join(table(found)) + "\n")
    return 0 if any(row.result.margins and row.result.margins.stable for row in found.rows) else 1


def table(found: Comparison) -> list[str]:
    """The comparison in lines."""
    rows = [HEADINGS, *(_cells(row) for row in found.rows)]
    widths = [max(len(row[i]) for row in rows) for i in range(len(HEADINGS))]
    lines = []
    for row in rows:
        left = [cell.ljust(width) for cell, width in zip(row[:3], widths[:3], strict=True)]
        right = [cell.rjust(width) for cell, width in zip(row[3:], widths[3:], strict=True)]
        lines.append("  ".join([*left, *right]).rstrip())
    return [*lines, *(f"no {rule}: {reason}" for rule, reason in found.left_out)]


def _cells(row: RuleRow) -> tuple[str, ...]:
    """One row of the table in text."""
    shown, m = row.result.to_dict(), row.result.margins
    gains, parallel = shown["gains"], shown["parallel"]
    assert isinstance(gains, dict)
    assert isinstance(parallel, dict)
    kc = _short(gains["kc"]) if gains["kc"] else f"Ki {_short(parallel['ki'])}"
    first = (row.result.tuning.rule, str(row.result.kind), row.result.form, kc, *map(_short, _times(gains)))
    if m is None or not m.stable:
        return (*first, "UNSTABLE", "-", "-", "-", "-", "-")
    robustness = (f"{m.ms:.2f}", _short(m.gm), f"{m.pm_deg:.1f}")
    return (*first, *robustness, *map(_short, (row.j, row.performance.iae_setpoint, row.performance.iae_load)))


def _times(gains: dict[str, float | None]) -> tuple[float | None, float | None]:
    return gains["tau_i"], gains["tau_d"]


def _short(value: object) -> str:
    """Four digits; none and infinite have words."""
    if value is None:
        return "-"
    assert isinstance(value, float)
    return "inf" if value == float("inf") else f"{value:.4g}"
