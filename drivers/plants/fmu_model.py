"""A functional mock-up unit as a plant: FMI 2 and 3, co-simulation and model exchange, by FMPy.

Inputs, outputs, parameters and start values go by the names of its modelDescription.xml. In co-simulation it brings its
solver; in model exchange FMPy's CVODE integrates, with state, time and step events, as the standard has them
(Functional Mock-up Interface 2.0.4, section 3; 3.0.1, section 3).
"""

import contextlib
import math
import shutil
from collections.abc import Sequence
from typing import Any

from retuner.drivers.plants.foreign_model import ModelSpec, PlantFaultError, missing_name

try:
    import fmpy
    from fmpy.simulation import apply_start_values, settable_in_initialization_mode, settable_in_instantiated
except ModuleNotFoundError as missing:
    raise PlantFaultError(f'= "fmu" needs {missing.name}: pip install "retuner[fmu]"', "kind") from None

CO_SIMULATION, MODEL_EXCHANGE = "co_simulation", "model_exchange"
FMI_TYPES = {CO_SIMULATION: "CoSimulation", MODEL_EXCHANGE: "ModelExchange"}
REAL, REAL_32 = {"Real", "Float64"}, "Float32"
MOST_EVENT_ITERATIONS = 1000  # Iterations that an FMU may take to settle its discrete states at one instant
LEAST_SHARE = 1e-9  # share of a step below which what is left of it counts as rounding
TOLERANCE = 1e-6  # relative tolerance of the integration where the FMU names none
SHOWN = 12  # variables of a kind that are shown; an FMU may have thousands


class FmuModel:
    """The unit at work: see model.PlantModel."""

    def __init__(self, spec: ModelSpec) -> None:
        self._spec = spec
        try:
            about = fmpy.read_model_description(spec.source, validate=False)
        except FileNotFoundError:
            raise PlantFaultError(f'= "{spec.source}": there is no such file', "file") from None
        except Exception as error:  # noqa: BLE001  FMPy raises what its parts raise
            raise PlantFaultError(f'= "{spec.source}" cannot be read as an FMU: {error}', "file") from None
        if about.fmiVersion == "1.0":
            raise PlantFaultError(f'= "{spec.source}" is FMI 1.0; export it as FMI 2 or 3', "file")
        has = {CO_SIMULATION: about.coSimulation, MODEL_EXCHANGE: about.modelExchange}
        offered = [name for name, one in has.items() if one is not None]
        interface = spec.interface or (offered or [""])[0]
        if interface not in offered:
            raise PlantFaultError(
                f"the FMU has no {spec.interface or 'interface for it'}; it has {' and '.join(offered) or 'none'}",
                "interface",
            )
        platforms = fmpy.supported_platforms(spec.source)
        if fmpy.platform not in platforms and fmpy.platform_tuple not in platforms:
            raise PlantFaultError(
                f"the FMU is for {', '.join(platforms)}, this machine is {fmpy.platform_tuple}", "file"
            )
        self._about, self._interface = about, interface
        self._known = {one.name: one for one in self._about.modelVariables}
        self._inputs = [self._place(name, "input") for name in spec.inputs or self._only("input")]
        self._outputs = [self._place(name, "output") for name in spec.outputs or self._only("output")]
        for name in spec.parameters:
            if name not in self._known:
                raise PlantFaultError(missing_name("variable of the FMU", name, self._known), "parameters", name)
            if isinstance(spec.parameters[name], str) and self._known[name].type in {*REAL, REAL_32}:
                raise PlantFaultError(
                    f'= "{spec.parameters[name]}": {_shown(self._known[name])} is a number', "parameters", name
                )
        self._t_s = 0.0
        self._folder = fmpy.extract(spec.source)
        self._unit: Any = fmpy.instantiate_fmu(self._folder, self._about, FMI_TYPES[self._interface])
        self._initialise()
        self._exchange = _Exchange(self._unit, self._about) if self._interface == MODEL_EXCHANGE else None
        if spec.settle_s:
            self.step(spec.start, spec.settle_s)
        self.readings = self._read()

    def described(self) -> list[str]:
        """The model's variables with the values that they have at the start here, for a person."""
        inputs = zip((one.name for one in self._inputs), self._spec.start, strict=True)
        given = {**self._spec.parameters, **dict(inputs)}
        lines = [f"FMI {self._about.fmiVersion} {self._interface.replace('_', '-')}, {self._about.modelName}"]
        for what in ("input", "output", "parameter"):
            names = [_shown(one, given.get(one.name)) for one in self._about.modelVariables if one.causality == what]
            more = f" and {len(names) - SHOWN} more" if len(names) > SHOWN else ""
            lines.append(f"{what}s: {', '.join(names[:SHOWN]) or 'none'}{more}")
        return lines

    def step(self, inputs: Sequence[float], dt_s: float) -> Sequence[float]:
        """See model.PlantModel."""
        self._write(inputs)
        count = max(math.ceil(dt_s / min(self._spec.step_s or dt_s, dt_s) - LEAST_SHARE), 1)
        for _ in range(count):
            until = self._t_s + dt_s / count
            if self._exchange is not None:
                self._exchange.advance(self._t_s, until)
            else:
                self._unit.doStep(currentCommunicationPoint=self._t_s, communicationStepSize=until - self._t_s)
            self._t_s = until
        return self._read()

    def close(self) -> None:
        """Terminate and free the unit, and its folder."""
        with contextlib.suppress(Exception):  # a unit that failed may refuse to end, too
            self._unit.terminate()
            self._unit.freeInstance()
        shutil.rmtree(self._folder, ignore_errors=True)

    def _only(self, what: str) -> list[str]:
        """The only variable of a causality, where none is named."""
        names = [one.name for one in self._about.modelVariables if one.causality == what]
        if len(names) != 1:
            raise PlantFaultError(f"is missing; the FMU has these {what}s: {', '.join(names) or 'none'}", what)
        return names

    def _place(self, name: str, key: str) -> Any:  # noqa: ANN401  FMPy's variable
        if name not in self._known:
            fitting = [one.name for one in self._about.modelVariables if one.causality in {key, "local"}]
            raise PlantFaultError(missing_name("variable of the FMU", name, fitting or self._known), key)
        found = self._known[name]
        if found.type not in {*REAL, REAL_32}:
            raise PlantFaultError(f'= "{name}" is of type {found.type}; a loop needs a real number', key)
        if getattr(found, "dimensions", None):
            raise PlantFaultError(f'= "{name}" is an array; a loop needs one number', key)
        if key == "input" and found.causality != "input":
            raise PlantFaultError(f'= "{name}" is not an input of the FMU but {found.causality}', key)
        return found

    def _initialise(self) -> None:
        unit, is_2 = self._unit, self._about.fmiVersion == "2.0"
        if is_2:
            unit.setupExperiment(startTime=0.0)
        left: Any = dict(self._spec.parameters)
        try:
            left = apply_start_values(unit, self._about, left, settable=settable_in_instantiated)
        except Exception as error:  # noqa: BLE001  FMPy raises nothing more special for a value of another type
            raise PlantFaultError(f"do not fit: {error}", "parameters") from None
        if is_2:
            unit.enterInitializationMode()
        else:
            unit.enterInitializationMode(startTime=0.0)
        left = apply_start_values(unit, self._about, left, settable=settable_in_initialization_mode)
        if left:
            name = next(iter(left))
            raise PlantFaultError(f"cannot be set: the FMU has it as {_shown(self._known[name])}", "parameters", name)
        self._write(self._spec.start)
        unit.exitInitializationMode()

    def _write(self, inputs: Sequence[float]) -> None:
        for place, value in zip(self._inputs, inputs, strict=True):
            getattr(self._unit, f"set{place.type}")([place.valueReference], [value])

    def _read(self) -> list[float]:
        return [float(getattr(self._unit, f"get{one.type}")([one.valueReference])[0]) for one in self._outputs]


