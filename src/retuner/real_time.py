"""--speed: simulated time, or how much faster than real time the far side of a bus runs."""

from retuner.errors import UserError


def real_time_speed(text: str, *, simulated: bool) -> float:
    """--speed as a number: "max" is simulated time; a number is how much faster than real time the far side runs.

    Raises
    ------
    UserError
        Neither "max" nor a positive number, or "max" for a bus that leaves this process.
    """
    if text == "max":
        return 1.0
    try:
        speed = float(text)
    except ValueError:
        speed = 0.0
    if not 0 < speed < float("inf"):
        raise UserError(f"--speed {text}: give max, or a positive number (1 is real time)")
    if simulated:
        raise UserError("--speed: the virtual bus runs in simulated time as fast as it goes; leave the option out, or "
                        "give --interface of a bus on which `retuner device` runs")  # fmt: skip
    return speed
