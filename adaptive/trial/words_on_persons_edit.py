"""What is said of gains that a person has set: what they are by what is known of the process, and for how long."""

from retuner.adaptive.trial.rollback import StillAllowed, models_words, robustness, robustness_words
from retuner.schedule.gains import PidGains

NOT_TAKEN = (
    "someone set gains that this region cannot hold beside its neighbours; they stay active until the next "
    "scheduled write"
)


def require_action(gains: PidGains, commissioned: PidGains) -> None:
    """Refuse gains that turn negative feedback into positive: no table holds them.

    Raises ValueError: they act in the other direction than the commissioned ones.
    """
    if gains.direction != commissioned.direction:
        raise ValueError(
            f"{_set(gains)} acts in the other direction than the configured {_set(commissioned)}: nothing is changed"
        )


def turned_words(ours: PidGains, now: PidGains, *, on_trial: bool) -> str:
    """Gains of the other sign run: what is held, and the two ways out."""
    return (
        f"the active gains have the other sign ({_set(now)}, configured {_set(ours)}), so the loop may drive away"
        "; on hold: nothing is written, no model is updated"
        f"{'; the trial ends, and what runs next is decided again' if on_trial else ''}"
        "; set gains of the configured sign at the controller, or end the session and change the sign in the "
        "configuration"
    )


def right_words(now: PidGains) -> str:
    """Gains of the configured sign run again."""
    return f"the active gains have the configured sign again ({_set(now)}): the hold is over"


def edit_words(ours: PidGains, now: PidGains, known: StillAllowed, hold_s: float, *, on_trial: bool) -> str:
    """A person has set gains where others were in force: recognised, weighed, held."""
    words = f"an operator replaced {_set(ours)} by {_set(now)}"
    words += "; the trial of these gains ended without a verdict" if on_trial else ""
    ms = known.ms(now)
    if ms:
        words += f"; over {models_words(len(ms))}: {robustness_words(*robustness(ms), len(ms))}"
    return f"{words}; held for {lasting_words(hold_s)}, in which changes are proposals for operator approval"


def lasting_words(lasts_s: float) -> str:
    """How long something lasts: hours and days where seconds are hard to read."""
    for unit, length_s in (("d", DAY_S), ("h", HOUR_S)):
        if lasts_s >= 2.0 * length_s:
            return f"{lasts_s / length_s:.3g} {unit}"
    return f"{lasts_s:,.0f} s"


DAY_S, HOUR_S = 86400.0, 3600.0


def _set(gains: PidGains) -> str:
    if not gains.kp:
        return f"ki {gains.ki:.4g}"
    words = [f"Kc {gains.kp:.4g}"]
    words += [f"tau_I {gains.kp / gains.ki:.4g} s"] if gains.ki else []
    words += [f"tau_D {gains.kd / gains.kp:.4g} s"] if gains.kd else []
    return " ".join(words)
