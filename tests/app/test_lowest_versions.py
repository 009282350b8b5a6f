"""What pyproject.toml allows is what the code takes; scripts/lowest_versions installs and runs it."""

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
# fmt: off
SINCE_NUMPY_2 = {
    "acos", "acosh", "asin", "asinh", "astype", "atan", "atan2", "atanh", "bitwise_count", "bitwise_invert",
    "bitwise_left_shift", "bitwise_right_shift", "concat", "cumulative_prod", "cumulative_sum", "isdtype",
    "matrix_norm", "matrix_transpose", "matvec", "permute_dims", "pow", "svdvals", "trapezoid", "unique_all",
    "unique_counts", "unique_inverse", "unique_values", "unstack", "vecdot", "vecmat", "vector_norm",
}
# fmt: on
"""Names of numpy and numpy.linalg that 1.26 does not have."""


USED = re.compile(rf"\b(?:np|numpy)(?:\.linalg)?\.({'|'.join(sorted(SINCE_NUMPY_2))})\b")


def names_of_numpy_2(source: str) -> list[str]:
    """Attributes of np and np.linalg that numpy 1.26 lacks, those in texts and comments too."""
    return USED.findall(source)


@pytest.mark.parametrize("room", ["schedule", "adaptive", "drivers", "src", "tests", "benchmarks", "scripts"])
def test_nothing_is_used_that_the_lowest_numpy_lacks(room: str) -> None:
    found = {path.name: names_of_numpy_2(path.read_text("utf-8")) for path in (ROOT / room).rglob("*.py")}
    assert {name: used for name, used in found.items() if used} == {}


def test_the_scan_sees_such_names() -> None:
    lacking = ["trapezoid", "vector_norm"]
    assert names_of_numpy_2("np.{0}(y, t) + np.linalg.{1}(y) + np.sum(y) + own.{0}(y)".format(*lacking)) == lacking


def test_every_file_that_is_run_with_the_lowest_versions_is_there() -> None:
    named = re.findall(r'"(tests/[^"]+)"', (ROOT / "scripts" / "lowest_versions.py").read_text("utf-8"))

    assert named
    assert [name for name in named if not (ROOT / name).exists()] == []
