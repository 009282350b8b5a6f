"""A heated nozzle behind a CANopen temperature controller, to practise on: zone.eds describes it, in whole numbers.

    python examples/nodes/zone_node.py -i udp_multicast -c ff15::7265:7475:9
    python examples/nodes/zone_node.py -i socketcan -c vcan0 --node 9

Object dictionary, SDO server and NMT are those of the package `canopen`; nothing of retuner's is in it. It measures and
controls twice a second. Its gains at power-on are wrong: the temperature creeps.
"""

import argparse
import contextlib
import random
import time
from collections import deque
from pathlib import Path

import can
import canopen

SAMPLE_S, SPAN = 0.5, 400.0  # s, degC
GAIN, LAG_S, SENSOR_S, DELAY = 2.5, 20.0, 1.5, 6  # degC per %, s, s, samples
AMBIENT, NOISE = 50.0, 0.1  # degC


class Zone:
    """Heater, sensor and the controller between them; what stands on it, in its own numbers."""

    def __init__(self) -> None:
        self.band, self.integral, self.derivative = 250, 80, 0  # 0.1 % of span, s, 0.1 s
        self.wanted = self.inner = self.seen = self.before = 150.0
        self.power = self.sum = (self.wanted - AMBIENT) / GAIN
        self.pipe = deque([self.power] * DELAY)
        self.random = random.Random(9)

    def sample(self) -> None:
        """Half a second passes."""
        self.pipe.append(self.power)
        self.inner += (AMBIENT + GAIN * self.pipe.popleft() - self.inner) * SAMPLE_S / LAG_S
        self.seen += (self.inner - self.seen) * SAMPLE_S / SENSOR_S
        measured = self.seen + self.random.gauss(0.0, NOISE)
        kc = 1000.0 / self.band * 100.0 / SPAN
        error, rate = self.wanted - measured, (measured - self.before) / SAMPLE_S
        wish = kc * (error - self.derivative / 10.0 * rate) + self.sum
        self.power = min(max(wish, 0.0), 100.0)
        if self.integral and wish == self.power:
            self.sum += kc * error * SAMPLE_S / self.integral
        self.before = measured


def main() -> None:
    """Run until Ctrl-C."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("-i", "--interface", default="socketcan")
    parser.add_argument("-c", "--channel", default="vcan0")
    parser.add_argument("--node", type=int, default=9, help="1 to 127 (9)")
    parser.add_argument("--speed", type=float, default=1.0, help="times real time (1)")
    chosen = parser.parse_args()
    zone = Zone()
    network = canopen.Network()
    node = canopen.LocalNode(chosen.node, str(Path(__file__).with_name("zone.eds")))
    numbers = {(0x2110, 1): "band", (0x2110, 2): "integral", (0x2110, 3): "derivative"}
    for (index, sub), name in numbers.items():
        node.sdo[index][sub].raw = getattr(zone, name)
    node.sdo[0x2102].raw = round(10 * zone.wanted)

    def on_write(index: int, subindex: int, od: canopen.objectdictionary.ODVariable, data: bytes) -> None:
        if index == 0x2102:
            zone.wanted = od.decode_raw(data) / 10.0
        elif (index, subindex) in numbers:
            setattr(zone, numbers[index, subindex], od.decode_raw(data))
            print(f"band {zone.band / 10} %, Tn {zone.integral} s, Tv {zone.derivative / 10} s", flush=True)

    node.add_write_callback(on_write)
    with can.Bus(interface=chosen.interface, channel=chosen.channel) as bus:
        network.bus = bus
        node.associate_network(network)
        node.nmt.send_command(0)
        node.tpdo.read(from_od=True)
        due, beats = time.monotonic(), 0
        while True:
            message = bus.recv(max(due - time.monotonic(), 0.0))
            if message is not None and not (message.is_extended_id or message.is_remote_frame):
                network.notify(message.arbitration_id, message.data, message.timestamp)
            if time.monotonic() >= due:
                zone.sample()
                due += SAMPLE_S / chosen.speed
                beats += 1
                if beats % 5 == 0:
                    network.send_message(0x700 + chosen.node, bytes([5 if node.nmt.state == "OPERATIONAL" else 127]))
                if node.nmt.state == "OPERATIONAL":
                    node.tpdo[1]["Actual temperature"].raw = round(10 * zone.before)
                    node.tpdo[1]["Heating power"].raw = round(100 * zone.power)
                    node.tpdo[1].transmit()


if __name__ == "__main__":
    with contextlib.suppress(KeyboardInterrupt):
        main()
