"""What other settings would do, for a page that works it out by itself (templates/what_if.js, no server needed).

The page gets matrices, not models: every process as it steps from sample to sample, and G(jw) on a grid, so that it
replays the record, draws responses and finds Ms for any settings that a slider gives. Its numbers are those of
adaptive/loop/replayed.py and margins.py, which a test holds.
"""

import base64
import hashlib
import json
import math
from collections.abc import Mapping, Sequence
from functools import cache
from importlib.resources import files

import numpy as np

from retuner.adaptive.choice.foreseen import likely_limits
from retuner.adaptive.loop.replayed import even, spread
from retuner.adaptive.loop.simulate import HeldInput
from retuner.adaptive.process.model import LinearProcess, ProcessModel
from retuner.adaptive.rules.registry import rule_named, settings
from retuner.adaptive.rules.rule import ControllerKind, Wishes
from retuner.adaptive.signals.sample import FloatArray, Window
from retuner.decision_page.row_values import Document, decided_on
from retuner.diagnosing import RecordDiagnosis
from retuner.report.change_of_settings import processes_of, settling_s
from retuner.report.scores import Columns, axis_floors
from retuner.schedule.controller_units import DEFAULT, ControllerUnits
from retuner.schedule.dials import CONTROLLERS
from retuner.schedule.gains import PidGains
from retuner.schedule.late_dataclass import dataclass

MOST_SAMPLES, MOST_MODELS, FREQUENCIES, SPEEDS = 800, 4, 240, 25
"""Sizes of what a page carries: some thirty kilobytes a loop."""
LEAST_SAMPLES = 50  # samples of a stay in a region, for settings to be tried on it
STEPS = 400  # samples of a step response, at the controller's interval where that is longer
MS_LIMIT = 1.8  # Ms above it is shown as too much where the page knows no limit of its own
FASTEST, SLOWEST = 0.3, 20.0
"""tau_c of the slider over the dead time as the controller sees it, at the least and at the most."""
FILL = """
{
  const place = document.getElementById("what-if");
  const given = JSON.parse(document.getElementById("what-if-data").textContent);
  place.hidden = false;
  for (const [name, what] of given.panels) whatIf(place, what, { name, ...given.how });
}
"""
"""The script of a static page's section."""
PAGE_UNITS = ("kc-s", "kc-min", "gain-min", "pb-s", "pb-min", "pb-rpm")
"""Units that are offered beside the vendors' controllers."""


@dataclass(frozen=True, slots=True)
class WhatIfQuestion:
    """What is asked about a loop.

    window : the record; None for step responses alone. models : of the process, the best first. dt_s : interval of the
    controller, s. active, recommended : settings; one of them at least.
    """

    window: Window | None
    models: Sequence[LinearProcess]
    rule_model: ProcessModel | None
    dt_s: float
    active: PidGains | None
    recommended: PidGains | None
    co_limits: tuple[float | None, float | None] = (None, None)
    ms_limit: float = MS_LIMIT


def of_diagnosis(window: Window, result: RecordDiagnosis) -> dict[str, object] | None:
    """What the page of a diagnosed record needs; None where no process or no settings are known."""
    if result.model is None or (result.active is None and result.recommended is None):
        return None
    models = processes_of(result)
    return what_if(
        WhatIfQuestion(
            window, models, result.model, window.sample_time_s, result.active, result.recommended, result.co_limits
        )
    )


def of_region(
    run: Columns,
    region: int,
    decisions: Sequence[Document],
    sets: tuple[PidGains | None, PidGains | None],
    ms_limit: float,
) -> dict[str, object] | None:
    """What the page of a region needs; None where nothing is known of its process, or the run hardly was in it.

    run : trend by column. region : its index. decisions : its documents, oldest first. sets : active and recommended.
    """
    model = next((found for one in reversed(decisions) if (found := decided_on(one)) is not None), None)
    here = np.flatnonzero(run["region"] == region)
    if model is None or not len(here):
        return None
    stay = max(np.split(here, np.flatnonzero(np.diff(here) > 1) + 1), key=len)
    if len(stay) < LEAST_SAMPLES:
        return None
    t_s, sp, pv, co = (np.asarray(run[name][stay], dtype=np.float64) for name in ("t", "sp", "pv", "co"))
    window = Window(t_s, sp, pv, co)
    return what_if(WhatIfQuestion(window, [model.linear()], model, window.sample_time_s, *sets, ms_limit=ms_limit))


