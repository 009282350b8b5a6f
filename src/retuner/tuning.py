"""`retuner.tune`: settings for a process by a named rule, with their margins; frozen results that know their JSON."""

from typing import Any

from retuner.adaptive import display_hook
from retuner.adaptive.loop.margins import Margins, margins
from retuner.adaptive.process.model import ProcessModel
from retuner.adaptive.rules.registry import RULES as REGISTRY
from retuner.adaptive.rules.registry import Explanation, explanation, kind_for, rule_named, settings
from retuner.adaptive.rules.rule import ControllerKind, Oscillation, Rule, Takes, Tuning, Wishes
from retuner.schedule.controller_units import ControllerUnits
from retuner.schedule.gains import PidGains
from retuner.schedule.late_dataclass import dataclass, field

RULES = tuple(REGISTRY)  # names of the tuning rules


@dataclass(frozen=True, slots=True)
class TuneResult(display_hook.Shown):
    """Settings of a rule, in a named form, with the margins of the model under them (None without a model).

    Attributes
    ----------
    tuning : the rule, its settings as parallel gains (`tuning.gains`), its notes.
    form : in which they are written.
    kind : p, pi or pid.
    explanation : formula and numbers.
    model : the process that they were worked out for.
    """

    tuning: Tuning
    form: str
    margins: Margins | None
    kind: ControllerKind = ControllerKind.PI
    explanation: Explanation | None = None
    model: ProcessModel | None = field(default=None, compare=False)

    def __repr__(self) -> str:
        g, ms = self.tuning.gains, "" if self.margins is None else f", Ms {self.margins.ms:.3g}"
        return f"TuneResult({self.tuning.rule} {self.kind}: kp {g.kp:.4g}, ki {g.ki:.4g}, kd {g.kd:.4g}{ms})"

    @classmethod
    def on(cls, tuning: Tuning, process: ProcessModel) -> "TuneResult":
        """Settings in the form of their rule, with the margins of that process under them."""
        kind = ControllerKind.PID if tuning.gains.kd else ControllerKind.PI
        return cls(tuning, tuning.form, margins(process.linear(), tuning.gains), kind)

    @property
    def gains(self) -> PidGains:
        """The settings as parallel gains."""
        return self.tuning.gains

    def to_dict(self) -> dict[str, Any]:
        """Keys rule, kind, form, gains {kc, tau_i, tau_d}, parallel {kp, ki, kd}, tau_c, margins {...}, notes."""
        return {
            **self.tuning.to_dict(self.form),
            "kind": str(self.kind),
            "margins": self.margins.to_dict() if self.margins else None,
            "notes": list(self.tuning.notes),
        }


def tune(
    model: ProcessModel | None = None,
    rule: str = "simc",
    *,
    kind: str | None = None,
    form: str | None = None,
    tau_c: float | None = None,
    ms: float | None = None,
    gm: float | None = None,
    c: float | None = None,
    u0: float | None = None,
    y_max: float | None = None,
    ku: float | None = None,
    pu: float | None = None,
    kq: float | None = None,
    pq: float | None = None,
) -> TuneResult:
    """Settings by a named rule.

    Parameters
    ----------
    model : the process; not needed by rules that work from ku and pu or kq and pq.
    rule : one of RULES.
    kind : "p", "pi" or "pid"; default PI where the rule has it.
    form : form to write the settings in; default the rule's own.
    tau_c : closed-loop time constant in seconds (lambda of the Lambda and IMC rules).
    ms, gm : demanded sensitivity peak or gain margin, from which SIMC's tau_c follows; ms also for rule optimal.
    c : SIMC's factor in tau_I = min(tau1, c (tau_c + theta)), default 4.
    u0, y_max : largest disturbance (co units) and allowed deviation (pv units) of rule simc-smooth.
    ku, pu : ultimate gain and period (s); from the model where not given. kq, pq : the same at quarter decay.

    Returns
    -------
    TuneResult
        The settings; `gains` has them in parallel form, `margins` what they leave.

    Raises
    ------
    ValueError
        The rule or kind is not known, the rule has no answer for this process or no use for what is given (named).

    Examples
    --------
    >>> from retuner import ProcessModel, ProcessType
    >>> tune(ProcessModel(ProcessType.FOPDT, k=0.361, tau1_s=138.0, theta_s=14.2))
    TuneResult(simc pi: kp 13.46, ki 0.1185, kd 0, Ms 1.61)
    """
    chosen = rule_named(rule)
    wanted = kind_for(chosen, kind, model)
    wishes = Wishes(tau_c, ms, gm, c, u0, y_max)
    reading = _reading(chosen, ku, pu, kq, pq)
    found = settings(chosen, wanted, model, reading, wishes)
    robustness = margins(model.linear(), found.gains) if model else None
    why = explanation(chosen, wanted, model, reading, wishes, found)
    result = TuneResult(found, form or found.form, robustness, wanted, why, model)
    result.to_dict()  # raises here, not later, when the form does not exist for these gains
    return result


def _reading(rule: Rule, ku: float | None, pu: float | None, kq: float | None, pq: float | None) -> Oscillation | None:
    """The gain and period given for this rule, if any; a half pair or the wrong pair is refused."""
    pairs = {Takes.ULTIMATE: ("ku", ku, "pu", pu), Takes.QUARTER_DECAY: ("kq", kq, "pq", pq)}
    for takes, (gain_name, gain, period_name, period_s) in pairs.items():
        if gain is None and period_s is None:
            continue
        if rule.takes != takes:
            raise ValueError(f"rule {rule.name} has no use for {gain_name} and {period_name}; leave them out")
        if gain is None or period_s is None:
            raise ValueError(f"give both {gain_name} and {period_name}, or neither")
        for name, value in ((gain_name, gain), (period_name, period_s)):
            if not abs(value) < float("inf") or value == 0 or (name == period_name and value < 0):
                raise ValueError(f"{name} = {value} must be finite and {'positive' if name[0] == 'p' else 'not 0'}")
        return Oscillation(gain, period_s)
    return None


def tuning_lines(result: TuneResult, units: ControllerUnits | None = None) -> list[str]:
    """Settings, margins and notes in lines. units : of the controller, for a line of the numbers that stand on it."""
    shown = result.to_dict()
    gains, parallel, m = shown["gains"], shown["parallel"], result.margins
    times = f"tau_I {_number(gains['tau_i'], ' s')}  tau_D {_number(gains['tau_d'], ' s')}"
    ki, kd = _number(parallel["ki"], "/s"), _number(parallel["kd"], " s")
    tau_c = "" if result.tuning.tau_c_s is None else f", tau_c {_number(result.tuning.tau_c_s, ' s')}"
    lines = [
        f"{result.tuning.rule} {result.kind.upper()}{tau_c}",
        f"  {result.form:<8}  Kc {_number(gains['kc'])}  {times}",
        f"  parallel  kp {_number(parallel['kp'])}  ki {ki}  kd {kd}",
    ]
    if units is not None:
        lines.append(f"  dialled   {units.text(result.gains, digits=4, acting=True)}")
    if m is not None and not m.stable:
        lines.append("  the closed loop would be UNSTABLE")
    elif m is not None:
        lines.append(
            f"  margins   Ms {m.ms:.3f}  Mt {m.mt:.3f}  GM {m.gm:.3g}  PM {m.pm_deg:.1f} deg  "
            f"delay margin {m.delay_margin_s:.4g} s"
        )
    return [*lines, *(f"  note: {note}" for note in result.tuning.notes)]


def _number(value: float | None, unit: str = "") -> str:
    return "none" if value is None else f"{value:.4g}{unit}"
