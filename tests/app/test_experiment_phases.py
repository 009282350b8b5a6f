"""Every phase of an experiment on demand against every cause of an abort, and real faults: the old state comes back."""

import itertools
from collections.abc import Callable, Mapping
from dataclasses import replace

import pytest
from effort import pairs

from retuner import LinearProcess, PidGains
from retuner.adaptive.experiments.phases import TRANSITIONS, AbortCause, Happening, Phase, after
from retuner.adaptive.experiments.plan import Experiment, Plan
from retuner.adaptive.experiments.valve_test import SHORT
from retuner.drivers.bus.bus import CanLink, LinkSettings
from retuner.drivers.clock import SimulatedClock
from retuner.drivers.controller.device_process import DeviceOnBus
from retuner.drivers.controller.firmware_settings import VirtualDeviceSettings
from retuner.drivers.controller.virtual_device import VirtualDevice
from retuner.drivers.host.can_device import CanDevice
from retuner.drivers.host.can_settings import CanDeviceSettings
from retuner.drivers.plants.linear_plant import LinearPlant
from retuner.drivers.protocol.checksum import to_wire
from retuner.errors import LedgerError
from retuner.experiment.runner import RESTORE_SAMPLES, ExperimentRunner

CHANNELS = itertools.count()
DT = 0.5
GAINS = PidGains(2.0, 0.25, 0.5)
PLANS = {
    Experiment.STEP: Plan(Experiment.STEP, 10.0, 30.0, 70.0, rest_samples=10, rest_time_s=60.0, time_s=200.0),
    Experiment.RELAY: Plan(
        Experiment.RELAY, 10.0, 30.0, 70.0, rest_samples=10, rest_time_s=60.0, time_s=400.0, bias=0.2
    ),
    Experiment.VALVE: Plan(
        Experiment.VALVE, 2.0, 30.0, 70.0, rest_samples=10, rest_time_s=60.0, time_s=200.0, hold_s=20.0, moves=SHORT
    ),
    Experiment.SETPOINT: Plan(
        Experiment.SETPOINT, 2.0, 30.0, 70.0, rest_samples=10, rest_time_s=60.0, time_s=200.0, kc0=3.0
    ),
}
LIVING = [phase for phase in Phase if not phase.over]


class Lab:
    """A controller with its plant, a conductor, and hands to interfere with both."""

    def __init__(
        self,
        plan: Plan,
        *,
        auto: bool = True,
        k: float = 1.0,
        noise: float = 0.0,
        gains: PidGains = GAINS,
        record: Callable[[str, float, Mapping[str, object]], None] | None = None,
        **firmware: float,
    ) -> None:
        plant = LinearPlant(LinearProcess(k, (10.0,), (), 2.0), start_pv=50.0, start_co=40.0, noise=noise, seed=5)
        self.device = VirtualDevice(VirtualDeviceSettings(gains=gains, sample_time_s=DT, **firmware), plant)
        self.clock = SimulatedClock()
        link = LinkSettings(channel=f"lab-{next(CHANNELS)}")
        self.far, self.near = CanLink(link, self.clock), CanLink(link, self.clock)
        self.on_bus = DeviceOnBus(self.device, self.far)
        self.rows: list[Mapping[str, object]] = []
        self.host = CanDevice(self.near, CanDeviceSettings(sample_time_s=DT))
        self.conductor = ExperimentRunner(self.host, plan, DT, self.host.settings.silent_s, record or self._record)
        self.alive = True
        if not auto:
            self.device.auto = False
            self.device._manual_co = 40.0

    def _record(self, kind: str, t_s: float, body: Mapping[str, object]) -> None:
        del t_s
        assert kind == "experiment"
        self.rows.append(body)

    def turn(self) -> None:
        """One controller sample, unless the controller is off; the host polls in any case."""
        self.clock.advance(DT)
        if self.alive:
            self.on_bus.sample()
        else:
            self.far.receive_all()
        self.conductor.poll(self.clock.now_s())
        if self.alive:
            self.on_bus.answer()

    def until(self, phase: Phase, most: int = 3000) -> None:
        for _ in range(most):
            if self.conductor.phase is phase:
                return
            self.turn()
        raise AssertionError(f"{phase} was not reached, it is in {self.conductor.phase}: {self.conductor.text}")

    def over(self, most: int = 3000) -> None:
        for _ in range(most):
            if self.conductor.phase.over:
                return
            self.turn()
        raise AssertionError(f"not over, in {self.conductor.phase}")

    def some(self, turns: int) -> None:
        for _ in range(turns):
            self.turn()

    def as_before(self, *, auto: bool = True, sp: float = 50.0, gains: PidGains = GAINS) -> bool:
        """What the controller truly is, not what it reports."""
        device = self.device
        same = device.running.gains == to_wire(gains) and abs(device.sp - sp) < 1e-4 and device.auto == auto
        return same and (auto or abs(device.co - 40.0) < 1e-3)

    def close(self) -> None:
        self.near.close()
        self.far.close()