def what_if(asked: WhatIfQuestion) -> dict[str, object]:
    """The document of the page.

    Keys
    ----
    dt, sp, pv, co : the part of the record that is replayed, empty without one. limits : of co. range : of pv and sp.
    floor : least heights of pv's and co's strips. models : each {record, step: matrices at the two intervals, curve:
    G(jw) as the controller sees it}. step : {dt, n}. curve : that of the best model. integrators. active, recommended :
    [kp, ki, kd] or None. speeds : [tau_c, kp, ki, kd] of rule simc, the fastest first. slowest : a time of the process.
    """
    best, shown = asked.models[0], asked.recommended or asked.active
    assert shown is not None
    models = spread(asked.models, MOST_MODELS)
    until_s = 2.0 * settling_s(best.seen_by_controller(asked.dt_s), shown)
    step_s = max(asked.dt_s, until_s / STEPS)
    record = _telling(even(asked.window)) if asked.window is not None else None
    each: list[dict[str, object]] = []
    for model in models:
        one: dict[str, object] = {"step": _matrices(model, step_s), "curve": _curve(model, asked.dt_s, models)}
        each.append(one | ({"record": _matrices(model, record.sample_time_s)} if record is not None else {}))
    if record is None:
        recorded = {"dt": 1.0, "sp": [], "pv": [], "co": [], "limits": [-1e9, 1e9], "range": 1.0, "floor": [0.0, 0.0]}
    else:
        low, high = float(np.min(record.co)), float(np.max(record.co))
        limits = likely_limits(asked.co_limits, low, high)
        room = 1e6 * max(high - low, 1.0)
        recorded = {
            "dt": record.sample_time_s,
            **{name: _listed(getattr(record, name), 6) for name in ("sp", "pv", "co")},
            "limits": [low - room if limits[0] is None else limits[0], high + room if limits[1] is None else limits[1]],
            "range": max(float(np.ptp(record.pv)), float(np.ptp(record.sp)), 1e-9),
            "floor": [*axis_floors(record.pv)],
        }
    return {
        **recorded,
        "models": each,
        "step": {"dt": step_s, "n": max(math.ceil(until_s / step_s), 20)},
        "curve": each[0]["curve"],
        "integrators": best.integrators,
        "active": _parallel(asked.active),
        "recommended": _parallel(asked.recommended),
        "speeds": _speeds(asked.rule_model, asked.dt_s, pid=bool(shown.kd)),
        "slowest": max((*best.lags_s, best.theta_s, asked.dt_s)),
        "ms_limit": asked.ms_limit,
    }


def _parallel(gains: PidGains | None) -> list[float] | None:
    return None if gains is None else [_short(value) for value in (gains.kp, gains.ki, gains.kd)]


def _short(value: float) -> float:
    return float(f"{value:.9g}")


def _listed(values: FloatArray, digits: int = 9) -> list[float]:
    return [float(f"{value:.{digits}g}") for value in values.tolist()]


def _matrices(process: LinearProcess, dt_s: float) -> dict[str, object]:
    """How a process steps (loop/simulate.py)."""
    held = HeldInput(process, dt_s).matrices
    lists = {
        name: [_listed(row) for row in held.phi] if name == "phi" else _listed(getattr(held, name))
        for name in ("phi", "g1", "g0", "c")
    }
    return {**lists, "d": _short(held.d), "delay": held.delay}


