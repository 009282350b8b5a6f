"""Make docs/oven.svg, the picture of the README: the trend of the demo, as its report shows it.

python scripts/readme_picture.py
"""

from pathlib import Path

from retuner.adaptive.supervision.decision import Mode
from retuner.config import load_config
from retuner.decision_page.svg import svg_file
from retuner.report.run_drawings import Mark, trend_svg
from retuner.session.running import Run, nothing

ROOT = Path(__file__).resolve().parent.parent


def main() -> None:
    """Run the demo with and without retuning, and draw it."""
    config = load_config(ROOT / "examples" / "oven.toml")
    retuned = Run(config, nothing).simulated().loops[0]
    fixed = Run(config, nothing, mode=Mode.OFF).simulated().loops[0]
    marks = [Mark(t_s, 0, rolled_back=False) for t_s, _ in retuned.changes]
    run, before = retuned.trend.columns(), fixed.trend.columns()
    drawing = trend_svg(run, before, marks, config.regions(), config.loop.pv_unit)
    (ROOT / "docs" / "oven.svg").write_text(svg_file(drawing), encoding="utf-8")


if __name__ == "__main__":
    main()
