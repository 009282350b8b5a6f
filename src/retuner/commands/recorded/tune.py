"""retuner tune: settings for a known process by a tuning rule, or by every rule that applies in one table."""

import math
from pathlib import Path

from retuner.adaptive.loop.performance import performance
from retuner.adaptive.process.model import ZERO_SIDE, ProcessModel, ProcessType
from retuner.adaptive.rules.registry import Explanation
from retuner.commands.options import check_plot, controller_units, tell
from retuner.commands.signatures import TuneOptions
from retuner.errors import UserError, user_input
from retuner.report.rule_comparison import Comparison, RuleRow, compare_rules
from retuner.schedule.gains import proportional_band_pct, repeats_per_min
from retuner.tuning import tune as tune_model
from retuner.tuning import tuning_lines
from retuner.verbosity import busy

HEADINGS = ("rule", "kind", "form", "Kc", "tau_I", "tau_D", "tau_c", "Ms", "GM", "PM", "J", "IAE sp", "IAE load")


def tune(options: TuneOptions) -> int:
    """Work out and show settings; the exit status: 0, or 1 when no loop that follows would be stable.

    Raises UserError: an option is out of its range, or no rule has an answer for this process.
    """
    check_plot(options.plot)
    if options.type is None:
        if options.k is not None or any((options.tau1, options.tau2, options.theta, options.inverse, options.tau3)):
            raise UserError(f"--type is missing: give one of {', '.join(ProcessType)}")
        model = None
    else:
        if options.type not in set(ProcessType):
            raise UserError(f"--type {options.type}: give one of {', '.join(ProcessType)}")
        if options.k is None:
            raise UserError("--k is missing: the steady-state gain, or the slope gain per second of integrating types")
        # Refuse a zero on the wrong side, or where the type has none
        side = ZERO_SIDE.get(ProcessType(options.type), 0)
        if not math.isfinite(options.inverse) or (options.inverse > 0) - (options.inverse < 0) != side:
            needs = f"needs one {'above' if side > 0 else 'below'} 0, in seconds" if side else "has none; leave it out"
            raise UserError(f"--inverse {options.inverse:g}: --type {options.type} {needs}")
        with user_input("retuner tune"):
            lags = (options.tau1, options.tau2, options.theta)
            model = ProcessModel(
                ProcessType(options.type), options.k, *lags, inverse_s=options.inverse, tau3_s=options.tau3
            )
    return _by_every_rule(model, options) if options.everything else _by_one_rule(model, options)


def _wishes(options: TuneOptions) -> dict[str, float | None]:
    names = ("tau_c", "ms", "gm", "c", "u0", "ku", "pu", "kq", "pq")
    return {"y_max": options.ymax, **{name: getattr(options, name) for name in names}}


def _by_one_rule(model: ProcessModel | None, options: TuneOptions) -> int:
    with user_input("retuner tune"), busy("tuning"):
        result = tune_model(model, options.rule, kind=options.kind, form=options.form, **_wishes(options))
    if options.plot is not None:
        if model is None:
            raise UserError("--plot needs the process: give --type, --k, --tau1, --tau2, --theta")
        if result.margins is None or not result.margins.stable:
            raise UserError("--plot: the closed loop would be unstable, so there is no response to draw")
        if result.tuning.rule != "optimal":
            _draw(model, (RuleRow(result, performance(model.linear(), result.tuning.gains), None),), options.plot)
        else:
            from retuner.decision_page.svg import drawn
            from retuner.report.tuning_plots import pareto_figure

            with user_input("--plot"):
                picture = drawn(pareto_figure(model), "J over Ms", options.plot.suffix)
            options.plot.write_bytes(picture)
    units = controller_units(options.controller, options.pv_span, options.action)
    why = result.explanation if options.explain else None
    shown = {"model": model.to_dict() if model else None, **result.to_dict()}
    lines = list[str]()
    if units is not None:
        # on the dials of a controller, by the keys of the configuration, and the form that they are of
        with user_input("--controller"):
            dials = units.numbers(result.gains)
        numbers = {dial.key: value for dial, value in zip(units.dials, dials[:3], strict=True) if dial.label}
        shown["dialled"] = {"controller": units.name, "form": str(dials.form), **numbers}
    elif options.pv_span is not None:
        gains = result.tuning.to_dict(result.form)["gains"]
        assert isinstance(gains, dict)
        with user_input("--pv-span"):
            band, repeats = proportional_band_pct(gains["kc"], options.pv_span), repeats_per_min(gains["tau_i"])
        shown["dialled"] = {"band_pct": band, "repeats_per_min": repeats}
        lines.append(f"  set as    proportional band {band:.4g} %  {repeats:.4g} repeats/min")
    if why is not None:
        shown["explanation"] = why.to_dict()
        lines += explained(why)
    tell(shown, [*tuning_lines(result, units), *lines], as_json=options.as_json)
    return 0 if result.margins is None or result.margins.stable else 1


