"""The plants behind the virtual devices of a session, from its configuration; loops that name one `shared` have one."""

import math
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

from retuner.adaptive.process.model import LinearProcess
from retuner.adaptive.signals.sample import FloatArray
from retuner.config.loading import key_name
from retuner.config.model import Config
from retuner.config.plants import (
    BoilerPlantConfig,
    FmuPlantConfig,
    IdentifiedPlantConfig,
    LoadConfig,
    OvenPlantConfig,
    PlantConfig,
    PythonPlantConfig,
    StateSpacePlantConfig,
)
from retuner.config.section import Problem
from retuner.drivers.closing import Closes
from retuner.drivers.historian.loop_record import read_loop_record
from retuner.drivers.historian.record_form import RecordForm
from retuner.drivers.plants.boiler_plant import BoilerPlant
from retuner.drivers.plants.foreign_model import ModelSpec, PlantFaultError, PlantModel, missing_name
from retuner.drivers.plants.identified import alike, load_of, model_of
from retuner.drivers.plants.linear_plant import LinearPlant
from retuner.drivers.plants.oven_plant import OvenPlant
from retuner.drivers.plants.plant import KnownPlant, Plant
from retuner.drivers.plants.plant_process import ModelInProcess
from retuner.drivers.plants.python_model import find_object
from retuner.drivers.plants.recorded_load import LoadedPlant, RecordedLoad, RecordedLoads
from retuner.drivers.plants.shared_plant import GOES_ON, PlantPort, PortSettings, SharedPlant
from retuner.drivers.plants.state_space import StateSpaceModel, matrices_of
from retuner.drivers.plants.stepped import SteppedPlant, rests_of
from retuner.drivers.recorded.recording import RecordingError
from retuner.errors import UserError

WAIT_SAMPLES, WAIT_FLOOR_S = 2.0, 0.1
"""Samples, and least time, that a model's step is waited for in real time before the controller goes on alone."""

SAMPLES_AT_REST, AT_REST = 20, 0.02
"""How long `check` holds a model's start, in samples, and the share of the pv range that pv may move meanwhile."""

ModelConfig = PythonPlantConfig | FmuPlantConfig | StateSpacePlantConfig
SCALES = ("input_scale", "input_offset", "output_scale", "output_offset")


class UnusablePlantError(UserError):
    """A plant that cannot be begun. loop : index of the loop whose it is. problem : with the key in its section."""

    def __init__(self, loop: int, name: str, fault: PlantFaultError) -> None:
        key = tuple(int(part) if part.isdecimal() else part for part in fault.key)
        self.loop, self.problem = loop, Problem(("device", "plant", *key), str(fault))
        super().__init__(f"loop {name}: {key_name(self.problem.path)} {fault}")


def plant_of(config: Config) -> PlantConfig:
    """What a loop's configuration says of its plant. Raises UserError: it has no [device] section, or no plant."""
    if config.device is None:
        raise UserError(
            "the configuration has no [device] section: there is no virtual device to run; add one, or give "
            "--interface and --channel of the controller's bus"
        )
    if config.device.plant is None:
        raise UserError(
            "[device] has no plant, so it is a real one; give --interface and --channel of its bus, or a "
            "[device.plant] for a virtual one"
        )
    return config.device.plant


def known_plant(config: Config) -> KnownPlant | None:
    """The simulated plant of a loop, where its true model is known: it is one of ours.

    Raises UserError: as plant_of; or a recorded load cannot be read.
    """
    plant = plant_of(config)
    if isinstance(plant, ModelConfig):
        return None
    try:
        assert config.device is not None
        seed = config.device.seed
        made: KnownPlant
        if isinstance(plant, OvenPlantConfig):
            made = OvenPlant(plant.settings(), plant.start_c, seed)
        elif isinstance(plant, BoilerPlantConfig):
            made = BoilerPlant(plant.settings(), plant.start_c, seed)
        elif isinstance(plant, IdentifiedPlantConfig):
            process = model_of(Path(plant.file))
            try:
                record = read_loop_record([Path(plant.record)]).recording
            except RecordingError as error:
                raise PlantFaultError(f": {error}", "record") from None
            load = load_of(process, record.t_s, record.pv, record.co)
            load = alike(load, seed) if plant.load == "alike" else load
            linear = LinearPlant(
                process,
                start_pv=float(record.pv[0]),
                start_co=float(record.co[0]),
                co_min=config.loop.co_min_pct,
                co_max=config.loop.co_max_pct,
            )
            made = LoadedPlant(linear, RecordedLoads([load]))
        else:
            process = LinearProcess(plant.k, plant.lags_s, plant.leads_s, plant.theta_s, plant.integrators)
            made = LinearPlant(
                process,
                start_pv=plant.start_pv,
                start_co=plant.start_co_pct,
                noise=plant.noise,
                seed=seed,
                co_min=config.loop.co_min_pct,
                co_max=config.loop.co_max_pct,
            )
        loads = _loads(plant.loads)
    except PlantFaultError as fault:
        raise UnusablePlantError(0, config.loop.name, fault) from None
    return made if loads is None else LoadedPlant(made, loads)


