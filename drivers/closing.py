"""What has a `with` block of its own: whatever it holds open is closed at the end, however that comes."""

from abc import abstractmethod
from typing import Self


class Closes:
    """Closed when its block is left."""

    __slots__ = ()

    @abstractmethod
    def close(self) -> object:
        """Let go of all that is held."""

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()
