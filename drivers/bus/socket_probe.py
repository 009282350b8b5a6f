"""What a bus's socket knows and python-can does not tell: frames lost in its queue, and whether it is still bound.

The kernel counts what it drops because the receive queue is full, and says nothing: 278 classic frames fill the usual
queue, 62 ms of a full 500 kbit/s bus. SO_MEMINFO reads the same counter that SO_RXQ_OVFL would attach to frames, for
CAN and UDP alike. A SocketCAN socket whose interface was removed is bound to nothing and hears nothing for ever, also
when an interface of the same name is made anew; the name that it is bound to tells.
"""

import contextlib
import os
import socket
import struct
import sys

SO_RCVBUFFORCE = 33  # linux/asm-generic/socket.h; beyond rmem_max, for who may
SO_MEMINFO = 55  # linux, since 4.12
DROPS = 8  # SK_MEMINFO_DROPS, place of the count among the 32-bit numbers
QUEUE_BYTES = 1 << 23
"""Receive queue that is asked for: about 10,000 frames, over a second of a full 1 Mbit/s bus. Unprivileged processes
get what net.core.rmem_max allows."""
WRAP = 1 << 32


class SocketProbe:
    """A second handle on a bus's socket; where there is no socket, or the system lacks the counter, it knows nothing.

    Parameters
    ----------
    fileno : of the socket, -1 without one.
    bound_to : interface that the socket must stay bound to, empty when that has no meaning.
    """

    def __init__(self, fileno: int, bound_to: str = "") -> None:
        self._bound_to = bound_to
        self._socket: socket.socket | None = None
        self._counted = 0
        if fileno < 0 or sys.platform != "linux":
            return
        with contextlib.suppress(OSError):
            self._socket = socket.socket(fileno=os.dup(fileno))
            assert self._socket is not None
            try:
                self._socket.setsockopt(socket.SOL_SOCKET, SO_RCVBUFFORCE, QUEUE_BYTES)
            except OSError:
                self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, QUEUE_BYTES)
            self._counted = self._count()

    def drops(self) -> int:
        """Frames that the kernel has dropped since the last call."""
        before, self._counted = self._counted, self._count()
        return (self._counted - before) % WRAP

    def is_unbound(self) -> bool:
        """Whether the interface went away under the socket."""
        if self._socket is None or not self._bound_to:
            return False
        try:
            name: str | tuple[str, ...] = self._socket.getsockname()
        except OSError:
            return True
        return self._bound_to not in (name, name[0])

    def close(self) -> None:
        """Let go of the socket; more than once does no harm."""
        if self._socket is not None:
            self._socket.close()
            self._socket = None

    def _count(self) -> int:
        """The kernel's count of dropped frames; where there is none, what was counted so far."""
        if self._socket is None:
            return self._counted
        try:
            raw = self._socket.getsockopt(socket.SOL_SOCKET, SO_MEMINFO, 4 * (DROPS + 1))
        except OSError:
            return self._counted
        return int(struct.unpack_from("=I", raw, 4 * DROPS)[0]) if len(raw) >= 4 * (DROPS + 1) else self._counted
