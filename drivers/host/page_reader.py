"""Read-back: asks for a gain page and puts the answers together, whatever their order.

Every request carries a new token and only answers to the newest request of a page count, so a late or replayed answer
to an older question cannot pass for the present state: the answers repeat the token's low bits, and the CRC of PAGE
covers all of it.
"""

from contextlib import suppress
from typing import NamedTuple

from retuner.drivers.protocol import frames as wire
from retuner.drivers.protocol.checksum import page_crc
from retuner.schedule.gains import PidGains


class ReadBack(NamedTuple):
    """A page as the device has it: its sequence, the gains (None when not all are there or no PID takes them), CRC.

    token is that of the question.
    """

    page: int
    seq: int
    gains: PidGains | None
    crc: int
    token: int = 0

    def fits(self, set_crc_: int) -> bool:
        """Whether the device's CRC is that of this set, in answer to this question."""
        return self.gains is not None and self.crc == page_crc(set_crc_, self.token)


class _Question(NamedTuple):
    token: int
    items: dict[int, wire.PageItem]
    ends: list[wire.PageEnd]


class PageReader:
    """Questions under way, at most one per page.

    first_token : where the tokens begin; hosts, and one host's lives, had better begin at different ones.
    """

    def __init__(self, first_token: int = 0) -> None:
        self._token = first_token
        self._asked: dict[int, _Question] = {}

    def ask(self, page: int) -> wire.Read:
        """The frame that asks for a page; answers to earlier questions about it no longer count."""
        self._token = (self._token + 1) % wire.TOKENS
        self._asked[page] = _Question(self._token, {}, [])
        return wire.Read(page, self._token)

    def overheard(self, read: wire.Read) -> None:
        """A question that another reader has asked: answers to it count from here on."""
        self._asked[read.page] = _Question(read.token, {}, [])

    def take(self, frame: wire.PageItem | wire.PageEnd) -> ReadBack | None:
        """Note an answer; the page once it is whole."""
        question = self._asked.get(frame.page)
        if question is None or frame.token != question.token % wire.PAGE_TAG:
            return None
        items, ends = question.items, question.ends
        if isinstance(frame, wire.PageEnd):
            ends[:] = [frame]
        else:
            items[frame.item] = frame
        if not ends:
            return None
        end = ends[0]
        if end.complete and (len(items) < len(wire.Item) or any(item.seq != end.seq for item in items.values())):
            return None
        del self._asked[end.page]
        gains = None
        if end.complete:
            with suppress(ValueError):
                gains = PidGains(*(items[item].value for item in wire.Item))
        return ReadBack(end.page, end.seq, gains, end.crc, question.token)

    def is_newest(self, challenge: wire.Challenge) -> bool:
        """Whether this answers the newest question for the challenge."""
        question = self._asked.get(wire.Page.CHALLENGE)
        return question is not None and challenge.token == question.token % wire.CHALLENGE_TAG
