"""Models and gains from and to scipy.signal and python-control objects; neither package is imported until asked for.

Both are told by where their class comes from. A discrete-time system is refused: its time constants depend on how the
signal was held, which the object does not say.
"""

import warnings
from collections.abc import Iterable
from importlib import import_module
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np

from retuner.adaptive.process.model import LinearProcess, ProcessModel
from retuner.adaptive.process.transfer_functions import from_roots, to_polynomials
from retuner.errors import UserError
from retuner.schedule.gains import PidGains

if TYPE_CHECKING:
    from control import TransferFunction as ControlFunction
    from scipy.signal import TransferFunction as ScipyFunction

PADE_ORDER = 5
"""Order of the Pade approximation of the dead time that is handed out: right to 0.2 degrees up to w = 5/theta."""
WHERE = 0.7
"""The gain of a system is read off at this share of its geometric mean frequency, a real s away from its roots."""

Thing = ProcessModel | LinearProcess | PidGains
System: TypeAlias = Any  # An object of a package that is not imported here, so its type has no name


def process_of(system: System, theta_s: float = 0.0) -> LinearProcess:
    """The process behind a scipy.signal or python-control system with one input and one output.

    Parameters
    ----------
    system : TransferFunction, ZerosPolesGain or StateSpace of scipy.signal; TransferFunction or StateSpace of
        python-control. Continuous. theta_s : dead time in seconds, which these objects cannot hold.

    Returns
    -------
    LinearProcess

    Raises
    ------
    ValueError
        The system is discrete, has several inputs or outputs, or is none that a model can stand for.
    TypeError
        It is neither package's.
    """
    package = type(system).__module__.split(".")[0]
    if package == "scipy":
        if system.dt is not None:
            raise ValueError(f"the system is sampled every {system.dt:g} s; give the continuous one")
        from scipy.signal import BadCoefficients  # noqa: PLC0415  imported already by whoever made the system

        with warnings.catch_warnings():
            # leading zeros of a state-space numerator, trimmed by scipy
            warnings.simplefilter("ignore", BadCoefficients)
            zpk = system.to_zpk()
        gain = np.atleast_1d(np.asarray(zpk.gain, dtype=np.float64))
        if gain.size != 1 or np.ndim(zpk.zeros) != 1:
            raise ValueError("the system has several inputs or outputs; give one channel")
        return from_roots(zpk.zeros, zpk.poles, float(gain[0]), theta_s)
    if package == "control":
        # Zeros, poles, and the gain from the system's value at one real s
        if not system.isctime():
            raise ValueError(f"the system is sampled every {system.dt} s; give the continuous one")
        if (system.ninputs, system.noutputs) != (1, 1):
            raise ValueError(f"the system has {system.ninputs} inputs and {system.noutputs} outputs; give one channel")
        zeros, poles = np.asarray(system.zeros()), np.asarray(system.poles())
        sizes = np.abs(np.concatenate([zeros, poles]))
        sizes = sizes[sizes > 0]
        s = WHERE * float(np.exp(np.mean(np.log(sizes)))) if sizes.size else 1.0
        at_s = complex(np.squeeze(system(s))) * np.prod(s - poles) / np.prod(s - zeros)
        return from_roots(zeros, poles, float(np.real(at_s)), theta_s)
    raise TypeError(f"{type(system).__name__} is neither a scipy.signal nor a python-control system")


def to_scipy(thing: Thing, pade_order: int = PADE_ORDER) -> "ScipyFunction":
    """A scipy.signal.TransferFunction of a model (dead time by Pade) or of gains (improper with derivative action).

    Parameters
    ----------
    thing : a model or gains. pade_order : order of the approximation of the dead time.

    Returns
    -------
    scipy.signal.TransferFunction

    Raises
    ------
    ValueError
        There is dead time, and pade_order is not positive.
    """
    from scipy.signal import TransferFunction  # noqa: PLC0415  not imported until asked for

    num, den = _polynomials(thing, pade_order)
    return TransferFunction(num, den)


def to_control(thing: Thing, pade_order: int = PADE_ORDER) -> "ControlFunction":
    """A python-control TransferFunction of a model (dead time by Pade) or of gains.

    Parameters
    ----------
    thing : a model or gains. pade_order : order of the approximation of the dead time.

    Returns
    -------
    control.TransferFunction

    Raises
    ------
    ValueError
        There is dead time, and pade_order is not positive.
    UserError
        python-control is not installed.
    """
    try:
        control = import_module("control")
    except ImportError:
        raise UserError("to_control needs python-control, which is not part of retuner; pip install control") from None
    num, den = _polynomials(thing, pade_order)
    made: ControlFunction = control.tf(num, den)
    return made


def _polynomials(thing: Thing, pade_order: int) -> tuple[list[float], list[float]]:
    if isinstance(thing, PidGains):
        num = [thing.kd, thing.kp, *([thing.ki] if thing.ki else [])]
        return np.trim_zeros(num, "f"), [1.0, 0.0] if thing.ki else [1.0]
    return to_polynomials(thing.linear() if isinstance(thing, ProcessModel) else thing, pade_order)


def gains_of(system: System) -> PidGains:
    """The gains of a PID controller without derivative filter, kp + ki/s + kd s, from either package.

    Parameters
    ----------
    system : TransferFunction of scipy.signal or python-control.

    Returns
    -------
    PidGains

    Raises
    ------
    ValueError
        It is no such controller, or the gains make none.
    TypeError
        It is neither package's.
    """
    if type(system).__module__.split(".")[0] not in {"scipy", "control"}:
        raise TypeError(f"{type(system).__name__} is neither a scipy.signal nor a python-control system")
    num, den = (np.atleast_1d(np.squeeze(np.asarray(x, dtype=np.float64))) for x in (system.num, system.den))
    num, den = np.trim_zeros(num, "f"), np.trim_zeros(den, "f")
    if len(den) == 1 and len(num) <= 2:  # kp + kd s
        kd, kp = ([0.0] * (2 - len(num)) + (num / den[0]).tolist())[:2]
        return PidGains(kp, 0.0, kd)
    if len(den) != 2 or den[1] != 0 or not 1 <= len(num) <= 3:
        raise ValueError(
            f"num {_shown(num)}, den {_shown(den)}: not kp + ki/s + kd s; a PID without derivative "
            "filter has den = [1, 0]"
        )
    kd, kp, ki = ([0.0] * (3 - len(num)) + (num / den[0]).tolist())[:3]
    return PidGains(kp, ki, kd)


def _shown(numbers: Iterable[float]) -> str:
    return ", ".join(f"{number:g}" for number in numbers)