@pytest.fixture
def lab(request: pytest.FixtureRequest) -> Callable[..., Lab]:
    def make(plan: Plan, **arguments: object) -> Lab:
        made = Lab(plan, **arguments)  # type: ignore[arg-type]  # keyword arguments of Lab
        request.addfinalizer(made.close)
        return made

    return make


def test_phases_that_touch_the_controller_end_only_over_parking_and_restoring() -> None:
    for phase, edges in TRANSITIONS.items():
        for new in edges.values():
            if new is Phase.RESTORED and phase.touched:
                assert phase is Phase.RESTORING


@pytest.mark.parametrize(("phase", "happening"), [(p, h) for p in Phase for h in Happening if h not in TRANSITIONS[p]])
def test_what_is_not_in_the_table_cannot_happen(phase: Phase, happening: Happening) -> None:
    with pytest.raises(ValueError, match="cannot happen"):
        after(phase, happening)


@pytest.mark.parametrize("kind", Experiment)
@pytest.mark.parametrize(("phase", "cause"), pairs(LIVING, AbortCause))
def test_every_cause_in_every_phase_ends_in_the_verified_old_state(phase, cause, kind, lab):
    bench = lab(PLANS[kind])
    bench.until(phase)
    bench.some(1 if phase is Phase.EXCITING else 0)
    bench.conductor.abort(cause, "by the test")
    bench.over()
    assert bench.conductor.phase is Phase.RESTORED
    assert bench.conductor.cause is cause
    assert bench.as_before()
    assert bench.conductor.touched == (phase not in {Phase.CONNECTING, Phase.RESTING})


@pytest.mark.parametrize("kind", Experiment)
@pytest.mark.parametrize("phase", LIVING)
def test_a_restart_of_the_controller_in_every_phase(phase: Phase, kind: Experiment, lab: Callable[..., Lab]) -> None:
    bench = lab(PLANS[kind])
    bench.until(phase)
    bench.some(0 if phase is Phase.CONNECTING else 2 if phase is Phase.EXCITING else 1)
    bench.device.restart()
    bench.over()
    assert bench.conductor.phase is Phase.RESTORED
    # at rest nothing had been changed, so what the controller woke up with is left alone
    if bench.conductor.touched:
        assert bench.as_before()
        assert bench.conductor.cause is None or bench.conductor.cause is AbortCause.RESTARTED


@pytest.mark.parametrize("kind", Experiment)
@pytest.mark.parametrize("phase", [p for p in LIVING if p is not Phase.CONNECTING])
def test_telemetry_lost_for_a_while_in_every_phase(phase: Phase, kind: Experiment, lab: Callable[..., Lab]) -> None:
    bench = lab(PLANS[kind])
    bench.until(phase)
    bench.alive = False
    bench.some(20)
    bench.alive = True
    bench.over()
    assert bench.conductor.phase is Phase.RESTORED
    assert bench.as_before()
    if phase in {Phase.RESTING, Phase.PREPARING, Phase.EXCITING}:
        assert bench.conductor.cause is AbortCause.SILENT


