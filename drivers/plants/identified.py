"""The plant of a record: the process that was identified from it, under the load that the record was under.

    d(t) = pv(t) - pv(0) - G (co(t) - co(0))        what the model leaves of pv, noise included: the load at the output

Another load of the same spectrum has the same amplitudes and other phases (J. Theiler et al., Physica D 58, 1992, 77,
section 2.4.1), once the straight line from d's first to its last value is taken off, which would be a jump where the
series begins again.
"""

import json
import math
from pathlib import Path

import numpy as np

from retuner.adaptive.process.model import LinearProcess, ProcessModel
from retuner.adaptive.signals.sample import FloatArray
from retuner.drivers.plants.foreign_model import PlantFaultError
from retuner.drivers.plants.linear_plant import LinearPlant
from retuner.drivers.plants.recorded_load import RecordedLoad

KEYS = {"tau1": "tau1_s", "tau2": "tau2_s", "tau3": "tau3_s", "theta": "theta_s", "inverse": "inverse_s"}
LEAST_ROWS = 8


def model_of(path: Path) -> LinearProcess:
    """The model in what `retuner identify --json` prints.

    Raises PlantFaultError: there is no such file, or no model in it.
    """
    try:
        document = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise PlantFaultError(f'= "{path}" cannot be read: {error}', "file") from None
    found = document.get("model") if isinstance(document, dict) else None
    if not isinstance(found, dict):
        raise PlantFaultError(f'= "{path}" holds no model; make it by retuner identify RECORD --json', "file")
    try:
        return ProcessModel(**{KEYS.get(str(name), str(name)): value for name, value in found.items()}).linear()
    except (TypeError, ValueError) as error:
        raise PlantFaultError(f'= "{path}": {error}', "file") from None


def load_of(process: LinearProcess, t_s: FloatArray, pv: FloatArray, co: FloatArray) -> RecordedLoad:
    """What the record's load did at the output. The record is taken on its own even grid.

    Raises PlantFaultError: it is too short.
    """
    dt_s = float(np.median(np.diff(t_s))) if len(t_s) > 1 else math.nan
    if len(t_s) < LEAST_ROWS or not dt_s > 0:
        raise PlantFaultError(f"has {len(t_s)} rows, too few to separate its load", "record")
    even_s = np.arange(0.0, float(t_s[-1] - t_s[0]) + dt_s / 2, dt_s)
    pv, co = (np.interp(even_s, t_s - t_s[0], column) for column in (pv, co))
    plant = LinearPlant(process, start_co=float(co[0]), co_min=-math.inf, co_max=math.inf)
    modelled = np.array([0.0, *(plant.step(float(held), 0.0, dt_s) for held in co[:-1])])
    return RecordedLoad(even_s, pv - pv[0] - modelled, at_output=True)


def alike(load: RecordedLoad, seed: int) -> RecordedLoad:
    """Another load of the same spectrum, which begins again after the record's length."""
    values = load.values - np.linspace(load.values[0], load.values[-1], len(load.values))
    spectrum = np.fft.rfft(values)
    phases = np.exp(2j * math.pi * np.random.default_rng(seed).random(len(spectrum)))
    phases[0] = 1.0
    if len(values) % 2 == 0:
        phases[-1] = 1.0  # the highest frequency of an even number is real
    drawn: FloatArray = np.fft.irfft(spectrum * phases, len(values))
    return RecordedLoad(load.t_s, drawn, at_output=True, repeat=True)