def stepped_plant(config: Config, configs: Sequence[Config], sp: FloatArray, co: FloatArray) -> SteppedPlant | None:
    """What steps on a copy tell of somebody else's plant; None of ours, which is known, and of a run without rest.

    configs : all loops of the bench, which a shared plant needs. sp, co : of the run.
    """
    plant = config.device.plant if config.device else None
    rests = rests_of(sp, co)
    if not isinstance(plant, ModelConfig) or not rests:
        return None

    def begin() -> tuple[PlantPort, Callable[[], None]]:
        users = [one for one in configs if plant.shared and _shares(one, plant.shared)] or [config]
        model = _Model(users, lambda _: None, None)
        return model.port(config, plant.model_copy(update={"noise": 0.0, "loads": ()})), model.close

    return SteppedPlant(begin, rests, config.loop.sample_time_s)


class Plants(Closes):
    """The plants of some loops; ends the processes of models when it is left.

    configs : of the loops. say : takes a line on a plant that does something wrong. speed : how much faster than real
    time the devices run; None for simulated time.

    Raises UserError: a loop has no plant, or one cannot be begun: UnusablePlantError.
    """

    def __init__(self, configs: Sequence[Config], say: Callable[[str], None], speed: float | None = None) -> None:
        self._configs = configs
        self._shared: dict[str, _Model] = {}
        self.plants: list[Plant] = []
        self.described: list[Sequence[str]] = []
        try:
            for i, config in enumerate(configs):
                try:
                    plant = plant_of(config)
                    if not isinstance(plant, ModelConfig):
                        known = known_plant(config)
                        assert known is not None
                        self.plants.append(known)
                        self.described.append(())
                    else:
                        name = plant.shared or f"\0{i}"
                        if name not in self._shared:
                            users = [one for one in configs if plant.shared and _shares(one, plant.shared)] or [config]
                            # how long a device waits for its model's step, s of the machine's time
                            paced_s = config.loop.sample_time_s / speed if speed is not None else None
                            wait_s = None if paced_s is None else max(WAIT_SAMPLES * paced_s, WAIT_FLOOR_S)
                            self._shared[name] = _Model(users, say, wait_s)
                        self.plants.append(self._shared[name].port(config, plant))
                        self.described.append(self._shared[name].described)
                except PlantFaultError as fault:
                    raise UnusablePlantError(i, config.loop.name, fault) from None
        except BaseException:
            self.close()
            raise

    @property
    def stopped(self) -> list[str]:
        """What is to be said of models that have stopped, or give no reading at the end."""
        return [one.plant.fault for one in self._shared.values() if one.plant.fault]

    def begun(self) -> list[list[str]]:
        """What a person should know of each loop's start; the models go on for a few samples.

        Raises UnusablePlantError: one fails within these.
        """
        ports = [one if isinstance(one, PlantPort) else None for one in self.plants]
        first = [one.pv if one else math.nan for one in ports]
        for _ in range(SAMPLES_AT_REST):
            for port, config in zip(ports, self._configs, strict=True):
                if port:
                    port.step(port.settings.start_co, 0.0, config.loop.sample_time_s)
        for i, (port, config) in enumerate(zip(ports, self._configs, strict=True)):
            if port and port.plant.fault:
                fault = PlantFaultError(port.plant.fault.removesuffix(f"; {GOES_ON}"))
                raise UnusablePlantError(i, config.loop.name, fault)
        found = [list(told) for told in self.described]
        for told, port, config, pv in zip(found, ports, self._configs, first, strict=True):
            if port is None:
                continue
            # where a loop begins, and what is odd about it
            loop, place = config.loop, port.settings
            value = place.input_scale * place.start_co + place.input_offset
            told.append(f"start: co {place.start_co:g} % is {value:g} at its input; pv {pv:.6g} {loop.pv_unit}")
            if not loop.pv_min <= pv <= loop.pv_max:
                ends = f"pv_min to pv_max ({loop.pv_min:g} to {loop.pv_max:g})"
                told.append(f"!! pv is outside of {ends}: output_scale, or start values?")
            elif abs(port.pv - pv) > AT_REST * (loop.pv_max - loop.pv_min) and not plant_of(config).loads:
                moved = f"pv is {port.pv:.6g} after {SAMPLES_AT_REST * loop.sample_time_s:g} s of this co"
                told.append(f"!! it is not at rest: {moved}; see input_scale, start_co_pct, settle_s")
        return found

    def close(self) -> None:
        """End the processes."""
        for one in self._shared.values():
            one.close()


def _shares(config: Config, name: str) -> bool:
    plant = config.device.plant if config.device else None
    return isinstance(plant, ModelConfig) and plant.shared == name