@pytest.mark.parametrize("kind", Experiment)
@pytest.mark.parametrize("phase", [p for p in LIVING if p.touched])
def test_a_controller_that_never_comes_back_is_told(phase: Phase, kind: Experiment, lab: Callable[..., Lab]) -> None:
    bench = lab(PLANS[kind])
    bench.until(phase)
    bench.alive = False
    bench.over(4 * RESTORE_SAMPLES)
    assert bench.conductor.phase is Phase.STRANDED
    assert bench.conductor.before is not None  # what a person has to bring back


@pytest.mark.parametrize("kind", Experiment)
def test_an_undisturbed_experiment_leaves_everything_as_it_was(kind: Experiment, lab: Callable[..., Lab]) -> None:
    bench = lab(PLANS[kind])
    bench.over()
    assert bench.conductor.phase is Phase.RESTORED
    assert bench.conductor.cause is None
    assert bench.as_before()
    assert [row["phase"] for row in bench.rows] == [
        "resting",
        "before",
        "preparing",
        "exciting",
        "parking",
        "restoring",
        "restored",
    ]
    assert len(bench.conductor.excited) > 20


@pytest.mark.parametrize("kind", [Experiment.STEP, Experiment.RELAY])
def test_a_loop_in_manual_is_left_in_manual_at_its_output(kind: Experiment, lab: Callable[..., Lab]) -> None:
    bench = lab(PLANS[kind], auto=False)
    bench.over()
    assert bench.conductor.phase is Phase.RESTORED
    assert bench.conductor.cause is None
    assert bench.as_before(auto=False)


def test_a_setpoint_experiment_in_manual_is_refused_before_anything_is_touched(lab: Callable[..., Lab]) -> None:
    bench = lab(PLANS[Experiment.SETPOINT], auto=False)
    bench.over()
    assert bench.conductor.cause is AbortCause.WRONG_MODE
    assert not bench.conductor.touched


@pytest.mark.parametrize("kind", Experiment)
def test_a_reverse_acting_loop(kind: Experiment, lab: Callable[..., Lab]) -> None:
    gains = PidGains(-2.0, -0.25, -0.5)
    plan = replace(PLANS[kind], kc0=-3.0 if kind == Experiment.SETPOINT else None)
    bench = lab(plan, k=-1.0, gains=gains)
    bench.over()
    assert bench.conductor.phase is Phase.RESTORED
    assert bench.conductor.cause is None
    assert bench.as_before(gains=gains)


# limits, each reached by what really happens


def test_pv_outside_its_band_at_the_start(lab: Callable[..., Lab]) -> None:
    bench = lab(replace(PLANS[Experiment.STEP], pv_low=60.0))
    bench.over()
    assert bench.conductor.cause is AbortCause.PV_BAND
    assert not bench.conductor.touched
    assert bench.as_before()


@pytest.mark.parametrize("kind", Experiment)
def test_a_load_that_drives_pv_out_of_its_band(kind: Experiment, lab: Callable[..., Lab]) -> None:
    bench = lab(replace(PLANS[kind], deviation=8.0))
    bench.until(Phase.EXCITING)
    bench.device.load = 40.0
    bench.over()
    assert bench.conductor.cause is AbortCause.PV_BAND
    assert bench.conductor.phase is Phase.RESTORED
    assert bench.as_before()


@pytest.mark.parametrize("kind", [Experiment.STEP, Experiment.RELAY])
def test_an_amplitude_beyond_the_range_of_the_output_is_refused(kind: Experiment, lab: Callable[..., Lab]) -> None:
    bench = lab(replace(PLANS[kind], amplitude=70.0))
    bench.over()
    assert bench.conductor.cause is AbortCause.NO_ROOM
    assert not bench.conductor.touched


