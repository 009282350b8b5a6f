"""docs/developers/real-records.md: a picture of each real record, what the program says of it, and what is seen by eye.

    python benchmarks/real_record_page.py --data FOLDER --also servo/pid_step.csv --also servo/relay.csv
           [--step FILE] [--from FILE] [--docs docs/developers]

FOLDER and --also are those of plant_records.py. --step is a record of an open-loop step (t, pv, co). --from takes what
plant_records.py kept with --out and fits nothing again. What is seen by eye stands in real_records_by_eye.toml.
Settings that are given are held to two models that do not know of each other.
"""

import argparse
import json
import sys
import tomllib
from pathlib import Path

import numpy as np
from plant_records import MS_MOST, Row, entries_of, judge, plain_step, read

from retuner import api
from retuner.adaptive.loop.margins import sensitivity_peak

EYES = Path(__file__).with_name("real_records_by_eye.toml")
HEAD = """# Every real record, and what is said of it

46 records of 15 loops of a refinery
([StictionGPT](https://github.com/TerenceXue-tech/StictionGPT), Apache-2.0, its text in `examples/LICENSE.plant`) and
two of a [servo](https://github.com/gkeiel/dc_motor_position_control) (MIT). pv blue, setpoint orange, co green; on the
right pv over co. The controllers' settings are unknown: they are read off the record where it shows them.

Beside each picture stand the two likeliest causes by `retuner diagnose`; above them, what we see in the pictures
ourselves. Labels are those of the records' author; "no stiction" does not mean healthy. All records were known while
this was built, so the page is no test. Written by `benchmarks/real_record_page.py`.
"""


