"""An experiment's findings in lines for a person."""

from retuner.adaptive.process import ProcessModel
from retuner.commands.tune import described as tuning_lines
from retuner.experiment.findings import FIT, Findings


def headline(found: Findings) -> str:
    """The result in a line."""
    if found.model is not None:
        return f"{model_text(found.model)} (fit)"
    if found.ultimate is not None:
        return f"Ku {found.ultimate[0]:.4g}, Pu {found.ultimate[1]:.4g} s"
    return found.reason or found.refused.get(FIT, "")


def model_text(model: ProcessModel) -> str:
    """A model in a line; times that its structure does not have are left out."""
    times = (("tau1", model.tau1_s), ("tau2", model.tau2_s))
    shown = "".join(f"  {name} {value:.4g} s" for name, value in times if value)
    return f"{model.type}  k {model.k:.4g}{shown}  theta {model.theta_s:.4g} s"


def described(found: Findings, *, settings: bool = True) -> list[str]:
    """Models by method, readings, and settings (unless they are not wanted) in lines."""
    width = max((len(name) for name in (*found.models, *found.refused)), default=0)
    lines = [f"{name:<{width}}  {model_text(model)}" for name, model in found.models.items()]
    lines += [f"{name:<{width}}  - {reason}" for name, reason in found.refused.items()]
    if FIT in found.models and found.fit is not None:
        std = ", ".join(f"{name} {value:.2g}" for name, value in found.fit.estimate.log.std().items())
        lines.append(f"{'':<{width}}  {found.fit.estimate.reason}; standard deviations: {std}")
    for name, values in found.measured.items():
        text = ", ".join(f"{k} {v:.4g}" if isinstance(v, float) else f"{k} {v}" for k, v in values.items())
        lines.append(f"{name}: {text}")
    if not settings:
        return lines
    if found.chosen is None:
        return [*lines, f"no settings: {found.reason}"]
    for name, offer in found.offers.items():
        head = "settings" if offer is found.chosen else "beside them"
        lines += [f"{head}, {name}:", *(f"  {line}" for line in tuning_lines(offer))]
    return lines