def test_an_output_that_the_controller_limits_ends_the_setpoint_experiment(lab: Callable[..., Lab]) -> None:
    bench = lab(replace(PLANS[Experiment.SETPOINT], amplitude=15.0, kc0=8.0))
    bench.over()
    assert bench.conductor.cause is AbortCause.SATURATED
    assert bench.as_before()


def test_a_held_setpoint_goes_out_and_back_under_the_active_gains(lab: Callable[..., Lab]) -> None:
    held = replace(PLANS[Experiment.SETPOINT], kc0=None, hold_s=20.0)
    bench = lab(held, noise=0.3)
    bench.over()
    assert bench.conductor.cause is None
    assert bench.as_before()
    excited = bench.conductor.excited
    out = [s.t_s for s in excited if s.sp == pytest.approx(52.0)]
    assert out[-1] - out[0] == pytest.approx(20.0, abs=2 * DT)
    assert excited[-1].t_s - out[-1] == pytest.approx(20.0, abs=3 * DT)
    assert {s.sp for s in excited} == {50.0, 52.0}
    with pytest.raises(ValueError, match="hold_s"):
        replace(PLANS[Experiment.STEP], hold_s=20.0)


def test_a_valve_test_plays_its_moves_in_manual_and_goes_back(lab: Callable[..., Lab]) -> None:
    plan = replace(PLANS[Experiment.VALVE], amplitude=1.0)
    bench = lab(plan)
    bench.over()
    assert bench.conductor.cause is None
    assert bench.as_before()
    co = [round(s.co - 40.0, 3) for s in bench.conductor.excited]
    played = [level for level, _ in itertools.groupby(co)]
    assert played == [0.0, 1.0, 2.0, 1.0, 0.0]
    assert [co.count(level) for level in (1.0, 2.0)] == [pytest.approx(80, abs=4), pytest.approx(40, abs=2)]
    assert {s.mode for s in bench.conductor.excited[plan.rest_samples :]} == {0}
    for wrong in ({"moves": ()}, {"moves": (1, 1)}, {"hold_s": 0.0}):
        with pytest.raises(ValueError, match=next(iter(wrong))):
            replace(plan, **wrong)


def test_a_setpoint_that_another_moves_during_a_hold_ends_it(lab: Callable[..., Lab]) -> None:
    bench = lab(replace(PLANS[Experiment.SETPOINT], kc0=None, hold_s=20.0))
    bench.until(Phase.EXCITING)
    bench.some(60)  # the setpoint is back by now
    bench.device.sp = 47.0
    bench.over()
    assert bench.conductor.cause is AbortCause.FOREIGN
    assert bench.as_before()


def test_a_relay_against_the_grain_never_switches_back(lab: Callable[..., Lab]) -> None:
    bench = lab(replace(PLANS[Experiment.RELAY], pv_low=0.0, pv_high=100.0, time_s=100.0, amplitude=5.0), k=-1.0)
    bench.over()
    assert bench.conductor.cause in {AbortCause.NEVER_SWITCHED, AbortCause.NOT_AT_REST, AbortCause.PV_BAND}
    bench = lab(replace(PLANS[Experiment.RELAY], hysteresis=30.0, pv_low=0.0, pv_high=100.0, time_s=100.0))
    bench.over()
    assert bench.conductor.cause is AbortCause.NEVER_SWITCHED
    assert bench.as_before()


def test_the_time_limit(lab: Callable[..., Lab]) -> None:
    bench = lab(replace(PLANS[Experiment.STEP], time_s=5.0))
    bench.over()
    assert bench.conductor.cause is AbortCause.TIME
    assert bench.as_before()