def picture(row: Row, source: Path, folder: Path) -> None:
    from matplotlib.figure import Figure

    record = read(source)
    figure = Figure(figsize=(8.4, 1.7), layout="constrained")
    over_time, over_co = figure.subplots(1, 2, width_ratios=[3.6, 1])
    t = record.t - record.t[0]
    every = max(len(t) // 1500, 1)
    over_time.plot(t[::every], record.sp[::every], lw=0.7, color="C1")
    over_time.plot(t[::every], record.pv[::every], lw=0.7, color="C0")
    second = over_time.twinx()
    second.plot(t[::every], record.co[::every], lw=0.7, color="C2")
    over_co.plot(record.co[::every], record.pv[::every], lw=0.5, color="C0")
    for axes in (over_time, second, over_co):
        axes.tick_params(labelsize=6)
        axes.ticklabel_format(useOffset=False, style="plain")
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / f"{Path(row.file).stem}.png"
    figure.savefig(path, dpi=80)
    # A smaller file: the colours of the lines and their shades towards white, and greys. A palette chosen by the
    # picture gives all of it to the greys of axes and loses the lines.
    from matplotlib.colors import to_rgb
    from PIL import Image

    palette = Image.new("P", (1, 1))
    shades = [(c, s / SHADES) for c in ("C0", "C1", "C2", "black") for s in range(1, SHADES + 1)]
    colours = [(1.0, 1.0, 1.0), *(tuple(1 - s * (1 - x) for x in to_rgb(c)) for c, s in shades)]
    palette.putpalette([round(255 * x) for colour in colours for x in colour])
    with Image.open(path) as image:
        image.convert("RGB").quantize(palette=palette, dither=Image.Dither.NONE).save(path, optimize=True)


SHADES = 6  # Shades of each line's colour: what is drawn smoothly fades into white


def agreement(rows: list[Row], eyes: dict[str, dict[str, str]]) -> list[str]:
    """How often the words say what is seen, by loop."""
    lines = ["| loop | records | label | said | the eye agrees |", "|---|---|---|---|---|"]
    for tag in dict.fromkeys(r.tag for r in rows):
        own = [r for r in rows if r.tag == tag]
        words = [_eye(r, eyes)["agrees"] for r in own]
        said = ", ".join(f"{cause} {n}" for cause, n in _counted([r.cause for r in own]))
        agrees = ", ".join(f"{word} {n}" if len(own) > 1 else word for word, n in _counted(words))
        lines.append(f"| [{tag}](#{tag.lower()}) | {len(own)} | {own[0].label} | {said} | {agrees} |")
    counts = dict(_counted([_eye(r, eyes)["agrees"] for r in rows]))
    told = ", ".join(f"{word} {counts.get(word, 0)}" for word in ("yes", "partly", "no"))
    return [f"Does the eye agree? Of {len(rows)} records: {told}.", "", *lines, ""]


def _counted(words: list[str]) -> list[tuple[str, int]]:
    """Each word with its number."""
    return [(word, words.count(word)) for word in dict.fromkeys(words)]


def _eye(row: Row, eyes: dict[str, dict[str, str]]) -> dict[str, str]:
    """What is seen in a record: its own words, or those of its loop."""
    return eyes.get(Path(row.file).stem) or eyes[row.tag]


def held_to_models(rows: list[Row], step: Path | None) -> list[str]:
    """The settings that identify and diagnose give, with Ms on models that do not know of each other."""
    lines = [
        "## Settings, held to two models",
        "",
        f"Gains given for a real record should be stable with Ms under {MS_MOST:g} on both models. The plain one is a",
        "first order with dead time, fitted to pv after the steps of setpoint (or of co) alone. It cannot describe the",
        "servo, which integrates: 99, unstable, says nothing there.",
        "",
        "| record | given by | Ms on identification's model | Ms on the plain fit |",
        "|---|---|---|---|",
    ]
    for row in rows:
        by = "diagnose" if row.retune else "identify"
        if row.ms:
            ms = [f"{value:.2f}" for value in row.ms] + ["no setpoint step"] * (2 - len(row.ms))
            lines.append(f"| {Path(row.file).stem} | {by} | {' | '.join(ms[:2])} |")
    if step is not None:
        columns = np.genfromtxt(step, delimiter=",", names=True)
        t, pv, co = (np.asarray(columns[name], dtype=np.float64) for name in ("t", "pv", "co"))
        found = api.identify(t, np.full_like(t, pv[0]), pv, co, open_loop=True)
        if found.settings is None:
            raise ValueError(f"{step}: {found.estimate.reason}")
        gains, delay = found.settings.tuning.gains, float(np.median(np.diff(t))) / 2
        models = found.estimate.log.model(), plain_step(t, pv, co)
        own, plain = (sensitivity_peak(model.seen_by_controller(2 * delay).linear(), gains) for model in models)
        lines.append(f"| {step.parent.name}, open loop | identify | {own:.2f} | {plain:.2f} |")
    return [*lines, "", "For the other records no settings are given.", ""]


def page(rows: list[Row], eyes: dict[str, dict[str, str]], step: Path | None) -> str:
    lines = [HEAD, *agreement(rows, eyes), *held_to_models(rows, step)]
    for tag in dict.fromkeys(r.tag for r in rows):
        own = [r for r in rows if r.tag == tag]
        lines += [f"## {tag}", "", f"Label: {own[0].label}. By eye: {eyes[tag]['seen']}", ""]
        for row in own:
            stem = Path(row.file).stem
            lines += [f"![{stem}](real-records/{stem}.png)", "", f"`{stem}`: **{row.told}**", ""]
            if stem in eyes and stem != tag:
                lines += [f"By eye: {eyes[stem]['seen']}", ""]
    return "\n".join(lines).rstrip() + "\n"


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", required=True, type=Path)
    parser.add_argument("--also", type=Path, action="append", default=[], metavar="FILE")
    parser.add_argument("--step", type=Path, metavar="FILE")
    parser.add_argument("--from", type=Path, dest="kept")
    parser.add_argument("--docs", type=Path, default=Path("docs/developers"))
    options = parser.parse_args()
    entries = entries_of(options.data, options.also, None)
    if options.kept is not None:
        rows = [Row(**json.loads(line)) for line in options.kept.read_text(encoding="utf-8").splitlines()]
    else:
        rows = [judge(entry) for entry in entries]
    rows.sort(key=lambda row: (not row.tag.isupper(), row.tag))
    paths = {entry["file"]: Path(entry["path"]) for entry in entries}
    for row in rows:
        picture(row, paths[row.file], options.docs / "real-records")
    eyes = tomllib.loads(EYES.read_text(encoding="utf-8"))
    (options.docs / "real-records.md").write_text(page(rows, eyes, options.step), encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
