"""Make docs/oven.png, the picture of the README: the trend of the demo, as its report shows it.

python scripts/readme_picture.py
"""

from pathlib import Path

from retuner.adaptive.supervision.decision import Mode
from retuner.config import load_config
from retuner.report.plots import trend_png
from retuner.session.running import Run, nothing

ROOT = Path(__file__).resolve().parent.parent


def main() -> None:
    """Run the demo with and without retuning, and draw it."""
    config = load_config(ROOT / "examples" / "oven.toml")
    retuned = Run(config, nothing).simulated().loops[0]
    fixed = Run(config, nothing, mode=Mode.OFF).simulated().loops[0]
    commits = [t for t, _ in retuned.commits]
    png = trend_png(retuned.trend.columns(), fixed.trend.columns(), commits, config.regions(), config.loop.pv_unit)
    (ROOT / "docs" / "oven.png").write_bytes(png)


if __name__ == "__main__":
    main()
