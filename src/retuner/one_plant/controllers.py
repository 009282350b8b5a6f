"""Controllers of a program whose loops are on one plant."""

from retuner.decisions.decider import DecideHere
from retuner.one_plant.change_among_loops import DecideAmong, OnePlant
from retuner.pid_controller import PidController


def on_one_plant(*controllers: PidController) -> None:
    """Have the loops of one plant retuned with regard to each other.

    A loop is not judged by what another's setpoint move does to it, and gets no gains that the others do not survive,
    as far as their moves have shown the plant.

    controllers : two or more, stepped in turn, each once a sample time, with the same clock.

    Raises ValueError: there are fewer than two, or one makes its decisions in the background.

    Examples
    --------
    >>> from retuner import PidController, PidGains
    >>> first, second = (PidController(PidGains(1.0, 0.1), dt_s=1.0, pv_range=(0, 100), name=n) for n in ("a", "b"))
    >>> on_one_plant(first, second)
    """
    if len(controllers) < 2:
        raise ValueError("give two controllers or more: one loop has its plant to itself")
    plant = OnePlant([one.retuner for one in controllers])
    for i, one in enumerate(controllers):
        one.decide_by(DecideAmong(DecideHere(), plant, i))
