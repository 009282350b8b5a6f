"""A model of somebody else in a process of its own, so that what it does to itself it does to itself alone.

A crash in a compiled FMU, an endless loop, a leak: the virtual controller goes on. Time is the trap: simulated time
stands still while a step is worked out, so only the machine's clock can tell that a model hangs.

    in simulated time   a step is waited for as long as `patience_s` of the machine's time; then the process is killed
    in real time        it is waited for `wait_s`, a few samples; then the controller goes on without a reading, and at
                        each later sample it is looked whether the answer has come (that one is taken then, so the
                        plant is behind by what it missed); after `patience_s` the process is killed here too
"""

import json
import pickle
import signal
import socket
import struct
import subprocess
import sys
from collections.abc import Sequence
from multiprocessing.connection import Connection

from retuner.drivers.clock import Clock, MonotonicClock
from retuner.drivers.plants.foreign_model import ModelSpec, PlantFaultError, StillBusyError

ENDS_S = 2.0  # how long a process is given to end by itself when it is no longer needed
FLOATS, TROUBLE = b"n", b"t"  # what an answer begins with: numbers, or why there are none


class ModelInProcess:
    """A model behind two pipes: see model.PlantModel.

    spec : which. patience_s : of the machine's time for a step, and for the beginning. wait_s : how long a step is
    waited for before the controller goes on without it; None: as long as patience_s. clock : of the machine.

    Raises PlantFaultError: it cannot be begun.
    """

    def __init__(
        self, spec: ModelSpec, patience_s: float, wait_s: float | None = None, clock: Clock | None = None
    ) -> None:
        self._patience_s, self._clock = patience_s, clock or MonotonicClock()
        self._wait_s = patience_s if wait_s is None else min(wait_s, patience_s)
        self._asked_s: float | None = None
        ours, theirs = socket.socketpair()
        with theirs:
            self._process = subprocess.Popen(  # noqa: S603  this program's own other half
                [sys.executable, "-P", "-m", "retuner.drivers.plants.plant_child", str(theirs.fileno())],
                pass_fds=[theirs.fileno()],
                stdin=subprocess.DEVNULL,
                stdout=2,  # what the model prints is for people: it must not get into a command's answer
            )
        self._pipe = Connection(ours.detach())
        self._pipe.send_bytes(pickle.dumps(spec))
        try:
            told = json.loads(self._answer(self._patience_s))
        except StillBusyError:
            self._end()
            raise PlantFaultError(f"is not ready after {self._patience_s:g} s (patience_s)", "patience_s") from None
        except PlantFaultError:
            self.close()
            raise
        self.readings: Sequence[float] = told["readings"]
        self.described: Sequence[str] = told["described"]

    def step(self, inputs: Sequence[float], dt_s: float) -> Sequence[float]:
        """See model.PlantModel."""
        waited_s = 0.0
        if self._asked_s is None:
            self._asked_s = self._clock.now_s()
            try:
                self._pipe.send_bytes(struct.pack(f"<{len(inputs) + 1}d", *inputs, dt_s))
            except OSError:
                raise PlantFaultError(self._how_it_ended()) from None
            waited_s = self._wait_s
        try:
            body = self._answer(waited_s)
        except StillBusyError:
            if self._clock.now_s() - self._asked_s >= self._patience_s:
                self._end()
                raise PlantFaultError(
                    f"no answer to a step within {self._patience_s:g} s of the machine's time (patience_s)"
                ) from None
            raise
        self._asked_s = None
        return struct.unpack(f"<{len(body) // 8}d", body)

    def close(self) -> None:
        """End the process: at first by closing its pipe, for a model may have something to put away."""
        self._pipe.close()
        try:
            self._process.wait(ENDS_S if self._asked_s is None else 0.0)
        except subprocess.TimeoutExpired:
            self._end()

    def _answer(self, within_s: float) -> bytes:
        try:
            if not self._pipe.poll(within_s):
                raise StillBusyError("does not answer")
            whole = self._pipe.recv_bytes()
        except (EOFError, OSError):
            raise PlantFaultError(self._how_it_ended()) from None
        kind, body = whole[:1], whole[1:]
        if kind == TROUBLE:
            told = json.loads(body)
            raise PlantFaultError(told["message"], *told["key"])
        return body

    def _how_it_ended(self) -> str:
        try:
            code = self._process.wait(ENDS_S)
        except subprocess.TimeoutExpired:
            self._end()
            return "its process closed its pipe"
        if code >= 0:
            return f"its process ended with status {code}"
        return f"its process was killed by {signal.Signals(-code).name}"

    def _end(self) -> None:
        self._process.kill()
        self._process.wait()
