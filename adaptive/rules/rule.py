"""What every tuning rule is made of: what it takes, what it is called, where it comes from, and the work itself.

Each file beside this one has its rule as plain functions, and one `Rule` a name under which the registry finds it. So
the command line, `--all` and the table in docs/rules.md are made from one list.
"""

from collections.abc import Callable, Mapping
from enum import StrEnum

from retuner.adaptive.process.model import ProcessModel, ProcessType
from retuner.schedule.gains import PidGains, from_form, in_form
from retuner.schedule.late_dataclass import dataclass
from retuner.schedule.plain_values import plain_values

# Which actions a controller has.


class ControllerKind(StrEnum):
    """Actions that a rule may use."""

    P = "p"
    PI = "pi"
    PID = "pid"


# The result of a tuning rule: settings in the rule's own form, and the same in parallel form.


@dataclass(frozen=True, slots=True)
class Tuning:
    """Settings that a rule gives.

    rule : name of the rule.
    form : the rule's native form ("series", "ideal" or "parallel").
    gains : the settings in parallel form, as they are stored and sent.
    tau_c_s : closed-loop time constant that the rule was given or chose; None where the rule has none.
    notes : what a person should know of these settings, a sentence each.
    """

    rule: str
    form: str
    gains: PidGains
    tau_c_s: float | None = None
    notes: tuple[str, ...] = ()

    def to_dict(self, form: str | None = None) -> dict[str, object]:
        """Keys rule, form, gains {kc, tau_i, tau_d}, parallel {kp, ki, kd}, tau_c.

        Raises ValueError: the gains do not exist in the form asked for.
        """
        shown = form or self.form
        gains = {"form": shown, "gains": in_form(self.gains, shown)}
        return {"rule": self.rule, **gains, **plain_values(self, "parallel=gains tau_c=tau_c_s")}


def tuning(rule: str, form: str, kc: float, tau_i_s: float | None, tau_d_s: float, tau_c_s: float | None) -> Tuning:
    """Settings given in a rule's native form.

    Raises ValueError: the rule's numbers make no controller (a gain of 0, a time that is not positive, an overflow).
    """
    return Tuning(rule, form, from_form(form, kc, tau_i_s, tau_d_s), tau_c_s)


FIRST_ORDER = (ProcessType.FOPDT,)
FIRST_ORDER_OR_INTEGRATING = (ProcessType.FOPDT, ProcessType.INTEGRATING)


class Takes(StrEnum):
    """What a rule works from."""

    MODEL = "model"
    ULTIMATE = "ku, pu"
    QUARTER_DECAY = "kq, pq"


@dataclass(frozen=True, slots=True)
class Oscillation:
    """A sustained or decaying oscillation under proportional control.

    gain : controller gain at which it was read, co units per pv unit: the ultimate gain Ku, or Kq at quarter decay.
    period_s : period in seconds.

    Raises ValueError: a value is not finite, the gain is 0 or the period is not positive.
    """

    gain: float
    period_s: float

    def __post_init__(self) -> None:
        if not (abs(self.gain) > 0 and abs(self.gain) < float("inf")):
            raise ValueError(f"gain = {self.gain} must be a finite number other than 0")
        if not 0 < self.period_s < float("inf"):
            raise ValueError(f"period = {self.period_s} s must be positive and finite")


@dataclass(frozen=True, slots=True)
class Wishes:
    """What a person may ask of a rule; a rule refuses what it has no use for.

    tau_c_s : closed-loop time constant (lambda in Lambda and IMC tuning) in seconds.
    ms, gm : demanded sensitivity peak, demanded gain margin.
    c : factor in SIMC's tau_I = min(tau1, c (tau_c + theta)).
    u0, y_max : largest disturbance in co units and allowed deviation in pv units, for smooth tuning.
    """

    tau_c_s: float | None = None
    ms: float | None = None
    gm: float | None = None
    c: float | None = None
    u0: float | None = None
    y_max: float | None = None

    def given(self) -> tuple[str, ...]:
        """Names of those that are given."""
        return tuple(name for name in WISHES if getattr(self, name) is not None)


WISHES = ("tau_c_s", "ms", "gm", "c", "u0", "y_max")
WISH_LABELS = {"tau_c_s": "tau_c", "y_max": "ymax"}  # How a person writes those whose name has a unit in it

Worker = Callable[[ProcessModel, ControllerKind, Wishes], Tuning]
OscillationWorker = Callable[[Oscillation, ControllerKind], Tuning]


@dataclass(frozen=True, slots=True)
class Rule:
    """One tuning rule.

    name : as the command line has it. form : native form of its settings. takes : what it works from.
    formulas : text for each kind that exists. source : author, year, where. valid : range that the source names.
    types : structures that it takes; a second lag is taken up by the half rule where only the shorter one is listed.
    wishes : what may be asked of it (fields of Wishes).
    from_model, from_oscillation : the work; one of the two, as `takes` says.
    """

    name: str
    form: str
    formulas: Mapping[ControllerKind, tuple[str, ...]]
    source: str
    valid: str
    takes: Takes = Takes.MODEL
    types: tuple[ProcessType, ...] = ()
    wishes: tuple[str, ...] = ()
    from_model: Worker | None = None
    from_oscillation: OscillationWorker | None = None

    @property
    def kinds(self) -> tuple[ControllerKind, ...]:
        """The kinds that exist."""
        return tuple(self.formulas)

    @property
    def usual_kind(self) -> ControllerKind:
        """PI where it exists, else the only one."""
        return ControllerKind.PI if ControllerKind.PI in self.formulas else self.kinds[-1]


def first_order(model: ProcessModel) -> tuple[float, float, float]:
    """K, tau and L of a first order model with dead time, as the classic tables name them.

    Raises ValueError: the dead time is 0: the classic rules divide by it.
    """
    return model.k, model.tau1_s, dead_time(model)


def dead_time(model: ProcessModel) -> float:
    """The dead time of a model for a rule that divides by it. Raises ValueError: it is 0."""
    if model.theta_s == 0:
        raise ValueError("theta = 0: this rule divides by the dead time; give theta, or use simc with tau_c")
    return model.theta_s
