"""What one session watches: a loop, or several that share what stands at the top of their file.

    [[loop]] tables + shared sections -> one Config a loop -> what must hold between the loops

Each loop is a whole configuration of its own: its table's keys, its own sections, and for what these leave out the
sections that stand at the top of the file. So everything behind the configuration deals with one loop at a time.
"""

import re
from collections.abc import Iterator, Mapping

from retuner.config.bench_config import OutputConfig
from retuner.config.model import Config
from retuner.config.plants import OF_A_PLACE, ModelSection
from retuner.config.section import Problem
from retuner.config.toml_lines import Path
from retuner.errors import UserError
from retuner.schedule.late_dataclass import dataclass

SECTIONS = ("schedule", "adaptation", "bus", "device", "scenario")
"""Sections that a loop may have for itself: [loop.schedule] and so on below its [[loop]]. [output] is the session's."""
NO_NAME = re.compile(r"[^A-Za-z0-9._-]+")  # what does not go into the name of a folder


@dataclass(frozen=True, slots=True)
class SessionConfig:
    """Configurations of the loops that one session watches.

    loops : one or more. several : written as [[loop]] tables, so rows, files and people name the loop.
    """

    loops: tuple[Config, ...]
    several: bool = False

    @property
    def output(self) -> OutputConfig:
        """What a run leaves behind, and where."""
        return self.loops[0].output

    @property
    def names(self) -> tuple[str, ...]:
        """The loops' names."""
        return tuple(config.loop.name for config in self.loops)

    @property
    def buses(self) -> tuple[tuple[int, ...], ...]:
        """The loops by the bus they hang on, as indexes, in the order of the file."""
        found: dict[tuple[str, str], list[int]] = {}
        for i, config in enumerate(self.loops):
            found.setdefault((config.bus.interface, config.bus.channel), []).append(i)
        return tuple(map(tuple, found.values()))

    @property
    def simulated(self) -> bool:
        """Whether the loops are virtual devices in this process."""
        return self.loops[0].bus.interface == "virtual"

    def place(self, name: str | None) -> int:
        """Index of the loop of this name; without a name that of the only one.

        Raises UserError: there is no such loop, or no name was given and there are several.
        """
        if name is None and len(self.loops) > 1:
            raise UserError(f"--loop: there are {len(self.loops)} loops, name one of {', '.join(self.names)}")
        if name is not None and name not in self.names:
            raise UserError(f"--loop {name}: there is no such loop; there are {', '.join(self.names)}")
        return 0 if name is None else self.names.index(name)

    def summary(self) -> dict[str, object]:
        """What it says, as JSON values."""
        if not self.several:
            return self.loops[0].summary()
        return {"loops": [config.summary() for config in self.loops]}

    def problems(self) -> Iterator[tuple[int, Problem]]:
        """What does not go together between loops: index of the later loop, and the problem."""
        for i, later in enumerate(self.loops):
            for earlier in self.loops[:i]:
                name, bus, other = later.loop.name, later.bus, earlier.bus
                before = f'"{earlier.loop.name}"'
                if folder_name(name).lower() == folder_name(earlier.loop.name).lower():
                    message = f'= "{name}" names the files of {before}, too; give another name'
                    yield i, Problem(("loop", "name"), message)
                if (bus.interface == "virtual") != (other.interface == "virtual"):
                    both = f'= "{bus.interface}" and "{other.interface}" above'
                    yield i, Problem(("bus", "interface"), f"{both}: simulated loops have a session of their own")
                (shared, model), (same, as_there) = _shared_plant(later), _shared_plant(earlier)
                if shared and shared == same and model != as_there:
                    message = f'= "{shared}" is another model for {before}; write it once, above all [[loop]]'
                    yield i, Problem(("device", "plant", "shared"), message)
                if (bus.interface, bus.channel) != (other.interface, other.channel):
                    continue
                if later.node == earlier.node:
                    message = f"= {later.node} is the number of {before} on the same bus; each controller has its own"
                    yield i, Problem(later.node_key, message)
                if bus.hop_limit != other.hop_limit:
                    both = f"= {bus.hop_limit}, and {other.hop_limit} for {before} on the same bus"
                    yield i, Problem(("bus", "hop_limit"), f"{both}; make them equal")


def _shared_plant(config: Config) -> tuple[str, dict[str, object]]:
    """Name and settings of the plant that a loop shares with others; no name for none."""
    plant = config.device.plant if config.device else None
    return (plant.shared, plant.model_dump(exclude=OF_A_PLACE)) if isinstance(plant, ModelSection) else ("", {})


def folder_name(loop: str) -> str:
    """A loop's name as a folder may have it."""
    return NO_NAME.sub("-", loop).strip("-.") or "loop"


def loop_documents(document: Mapping[str, object]) -> list[dict[str, object]]:
    """A document with [[loop]] tables as one document a loop, each with what all share."""
    tables = document["loop"]
    assert isinstance(tables, list)
    shared, found = {name: value for name, value in document.items() if name != "loop"}, []
    for table in tables:
        own = {name: table[name] for name in SECTIONS if name in table} if isinstance(table, Mapping) else {}
        loop = (
            {name: value for name, value in table.items() if name not in own} if isinstance(table, Mapping) else table
        )
        found.append({**_joined(shared, own), "loop": loop})
    return found


def _joined(shared: Mapping[str, object], own: Mapping[str, object]) -> dict[str, object]:
    """Tables key by key, the own ones first; one of another kind stands alone, and so do arrays."""
    found = dict(shared)
    for name, value in own.items():
        before = shared.get(name)
        if isinstance(before, Mapping) and isinstance(value, Mapping):
            same = value.get("kind", before.get("kind")) == before.get("kind")
            found[name] = _joined(before, value) if same else value
        else:
            found[name] = value
    return found


def written_at(path: Path, loop: int, lines: Mapping[Path, int]) -> Path:
    """Where a key of a loop's configuration stands in the file: in its own tables, or in those that all share."""
    if path[:1] == ("loop",):
        return ("loop", loop, *path[1:])
    own = ("loop", loop, *path)
    return own if _depth(own, lines) - 2 >= _depth(path, lines) else path


def _depth(path: Path, lines: Mapping[Path, int]) -> int:
    return max(n for n in range(len(path) + 1) if path[:n] in lines)
