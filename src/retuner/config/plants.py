"""[device.plant]: what stands behind a virtual device, a plant of ours or a model of the user's."""

from collections.abc import Iterator
from typing import Annotated, Literal

from pydantic import Field

from retuner.config.section import Many, Problem, Section, holding, setting
from retuner.drivers.plants.boiler_plant import BoilerSettings
from retuner.drivers.plants.foreign_model import Parameter
from retuner.drivers.plants.oven_plant import OvenSettings

LARGE = 1e9  # what a number of a model may be: no physical one is larger in any usual unit


class LoadConfig(Section):
    """[[device.plant.loads]]: a recorded load on top of the plant: how a column moved from its first value on."""

    file: str = setting("File with the record, as diagnose reads it", "1..1024 characters")
    column: str = setting("Column of the load", "1..128 characters")
    time: str = setting("Column of the time; empty: found as diagnose finds it", "0..128 characters", "", "none")
    at: Literal["input", "output"] = setting(
        "Where it acts: at the plant's input in % of co, or at its output in pv units",
        default="input",
        source="where loads act in most plants",
    )
    scale: float = setting("Load for one of the column's", f"{-LARGE}..{LARGE}", 1.0, "none")
    repeat: bool = setting(
        "Whether it begins again after its last row; else it stays there", default=False, source="none"
    )


class _PlantSection(Section):
    loads: Many[LoadConfig] = setting("Recorded loads", default=(), source="none")


@holding(OvenSettings)
class OvenPlantConfig(_PlantSection):
    """[device.plant] with kind = "oven": a laboratory oven, 20 to 220 degC."""

    kind: Literal["oven"] = setting("Which plant")
    start_c: float = setting("Temperature at the start", "-50..500 degC", 20.0, "a room")

    def settings(self) -> OvenSettings:
        """The oven's physics as the plant takes it."""
        return OvenSettings(**self.model_dump(exclude={"kind", "start_c", "loads"}))


class LinearPlantConfig(_PlantSection):
    """[device.plant] with kind = "linear": G(s) = k prod(1 + lead s) / (s^n prod(1 + lag s)) e^(-theta s), exact."""

    kind: Literal["linear"] = setting("Which plant")
    k: float = setting("Gain; per second for an integrating plant", "-1e9..1e9 pv/%")
    lags_s: Many[Annotated[float, Field(ge=0, le=1e9)]] = setting("Lags", "s", ())
    leads_s: Many[Annotated[float, Field(ge=-1e9, le=1e9)]] = setting(
        "Leads; a negative one is an inverse response", "s", ()
    )
    theta_s: float = setting("Dead time", "0..1e7 s", 0.0)
    integrators: int = setting("Number of integrators", "0..2", 0)
    start_pv: float = setting("pv at the start, at rest", "-1e9..1e9 pv", 0.0)
    start_co_pct: float = setting("Output that holds start_pv", "-200..200 %", 50.0, "user")
    noise: float = setting("Standard deviation of the measurement noise", "0.. pv", 0.0)

    def problems(self) -> Iterator[Problem]:
        """A process that moves and that can be built."""
        if self.k == 0:
            yield Problem(("k",), "= 0: the output would not move this plant; give its gain")
        if len(self.leads_s) > len(self.lags_s) + self.integrators:
            there = f"{len(self.leads_s)} leads for {len(self.lags_s) + self.integrators} lags and integrators"
            yield Problem(("leads_s",), f"has {there}; a plant needs at least as many of these")


@holding(BoilerSettings)
class BoilerPlantConfig(_PlantSection):
    """[device.plant] with kind = "boiler": a continuous-flow boiler: gain by temperature, lag and delay by flow."""

    kind: Literal["boiler"] = setting("Which plant; a load is the change of its flow")
    start_c: float = setting("Temperature at the start", "0..500 degC", 30.0)

    def settings(self) -> BoilerSettings:
        """The boiler's physics as the plant takes it."""
        return BoilerSettings(**self.model_dump(exclude={"kind", "start_c", "loads"}))


OF_A_PLACE = {  # settings of a loop's place; the others are the model's, and equal for all of its loops
    "input", "output", "aux", "load_input", "start_co_pct", "noise", "loads", "input_scale", "input_offset",
    "output_scale", "output_offset", "start_pv",
}  # fmt: skip
Rows = Many[Many[Annotated[float, Field(ge=-LARGE, le=LARGE)]]]


