"""The whole examination, in its order: chapter of docs/developers/protocol.md and what is tried of it."""

from retuner.drivers.bus.bus import CanLink
from retuner.drivers.clock import Clock
from retuner.drivers.conformance import frame_checks, set_checks
from retuner.drivers.conformance.examination import Check
from retuner.drivers.protocol.checksum import sample_crc
from retuner.drivers.protocol.codec import COMMAND_BITS, Codec
from retuner.drivers.protocol.frames import Identity, Page, Read, TelemetryPv, TelemetrySp

CHAPTERS: tuple[tuple[str, Check], ...] = (
    ("Connecting", frame_checks.connecting), ("Frames", frame_checks.frames),
    ("Who may command: the lease", frame_checks.leases), ("Changing gains", set_checks.staging),
    ("Changing gains", set_checks.committing), ("Changing gains", set_checks.swapping),
    ("Changing gains", set_checks.refusing), ("Changing gains", set_checks.fencing),
    ("Changing gains", set_checks.busy), ("Trial", set_checks.trial),
    ("Storing and restarting", set_checks.storing), ("Authentication of commits", set_checks.codes),
    ("Setpoint, mode, load", frame_checks.commands), ("Samples", frame_checks.samples),
    ("Who may command: the lease", frame_checks.stamps), ("Storing and restarting", set_checks.restarting),
)  # fmt: skip


def chapters(trial_samples: int = 0) -> tuple[tuple[str, Check], ...]:
    """All chapters; with trial_samples also what happens when a set is not confirmed in so many samples."""
    return (*CHAPTERS, ("Trial", set_checks.reverting(trial_samples))) if trial_samples else CHAPTERS


# Which node is on a bus, and its sample time, found without a frame to any other device.
#
# Only listening tells nodes: the number that a question needs is another device's command (READ is an ODrive's
# Estop).


LONGEST_S = 10.0
"""Wait for a first sample or an answer; a device with longer samples is named by its number and sample time."""
OTHERS_S = 2.5  # wait for further nodes once one is heard
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
