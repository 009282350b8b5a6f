"""The worker: a process of low priority that answers questions from its standard input on its standard output.

Started by worker.py as `python -m`, so that it shares nothing with the loop but two pipes: what it does to
itself (a crash in a compiled fit, no memory left) it does to itself alone. It ends when its input does.
"""

import contextlib
import gc
import os
import pickle
import signal
import struct
import sys
from pathlib import Path
from typing import IO

LENGTH = struct.Struct("<Q")  # length in bytes that stands before each message
WARM = "warm"  # the first message to the loop: all that a decision needs is imported
MOST_EXPENDABLE = "1000"  # what the kernel is told when memory runs out: end this process first, not the loop's


def send(pipe: IO[bytes], message: object) -> None:
    """Put a message on a pipe. Raises OSError: the other end is gone."""
    body = pickle.dumps(message, protocol=pickle.HIGHEST_PROTOCOL)
    pipe.write(LENGTH.pack(len(body)) + body)
    pipe.flush()


def receive(pipe: IO[bytes]) -> object:
    """Take the next message from a pipe. Raises EOFError: the other end is gone."""
    head = pipe.read(LENGTH.size)
    if len(head) < LENGTH.size:
        raise EOFError
    (length,) = LENGTH.unpack(head)
    body = pipe.read(length)
    if len(body) < length:
        raise EOFError
    return pickle.loads(body)  # noqa: S301  from this program's own other half, over a pipe that nobody else has


def main(nice: int, memory_bytes: int) -> None:
    """Answer until the input ends: the result, or a sentence on why there is none."""
    # Give way to the loop, and end before it when memory runs out. Ctrl-C is the loop's to answer.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    if hasattr(os, "nice"):
        os.nice(nice)
    if memory_bytes:
        import resource  # noqa: PLC0415  not on every system

        resource.setrlimit(resource.RLIMIT_DATA, (memory_bytes, memory_bytes))
    with contextlib.suppress(OSError):  # only Linux has it
        Path("/proc/self/oom_score_adj").write_text(MOST_EXPENDABLE, encoding="ascii")
    questions, answers = sys.stdin.buffer, sys.stdout.buffer
    sys.stdout = sys.stderr  # nothing else may get among the answers
    from retuner.adaptive.supervision.decide import decide  # noqa: PLC0415  a second of imports, at low priority
    from retuner.adaptive.supervision.question import Question  # noqa: PLC0415
    from retuner.decisions.warm_up import warm_up  # noqa: PLC0415

    with contextlib.suppress(MemoryError):
        warm_up()
    with contextlib.suppress(OSError):
        send(answers, WARM)
    while True:
        try:
            question = receive(questions)
            assert isinstance(question, Question)
        except EOFError:
            return
        try:
            answer: object = decide(question)
        except MemoryError:
            gc.collect()
            answer = "the worker ran out of memory"
        except Exception as error:  # noqa: BLE001  whatever it is, the loop is told and goes on
            answer = f"it failed: {type(error).__name__}: {error}"
        try:
            send(answers, answer)
        except OSError:
            return


if __name__ == "__main__":
    main(int(sys.argv[1]), int(sys.argv[2]))
