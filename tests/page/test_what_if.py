"""The panel that tries settings on a page: its engine against ours, and what a person does with it."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from chromium import Seen

from retuner import ControllerUnits, PidGains, ProcessModel, ProcessType
from retuner.adaptive.loop.margins import sensitivity_peak
from retuner.adaptive.loop.replayed import even, replayed
from retuner.adaptive.loop.simulate import step_response
from retuner.adaptive.signals.sample import Window
from retuner.drivers.plants.linear_plant import LinearPlant
from retuner.report.what_if import WhatIfQuestion, page_script, panel_style, what_if
from retuner.schedule import pid
from retuner.schedule.dials import CONTROLLERS
from retuner.templates import palette

pytestmark = [pytest.mark.slow, pytest.mark.uncounted]
ACTIVE, NEW = PidGains(4.0, 0.25, 6.0), PidGains(2.0, 0.1, 3.0)
MODELS = {
    "fopdt": ProcessModel(ProcessType.FOPDT, 1.0, 20.0, theta_s=4.3),
    "sopdt": ProcessModel(ProcessType.SOPDT, 0.8, 30.0, 6.0, theta_s=2.5),
    "integrating": ProcessModel(ProcessType.INTEGRATING, 0.05, theta_s=3.0),
    "inverse": ProcessModel(ProcessType.SOPDT_INVERSE, 0.8, 30.0, 6.0, theta_s=1.0, inverse_s=2.0),
}


def record(model: ProcessModel) -> Window:
    """300 samples of a loop with the active gains: two setpoint steps, a load and noise."""
    rng, plant, law = np.random.default_rng(5), LinearPlant(model.linear(), start_pv=50.0), pid.law(PidGains(1.0, 0.04))
    state: pid.StateTuple = pid.start(law, 50.0, 50.0, 50.0)
    pv, rows = 50.0, []
    for i in range(300):
        sp = 50.0 + 2.0 * (60 <= i < 180)
        state, co = pid.step(law, state, sp, pv, 1.0)
        rows.append((float(i), sp, pv, co))
        pv = plant.step(co, 1.5 * (i > 220), 1.0) + 0.02 * rng.normal()
    return Window(*np.array(rows).T)


def asked(name: str) -> tuple[Window, dict[str, Any]]:
    model = MODELS[name]
    window = record(model)
    others = (model.linear(), model.linear().seen_by_controller(2.0))
    return window, what_if(WhatIfQuestion(window, others, model, 1.0, ACTIVE, NEW))  # in percent


def open_page(seen: Seen, folder: Path, what: dict[str, Any], options: str = "{}") -> None:
    """A page that holds the panel and nothing else."""
    page = folder / "page.html"
    script = f"{page_script()}; const what = {json.dumps(what)}; whatIf(at, what, {options})"
    body = f"<main id=at></main><script>{script}</script>"
    page.write_text(
        f"<!doctype html><meta charset=utf-8><style>{palette()}{panel_style()}</style>{body}", encoding="utf-8"
    )
    seen.open(f"file://{page}")


@pytest.mark.parametrize("name", MODELS)
def test_the_engine_of_the_page_has_our_numbers(name: str, tmp_path: Path, browsers: Callable[..., Seen]) -> None:
    window, what = asked(name)
    seen = browsers()
    open_page(seen, tmp_path, what)
    gains = [NEW.kp, NEW.ki, NEW.kd]
    run = seen.driver.execute_script
    found = run("return replay(what, what.models[0].record, arguments[0])", gains)
    ours = replayed(even(window), MODELS[name].linear(), NEW, (0.0, 100.0), ACTIVE)
    assert found["pv"] == pytest.approx(ours.pv.tolist(), abs=1e-4)
    assert found["co"] == pytest.approx(ours.co.tolist(), abs=1e-3)
    told = run("return robustness(what.curve, what.integrators, arguments[0])", gains)
    seen_process = MODELS[name].linear().seen_by_controller(1.0)
    assert told["stable"]
    assert told["ms"] == pytest.approx(sensitivity_peak(seen_process, NEW), rel=0.02)
    far = run("return robustness(what.curve, what.integrators, arguments[0])", [20 * one for one in gains])
    assert not far["stable"]
    for load in (False, True):
        ran = run("return stepped(what.step, what.models[0].step, arguments[0], arguments[1])", gains, load)
        exact = step_response(seen_process, NEW, what["step"]["n"] * what["step"]["dt"], 0.15, load=load)
        t = np.arange(what["step"]["n"] + 1) * what["step"]["dt"]
        size = max(np.ptp(exact.pv), 1e-9)
        assert np.max(np.abs(np.interp(t, exact.t, exact.pv, left=0.0) - ran["pv"])) < 0.12 * size


def test_the_page_dials_as_we_do(tmp_path: Path, browsers: Callable[..., Seen]) -> None:
    seen = browsers()
    open_page(seen, tmp_path, asked("fopdt")[1])
    for name in (*CONTROLLERS, "kc-s", "gain-min", "pb-rpm"):
        gains = PidGains(2.0, 0.1, 0.0 if name == "odrive" else 4.0)
        shown = ControllerUnits.named(name, pv_span=200.0).numbers(gains)
        told = seen.driver.execute_script(
            "return dialled(arguments[0], arguments[1], 200)", name, [gains.kp, gains.ki, gains.kd]
        )
        assert [number for *_, number in told] == pytest.approx([value for value in shown[:3] if value])


def test_a_person_tries_settings(tmp_path: Path, browsers: Callable[..., Seen]) -> None:
    seen = browsers()
    open_page(
        seen, tmp_path, asked("fopdt")[1], "{propose: (gains, text) => { window.asked = [gains, text] }, span: 200}"
    )
    seen.sees("mean error of the record")
    figures = "return document.querySelector('.figures').innerText"
    before = seen.driver.execute_script(figures)
    gain = "const one = document.querySelectorAll('input[type=range]')[1]"
    seen.driver.execute_script(f"{gain}; one.value = Math.log(40); one.dispatchEvent(new Event('input'))")
    after = seen.driver.execute_script(figures)
    assert "unstable" in after
    assert after != before
    seen.press("Use recommended")
    assert seen.driver.execute_script(figures) == before
    seen.driver.execute_script("const s = document.querySelector('select'); s.value = 'rockwell-pide'; s.onchange()")
    seen.sees("PGain 4 IGain 12/min DGain 0.1 min")
    seen.press("Propose")
    gains, text = seen.driver.execute_script("return window.asked")
    assert gains == pytest.approx([2.0, 0.1, 3.0])
    assert text.startswith("PGain 4")
