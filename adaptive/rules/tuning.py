"""The result of a tuning rule: settings in the rule's own form, and the same in parallel form."""

from dataclasses import dataclass

from retuner.schedule.forms import from_form, in_form
from retuner.schedule.gains import PidGains


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

        Raises
        ------
        ValueError
            The gains do not exist in the form asked for.
        """
        shown = form or self.form
        return {
            "rule": self.rule,
            "form": shown,
            "gains": in_form(self.gains, shown),
            "parallel": {"kp": self.gains.kp, "ki": self.gains.ki, "kd": self.gains.kd},
            "tau_c": self.tau_c_s,
        }


def tuning(rule: str, form: str, kc: float, tau_i_s: float | None, tau_d_s: float, tau_c_s: float | None) -> Tuning:
    """Settings given in a rule's native form.

    Raises
    ------
    ValueError
        The rule's numbers make no controller (a gain of 0, a time that is not positive, an overflow).
    """
    return Tuning(rule, form, from_form(form, kc, tau_i_s, tau_d_s), tau_c_s)
