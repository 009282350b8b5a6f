"""What an experiment's record says: the fit first, the methods with names beside it, and the settings that follow.

One evaluation for recorded and live experiments. The settings are SIMC's from the fit, robust on all models that the
record allows; another method's model or another rule is taken only when it is asked for by name.
"""

from collections.abc import Callable

from retuner.adaptive.experiments import relay, step
from retuner.adaptive.experiments.plan import Experiment
from retuner.adaptive.experiments.relay import RelayCycle, relay_cycle
from retuner.adaptive.experiments.step import swing
from retuner.adaptive.experiments.valve_test import ValveReading
from retuner.adaptive.process.model import ProcessModel
from retuner.adaptive.rules.registry import rule_named
from retuner.adaptive.rules.rule import Takes
from retuner.adaptive.signals.sample import Window
from retuner.api import Identification, identify_record
from retuner.errors import UserError
from retuner.schedule.gains import PidGains
from retuner.schedule.late_dataclass import dataclass, field
from retuner.schedule.plain_values import plain_values
from retuner.tuning import TuneResult, tune, tuning_lines

ULTIMATE = "ultimate"  # the experiment that exists as a record only: a swing under proportional control
FIT = "fit"
METHODS = {
    str(Experiment.STEP): (FIT, *(str(method) for method in step.StepMethod)),
    str(Experiment.SETPOINT): (FIT, "two-step"),
    str(Experiment.RELAY): (FIT, "asymmetric"),
    ULTIMATE: (FIT,),
}
"""Methods of each experiment by name."""
OVERSHOOT_RULE = "setpoint-overshoot"  # the direct settings of the setpoint experiment, as a rule
LIKELY = 0.9  # odds from which a fault of a valve is named first
ULTIMATE_RULES = (("zn-ultimate", "pi"), ("zn-ultimate", "pid"))
"""Rules from Ku and Pu that are shown beside the chosen settings."""


@dataclass(frozen=True, slots=True)
class ExperimentQuestion:
    """What is asked of a record.

    kind : step, setpoint, relay or ultimate. method : whose model is tuned for. rule, controller : by which rule.
    kc : proportional gain in force (setpoint, ultimate), None when not known.
    hysteresis : of the relay. rest : pv and co at rest before the relay began; None: the first sample.
    from_rest : the record begins at rest and has no load in it.
    in_force : gains of the controller, where they are known: the sign of the process is theirs.
    """

    kind: str
    method: str = FIT
    rule: str = "simc"
    controller: str | None = None
    kc: float | None = None
    hysteresis: float = 0.0
    rest: tuple[float, float] | None = None
    from_rest: bool = True
    in_force: PidGains | None = None


@dataclass(slots=True)
class ExperimentFindings:
    """What was found. models and refused by method; measured by kind of reading; offers by their name."""

    kind: str
    fit: Identification | None = None
    models: dict[str, ProcessModel] = field(default_factory=dict)
    refused: dict[str, str] = field(default_factory=dict)
    measured: dict[str, dict[str, float | int | bool]] = field(default_factory=dict)
    offers: dict[str, TuneResult] = field(default_factory=dict)
    chosen: TuneResult | None = None
    reason: str = ""
    cycle: RelayCycle | None = None
    ultimate: tuple[float, float] | None = None

    @property
    def usable(self) -> bool:
        """Whether there are settings, and the loop would be stable as far as is known."""
        return self.chosen is not None and (self.chosen.margins is None or self.chosen.margins.stable)

    @property
    def model(self) -> ProcessModel | None:
        """The best model: the fit where the record identifies it."""
        return self.models.get(FIT)

    def to_dict(self) -> dict[str, object]:
        """Keys identifiable, model, std, methods, refused, measured, settings, rule, form, gains, margins, reason."""
        chosen = self.chosen.to_dict() if self.chosen else {}
        return {
            "experiment": self.kind,
            "identifiable": FIT in self.models,
            "model": self.model.to_dict() if self.model else None,
            "std": self.fit.estimate.log.std() if self.fit and FIT in self.models else None,
            "methods": {name: model.to_dict() for name, model in self.models.items()},
            "refused": self.refused,
            "measured": self.measured,
            "settings": {name: offer.to_dict() for name, offer in self.offers.items()},
            **{name: chosen.get(name) for name in ("rule", "kind", "form", "gains", "parallel", "margins")},
            "reason": self.reason,
        }


