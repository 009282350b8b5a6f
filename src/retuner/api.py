"""`retuner.identify`: the process behind a record of arrays, with frozen results that know their JSON."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from retuner.adaptive.estimate import ModelEstimate
from retuner.adaptive.identify import OPEN_LOOP, FitSettings, identify_window
from retuner.adaptive.margins import Margins, margins
from retuner.adaptive.sample import Window
from retuner.schedule.gains import PidGains
from retuner.tuning import TuneResult, tune

Numbers = Sequence[float] | npt.NDArray[np.floating]


@dataclass(frozen=True, slots=True)
class Identification:
    """What a record says of its process, and the settings that follow (None when it does not say enough)."""

    estimate: ModelEstimate
    settings: TuneResult | None
    margins_in_force: Margins | None

    def to_dict(self) -> dict[str, object]:
        """Keys identifiable, model, std, gains, margins, margins_in_force, reason, loads, residual, noise."""
        found = self.settings.to_dict() if self.settings else None
        in_force = self.margins_in_force.to_dict() if self.margins_in_force else None
        return {**self.estimate.to_dict(), "gains": found["gains"] if found else None,
                "form": found["form"] if found else None, "margins": found["margins"] if found else None,
                "margins_in_force": in_force}  # fmt: skip


def identify(
    t: Numbers, sp: Numbers, pv: Numbers, co: Numbers, *, open_loop: bool = False, gains: PidGains | None = None,
) -> Identification:  # fmt: skip
    """Find the process behind a record.

    Parameters
    ----------
    t : time in seconds, increasing. sp, pv : setpoint and process value. co : controller output, held between samples.
        All of shape (n,), n >= 3.
    open_loop : the record is an experiment in manual that begins at rest. gains : the controller in force, for the sign
        of the process and its margins now.

    Raises
    ------
    ValueError
        Shapes differ, a value is not finite, time does not increase, or pv or co never moves.
    """
    window = Window(*(np.asarray(v, dtype=np.float64) for v in (t, sp, pv, co)))
    return identify_record(window, open_loop=open_loop, gains=gains)


def identify_record(window: Window, *, open_loop: bool = False, gains: PidGains | None = None) -> Identification:
    """The same for a record that is a Window already; see identify."""
    fit = OPEN_LOOP if open_loop else FitSettings()
    estimate = identify_window(window, gains.direction if gains else None, settings=fit)
    model = estimate.log.model()
    settings = tune(model) if estimate.identifiable else None
    in_force = margins(model.linear(), gains) if gains and estimate.identifiable else None
    return Identification(estimate, settings, in_force)
