"""Which node is on a bus, and its sample time, found without a frame to any other device.

Only listening tells nodes: the number that a question needs is another device's command (READ is an ODrive's Estop).
"""

from retuner.drivers.bus.bus import CanLink
from retuner.drivers.clock import Clock
from retuner.drivers.protocol.checksum import sample_crc
from retuner.drivers.protocol.codec import COMMAND_BITS, Codec
from retuner.drivers.protocol.frames import Identity, Page, Read, TelemetryPv, TelemetrySp

LONGEST_S = 10.0
"""Wait for a first sample or an answer; a device with longer samples is named by its number and sample time."""
OTHERS_S = 2.5
"""Wait for further nodes once one is heard."""
LOOK_S, AGAIN_S = 0.05, 1.0
NODES = range(1, 64)


def nodes_heard(link: CanLink, clock: Clock) -> list[int]:
    """Numbers of the devices of this protocol that send samples: both halves, with the checksum of a sample."""
    codecs = {node: Codec(node) for node in NODES}
    first: dict[int, TelemetryPv] = {}
    found: set[int] = set()
    until_s = clock.now_s() + LONGEST_S
    while clock.now_s() < until_s:
        link.wait_until(min(until_s, clock.now_s() + LOOK_S))
        for message in link.receive_all():
            node = message.arbitration_id >> COMMAND_BITS
            frame = codecs[node].decode(message) if node in codecs else None
            if isinstance(frame, TelemetryPv):
                first[node] = frame
            elif isinstance(frame, TelemetrySp) and node in first and frame.crc == sample_crc(node, first[node], frame):
                if not found:
                    until_s = min(until_s, clock.now_s() + OTHERS_S)
                found.add(node)
    return sorted(found)


def sample_time_of(link: CanLink, clock: Clock, node: int) -> float | None:
    """Seconds between a device's samples, as its identity tells; None where it does not answer."""
    codec, until_s, next_s = Codec(node), clock.now_s() + LONGEST_S, clock.now_s()
    while clock.now_s() < until_s:
        if clock.now_s() >= next_s:
            link.send(codec.encode(Read(Page.IDENTITY, 0)))
            next_s += AGAIN_S
        link.wait_until(min(until_s, next_s, clock.now_s() + LOOK_S))
        for message in link.receive_all():
            frame = codec.decode(message)
            if isinstance(frame, Identity):
                return frame.sample_time
    return None
