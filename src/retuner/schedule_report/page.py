"""The page of a schedule: what was found, the picture, the sets, the proofs in motion, what to record next."""

from collections.abc import Sequence

from retuner.adaptive.signals.sample import Window
from retuner.decision_page.html import document, escaped, figure, paragraph, text_table
from retuner.decision_page.shown_units import chosen_units
from retuner.decision_page.svg import svg
from retuner.schedule.config_section import schedule_section
from retuner.schedule.controller_units import ControllerUnits
from retuner.schedule.gains import PidGains
from retuner.schedule.table import GainTable
from retuner.schedule_report.drawing import SHOWS, schedule_figure
from retuner.schedule_report.sentences import (
    aim_sentence,
    experiment_sentence,
    limit_sentence,
    motion_sentences,
    push_sentence,
    variable_sentence,
    why_sentence,
)
from retuner.scheduling import ScheduleDesign


def page(found: ScheduleDesign, windows: Sequence[Window], name: str) -> str:
    """The page as text."""
    along = " and ".join(filter(None, (found.variable, found.second)))
    body = [
        f"<h1>{escaped(name)}: gain schedule over {escaped(along)}</h1>",
        paragraph(why_sentence(found), "lead"),
        figure(svg(schedule_figure(found, windows), SHOWS)),
        paragraph(
            "Bands are two standard deviations; ticks at the foot show where the records were; grey is not accurate "
            "enough. Dashed lines are boundaries, dotted ones knots.",
            "muted",
        ),
        *([] if found.table is None else [_sets(found.table)]),
        *(paragraph(told) for told in (aim_sentence(found),) if told),
        "<h2>In motion</h2>",
        *(paragraph(told) for told in (push_sentence(found), limit_sentence(found)) if told),
        *(paragraph(sentence) for sentence in motion_sentences(found)),
        "<h2>What to record next</h2>",
        paragraph(experiment_sentence(found)),
        "<h2>Which variable</h2>",
        *(paragraph(told) for told in (variable_sentence(found),) if told),
        text_table(
            ("variable", "evidence over a constant process [nats]", "changes with it", "ln likelihood"),
            [
                (e.variable, f"{e.ln_evidence:.0f}", "yes" if e.changes else "no", f"{e.log_likelihood:.0f}")
                for e in found.design.candidates
            ],
        ),
    ]
    return document(f"{name}: gain schedule", "\n".join(body))


def _sets(table: GainTable) -> str:
    """The sets, and the section for the configuration."""
    units = chosen_units()
    rows = [
        (
            name,
            table.regions.text(i),
            *_dialled(gains, units),
            f"{gains.kp:.5g}, {gains.ki:.5g}, {gains.kd:.5g}",
        )
        for i, (name, gains) in enumerate(zip(table.regions.names, table.gains, strict=True))
    ]
    dialled = ("Kc", "tau_I [s]") if units is None else (units.heads,)
    heads = ("region", "range", *dialled, "kp, ki, kd (parallel)")
    section = f"<pre>{escaped(schedule_section(table))}</pre>"
    return "<h2>The sets</h2>" + text_table(heads, rows) + "<h2>For the configuration</h2>" + section


def _dialled(gains: PidGains, units: ControllerUnits | None) -> tuple[str, ...]:
    """A set as it stands on the controller."""
    if units is not None:
        return (units.short(gains),)
    return f"{gains.kp:.4g}", f"{gains.kp / gains.ki:.4g}" if gains.ki else "none"
