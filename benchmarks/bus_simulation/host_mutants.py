"""Hosts with one layer of the protocol taken away each: what the invariants over hosts must find.

    python benchmarks/bus_simulation/host_mutants.py NUMBER [SEEDS STEPS]     one of them: the first promise it breaks

Each is a module, and one change of a text in it. A mutant runs in a process of its own, whose import of that module is
changed, beside the firmware in C: what host and virtual device share is then changed at the host alone.
"""

import importlib.util
import subprocess
import sys
from pathlib import Path
from typing import NamedTuple

SEEDS, STEPS = 20, 700  # what CI simulates
HOST = "retuner.drivers.host."


class HostMutant(NamedTuple):
    """One change: old stands in the module exactly once."""

    name: str
    module: str
    old: str
    new: str


HOST_MUTANTS = tuple(
    HostMutant(*texts)
    for texts in (
        # the staged page
        (
            "no read-back compare",
            HOST + "write_protocol",
            "= page.seq == order.seq and page.gains == order.gains and page.fits(order.set_crc)",
            "= True",
        ),
        (
            "the CRC of a staged page is not compared",
            HOST + "write_protocol",
            " and page.gains == order.gains and page.fits(order.set_crc)",
            " and page.gains is not None",
        ),
        (
            "what is staged again is not read back again",
            HOST + "write_protocol",
            "        self._staged_right = False  # what is sent again is read back again\n",
            "",
        ),
        ("no token check", HOST + "page_reader", "frame.token != question.token % wire.PAGE_TAG", "False"),
        ("no CRC of pages", HOST + "page_reader", " and self.crc == page_crc(set_crc_, self.token)", ""),
        (
            "parts of two sets make a page",
            HOST + "page_reader",
            " or any(item.seq != end.seq for item in items.values())",
            "",
        ),
        ("an unfinished page is whole", HOST + "page_reader", "if len(items) < len(wire.Item) or", "if not items or"),
        # the lease
        ("no lease before the stage", HOST + "write_protocol", "and (owned or (asked and self._claims == 0)):", ":"),
        (
            "a lapsed lease is not noticed",
            HOST + "write_protocol",
            "elif not owned and self._unsent(now_s):",
            "elif False:",
        ),
        (
            "the lease never runs out at the host",
            HOST + "lease_and_commands",
            "if self.held and now_s - self._since_s >= self._length_s:",
            "if False:",
        ),
        ("another's lease is taken for ours", HOST + "lease_and_commands", "if ack.seq != self.owner or ", "if "),
        (
            "a refused lease counts as given",
            HOST + "lease_and_commands",
            "before, self.held = self.other, ack.reason == Reason.OK",
            "before, self.held = self.other, True",
        ),
        ("the counter of the lease stands", HOST + "lease_and_commands", "(self._counter + 1)", "(self._counter + 0)"),
        (
            "that the lease is gone is not heard",
            HOST + "can_device",
            "if ack.reason == frames.Reason.NOT_OWNER and self.lease.held:",
            "if False:",
        ),
        (
            "the stamp is of no time",
            HOST + "can_device",
            "stamp = lease_stamp(epoch, sample)\n        due",
            "stamp = lease_stamp(0, sample)\n        due",
        ),
        # the commit
        ("the commit is repeated", HOST + "write_protocol", "P.COMMITTING: 1}", "P.COMMITTING: 3}"),
        (
            "a refused commit is not fenced",
            HOST + "write_protocol",
            "(P.COMMITTING, W.REFUSED): P.FENCING",
            "(P.COMMITTING, W.REFUSED): P.READING",
        ),
        (
            "a lost acknowledge is not fenced",
            HOST + "write_protocol",
            "(P.COMMITTING, W.EXHAUSTED): P.FENCING",
            "(P.COMMITTING, W.EXHAUSTED): P.READING",
        ),
        (
            "gains that were never read back are not fenced",
            HOST + "write_protocol",
            "(P.STAGING, W.EXHAUSTED): P.FENCING",
            "(P.STAGING, W.EXHAUSTED): P.READING",
        ),
        (
            "the commit is not verified",
            HOST + "write_protocol",
            "asked = self.phase is WritePhase.READING and self._tries > 0",
            "asked = self.phase in {WritePhase.COMMITTING, WritePhase.READING}",
        ),
        (
            "an older read-back settles it",
            HOST + "write_protocol",
            "self.phase is WritePhase.READING and self._tries > 0",
            "self.phase is WritePhase.READING",
        ),
        (
            "acknowledged is done",
            HOST + "write_protocol",
            "if running.seq == order.seq and running.gains == order.gains:",
            "if 'it ran' in self._why or running.seq == order.seq:",
        ),
        (
            "an acknowledge of another number is taken",
            HOST + "write_protocol",
            "if self._order is None or ack.seq != self._order.seq:",
            "if self._order is None:",
        ),
        (
            "a number that is used up is staged again",
            HOST + "write_protocol",
            "replace(self._order, seq=seq), False",
            "self._order, False",
        ),
        (
            "the base is not the set that was read",
            HOST + "write_protocol",
            "Commit(self.seq, self.base, commit_crc(self.set_crc, self.base, self.owner))",
            "Commit(self.seq, self.base, commit_crc(self.set_crc, self.seq, self.owner))",
        ),
        # codes
        (
            "any challenge serves",
            HOST + "page_reader",
            "challenge.token == question.token % wire.CHALLENGE_TAG",
            "challenge is not None",
        ),
        (
            "half a code is sent",
            HOST + "write_protocol",
            "return [*code_frames(code, self.seq), commit]",
            "return [code_frames(code, self.seq)[0], commit]",
        ),
        # epochs
        (
            "a stale acknowledge is taken",
            HOST + "can_device",
            "if epoch is None or ack.epoch != epoch % frames.EPOCH_TAG:",
            "if epoch is None:",
        ),
        (
            "an epoch change is ignored",
            HOST + "running_set",
            "        self._candidate = heartbeat\n        return False",
            "        return True",
        ),
        (
            "a read-back of any epoch is believed",
            HOST + "running_set",
            "page.fits(set_crc(self._node, epoch, page.seq, page.gains))",
            "epoch >= 0",
        ),
        (
            "a device that has booted is not asked who it is",
            HOST + "running_set",
            "if self.unidentified:\n                self.running = None",
            "if False:\n                self.running = None",
        ),
        (
            "a restart does not touch the write",
            HOST + "can_device",
            "            self.write.on_restart()\n            self.lease.forget()",
            "            self.lease.forget()",
        ),
        # what is told and kept
        (
            "silence is not noticed",
            "retuner.drivers.device",
            'return f"no frame for {age_s:.3g} s" if age_s > self._silent_s else ""',
            'return ""',
        ),
        (
            "a set is kept that is on probation",
            HOST + "can_device",
            "        if running.seq == self.probation.seq:\n            raise",
            "        if False:\n            raise",
        ),
        (
            "the halves of a sample are not checked",
            "retuner.drivers.telemetry.sample_assembly",
            "        if sp.crc != sample_crc(self._node, pv, sp):\n            self.arrivals",
            "        if False:\n            self.arrivals",
        ),
        (
            "no checksum of frames at the host",
            "retuner.drivers.protocol.codec",
            "if plan.checked and data[-1] != frame_crc(id_, data[:-1]):",
            "if False:",
        ),
        (
            "the row comes after the write",
            "bus_simulation.host_end",
            'self._record("intent", gains)\n        try:\n            seq = device.begin_write(gains, self.now_s)\n',
            "try:\n            seq = device.begin_write(gains, self.now_s)\n"
            '            self._record("intent", gains)\n',
        ),
    )
)
"""All mutants of the host."""


