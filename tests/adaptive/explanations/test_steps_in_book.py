"""A fit whose loads are steps: what it is worth beside a load that wanders, and what it says of processes of a grid."""

import math
from dataclasses import replace

import numpy as np
import pytest
from pi_loop import Lag, pi_loop

from retuner.adaptive.explanations.book import update, with_response
from retuner.adaptive.explanations.process_grid import DEAD_TIMES, EVERY_LAG, GAINS, apart, shapes
from retuner.adaptive.explanations.settings_by_book import by_book
from retuner.adaptive.explanations.wandering_load import lead_of_steps, log_likelihood
from retuner.adaptive.fit.structure import parameters_of
from retuner.adaptive.identification.estimate import LogModel
from retuner.adaptive.identification.identify import identify_window
from retuner.adaptive.process.model import ProcessModel, ProcessType
from retuner.adaptive.signals.sample import Window
from tests.adaptive.explanations.test_book import DEAD, GOOD, LAG, SETTINGS, K, after, recorded
from tests.adaptive.explanations.test_wandering_load import drawn_record


def test_what_steps_leave_is_priced_against_the_best_walk() -> None:
    record = drawn_record(3)
    n, likelihood = len(record.pv), log_likelihood(record, 1, 1.0)
    left = float(np.var(record.pv))
    nothing = lead_of_steps(left, 0, n, record, likelihood)
    assert nothing < 0  # a fit that explains nothing, against one that does
    assert nothing - lead_of_steps(left, 1, n, record, likelihood) == pytest.approx(math.log(n))
    assert lead_of_steps(left / 2, 0, n, record, likelihood) - nothing == pytest.approx(n / 2 * math.log(2))
    exact, fine = (lead_of_steps(share * record.resolution**2, 0, n, record, likelihood) for share in (0.0, 1.0))
    assert exact == fine  # nothing finer than pv's resolution is believed, and that is not added to what is left


@pytest.mark.parametrize("sign", [1, -1])
@pytest.mark.parametrize(
    ("model", "lag", "second"),
    [
        (ProcessModel(ProcessType.FOPDT, 2.0, 30.0, 0.0, 12.0), 15.0, 0.0),
        (ProcessModel(ProcessType.SOPDT, 2.0, 30.0, 12.0, 12.0), 15.0, 6.0),
        (ProcessModel(ProcessType.INTEGRATING, float(GAINS[40]) / 160.0, 0.0, 0.0, 12.0), math.inf, 0.0),
    ],
)
def test_the_nearest_process_of_the_grid_is_the_fit_itself(model, lag, second, sign):
    """Two seconds a sample; loop gains are counted in 1/4."""
    d = len(parameters_of(model))
    far = apart(LogModel(parameters_of(model), 1e-4 * np.eye(d), sign, model.type), 10.0, 4.0, 2.0)
    row, dead, gain = np.unravel_index(int(np.argmin(far)), far.shape)
    shape = shapes(EVERY_LAG)[row]
    assert (shape.lag, shape.second, DEAD_TIMES[dead]) == (lag, second, 6.0)
    of_grid = GAINS[gain] / 4.0 * shape.unit / (2.0 if shape.integrates else 1.0)
    assert of_grid == pytest.approx(model.k, rel=0.11)
    assert far.min() == 0.0
    beside = np.moveaxis(far, 2, 0)[:, row, dead]
    assert np.all(np.diff(beside[gain:]) > 0)
    assert np.all(np.diff(beside[: gain + 1]) < 0)
    wide = apart(LogModel(parameters_of(model), 0.1 * np.eye(d), sign, model.type), 10.0, 4.0, 2.0)
    assert np.median(wide) < 0.1 * np.median(far), "what the record does not tell, it does not say"
    outside = replace(model, k=1e4 * model.k)
    far = apart(LogModel(parameters_of(outside), 1e-4 * np.eye(d), sign, model.type), 10.0, 4.0, 2.0)
    assert far.min() > 100.0, "the last gain of the grid stands for none a hundred times as large"


def stepped(seed: int, times: float) -> Window:
    """A loop under good gains after a step in the load, on a process whose gain is so many times what it was."""
    noise, load = np.random.default_rng(seed).normal(size=400) * 0.02, np.where(np.arange(400) < 100, 0.0, 0.5)
    window = pi_loop(GOOD, Lag(LAG, DEAD, times * K), np.zeros(400), noise, load)
    return replace(window, t_s=window.t_s + 1000.0 * seed)


def test_loads_that_are_steps_tell_the_book_that_the_gain_has_doubled() -> None:
    """Three of them agreed on Ms 3.7, and the book, which knew loads that wander only, held on to 1.56 with 99 %."""
    book = without = after(GOOD, 3)
    for seed in (3, 4):
        window = stepped(seed, 2.0)
        without = update(without, window)
        book = with_response(update(book, window), window, identify_window(window, 1))
    assert by_book(without, GOOD, SETTINGS).numbers.book_high < 0.5
    assert by_book(book, GOOD, SETTINGS).numbers.book_high > 0.9


def test_a_response_adds_nothing_where_its_load_wanders() -> None:
    window = recorded(GOOD, 8, 400)
    book = update(after(GOOD, 3), window)
    assert with_response(book, window, identify_window(window, 1)) is book
    few = Window(*(x[:12] for x in (window.t_s, window.sp, window.pv, window.co)))
    assert with_response(book, few, identify_window(window, 1)) is book
