"""The book of a loop as time goes by and gains change: what fades, what is counted, and what is left out."""

from dataclasses import replace

import numpy as np
import pytest

from retuner.adaptive.explanations import book as room
from retuner.adaptive.explanations.book import DEEPEST, GRID, PLANES, STEP, WEIGHED, Book, faded, update
from retuner.adaptive.explanations.process_grid import shapes
from retuner.adaptive.explanations.wandering_load import ORDERS, T_LOADS, TEMPER
from retuner.adaptive.signals.sample import FloatArray, Window
from retuner.schedule.gains import PidGains

N = 300
GOOD = PidGains(2.2, 0.11)
DAY = 86400.0
HAZARD = 30.0 * DAY


def window(first_s: float, n: int = N, co: float = 1.0) -> Window:
    """Samples that say something; what they are weighed as, a test sets."""
    noise = np.random.default_rng(1).normal(size=(2, n))
    return Window(first_s + np.arange(float(n)), np.zeros(n), noise[0], co * noise[1])


@pytest.fixture
def likely(monkeypatch: pytest.MonkeyPatch) -> FloatArray:
    """Tempered log-likelihood of each process of the next window; all alike until a test changes it."""
    plane = np.zeros(GRID)
    monkeypatch.setattr(room, "log_likelihoods", lambda *_: (np.array([plane] * 3), np.array([plane] * len(ORDERS))))
    return plane


def known(likely: FloatArray) -> Book:
    """A book that is sure of one process."""
    book = Book.begun(GOOD, 1.0, 0.0)
    first = np.unravel_index(int(np.argmax(book.weights())), GRID)
    likely[first] = 50.0
    for i in range(3):
        book = update(book, window(i * N))
    likely[first] = 0.0
    return book


def test_a_book_that_is_looked_at_often_fades_as_one_that_is_not(likely: FloatArray) -> None:
    """By less than half a level at a time, what was known never faded."""
    often = seldom = known(likely)
    for i in range(1, 101):
        often = update(often, window(0.01 * i * HAZARD), hazard_s=HAZARD)
    seldom = update(seldom, window(HAZARD), hazard_s=HAZARD)
    sure, first = (float(np.max(book.weights())) for book in (known(likely), Book.begun(GOOD, 1.0, 0.0)))
    assert float(np.max(seldom.weights())) == pytest.approx(first + (sure - first) * np.exp(-1.0), rel=0.05)
    assert float(np.max(often.weights())) == pytest.approx(float(np.max(seldom.weights())), rel=0.2)


def test_less_than_a_level_waits_and_is_not_lost() -> None:
    book = Book.begun(GOOD, 1.0, 0.0)
    soon, later = 0.9 * STEP * HAZARD, 1.1 * STEP * HAZARD
    assert faded(book, soon, HAZARD).faded_s[0] == 0.0
    assert faded(book, later, HAZARD).faded_s[0] == later
    again = faded(replace(book, faded_s=(0.0, soon)), later, HAZARD)
    assert again.faded_s == (later, later), "a tone by its own clock"


def test_a_window_that_grows_fades_once(likely: FloatArray) -> None:
    book, hazard_s = known(likely), 2000.0
    grown = book
    for n in (100, 200, N):
        grown = update(grown, window(3 * N, n), hazard_s=hazard_s, grows=True)
    assert grown.whole == book.whole
    once = update(book, window(3 * N), hazard_s=hazard_s)
    assert update(grown, window(3 * N), hazard_s=hazard_s) == once
    assert once.moved_before <= book.moved_before
    assert once.levels != book.levels


def test_the_time_between_windows_counts(likely: FloatArray) -> None:
    """In other regions, in manual, or without samples, a process changes as well."""
    book = known(likely)
    soon, late = (update(book, window(at), hazard_s=HAZARD) for at in (3.0 * N, 10.0 * HAZARD))
    assert float(np.max(soon.weights())) == pytest.approx(float(np.max(book.weights())), rel=0.01)
    assert float(np.max(late.weights())) < 2.0 * float(np.max(Book.begun(GOOD, 1.0, 0.0).weights()))