def broken_by(number: int, seeds: int = SEEDS, steps: int = STEPS) -> str:
    """The first promise that a mutant breaks, empty for none; in a process of its own."""
    command = [sys.executable, "-P", __file__, str(number), str(seeds), str(steps)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode not in {0, 1}:
        raise RuntimeError(f"mutant {number}: {done.stderr.strip().splitlines()[-1:]}")
    return done.stdout.strip()


def main() -> int:
    number, seeds, steps = map(int, [*sys.argv[1:], SEEDS, STEPS][:3] if len(sys.argv) == 2 else sys.argv[1:])
    sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
    # load the module with its change, before anything else does
    mutant = HOST_MUTANTS[number]
    spec = importlib.util.find_spec(mutant.module)
    if spec is None or spec.origin is None or mutant.module in sys.modules:
        raise ValueError(f"{mutant.module} is not there, or loaded already")
    source = Path(spec.origin).read_text(encoding="utf-8")
    if source.count(mutant.old) != 1:
        raise ValueError(f"{mutant.name}: {mutant.old!r} stands {source.count(mutant.old)} times in {mutant.module}")
    module = importlib.util.module_from_spec(spec)
    sys.modules[mutant.module] = module
    exec(compile(source.replace(mutant.old, mutant.new), spec.origin, "exec"), module.__dict__)
    from bus_simulation.campaign import World
    from bus_simulation.firmware import FirmwareDevice

    for seed in range(seeds):
        try:
            World(seed, FirmwareDevice).run(steps)
        except (AssertionError, ArithmeticError, AttributeError, LookupError, TypeError, ValueError) as error:
            print(f"{type(error).__name__}: {error}" if not isinstance(error, AssertionError) else error)
            return 0
    return 1


if __name__ == "__main__":
    sys.exit(main())
