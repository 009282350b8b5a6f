"""Picture of developers/plants-of-others.md: a session in the temperature lab, and the same under its first gains."""

from pathlib import Path

from plants_of_others import session
from plants_of_others.loop import Action, Controlled
from plants_of_others.temperature_lab import TemperatureLab
from plants_of_others.truth import StepTest, truth

HOUR_S = 3600.0
NAME = "plants-of-others.png"


def draw(folder: Path, seed: int, start: str, loop: str = "T1") -> Path:
    """Setpoint, temperature and heater with retuner and without; the changes as lines."""
    import matplotlib as mpl

    mpl.use("Agg")
    from matplotlib import pyplot as plt

    lab = TemperatureLab()
    card = lab.cards[loop]
    first = session.begins_with(card, truth(lab, card, StepTest(2400.0, 1500.0)), start)
    runs = [_run(lab, loop, seed, Controlled(card, first, lab.rest(loop), watched=on)) for on in (False, True)]
    figure, (upper, lower) = plt.subplots(2, 1, sharex=True, figsize=(10, 5.5), layout="constrained")
    hours = [i * card.dt_s / HOUR_S for i in range(len(runs[0].track.pv))]
    upper.plot(hours, runs[0].track.sp, "k--", lw=0.8, label="setpoint")
    for run, colour, name in zip(runs, ("tab:orange", "tab:blue"), ("gains as they were", "retuner"), strict=True):
        upper.plot(hours, run.track.pv, colour, lw=0.8, label=name)
        lower.plot(hours, run.track.co, colour, lw=0.6)
    for made in runs[1].writes:
        for axes in (upper, lower):
            axes.axvline(made.t_s / HOUR_S, color="tab:red" if made.action is Action.WRITE else "tab:purple", lw=1)
    upper.set_ylabel("temperature, °C")
    upper.legend(loc="lower right")
    lower.set_ylabel("heater, %")
    lower.set_xlabel("hours; red: gains changed")
    figure.savefig(folder / NAME, dpi=80)
    return folder / NAME


def _run(lab: TemperatureLab, loop: str, seed: int, control: Controlled) -> Controlled:
    lab.session({loop: control}, loop, seed)
    return control
