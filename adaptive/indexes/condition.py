"""What a record is before anyone asks what is wrong with the loop: is there a loop at work in it at all?

In this order, the first that applies:

    dead pv, dead co      the signal does not change: a broken sensor, a closed line, a flat-lined tag
    no response           co moves and pv does not follow: it stays within its noise, or on a few values of its grid,
                          while the setpoint asks for more, or, beside its setpoint, while co goes one way all the time
    manual                co stands exactly still for most of the time although the error would move it
    not controlling       the error stays far on one side and co is not at a limit: no integral action, or another
                          controller has the valve
    moving setpoint       the setpoint changes all the time: the inner loop of a cascade
    quiet                 nothing happens beyond noise: no setpoint change, pv within its noise band
"""

import math
from collections.abc import Callable
from enum import StrEnum

import numpy as np

from retuner.adaptive.indexes.autocovariance import running_mean
from retuner.adaptive.indexes.recording_quality import runs
from retuner.adaptive.signals.noise import noise_sigma
from retuner.adaptive.signals.sample import FloatArray, Window
from retuner.schedule.late_dataclass import dataclass

DEAD = 1e-9  # A signal that varies by less than this share of its magnitude is dead
STILL_SHARE = 0.6  # share of the record in long stretches of constant co from which it counts as manual
STILL_STRETCH = 20  # samples of constant co that make a long stretch, at least
STILL_LENGTH = 0.1  # length of a standstill as a share of the record: a rounded co stands still for a while as well
MOVING_SHARE = 0.3  # share of samples with a setpoint change from which the setpoint moves all the time
OFFSET_RATIO = 6.0  # mean error over its standard deviation from which it stands far on one side
BESIDE = 1.0  # the same up to which pv rests at its setpoint: held against a load, where co goes one way
NOISE_RATIO = 1.6  # slow movement over what averaged noise would leave, from which a signal moves
ASKED_SIGMAS = 8.0  # A setpoint step of so many standard deviations of the noise shows in any pv that follows
AVERAGED = 16  # samples averaged to see slow movement


class Condition(StrEnum):
    """What the record shows before any diagnosis; the value is the word that people see."""

    NORMAL = "normal"
    DEAD_PV = "dead pv"
    DEAD_CO = "dead co"
    NO_RESPONSE = "no response"
    MANUAL = "manual"
    NOT_CONTROLLING = "not controlling"
    MOVING_SETPOINT = "moving setpoint"
    QUIET = "quiet"


SENTENCES = {
    Condition.NORMAL: "a loop at work",
    Condition.DEAD_PV: "pv does not change in the whole record: a dead signal",
    Condition.DEAD_CO: "co does not change in the whole record: manual, or a dead signal",
    Condition.NO_RESPONSE: "co moves and pv does not respond to it",
    Condition.MANUAL: "co does not move for most of the record: the loop is in manual",
    Condition.NOT_CONTROLLING: "pv stays far from its setpoint with co inside its range: no integral action, or "
    "another controller has the valve",
    Condition.MOVING_SETPOINT: "the setpoint moves all the time: the inner loop of a cascade",
    Condition.QUIET: "nothing happens in this record beyond noise",
}


@dataclass(frozen=True, slots=True)
class RecordCondition:
    """The condition and the numbers behind it.

    still_share : share of samples in long stretches of constant co. sp_moving_share : share of samples with a new sp.
    offset : |mean error| / standard deviation of the error.
    """

    condition: Condition
    still_share: float
    sp_moving_share: float
    offset: float

    @property
    def sentence(self) -> str:
        """The condition in a sentence."""
        return SENTENCES[self.condition]


@dataclass(frozen=True, slots=True)
class Traits:
    """What the condition of a record is told from.

    dead_pv, dead_co : the signal is constant. still : share of samples in long stretches of constant co. at_limit :
    share of samples with co at a limit. sp_moving, offset : as in RecordCondition. pv_moves, co_moves : slowly, more
    than noise does. asks : the setpoint asks for more than noise, escapes : co goes one way; both where pv does not
    move. runs : co goes one way by itself; asked where pv stays far from its setpoint.
    """

    dead_pv: bool
    dead_co: bool
    still: float
    at_limit: float
    sp_moving: float
    offset: float
    pv_moves: bool
    co_moves: bool
    asks: Callable[[], bool]
    escapes: Callable[[], bool]
    runs: Callable[[], bool]