def evaluate(window: Window, question: ExperimentQuestion) -> ExperimentFindings:
    """Everything that the record says. Raises UserError: the rule that was asked for refuses."""
    found = ExperimentFindings(question.kind)
    if question.kind != ULTIMATE:
        at_setpoint = question.kc and question.kind == Experiment.SETPOINT
        gains = PidGains(question.kc, 0.0) if question.kc and at_setpoint else question.in_force
        try:
            found.fit = identify_record(window, open_loop=question.from_rest, gains=gains)
        except ValueError as refusal:
            found.refused[FIT] = str(refusal)
        else:
            estimate = found.fit.estimate
            if estimate.identifiable:
                found.models[FIT] = estimate.log.model()
            else:
                found.refused[FIT] = estimate.reason
    if question.kind == Experiment.STEP:
        for method in step.StepMethod:
            try:
                seen = step.step_response(window, rest=method != step.StepMethod.SLOPE)
                found.models[method] = step.model_by(method, seen)
            except ValueError as refusal:
                found.refused[method] = str(refusal)
    else:
        read = {Experiment.SETPOINT: _read_setpoint, Experiment.RELAY: _read_relay, ULTIMATE: _read_swing}
        read[question.kind](found, window, question)
    try:
        name, found.chosen = _asked_for(found, question)
    except ValueError as refusal:
        raise UserError(f"--rule {question.rule}: {refusal}") from refusal
    if found.chosen is not None:
        found.offers = {name: found.chosen, **{n: offer for n, offer in found.offers.items() if n != name}}
    return found


def _try(found: ExperimentFindings, name: str, work: Callable[[], ProcessModel]) -> None:
    try:
        found.models[name] = work()
    except ValueError as refusal:
        found.refused[name] = str(refusal)


def _read_setpoint(found: ExperimentFindings, window: Window, question: ExperimentQuestion) -> None:
    try:
        seen = step.measure(window)
    except ValueError as refusal:
        found.refused["two-step"] = str(refusal)
        return
    found.measured["overshoot"] = plain_values(seen, "dy_s dy_p dy_u t_p=t_p_s dy_inf overshoot=d b a")
    if question.kc is None:
        found.refused["two-step"] = "the proportional gain of the experiment is not known; give --kc0"
        return
    kc0 = question.kc
    _try(found, "two-step", lambda: step.two_step_model(seen, kc0))
    if "two-step" in found.models:
        direct = step.direct_settings(seen, kc0)
        found.offers[OVERSHOOT_RULE] = TuneResult.on(direct, found.model or found.models["two-step"])


def _read_relay(found: ExperimentFindings, window: Window, question: ExperimentQuestion) -> None:
    try:
        cycle = relay_cycle(window, question.hysteresis)
    except ValueError as refusal:
        found.refused["ku-pu"] = found.refused["asymmetric"] = str(refusal)
        return
    found.cycle = cycle
    found.measured["ultimate"] = cycle.to_dict()
    pv_rest, co_rest = question.rest or (float(window.pv[0]), float(window.co[0]))
    _try(found, "asymmetric", lambda: relay.first_order(cycle, pv_rest, co_rest))
    _offer_ultimate(found, cycle.ku * cycle.direction, cycle.pu_s)


def _read_swing(found: ExperimentFindings, window: Window, question: ExperimentQuestion) -> None:
    try:
        seen = swing(window)
    except ValueError as refusal:
        found.refused["swing"] = found.reason = str(refusal)
        return
    found.measured["swing"] = seen.to_dict()
    found.reason = seen.verdict()
    if question.kc is None:
        found.reason += "; give the gain of the experiment with --kc for settings"
    elif seen.sustained:
        _offer_ultimate(found, question.kc, seen.period_s)
    elif seen.quarter_decay:
        found.offers["quarter-decay pid"] = tune(rule="quarter-decay", kq=question.kc, pq=seen.period_s)


def _offer_ultimate(found: ExperimentFindings, ku: float, pu_s: float) -> None:
    """The rules of the ultimate gain; ku has the sign of the process."""
    found.ultimate = ku, pu_s
    for rule, kind in ULTIMATE_RULES:
        found.offers[f"{rule} {kind}"] = tune(found.model, rule, kind=kind, ku=ku, pu=pu_s)


def _asked_for(found: ExperimentFindings, question: ExperimentQuestion) -> tuple[str, TuneResult | None]:
    """Name and settings by the method and rule asked for; None where the record does not carry them."""
    rule, kind = question.rule, question.controller
    if rule == OVERSHOOT_RULE or (question.kind == ULTIMATE and found.ultimate is None):
        name = OVERSHOOT_RULE if rule == OVERSHOOT_RULE else "quarter-decay pid"
        found.reason = found.reason or found.refused.get("two-step", "")
        return name, found.offers.get(name)
    if question.kind == ULTIMATE and rule == "simc":
        rule = "zn-ultimate"
    if rule_named(rule).takes == Takes.ULTIMATE and found.ultimate is not None:
        chosen = tune(found.model, rule, kind=kind, ku=found.ultimate[0], pu=found.ultimate[1])
        return f"{rule} {chosen.kind}", chosen
    model = found.models.get(question.method)
    if model is None:
        found.reason = found.refused.get(question.method, "")
        return rule, None
    name = f"{rule} from {question.method}"
    if question.method == FIT and rule == "simc" and kind in {None, "pi"} and found.fit is not None:
        return name, found.fit.aim or found.fit.settings
    return name, tune(model, rule, kind=kind)