def _curve(process: LinearProcess, dt_s: float, models: Sequence[LinearProcess]) -> dict[str, list[float]]:
    """G(jw) as a sampled controller sees it, from far below its slowest time to far beyond its dead time."""
    seen = process.seen_by_controller(dt_s)
    times = [
        t
        for one in models
        for t in (*one.lags_s, one.theta_s, dt_s, *(math.sqrt(c2) for _, c2 in one.quadratics))
        if t > 0
    ]
    w = np.geomspace(1e-3 / max(times), 30.0 / max(seen.theta_s, min(times)), FREQUENCIES)
    g = seen.response(w)
    return {"w": _listed(w, 7), "re": _listed(g.real, 7), "im": _listed(g.imag, 7)}


def _telling(record: Window) -> Window:
    """The part of a record with the greatest error, as long as a page carries."""
    if len(record.t_s) <= MOST_SAMPLES:
        return record
    error = np.concatenate([[0.0], np.cumsum(np.abs(record.sp - record.pv))])
    first = int(np.argmax(error[MOST_SAMPLES:] - error[:-MOST_SAMPLES]))
    part = slice(first, first + MOST_SAMPLES)
    return Window(record.t_s[part], record.sp[part], record.pv[part], record.co[part], record.noise_std)


def _speeds(model: ProcessModel | None, dt_s: float, *, pid: bool) -> list[list[float]]:
    """Settings of rule simc over its tau_c, the fastest first; none where it has no answer."""
    if model is None:
        return []
    seen = model.seen_by_controller(dt_s)
    late = max(seen.theta_s, 1e-3 * seen.tau1_s, dt_s / 2)
    rule = rule_named("simc")
    kind = ControllerKind.PID if pid and ControllerKind.PID in rule.formulas else rule.usual_kind
    found = []
    for tau_c in np.geomspace(FASTEST * late, SLOWEST * late, SPEEDS).tolist():
        try:
            gains = settings(rule, kind, seen, wishes=Wishes(tau_c_s=tau_c)).gains
        except ValueError:
            return []
        found.append([float(f"{tau_c:.3g}"), *(_short(value) for value in (gains.kp, gains.ki, gains.kd))])
    return found


def section(panels: Sequence[tuple[str, dict[str, object]]], how: Mapping[str, object]) -> str:
    """The part of a static page that tries settings, out of sight where no script may run; nothing without panels.

    What the panels show is data; the script is the same on every page, so a server may let it and nothing else run.
    """
    if not panels:
        return ""
    data = json.dumps({"panels": panels, "how": how}, allow_nan=False).replace("<", "\\u003c")
    return (
        '<section id="what-if" hidden><h2>What other settings would do</h2></section>'
        f'<script type="application/json" id="what-if-data">{data}</script><script>{section_script()}</script>'
    )


@cache
def section_script() -> str:
    """The engine with the lines that fill `section`."""
    return page_script() + FILL


def script_hash() -> str:
    """The script of `section` as a content security policy names it."""
    return "sha256-" + base64.b64encode(hashlib.sha256(section_script().encode()).digest()).decode()


def page_script() -> str:
    """The engine with all controllers, for a page."""
    text = files("retuner.templates").joinpath("what_if.js").read_text(encoding="utf-8")
    named = {name: ControllerUnits.named(name, 1.0) for name in (DEFAULT, *(n for n in PAGE_UNITS if n != DEFAULT))}
    forms = {name: (units.dials, units.form) for name, units in named.items()} | {
        n: tuple(c) for n, c in CONTROLLERS.items()
    }
    keys = ("label", "unit", "quantity", "scale", "of_span")
    controllers = {
        name: {"form": str(form), "dials": [{key: getattr(dial, key) for key in keys} for dial in dials]}
        for name, (dials, form) in forms.items()
    }
    return text.replace("/*CONTROLLERS*/{}", json.dumps(controllers))


def panel_style() -> str:
    """The look of the panel."""
    return files("retuner.templates").joinpath("what_if.css").read_text(encoding="utf-8")