def test_what_is_left_out_counts_neither_as_the_best_nor_in_the_mean(likely: FloatArray) -> None:
    """A process on which the loop cannot run fitted best: then every other seemed as odd as the others."""
    begun = Book.begun(GOOD, 1.0, 0.0)
    kept = begun.weights() > 0.0
    first = np.unravel_index(int(np.argmax(begun.weights())), GRID)
    likely[first] = 2.0 * T_LOADS / TEMPER
    without = update(begun, window(0.0))
    likely[~kept] = 100.0
    assert update(begun, window(0.0)).levels == without.levels


@pytest.mark.usefixtures("likely")
@pytest.mark.parametrize(("co", "n", "records"), [(1.0, N, 1), (0.0, N, 0), (1.0, 20, 0)])
def test_a_window_that_says_nothing_is_no_record(co: float, n: int, records: int) -> None:
    assert update(Book.begun(GOOD, 1.0, 0.0), window(0.0, n, co)).records == records


def out_of(book: Book) -> FloatArray:
    """What is left out; shape GRID."""
    return np.frombuffer(book.prior, dtype=np.uint8).reshape(PLANES)[0] == DEEPEST


@pytest.mark.parametrize("times", [8.0, 1 / 8.0])
def test_gains_far_from_the_first_open_what_those_left_out(likely: FloatArray, times: float) -> None:
    """More of them: a start so weak that the process was "idle"; less: one that the loop could not have run on."""
    now, book = PidGains(times * GOOD.kp, times * GOOD.ki), known(likely)
    assert book.under(GOOD) is book
    opened, fresh = book.under(now), Book.begun(now, 1.0, 0.0)
    new = out_of(book) & ~out_of(opened)
    count = len(shapes())
    assert new[:count].any()
    shift = round(np.log(times) / np.log(10.0) * 12)  # of the gains of the grid, which are counted in the first kp
    possible = ~out_of(fresh)[:count]
    moved = slice(max(-shift, 0), min(61 - shift, 61)), slice(max(shift, 0), min(61 + shift, 61))
    agree = possible[:, :, moved[1]] <= ~out_of(opened)[:count][:, :, moved[0]]
    assert float(np.mean(agree)) > 0.99
    entered = float(opened.weights()[new].sum())
    if times > 1.0:
        assert entered == pytest.approx(float(np.sum(new)) / float(np.sum(~out_of(opened))), abs=0.05)
    else:
        assert 0.0 < entered < 0.1, "only a change of the process brings them"
        assert float(faded(opened, 30.0 * HAZARD, HAZARD).whole != opened.whole)
        late = replace(opened, levels=faded(opened, 30.0 * HAZARD, HAZARD).whole)
        assert float(late.weights()[new].sum()) > 0.01
    assert opened.under(now) is opened


def test_a_tone_may_be_likelier_where_the_setpoint_has_moved(likely, monkeypatch):
    """How late a step is answered was asked of the likeliest process without a tone, also where one was likelier."""
    asked: list[tuple[int, ...]] = []
    begun = Book.begun(GOOD, 1.0, 0.0)
    alone, beside = (tuple(int(x) for x in place) for place in np.argwhere(begun.weights() > 0.0)[[0, -1000]])
    planes = np.tile(likely, (3, 1, 1, 1))
    planes[0][alone], planes[1][beside] = 50.0, 200.0
    monkeypatch.setattr(room, "log_likelihoods", lambda *_: (planes, np.array([likely] * len(ORDERS))))

    def noted(_record: object, _setpoint: object, found: int) -> float:
        asked.append(tuple(int(x) for x in np.unravel_index(found, GRID)))
        return 0.0

    monkeypatch.setattr(room, "_moved_by_setpoint", noted)
    update(begun, window(0.0))
    assert asked == [beside]
    assert WEIGHED == 2