# An experiment's findings in lines for a person.


def headline(found: ExperimentFindings) -> str:
    """The result in a line."""
    if found.model is not None:
        return f"{model_text(found.model)} (fit)"
    if found.ultimate is not None:
        return f"Ku {found.ultimate[0]:.4g}, Pu {found.ultimate[1]:.4g} s"
    return found.reason or found.refused.get(FIT, "")


def model_text(model: ProcessModel) -> str:
    """A model in a line; times that its structure does not have are left out."""
    shown = "".join(f"  {name} {time:.4g} s" for name, time in model.times_s.items())
    shown += f"  zeta {model.zeta:.2g}" if model.zeta < 1 else ""
    return f"{model.type}  k {model.k:.4g}{shown}  theta {model.theta_s:.4g} s"


TITLES = {"ultimate": "limit cycle", "swing": "oscillation"}
LABELS = {
    "ku": "Ku",
    "pu": "Pu [s]",
    "ku_std": "std of Ku",
    "pu_std": "std of Pu [s]",
    "waves": "full waves",
    "amplitude": "amplitude of pv",
    "co_amplitude": "amplitude of co",
    "high": "time at the upper level [s]",
    "low": "time at the lower level [s]",
    "gain": "gain at Pu",
    "phase_deg": "phase at Pu [deg]",
    "period": "period [s]",
    "period_std": "std of the period [s]",
    "decay": "decay ratio",
    "quarter_decay": "quarter decay",
}
"""Readings of a test in words; what is not here has the name of its method's paper."""


def described(found: ExperimentFindings, *, settings: bool = True) -> list[str]:
    """Models by method, readings, and settings (unless they are not wanted) in lines."""
    width = max((len(name) for name in (*found.models, *found.refused)), default=0)
    lines = [f"{name:<{width}}  {model_text(model)}" for name, model in found.models.items()]
    lines += [f"{name:<{width}}  - {reason}" for name, reason in found.refused.items()]
    if FIT in found.models and found.fit is not None:
        std = ", ".join(f"{name} {value:.2g}" for name, value in found.fit.estimate.log.std().items())
        lines.append(f"{'':<{width}}  {found.fit.estimate.reason}; standard deviations: {std}")
    for name, values in found.measured.items():
        told = list[str]()
        for key, value in values.items():
            shown = ("yes" if value else "no") if isinstance(value, bool) else f"{value:.4g}"
            told.append(f"{LABELS.get(key, key)} {shown}")
        lines.append(f"{TITLES.get(name, name)}: {', '.join(told)}")
    if not settings:
        return lines
    if found.chosen is None:
        return [*lines, f"no settings: {found.reason}"]
    for name, offer in found.offers.items():
        head = "settings" if offer is found.chosen else "for comparison"
        lines += [f"{head}, {name}:", *(f"  {line}" for line in tuning_lines(offer))]
    return lines


def valve_described(found: ValveReading) -> list[str]:
    """What a valve test says, in lines."""
    lines = [f"SOUND ({_odds(found.sound)}): the valve follows steps of {found.step:.3g}"]
    if found.sound < 1.0 - LIKELY:
        lines = ["THE VALVE DOES NOT FOLLOW: see its positioner, packing and linkage"]
    elif found.sound < LIKELY:
        lines = [f"OPEN (sound {_odds(found.sound)}): repeat it with larger steps, or hold them longer"]
    for name, value, ends, odds in (
        ("dead band", found.dead_band, found.dead_band_range, found.dead_band_odds),
        ("resolution", found.resolution, found.resolution_range, found.resolution_odds),
    ):
        least = f"below {found.step:.3g}, the step of the test" if name == "resolution" else "none"
        seen = f"{value:.3g} of co ({ends[0]:.3g} to {ends[1]:.3g})" if odds > 1.0 - LIKELY else least
        lines.append(f"  {name:<11}{seen}; {_odds(odds)} that there is one")
    if found.stroke_s is not None:
        lines.append(f"  {'stroke':<11}at most {found.stroke_s:.3g} s for the whole range")
    return lines


def _odds(p: float) -> str:
    return "over 99 %" if p > 0.99 else "under 1 %" if p < 0.01 else f"{p:.0%}".replace("%", " %")