class _Model:
    """A model, and the loops on it. users : configurations of these."""

    def __init__(self, users: Sequence[Config], say: Callable[[str], None], wait_s: float | None) -> None:
        plants = [plant for plant in map(plant_of, users) if isinstance(plant, ModelConfig)]
        first = plants[0]
        self.source = first.file if isinstance(first, FmuPlantConfig) else first.model or "state_space"
        self._inputs, self._outputs, start = _names(plants)
        self.described: Sequence[str] = ()
        if isinstance(first, StateSpacePlantConfig):
            # The matrices as a model
            a, b, c, d = matrices_of(find_object(first.model)) if first.model else (first.a, first.b, first.c, first.d)
            outputs, inputs = len(c), len(b[0]) if b else len(d[0]) if d else 0
            for key, names, count in (("inputs", first.inputs, inputs), ("outputs", first.outputs, outputs)):
                if len(names) != count and (names or count != 1):
                    raise PlantFaultError(f"has {len(names)} names; the system has {count} {key}: name them all", key)
            for key, name, known in (
                ("input", first.input, first.inputs),
                ("output", first.output, first.outputs),
                ("aux", first.aux, first.outputs),
                ("load_input", first.load_input, first.inputs),
            ):
                if name and name not in known:
                    raise PlantFaultError(missing_name(key.rpartition("_")[2], name, known), key)
            theta = first.theta_s
            rows = theta if isinstance(theta, tuple) else [[theta] * inputs] * outputs
            model: PlantModel = StateSpaceModel(a, b, c, d, rows)
            start = [0.0] * (len(self._inputs) or 1)
            self.described = [
                f"{len(a)} states, inputs: {', '.join(first.inputs) or 1}, outputs: {', '.join(first.outputs) or 1}"
            ]
        else:
            spec = ModelSpec(
                first.kind,
                self.source,
                tuple(self._inputs),
                tuple(self._outputs),
                tuple(start),
                first.parameters,
                first.settle_s,
                first.step_s if isinstance(first, FmuPlantConfig) else 0.0,
                first.interface if isinstance(first, FmuPlantConfig) else "",
            )
            in_process = ModelInProcess(spec, first.patience_s, wait_s)
            model, self.described = in_process, in_process.described
        self.plant = SharedPlant(model, start, say)

    def port(self, config: Config, plant: ModelConfig) -> PlantPort:
        assert config.device is not None
        places: dict[str, int | None] = {
            key: names.index(name) if (name := getattr(plant, key)) else None
            for key, names in (("input", self._inputs), ("output", self._outputs), ("aux", self._outputs),
                               ("load_input", self._inputs))
        }  # fmt: skip
        scales = (
            {"input_offset": -plant.start_co_pct, "output_offset": plant.start_pv}
            if isinstance(plant, StateSpacePlantConfig)
            else {key: getattr(plant, key) for key in SCALES}
        )
        settings = PortSettings(
            self.source,
            places["input"] or 0,
            places["output"] or 0,
            places["aux"],
            places["load_input"],
            start_co=plant.start_co_pct,
            noise=plant.noise,
            seed=config.device.seed,
            **scales,
        )
        return self.plant.port(settings, _loads(plant.loads))

    def close(self) -> None:
        self.plant.close()


def _names(plants: Sequence[ModelConfig]) -> tuple[list[str], list[str], list[float]]:
    """Inputs and outputs by name that the loops of a model use, and the inputs' values at the start."""
    first = plants[0]
    if isinstance(first, StateSpacePlantConfig):
        return [*first.inputs], [*first.outputs], []
    start: dict[str, float] = {}
    outputs: dict[str, None] = {}
    for plant in plants:
        assert not isinstance(plant, StateSpacePlantConfig)
        value = plant.input_scale * plant.start_co_pct + plant.input_offset
        if not plant.input:
            return [], [], [value]
        start[plant.input] = value
        outputs |= dict.fromkeys(filter(None, (plant.output, plant.aux)))
    start = {**{plant.load_input: 0.0 for plant in plants if plant.load_input}, **start}
    return [*start], [*outputs], [*start.values()]


def _loads(loads: Sequence[LoadConfig]) -> RecordedLoads | None:
    found = []
    for place, load in enumerate(loads):
        columns = {**dict.fromkeys(("pv", "sp", "co"), load.column), **({"t": load.time} if load.time else {})}
        try:
            read = read_loop_record([Path(load.file)], RecordForm(columns=columns)).recording
            t_s, pv = np.asarray(read.t_s) - read.t_s[0], np.asarray(read.pv)
            found.append(RecordedLoad(t_s, pv, load.scale, load.at == "output", load.repeat))
        except (RecordingError, ValueError) as error:
            told = str(error).replace("name it as in --columns sp=NAME", "give one of them as column")
            raise PlantFaultError(f": {told}", "loads", str(place)) from None
    return RecordedLoads(found) if found else None
