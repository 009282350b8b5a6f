"""retuner check refuses what `run` would refuse before it opens a bus: an unknown interface, an unusable key file."""

from pathlib import Path

import pytest
from command_line import answer, refused

from retuner.cli import main

OVEN = Path(__file__).resolve().parents[2] / "examples" / "oven.toml"


def configured(folder: Path, interface: str, key_file: Path | None = None) -> Path:
    text = OVEN.read_text()
    assert 'interface = "virtual"\n' in text
    key = f'key_file = "{key_file}"\n' if key_file else ""
    path = folder / "loop.toml"
    path.write_text(text.replace('interface = "virtual"\n', f'interface = "{interface}"\n{key}'))
    return path


def test_every_problem_is_one_line_with_its_place(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = configured(tmp_path, "sockercan", tmp_path / "nokey")
    line = path.read_text().splitlines().index('interface = "sockercan"') + 1
    assert main(["check", str(path)]) == 2
    first, second = capsys.readouterr().err.splitlines()
    assert first.startswith(f'{path}:{line} bus.interface = "sockercan" is no interface of python-can; choose from ')
    assert "socketcan" in first
    assert second.startswith(f"{path}:{line + 1} bus.key_file is refused: key file {tmp_path / 'nokey'}: ")
    told = answer("check", path, status=2)
    assert [one["key"] for one in told["problems"]] == ["bus.interface", "bus.key_file"]


@pytest.mark.parametrize("interface", ["virtual", "socketcan", "udp_multicast", "kvaser"])
def test_a_known_interface_and_a_good_key_pass(tmp_path: Path, interface: str) -> None:
    key = tmp_path / "key"
    key.write_text("00" * 32)
    key.chmod(0o600)
    assert main(["check", str(configured(tmp_path, interface, key))]) == 0


def test_a_key_that_others_may_read_is_refused(tmp_path: Path) -> None:
    key = tmp_path / "key"
    key.write_text("00" * 32)
    key.chmod(0o644)
    assert "others can read or write it" in refused("check", str(configured(tmp_path, "virtual", key)))
