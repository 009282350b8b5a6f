"""A servo axis that speaks ODrive's CAN Simple 0.5, to practise on. It knows nothing of retuner, nor of a DBC.

    python examples/nodes/axis_node.py -i udp_multicast -c ff15::7265:7475:3
    python examples/nodes/axis_node.py -i socketcan -c vcan0 --node 3

Velocity control every millisecond, torque limited to 2 Nm (20 A at 0.1 Nm/A); a belt passes the torque on 50 ms late.
Its gains at power-on are wrong: it rings. Needs python-can alone.
"""

import argparse
import contextlib
import random
import struct
import time
from collections import deque

import can

TICK_S, STEP_S = 0.05, 0.001  # between encoder frames; of control and flywheel
INERTIA, FRICTION = 0.0125, 0.025  # kg m^2/rad and Nm s/rad, in turns: Nm per rev/s^2 and per rev/s
TORQUE_MAX, NM_PER_A, BELT_S = 2.0, 0.1, 0.05
NOISE = 0.05  # rev/s, of the encoder
CLOSED_LOOP = 8
HEARTBEAT, ESTIMATES, SET_VELOCITY, GET_IQ, SET_GAINS = 0x01, 0x09, 0x0D, 0x14, 0x1B


class Axis:
    """Gains in Nm per rev/s and Nm per rev, velocities in rev/s."""

    def __init__(self) -> None:
        self.vel_gain, self.integrator_gain = 0.16, 0.64
        self.wanted = self.vel = self.integrator = self.torque = 0.0
        self.belt = deque([0.0] * round(BELT_S / STEP_S))
        self.seen = 0.0
        self.random = random.Random(3)

    def tick(self) -> None:
        """One encoder frame's time."""
        for _ in range(round(TICK_S / STEP_S)):
            error = self.wanted - self.vel
            wish = self.vel_gain * error + self.integrator
            self.torque = min(max(wish, -TORQUE_MAX), TORQUE_MAX)
            if wish == self.torque:
                self.integrator += self.integrator_gain * error * STEP_S
            self.belt.append(self.torque)
            self.vel += (self.belt.popleft() - FRICTION * self.vel) / INERTIA * STEP_S
        self.seen = self.vel + self.random.gauss(0.0, NOISE)

    def take(self, command: int, message: can.Message) -> bytes | None:
        """Obey a frame; what it asks for."""
        if command == GET_IQ and message.is_remote_frame:
            amps = self.torque / NM_PER_A
            return struct.pack("<ff", amps, amps)
        if command == SET_VELOCITY and len(message.data) == 8:
            self.wanted = struct.unpack("<ff", message.data)[0]
        if command == SET_GAINS and len(message.data) == 8:
            self.vel_gain, self.integrator_gain = struct.unpack("<ff", message.data)
            print(f"vel_gain {self.vel_gain:.4g} Nm/(rev/s), integrator {self.integrator_gain:.4g} Nm/rev", flush=True)
        return None


def main() -> None:
    """Run until Ctrl-C."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("-i", "--interface", default="socketcan")
    parser.add_argument("-c", "--channel", default="vcan0")
    parser.add_argument("--node", type=int, default=3, help="0 to 63 (3)")
    parser.add_argument("--speed", type=float, default=1.0, help="times real time (1)")
    chosen = parser.parse_args()
    axis, ticks = Axis(), 0
    with can.Bus(interface=chosen.interface, channel=chosen.channel) as bus:

        def send(command: int, data: bytes) -> None:
            bus.send(can.Message(arbitration_id=chosen.node << 5 | command, is_extended_id=False, data=data))

        due = time.monotonic()
        while True:
            message = bus.recv(max(due - time.monotonic(), 0.0))
            if message is not None and message.arbitration_id >> 5 == chosen.node and not message.is_extended_id:
                answer = axis.take(message.arbitration_id & 31, message)
                if answer is not None:
                    send(message.arbitration_id & 31, answer)
            if time.monotonic() >= due:
                axis.tick()
                ticks += 1
                due += TICK_S / chosen.speed
                if ticks % 2:
                    send(HEARTBEAT, struct.pack("<IB3x", 0, CLOSED_LOOP))
                send(ESTIMATES, struct.pack("<ff", 0.0, axis.seen))


if __name__ == "__main__":
    with contextlib.suppress(KeyboardInterrupt):
        main()
