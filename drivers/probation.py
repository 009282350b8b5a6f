"""When a set that was written may be confirmed: after so many samples have shown it running and the link sound."""


class Probation:
    """The set that waits to be confirmed by this host.

    Parameters
    ----------
    samples : samples to be seen with the set before it is confirmed.
    """

    def __init__(self, samples: int) -> None:
        self._samples = samples
        self._left = 0
        self.seq: int | None = None

    def begin(self, seq: int) -> None:
        """Set seq has been written by this host and read back."""
        self.seq, self._left = seq, self._samples

    def end(self) -> None:
        """It is confirmed, or runs no more."""
        self.seq = None

    def again(self) -> None:
        """The confirmation was not answered, or refused: watch on, then confirm once more."""
        self._left = self._samples

    def sample(self, revision: int) -> int | None:
        """A sample under set revision has arrived; the set to confirm now, if any."""
        if self.seq is None or revision != self.seq or self._left < 0:
            return None
        self._left -= 1
        return self.seq if self._left < 0 else None
