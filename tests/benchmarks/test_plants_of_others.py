"""Plants made by others: what a loop truly is is found from its answer to a step; a session runs from end to end."""

import importlib
from collections.abc import Callable, Mapping
from functools import partial

import numpy as np
import pytest
from online.judge import Judge
from plants_of_others import columns, eastman, session, temperature_lab, wastewater
from plants_of_others.answered import Answered
from plants_of_others.columns import Distillation
from plants_of_others.loop import Card, Control, Stepped
from plants_of_others.truth import StepTest, fitted, step_answer, truth

from retuner import LinearProcess, PidGains

CARD = Card("y", 1.0, (0.0, 100.0), (0.0, 100.0), PidGains(2.0, 0.05, 0.0), "here", 5.0)
LAG = LinearProcess(0.6, (40.0, 5.0), (), 6.0)


@pytest.mark.parametrize("process", [LAG, LinearProcess(-0.01, (), (), 6.0, 1)])
def test_a_process_is_found_from_its_answer(process: LinearProcess) -> None:
    found, misfit = fitted(step_answer(process, 1.0, 300), 1.0)
    assert misfit < 0.01
    w = np.geomspace(1e-2, 0.2, 20)
    assert np.max(np.abs(found.response(w) / process.response(w) - 1)) < 0.02


@pytest.mark.parametrize("factor", [0.3, 1.0, 2.0, 8.0])
def test_an_answer_judges_as_the_process_behind_it(factor: float) -> None:
    judge = Judge(LAG, 1.0)
    seen = step_answer(LAG, 1.0, 300)
    by_answer, gains = Answered(seen, 1.0, judge.best), judge.best
    gains = PidGains(factor * gains.kp, factor * gains.ki, 0.0)
    found, true = by_answer.of(gains), judge.of(gains)
    assert found.ms == pytest.approx(true.ms, rel=0.05)
    assert found.j == pytest.approx(true.j, rel=0.05)


class Quick:
    """A plant that costs nothing to run: one lag and its dead time, steps of the setpoint."""

    name = "quick"
    licence = "ours"
    cards: Mapping[str, Card]

    def __init__(self) -> None:
        self.cards = {"y": CARD}

    def rest(self, _loop: str) -> float:
        return 50.0

    def times(self, _loop: str, _seed: int) -> list[float]:
        return [400.0, 800.0]

    def session(self, controls: Mapping[str, Control], loop: str, seed: int) -> None:
        noise = np.random.default_rng(seed).normal(0.0, 0.02, 1200)
        self._run(controls[loop], [30.0] * 400 + [35.0] * 400 + [30.0] * 400, noise.tolist())

    def calm(self, controls: Mapping[str, Control], seconds: float) -> None:
        self._run(next(iter(controls.values())), [30.0] * int(seconds), [0.0] * int(seconds))

    def _run(self, control: Control, sps: list[float], noise: list[float]) -> None:
        plant, y = columns.HeldPlant(LAG, 1.0), 0.0
        for sp, more in zip(sps, noise, strict=True):
            y = plant.move(control(sp, 30.0 + y + more) - 50.0)


@pytest.mark.slow
def test_a_session_is_told_with_its_replays() -> None:
    plant = Quick()
    known = truth(plant, CARD, StepTest(300.0, 300.0))
    assert known.process.k == pytest.approx(LAG.k, rel=0.01)
    row = session.run(plant, {"y": known}, session.Task("y", "low", 1))
    assert len(row["spec"]) == 2
    assert row["tripped"] == ""
    assert row["replays"]["best"]["iae"] < row["replays"]["start"]["iae"]
    assert row["replays"]["end"]["iae"] <= row["replays"]["start"]["iae"]
    assert "quick y" in session.line(row)
    assert session.table([row])[1].startswith("quick low")


def test_the_steady_state_of_a_published_column_is_that_of_its_gains() -> None:
    plant = Distillation("wood-berry")
    held = {name: Stepped(lambda _sp, _pv: 0.0, 0, 0, step) for name, step in (("y1", 0.01), ("y2", 0.02))}
    plant.calm(held, 60.0 * 200)
    assert held["y1"].track.pv[-1] == pytest.approx(12.8 * 0.01 - 18.9 * 0.02, rel=0.01)
    assert held["y2"].track.pv[-1] == pytest.approx(6.6 * 0.01 - 19.4 * 0.02, rel=0.01)


@pytest.mark.parametrize(
    ("load", "said"),
    [
        (temperature_lab.load, "tclab"),
        (eastman.load, "tep-studio"),
        (partial(wastewater.load, "bsm1_cl"), "bsm2-python"),
    ],
)
def test_a_missing_package_is_one_line(load: Callable[[], object], said: str, monkeypatch: pytest.MonkeyPatch) -> None:
    def missing(name: str) -> None:
        raise ModuleNotFoundError(name=name)

    monkeypatch.setattr(importlib, "import_module", missing)
    with pytest.raises(SystemExit, match=said):
        load()