def _by_every_rule(model: ProcessModel | None, options: TuneOptions) -> int:
    if model is None:
        raise UserError("--all needs the process: give --type, --k, --tau1, --tau2, --theta")
    with user_input("retuner tune --all"):
        found = compare_rules(model, kind=options.kind, form=options.form, **_wishes(options))
    if options.plot is not None:
        _draw(model, found.rows, options.plot)
    shown = {"model": model.to_dict(), **found.to_dict(), "plot": str(options.plot) if options.plot else None}
    tell(shown, table(found), as_json=options.as_json)
    return 0 if any(row.result.margins and row.result.margins.stable for row in found.rows) else 1


def _draw(model: ProcessModel, rows: tuple[RuleRow, ...], path: Path) -> None:
    from retuner.decision_page.svg import drawn
    from retuner.report.tuning_plots import responses_figure

    with user_input("--plot"):
        picture = drawn(responses_figure(model, rows), "closed-loop responses", path.suffix)
    path.write_bytes(picture)


def explained(why: Explanation) -> list[str]:
    """Formula, numbers put in, source and range in lines."""
    numbers = "  ".join(f"{name} = {value:.6g}" for name, value in why.numbers.items())
    lines = [f"  formula   {line}" for line in why.formula]
    lines += [f"  with      {numbers}"] if numbers else []
    lines += [f"            {line}" for line in why.with_numbers if line not in why.formula]
    return [*lines, f"  source    {why.source}", f"  range     {why.valid}"]


def table(found: Comparison) -> list[str]:
    """The comparison in lines."""
    rows: list[tuple[str, ...]] = [HEADINGS]
    for one in found.rows:
        shown, m, tuning = one.result.to_dict(), one.result.margins, one.result.tuning
        gains, parallel = shown["gains"], shown["parallel"]
        kc = _short(gains["kc"]) if gains["kc"] else f"Ki {_short(parallel['ki'])}"
        times = map(_short, (gains["tau_i"], gains["tau_d"], tuning.tau_c_s))
        cells = (tuning.rule, str(one.result.kind), one.result.form, kc, *times)
        if m is None or not m.stable:
            rows.append((*cells, "UNSTABLE", "-", "-", "-", "-", "-"))
        else:
            costs = map(_short, (one.j, one.performance.iae_setpoint, one.performance.iae_load))
            rows.append((*cells, f"{m.ms:.2f}", _short(m.gm), f"{m.pm_deg:.1f}", *costs))
    widths = [max(len(row[i]) for row in rows) for i in range(len(HEADINGS))]
    lines = []
    for row in rows:
        left = [cell.ljust(width) for cell, width in zip(row[:3], widths[:3], strict=True)]
        right = [cell.rjust(width) for cell, width in zip(row[3:], widths[3:], strict=True)]
        lines.append("  ".join([*left, *right]).rstrip())
    return [*lines, *(f"not applicable: {rule}: {reason}" for rule, reason in found.left_out)]


def _short(value: float | None) -> str:
    return "-" if value is None else f"{value:.4g}"