class ModelSection(_PlantSection):
    """What every model of several inputs and outputs has: how a loop hangs on it."""

    shared: str = setting(
        "Name of a plant on which several loops act: those that give the same one share one model; empty: its own",
        "0..64 characters",
        "",
    )
    input: str = setting(
        "Input that the controller's output moves; empty where the model has one", "0..128 characters", "", "the model"
    )
    output: str = setting(
        "Output that is the loop's pv; empty where the model has one", "0..128 characters", "", "the model"
    )
    aux: str = setting("Another output, which the device publishes as PLANT.aux; empty: none", "0..128 characters", "")
    load_input: str = setting(
        "Input that the scenario's loads move; empty: they are added to co", "0..128 characters", ""
    )
    start_co_pct: float = setting("Output at the start, under which the model is at rest", "-200..200 %", 50.0)
    noise: float = setting("Standard deviation of the measurement noise", f"0..{LARGE} pv", 0.0)

    def problems(self) -> Iterator[Problem]:
        """Names that need each other."""
        if bool(self.input) != bool(self.output):
            here, other = ("output", "input") if self.input else ("input", "output")
            yield Problem((here,), f"is missing; name it as well as {other}")
        for key in ("aux", "load_input", "shared"):
            if getattr(self, key) and not self.input:
                yield Problem((key,), "needs input and output by name, too; add them")


class _ForeignModelSection(ModelSection):
    parameters: dict[str, Parameter] = setting(
        "Parameters and start values by name", default={}, source="the model's own"
    )
    input_scale: float = setting("Of the model's input for 1 % of co", f"{-LARGE}..{LARGE}", 1.0, "the model is in %")
    input_offset: float = setting("The model's input at co = 0", f"{-LARGE}..{LARGE}", 0.0, "the model is in %")
    output_scale: float = setting("pv for one of the model's output", f"{-LARGE}..{LARGE}", 1.0, "the same unit")
    output_offset: float = setting("pv where the model's output is 0", f"{-LARGE}..{LARGE} pv", 0.0, "the same unit")
    settle_s: float = setting(
        "How long the model is run on start_co_pct before the bench begins, for one that does not begin at rest",
        f"0..{LARGE} s",
        0.0,
        "it begins at rest",
    )
    patience_s: float = setting(
        "Time of the machine that a step, or the model's beginning, may take; then it counts as hanging",
        ">0..3600 s",
        60.0,
        "large imports on a busy machine take half a minute",
    )


class PythonPlantConfig(_ForeignModelSection):
    """[device.plant] with kind = "python": an object with a method step(co, dt) that returns pv."""

    kind: Literal["python"] = setting("Which plant")
    model: str = setting('The class: "module:Class" or "folder/file.py:Class"', "3..1024 characters")


class FmuPlantConfig(_ForeignModelSection):
    """[device.plant] with kind = "fmu": a functional mock-up unit of FMI 2 or 3; needs the extra fmu."""

    kind: Literal["fmu"] = setting("Which plant")
    file: str = setting("The FMU", "1..1024 characters")
    interface: Literal["", "co_simulation", "model_exchange"] = setting(
        "Which interface of an FMU that has both; empty: co-simulation, where it has it",
        default="",
        source="the FMU brings its solver",
    )
    step_s: float = setting("Longest communication step; 0: the loop's sample time", f"0..{LARGE} s", 0.0, "none")


class StateSpacePlantConfig(ModelSection):
    """[device.plant] with kind = "state_space": matrices about the start, with dead times; exact."""

    kind: Literal["state_space"] = setting("Which plant")
    model: str = setting(
        'A system of python-control or scipy.signal in place of matrices: "module:name" or "folder/file.py:name"',
        "0..1024 characters",
        "",
    )
    a: Rows = setting("Matrix A, by rows", "1/s", ())
    b: Rows = setting("Matrix B, inputs in %", default=())
    c: Rows = setting("Matrix C, outputs in pv units", default=())
    d: Rows = setting("Matrix D; empty: none", default=())
    theta_s: float | Rows = setting(
        "Dead time: one, or a row for each output with one for each input", "s", 0.0, "none"
    )
    inputs: Many[str] = setting("Names of the inputs, in the order of B's columns", default=(), source="user")
    outputs: Many[str] = setting("Names of the outputs, in the order of C's rows", default=(), source="user")
    start_pv: float = setting("pv at the start, at rest", f"{-LARGE}..{LARGE} pv", 0.0, "user")

    def problems(self) -> Iterator[Problem]:
        """One description of the system."""
        yield from super().problems()
        if bool(self.model) == bool(self.c):
            yield Problem(("model",), "or the matrices a, b, c: give one of them")


class IdentifiedPlantConfig(_PlantSection):
    """[device.plant] with kind = "identified": the plant of a record, as `retuner identify` found it, and its load."""

    kind: Literal["identified"] = setting("Which plant")
    file: str = setting("What retuner identify RECORD --json printed", "1..1024 characters")
    record: str = setting("The record, for its load and its start", "1..1024 characters")
    load: Literal["alike", "recorded"] = setting(
        "Another load of the same spectrum, or the record's own", default="alike"
    )


OwnPlant = OvenPlantConfig | LinearPlantConfig | BoilerPlantConfig | IdentifiedPlantConfig
PlantConfig = Annotated[
    OwnPlant | PythonPlantConfig | FmuPlantConfig | StateSpacePlantConfig, Field(discriminator="kind")
]