def test_hysteresis_comes_from_the_noise_seen_at_rest(lab: Callable[..., Lab]) -> None:
    plan = replace(PLANS[Experiment.RELAY], rest_samples=100)
    bench = lab(plan, auto=False, noise=0.2)
    bench.over()
    assert bench.conductor.cause is None
    assert bench.conductor.rest.hysteresis == pytest.approx(0.6, rel=0.35)


def test_a_gain_set_that_the_controller_refuses_ends_the_experiment(lab: Callable[..., Lab]) -> None:
    bench = lab(replace(PLANS[Experiment.SETPOINT], kc0=1000.0))
    bench.over()
    assert bench.conductor.cause is AbortCause.REFUSED
    assert bench.as_before()


def test_a_setpoint_that_the_controller_refuses_ends_the_experiment(lab: Callable[..., Lab]) -> None:
    bench = lab(PLANS[Experiment.SETPOINT], sp_max=51.0)
    bench.over()
    assert bench.conductor.cause is AbortCause.REFUSED
    assert bench.as_before()


def test_an_operator_who_takes_over_ends_the_experiment(lab: Callable[..., Lab]) -> None:
    bench = lab(PLANS[Experiment.RELAY])
    bench.until(Phase.EXCITING)
    bench.some(3)
    bench.device.auto = True  # at the panel of the controller
    bench.over()
    assert bench.conductor.cause is AbortCause.FOREIGN
    assert bench.as_before()


def test_a_setpoint_that_follows_pv_in_manual_is_no_trouble_and_is_brought_back(lab: Callable[..., Lab]) -> None:
    bench = lab(PLANS[Experiment.STEP])
    for _ in range(3000):
        if bench.conductor.phase.over:
            break
        bench.turn()
        if not bench.device.auto:
            bench.device.sp = bench.device.pv
    assert bench.conductor.cause is None
    assert bench.conductor.phase is Phase.RESTORED
    assert bench.as_before()


@pytest.mark.parametrize("kind", Experiment)
def test_a_loop_that_another_host_commands_is_left_alone(kind: Experiment, lab: Callable[..., Lab]) -> None:
    bench = lab(PLANS[kind])
    link = CanLink(bench.near.settings, bench.clock)
    other = CanDevice(link, CanDeviceSettings(sample_time_s=DT, owner=77))
    try:
        for _ in range(20):
            bench.clock.advance(DT)
            bench.on_bus.sample()
            other.poll(bench.clock.now_s())
            bench.near.receive_all()
            bench.on_bus.answer()
        for _ in range(300):
            bench.turn()
            other.poll(bench.clock.now_s())
            bench.on_bus.answer()
            if bench.conductor.phase.over:
                break
    finally:
        link.close()
    assert bench.conductor.cause is AbortCause.FOREIGN
    assert "host 77" in bench.conductor.text
    assert not bench.conductor.touched
    assert bench.as_before()


@pytest.mark.parametrize("failing", range(7))
def test_a_ledger_that_fails_ends_the_experiment_but_not_the_way_back(failing: int, lab: Callable[..., Lab]) -> None:
    calls = []

    def record(kind: str, t_s: float, body: Mapping[str, object]) -> None:
        calls.append((kind, t_s, body))
        if len(calls) > failing:
            raise LedgerError("the disk is full")

    bench = lab(PLANS[Experiment.STEP], record=record)
    bench.over()
    assert bench.conductor.phase is Phase.RESTORED
    assert bench.conductor.lost_ledger is not None
    assert bench.as_before()
    assert len(calls) == failing + 1  # nothing is asked of a ledger that has failed
    if failing < 2:
        assert not bench.conductor.touched  # what cannot be recorded is not done


def test_without_a_controller_nothing_is_conducted(lab: Callable[..., Lab]) -> None:
    from retuner.drivers.device import DeviceSilentError

    bench = lab(PLANS[Experiment.STEP])
    bench.alive = False
    with pytest.raises(DeviceSilentError):
        bench.over()
    assert bench.conductor.phase is Phase.CONNECTING
