"""The process in which a model of somebody else runs: started by plant_process.py, ends when its pipe does."""

import json
import pickle
import signal
import struct
import sys
import traceback
from multiprocessing.connection import Connection
from pathlib import Path
from typing import TYPE_CHECKING

from retuner.drivers.plants.model import ModelSpec, PlantFaultError
from retuner.drivers.plants.plant_process import FLOATS, TROUBLE, on_pipe

if TYPE_CHECKING:
    from retuner.drivers.plants.fmu_model import FmuModel
    from retuner.drivers.plants.python_model import PythonModel


def main(handle: int) -> None:
    """Make the model, then answer steps until the pipe ends."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is the device's to answer
    pipe = on_pipe(handle)
    sys.path.append(str(Path.cwd()))  # behind everything: a folder of the user's must not stand before a package
    spec = pickle.loads(pipe.recv_bytes())  # noqa: S301  from this program's own other half
    model = None
    try:
        model = _made(spec)
        told = {"readings": [*map(float, model.readings)], "described": model.described()}
        pipe.send_bytes(FLOATS + json.dumps(told).encode())
        _answer(pipe, model, len(spec.inputs) or 1)
    except (EOFError, BrokenPipeError, ConnectionResetError):
        pass
    except Exception as error:  # noqa: BLE001  whatever it is, the bench tells it in a line
        key = error.key if isinstance(error, PlantFaultError) else ()
        told = {"message": _in_a_line(error), "key": key}
        pipe.send_bytes(TROUBLE + json.dumps(told).encode())
    finally:
        if model is not None:
            model.close()


def _made(spec: ModelSpec) -> "PythonModel | FmuModel":
    if spec.kind == "fmu":
        from retuner.drivers.plants.fmu_model import FmuModel  # noqa: PLC0415  an extra

        return FmuModel(spec)
    from retuner.drivers.plants.python_model import PythonModel  # noqa: PLC0415

    return PythonModel(spec)


def _answer(pipe: Connection, model: "PythonModel | FmuModel", count: int) -> None:
    """Step by step, for as long as somebody asks."""
    question = struct.Struct(f"<{count + 1}d")
    while True:
        *inputs, dt_s = question.unpack(pipe.recv_bytes())
        readings = model.step(inputs, dt_s)
        pipe.send_bytes(FLOATS + struct.pack(f"<{len(readings)}d", *readings))


def _in_a_line(error: Exception) -> str:
    """What went wrong, and where in the user's file."""
    if isinstance(error, PlantFaultError):
        return str(error)
    last = traceback.extract_tb(error.__traceback__)[-1]
    return f"{type(error).__name__}: {error} (line {last.lineno} of {last.filename})"


if __name__ == "__main__":
    main(int(sys.argv[1]))
