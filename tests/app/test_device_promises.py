"""What docs/devices.md says that a profile can do is what it can do."""

from pathlib import Path

import pytest

from retuner.config.described import make_access
from retuner.config.loading import load_config

ROOT = Path(__file__).parents[2]
PROFILES = ("odrive", "cia402", "cia404")


def promised() -> dict[str, dict[str, bool]]:
    """The table of the page: promise to profile to whether it holds."""
    text = (ROOT / "docs" / "devices.md").read_text()
    lines = [line.strip("| ").split(" | ") for line in text.splitlines() if line.startswith("| ")]
    start = next(
        i for i, cells in enumerate(lines) if cells[1:] == ["native", *PROFILES] or cells == ["native", *PROFILES]
    )
    names = ("native", *PROFILES)
    rows = [cells for cells in lines[start + 1 :] if len(cells) == 5]
    return {cells[0]: dict(zip(names, (cell == "yes" for cell in cells[1:]), strict=True)) for cells in rows}


@pytest.mark.parametrize("profile", PROFILES)
def test_the_page_says_what_the_profile_can_do(profile: str) -> None:
    config = load_config(ROOT / "examples" / f"{profile}.toml")
    assert config.foreign_device is not None
    access = make_access(config, config.foreign_device)
    table = promised()
    assert len(table) == 7
    assert table["whole set at once"][profile] == access.units.atomic
    assert table["gains read back"][profile] == access.reads_back
    assert table["each write acknowledged"][profile] == access.acknowledges
    stops = bool(config.foreign_device.stop) or config.foreign_device.kind == "canopen"  # emergencies
    assert table["tells of a stop of its own"][profile] == stops
    assert all(table["whole set at once"][name] for name in ("native",))
