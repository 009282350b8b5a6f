"""report.html: one self-contained page, read from the top: result, pictures, every decision, provenance."""

import base64
import html
import math
from collections.abc import Iterable
from dataclasses import dataclass, field

from retuner.adaptive.decision import Action, Decision
from retuner.explain import cause_text, change_text, model_text, response_text, settings_text
from retuner.plots import trend_png, twin_png
from retuner.schedule.table import GainTable
from retuner.scores import Columns, RegionScore, twin_steps

STYLE = """
body{font:15px/1.5 system-ui,sans-serif;color:#222;max-width:1180px;margin:2em auto;padding:0 1.2em}
h1{font-size:1.7em;margin:0 0 .2em} h2{font-size:1.2em;margin:1.8em 0 .5em}
p.lead{font-size:1.08em} .muted{color:#666} img{max-width:100%}
table{border-collapse:collapse;width:100%;font-size:.92em}
th,td{text-align:left;padding:.35em .6em;border-bottom:1px solid #ddd;vertical-align:top}
th{background:#f4f6f8} td.n,th.n{text-align:right;white-space:nowrap} .good{color:#1a7f37} .bad{color:#b42318}
.twins{display:flex;flex-wrap:wrap;gap:1em} .twins img{flex:1 1 340px;max-width:560px} tr.commit td{background:#fff8e6}
code{background:#f4f6f8;padding:0 .25em}
"""


@dataclass(frozen=True, slots=True)
class ReportData:
    """What a report tells of.

    run, fixed : trends by column (fixed: the same run without retuning, or None). commits : times of changes.
    events : times of setpoint and load steps, s. facts : provenance, name to value, shown at the end.
    stopped : the run did not have its whole length.
    """

    loop: str
    unit: str
    before: GainTable
    after: GainTable
    scores: list[RegionScore]
    decisions: list[Decision]
    run: Columns
    fixed: Columns | None
    commits: list[float]
    events: list[float] = field(default_factory=list)
    facts: dict[str, str] = field(default_factory=dict)
    stopped: bool = False


def render(data: ReportData) -> str:
    """The page as text."""
    body = [
        f"<h1>{_e(data.loop)}: retuning report</h1>",
        f'<p class="lead">{_e(_lead(data))}</p>',
        "<h2>Regions</h2>",
        _scores_table(data),
        "<h2>The whole run</h2>",
        _image(trend_png(data.run, data.fixed, data.commits, data.after.regions, data.unit), "Trend with region bands"),
        _twins(data),
        "<h2>Decisions</h2>",
        '<p class="muted">One row per recognised response; rows that write or advise other gains are shaded.</p>',
        _decisions_table(data.decisions),
        "<h2>Provenance</h2>",
        _table(("what", "value"), ((_e(k), f"<code>{_e(v)}</code>") for k, v in data.facts.items())),
    ]
    head = f'<meta charset="utf-8"><title>{_e(data.loop)}: retuning report</title><style>{STYLE}</style>'
    return f'<!doctype html><html lang="en"><head>{head}</head><body>{"".join(body)}</body></html>\n'


def _e(text: object) -> str:
    return html.escape(str(text))


def _lead(data: ReportData) -> str:
    """The result in a few sentences."""
    hours = float(data.run["t"][-1] - data.run["t"][0]) / 3600
    parts = ["The run was stopped before its end."] if data.stopped else []
    parts.append(f"{_counted(len(data.decisions), 'response')} recognised in {hours:.2g} h.")
    parts.append(f"{_counted(sum(s.changes for s in data.scores), 'change')} written to the controller.")
    advised = sum(d.action == Action.ADVISE for d in data.decisions)
    if advised:
        parts.append(f"{_counted(advised, 'change')} advised and not written.")
    worst = max((s.ms_after for s in data.scores if s.ms_after is not None), default=None)
    if worst is not None:
        stable = f"is at most {worst:.2f}" if math.isfinite(worst) else "is not finite: the loop is UNSTABLE"
        parts.append(f"Ms of the final gains on the true process {stable}.")
    saved = [(s.iae, s.iae_fixed) for s in data.scores if s.iae_fixed]
    if saved:
        share = 1 - sum(a for a, _ in saved) / sum(b for _, b in saved if b)
        much = f"{abs(share):.0%} {'smaller' if share > 0 else 'LARGER'} than" if round(share, 2) else "the same as"
        parts.append(f"The integrated error is {much} with fixed gains.")
    return " ".join(parts)


def _counted(count: int, what: str) -> str:
    """A number and its noun with its verb."""
    return f"{count} {what}{' was' if count == 1 else 's were'}"


def _table(heads: Iterable[str], rows: Iterable[Iterable[str]], classes: Iterable[str] = ()) -> str:
    """A table of cells that are already HTML; classes are those of the rows."""
    kinds = iter(classes)
    head = "".join(f"<th>{h}</th>" for h in heads)
    lines = "".join(f'<tr class="{next(kinds, "")}">{"".join(f"<td>{c}</td>" for c in row)}</tr>' for row in rows)
    return f"<table><tr>{head}</tr>{lines}</table>"


def ms_text(ms: float | None) -> str:
    """Ms as people read it."""
    return "-" if ms is None else "unstable" if ms == float("inf") else f"{ms:.2f}"


def _scores_table(data: ReportData) -> str:
    unit = _e(data.unit)
    heads = ("region", "commissioned gains", "final gains", "changes", "Ms before", "Ms after",
             f"IAE fixed [{unit} s]", f"IAE retuned [{unit} s]")  # fmt: skip
    rows = []
    for s in data.scores:
        fixed = s.iae if s.iae_fixed is None else s.iae_fixed
        mark = "good" if s.iae < fixed else "bad" if s.iae > fixed else ""
        rows.append((_e(s.region), _e(settings_text(s.before)), _e(settings_text(s.after)), str(s.changes),
                     ms_text(s.ms_before), ms_text(s.ms_after), "-" if s.iae_fixed is None else f"{s.iae_fixed:,.0f}",
                     f'<span class="{mark}">{s.iae:,.0f}</span>'))  # fmt: skip
    note = ('<p class="muted">Settings in series form unless marked. Ms is the peak of the sensitivity on the true '
            "process, the largest over the operating points visited; 1.8 is the limit.</p>")  # fmt: skip
    return _table(heads, rows) + note


def _image(png: bytes, alt: str) -> str:
    return f'<img alt="{_e(alt)}" src="data:image/png;base64,{base64.b64encode(png).decode()}">'


def _twins(data: ReportData) -> str:
    """The same step before and after, per region."""
    names = data.after.regions.names
    images = [_image(twin_png(data.run, twin, names[twin.region], data.unit), f"{names[twin.region]} before and after")
              for twin in twin_steps(data.run, data.events)]  # fmt: skip
    if not images:
        return ""
    return f'<h2>The same step, first and last time</h2><div class="twins">{"".join(images)}</div>'


def _decisions_table(decisions: list[Decision]) -> str:
    heads = ("no.", "time [s]", "region", "response", "cause", "reason", "process", "change")
    rows = [(str(d.number), f"{d.t_s:,.0f}", _e(d.region), _e(response_text(d)), _e(cause_text(d)), _e(d.reason),
             _e(model_text(d)), _e(change_text(d))) for d in decisions]  # fmt: skip
    return _table(heads, rows, ("" if d.action == Action.NONE else "commit" for d in decisions))
