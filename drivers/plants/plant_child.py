"""The process in which a model of somebody else runs: started by plant_process.py, ends when its pipe does."""

import contextlib
import json
import os
import pickle
import signal
import struct
import sys
import traceback
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

from retuner.drivers.plants.foreign_model import ModelSpec, PlantFaultError, PlantModel
from retuner.drivers.plants.plant_process import FLOATS, TROUBLE


def main(handle: int) -> None:
    """Make the model, then answer steps until the pipe ends."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is the device's to answer
    pipe = Connection(os.dup(handle))
    sys.path.append(str(Path.cwd()))  # behind everything: a folder of the user's must not stand before a package
    spec: ModelSpec = pickle.loads(pipe.recv_bytes())  # noqa: S301  from this program's own other half
    model: Any = None
    try:
        if spec.kind == "fmu":
            from retuner.drivers.plants.fmu_model import FmuModel  # noqa: PLC0415  an extra

            model = FmuModel(spec)
        else:
            from retuner.drivers.plants.python_model import PythonModel  # noqa: PLC0415

            model = PythonModel(spec)
        told = {"readings": [*map(float, model.readings)], "described": model.described()}
        _send(pipe, FLOATS + json.dumps(told).encode())
        _answer(pipe, model, len(spec.inputs) or 1)
    except BaseException as error:  # noqa: BLE001  whatever it is, the bench tells it in a line
        key = error.key if isinstance(error, PlantFaultError) else ()
        _send(pipe, TROUBLE + json.dumps({"message": _in_a_line(error), "key": key}).encode())
    finally:
        if model is not None:
            model.close()
        with contextlib.suppress(OSError):  # the model may have closed what it found open
            pipe.close()


def _answer(pipe: Connection, model: PlantModel, count: int) -> None:
    """Step by step, for as long as somebody asks."""
    question = struct.Struct(f"<{count + 1}d")
    while True:
        try:
            asked = pipe.recv_bytes()
        except (EOFError, OSError):  # nobody asks any more; the model's own errors of this kind are told
            return
        *inputs, dt_s = question.unpack(asked)
        readings = model.step(inputs, dt_s)
        _send(pipe, FLOATS + struct.pack(f"<{len(readings)}d", *readings))


def _send(pipe: Connection, answer: bytes) -> None:
    with contextlib.suppress(OSError):  # nobody is there any more
        pipe.send_bytes(answer)


def _in_a_line(error: BaseException) -> str:
    """What went wrong, and where in the user's file."""
    text = "it cannot be printed"
    with contextlib.suppress(Exception):
        text = str(error)
    if isinstance(error, PlantFaultError):
        return text
    places = [
        f" (line {one.lineno} of {one.filename})"
        for one in traceback.extract_tb(error.__traceback__)
        if "site-packages" not in one.filename and Path(one.filename).parent != Path(__file__).parent
    ]
    return type(error).__name__ + (f": {text}" if text else "") + "".join(places[-1:])


if __name__ == "__main__":
    main(int(sys.argv[1]))