def record_condition(
    window: Window, at_limit_share: float = 0.0, *, oscillates: bool = False, in_auto: bool = False
) -> RecordCondition:
    """Judge a record.

    at_limit_share : share of samples with co at a limit: there an error may stand. oscillates : a lasting oscillation
        was seen, which may be too fast for means of AVERAGED samples to show it. in_auto : the samples say that the
        loop is in automatic: a co that stands still is rounded, or the error is within the controller's dead band.
    """
    e = window.sp - window.pv
    spread = float(np.std(e))
    offset = abs(float(np.mean(e))) / spread if spread > 0 else 0.0
    still = 0.0 if in_auto else sum(end - start for start, end in still_stretches(window.co)) / len(window.co)
    moving = float(np.mean(np.diff(window.sp) != 0))
    traits = Traits(
        _dead(window.pv), _dead(window.co), still, at_limit_share, moving, offset,
        _slow_movement(window.pv), _slow_movement(window.co),
        lambda: asks(window), lambda: escapes(window), lambda: runs_by_itself(window),
    )  # fmt: skip
    return condition_of(traits, oscillates=oscillates)


def condition_of(traits: Traits, *, oscillates: bool = False) -> RecordCondition:
    """The first condition that applies, the most fundamental first; oscillates : see record_condition."""
    if traits.dead_pv:
        condition = Condition.DEAD_PV
    elif traits.dead_co:
        condition = Condition.DEAD_CO
    elif traits.still - traits.at_limit > STILL_SHARE:
        condition = Condition.MANUAL
    elif not traits.pv_moves and traits.sp_moving < MOVING_SHARE:
        if not (traits.co_moves and (traits.asks() or traits.escapes())):
            condition = Condition.QUIET
        else:
            condition = Condition.NO_RESPONSE if traits.offset > BESIDE or traits.asks() else Condition.NORMAL
    elif traits.offset > OFFSET_RATIO and traits.at_limit < STILL_SHARE:
        condition = Condition.NO_RESPONSE if traits.co_moves and traits.runs() else Condition.NOT_CONTROLLING
    else:
        condition = Condition.MOVING_SETPOINT if traits.sp_moving > MOVING_SHARE else Condition.NORMAL
    if oscillates and condition in {Condition.QUIET, Condition.NO_RESPONSE}:
        condition = Condition.NORMAL
    return RecordCondition(condition, traits.still, traits.sp_moving, traits.offset)


def asks(window: Window) -> bool:
    """Whether the setpoint asks for a movement that stands out of pv's noise, and leaves time for one."""
    return float(np.ptp(window.sp[: max(len(window.sp) - AVERAGED, 1)])) > ASKED_SIGMAS * noise_sigma(window.pv)


def runs_by_itself(window: Window) -> bool:
    """Whether co goes one way and not as the error does, so that it is integral action that moves it."""
    return escapes(window) and abs(float(np.corrcoef(window.co, window.sp - window.pv)[0, 1])) < PROPORTIONAL


PROPORTIONAL = 0.97  # correlation of co with the error from which co is proportional to it


def one_sided(window: Window) -> float | None:
    """Share of a record in which slow pv is on one side of its setpoint, where co goes one way meanwhile; else None."""
    error, slow = (running_mean(x, AVERAGED) for x in (window.sp - window.pv, window.co))
    above = float(np.mean(error > 0))
    share, back = max(above, 1 - above), ONE_WAY * abs(float(slow[-1] - slow[0]))
    way = np.sign(slow[-1] - slow[0])
    turned = float(np.max(np.maximum.accumulate(way * slow) - way * slow))
    return share if share >= ONE_SIDE and way and turned <= back else None


ONE_SIDE = 0.9  # share of a record on one side of the setpoint that counts as all of it
ONE_WAY = 0.1  # how far co may go back, as a share of how far it went, to have gone one way


def _dead(x: FloatArray) -> bool:
    return float(np.ptp(x)) <= DEAD * float(np.max(np.abs(x)))


def still_stretches(co: FloatArray) -> list[tuple[int, int]]:
    """Long stretches without any change of co: first sample, and sample after the last."""
    shortest = max(STILL_STRETCH, STILL_LENGTH * len(co))
    return [(first, end) for first, end in runs(np.diff(co) == 0) if end - first >= shortest]


def _slow_movement(x: FloatArray) -> bool:
    """Whether means over AVERAGED samples vary more than those of noise would."""
    width = min(AVERAGED, max(len(x) // 8, 1))
    means = running_mean(x, width)[width // 2 :: width]
    noise = noise_sigma(x) / math.sqrt(width)
    return float(np.std(means)) > NOISE_RATIO * noise


def escapes(window: Window) -> bool:
    """Whether co travels far in one direction, as an integrator does whose pv does not answer."""
    slow = running_mean(window.co, AVERAGED)
    return 2 * abs(float(slow[-1] - slow[0])) > float(np.sum(np.abs(np.diff(slow))))
