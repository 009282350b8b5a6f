"""--plot: where a command draws its picture."""

from pathlib import Path

from retuner.errors import UserError


def check_plot(path: Path | None) -> None:
    """Refuse a picture of another kind. Raises UserError: the name ends neither in .png nor in .svg."""
    if path is not None and path.suffix.lower() not in {".png", ".svg"}:
        raise UserError(f"--plot {path}: give a name that ends in .png or .svg")
