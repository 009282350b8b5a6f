"""Each layer of the protocol taken away alone: the simulation's invariants find it, with no second device beside it."""

from functools import partial
from importlib import util
from pathlib import Path

import pytest
from bus_simulation.campaign import World
from bus_simulation.firmware import FirmwareDevice
from bus_simulation.host_mutants import HOST_MUTANTS, broken_by
from bus_simulation.layers.door import Door
from bus_simulation.mutants import MUTANTS, MUTANTS_OF_THE_STORE, Mutant
from bus_simulation.truth import ViolationError
from effort import sized

from retuner.drivers.controller.virtual_device import LeaseDesk, VirtualDevice
from retuner.drivers.protocol.authentication import CodeDesk

SEEDS, STEPS = 20, 700  # what CI simulates
ALL = (*MUTANTS, *MUTANTS_OF_THE_STORE)


def found(make: object = VirtualDevice) -> str:
    """The first promise that is broken, and by its name the layer."""
    for seed in range(SEEDS):
        try:
            World(seed, make).run(STEPS)
        except ViolationError as error:
            return str(error).split(":")[0]
    return ""


@pytest.mark.uncounted
@pytest.mark.parametrize("mutant", ALL[:: sized(12, 10, 1)], ids=lambda mutant: mutant.name)
def test_firmware_with_one_thing_wrong_is_found(mutant: Mutant) -> None:
    assert found(partial(FirmwareDevice, changes=((mutant.old, mutant.new),))) != ""


def test_what_a_host_mutant_changes_stands_once() -> None:
    """Few of them are tried each time; a text that is gone would be seen only when its turn comes."""
    found = {m.name: Path(str(util.find_spec(m.module).origin)).read_text().count(m.old) for m in HOST_MUTANTS}
    assert {name: count for name, count in found.items() if count != 1} == {}


@pytest.mark.parametrize("number", range(sized(7, 3, 0), len(HOST_MUTANTS), sized(40, 20, 1)))
def test_a_host_with_one_layer_taken_away_is_found(number: int) -> None:
    """By what it sends and tells alone: the device, which is whole, keeps it from doing harm."""
    assert broken_by(number) != ""


def test_an_epoch_that_is_kept_over_a_restart_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    restart = VirtualDevice.restart

    def keeps(self: VirtualDevice) -> None:
        self.epoch -= 1
        restart(self)

    monkeypatch.setattr(VirtualDevice, "restart", keeps)
    assert found() == "epochs_are_new"


def test_a_lease_that_outlives_its_samples_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(LeaseDesk, "tick", lambda _: False)
    assert found() == "leases_end"


def test_a_challenge_that_stays_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    renew = CodeDesk.renew
    monkeypatch.setattr(CodeDesk, "renew", lambda self: None if hasattr(self, "nonce") else renew(self))
    assert found() == "codes_are_fresh"


def test_no_frame_passes_unseen(monkeypatch: pytest.MonkeyPatch) -> None:
    seen = {"coming": 0, "came": 0, "sampled": 0}
    for name in seen:
        told = getattr(Door, name)

        def counted(self: Door, *args: object, name: str = name, told: object = told) -> None:
            seen[name] += 1
            told(self, *args)

        monkeypatch.setattr(Door, name, counted)
    World(0).run(200)
    assert seen["coming"] == seen["came"] > 100
    assert seen["sampled"] > 200