class _Exchange:
    """Integration of a unit's own states from one time to another, inputs held."""

    def __init__(self, unit: Any, about: Any) -> None:  # noqa: ANN401  FMPy's
        from fmpy.sundials import CVodeSolver  # noqa: PLC0415  loads compiled libraries

        self._unit, self._is_2 = unit, about.fmiVersion == "2.0"
        self._completes = about.modelExchange.needsCompletedIntegratorStep
        self._next_event_s = self._settled()
        unit.enterContinuousTimeMode()
        tolerance = about.defaultExperiment.tolerance if about.defaultExperiment else None
        self._solver = CVodeSolver(
            nx=about.numberOfContinuousStates,
            nz=about.numberOfEventIndicators,
            get_x=unit.getContinuousStates,
            set_x=unit.setContinuousStates,
            get_dx=unit.getDerivatives if self._is_2 else unit.getContinuousStateDerivatives,
            get_z=unit.getEventIndicators,
            get_nominals=unit.getNominalsOfContinuousStates,
            set_time=unit.setTime,
            input=_Held(),
            startTime=0.0,
            relativeTolerance=float(tolerance or TOLERANCE),
        )

    def _settled(self) -> float:
        """Discrete states brought to rest; when the next time event is due."""
        for _ in range(MOST_EVENT_ITERATIONS):
            update = self._unit.newDiscreteStates if self._is_2 else self._unit.updateDiscreteStates
            again, over, _, _, defined, at_s = update()
            if over:
                raise PlantFaultError("the FMU asked to end the simulation")
            if not again:
                return float(at_s) if defined else math.inf
        raise PlantFaultError(f"the FMU's discrete states do not settle in {MOST_EVENT_ITERATIONS} rounds")

    def advance(self, t_s: float, until_s: float) -> None:
        """Integrate, event by event. The inputs have jumped at the start, so the solver begins anew there."""
        self._unit.enterEventMode()
        self._next_event_s = self._settled()
        self._unit.enterContinuousTimeMode()
        self._solver.reset(t_s)
        rounding = LEAST_SHARE * (until_s - t_s)
        while until_s - t_s > rounding:
            state_event, _, t_s = self._solver.step(t_s, min(until_s, max(self._next_event_s, t_s + rounding)))
            self._unit.setTime(t_s)
            step_event, over = self._unit.completedIntegratorStep() if self._completes else (False, False)
            if over:
                raise PlantFaultError("the FMU asked to end the simulation")
            if state_event or step_event or t_s >= self._next_event_s - rounding:
                self._unit.enterEventMode()
                self._next_event_s = self._settled()
                self._unit.enterContinuousTimeMode()
                self._solver.reset(t_s)


class _Held:
    """Inputs for FMPy's solver: they are held, so there is nothing to apply."""

    def apply(self, t_s: float) -> None:
        """Do nothing."""


def _shown(variable: Any, given: object = None) -> str:  # noqa: ANN401  FMPy's
    """A variable with its start value and unit; given : what it starts with instead."""
    start = variable.start if given is None else f"{given:g}" if isinstance(given, float) else given
    value = f" = {start}" if start is not None else ""
    own = variable.start if given is not None and str(variable.start) not in {str(given), start} else None
    instead = f" (the FMU's own: {own})" if own is not None else ""
    return f"{variable.name}{value}" + (f" {variable.unit}" if variable.unit else "") + instead
