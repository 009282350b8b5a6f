"""The key file: who may read it, what may be in it, and that no message shows it."""

import os
from pathlib import Path

import pytest

from retuner.drivers.device import DeviceError
from retuner.drivers.host.key_file import KeyFileError, read_key

KEY = "00112233445566778899aabbccddeeff"


def key_file(folder: Path, text: str | bytes = KEY, mode: int = 0o600) -> Path:
    path = folder / "key"
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    path.chmod(mode)
    return path


@pytest.mark.parametrize("text", [KEY, KEY + "\n", KEY.upper(), "0011 2233 4455 6677\n8899 aabb ccdd eeff\n"])
def test_a_private_file_of_hexadecimal_digits_is_a_key(tmp_path: Path, text: str) -> None:
    assert read_key(key_file(tmp_path, text)) == bytes.fromhex(KEY)


@pytest.mark.parametrize("mode", [0o604, 0o640, 0o620, 0o602, 0o777, 0o644])
def test_a_file_that_others_may_use_is_refused(tmp_path: Path, mode: int) -> None:
    with pytest.raises(KeyFileError, match=rf"others can read or write it \(mode {mode:o}\); chmod 600"):
        read_key(key_file(tmp_path, mode=mode))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "0 bytes; give at least 16"),
        (KEY[:-2], "15 bytes; give at least 16"),
        (KEY + "0", "not hexadecimal"),
        ("secret" * 9, "not hexadecimal"),
        (b"\xff\xfe" * 20, "not hexadecimal"),
        (KEY * 200, "a key has at most 4096"),
    ],
)
def test_what_is_no_key_is_refused_without_showing_it(tmp_path: Path, text: str | bytes, message: str) -> None:
    with pytest.raises(KeyFileError, match=message) as caught:
        read_key(key_file(tmp_path, text))
    assert isinstance(caught.value, DeviceError)
    assert "secret" not in str(caught.value)
    assert KEY[:8] not in str(caught.value)


def test_what_is_no_plain_file_is_refused(tmp_path: Path) -> None:
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe, 0o600)
    for path, message in [
        (tmp_path / "none", "No such file"),
        (tmp_path, "directory|not a plain file"),
        (pipe, "not a plain file"),
        (Path("/dev/zero"), "not a plain file|others may"),
    ]:
        with pytest.raises(KeyFileError, match=message):
            read_key(path)
