"""Is the loss true that the audit tells of a loop that is tuned badly? The same plant again with the settings proposed.

    python benchmarks/audit/loss.py --loops 60 --days 2 --seed 1

Loops that are too strong or sluggish are audited as a historian recorded them; then all of the plant is simulated once
more under the same loads and noise, with the settings that the audit proposes for each. Printed for each loop: the
share of the mean error (and of co's travel) that the audit says may go, and that which went.
"""

import argparse
import json
import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np
from plant import Loop, draw, recorded, simulate

from retuner.audit.catalogue import Task
from retuner.audit.loop_row import AuditSettings, Row, audit_task

KINDS = ("sluggish", "aggressive")


def trends(loops: list[Loop], days: float, seed: int) -> dict[str, np.ndarray]:
    """What the loops did; equal loads and noise for equal seeds, whatever their settings."""
    return simulate(loops, days, np.random.default_rng([seed, 1]), {})


def audited(folder: Path, loops: list[Loop], found: dict[str, np.ndarray], seed: int, stretches: int) -> dict[str, Row]:
    """The rows of the loops as a historian has them."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    rng, rows = np.random.default_rng([seed, 2]), {}
    t_s = np.datetime64(1_700_000_000, "s") + (np.arange(len(found["sp"])) * 10).astype("timedelta64[s]")
    for j, loop in enumerate(loops):
        sp, pv, co = (found[name][:, j] for name in ("sp", "pv", "co"))
        path = folder / f"{loop.tag}.parquet"
        pq.write_table(pa.table({"t": t_s, "sp": sp, "pv": recorded(pv, rng), "co": recorded(co, rng)}), path)
        (rows[loop.tag],) = audit_task(Task((loop.tag,), (path,), separate=True), AuditSettings(stretches))
    return rows


def shares(before: dict[str, np.ndarray], after: dict[str, np.ndarray], j: int) -> tuple[float, float]:
    """Shares of the mean error and of co's travel that went."""

    def kept(of: dict[str, np.ndarray]) -> tuple[float, float]:
        return float(np.abs(of["sp"] - of["pv"])[:, j].mean()), float(np.abs(np.diff(of["co"][:, j])).sum())

    return tuple(1 - b / a for a, b in zip(kept(before), kept(after), strict=True))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    for name, kind, default in (("loops", int, 60), ("days", float, 2.0), ("seed", int, 1), ("stretches", int, 4)):
        parser.add_argument(f"--{name}", type=kind, default=default)
    given = parser.parse_args()
    loops = [loop for loop in draw(given.loops, np.random.default_rng(given.seed)) if loop.kind in KINDS]
    before = trends(loops, given.days, given.seed)
    with tempfile.TemporaryDirectory() as made:
        rows = audited(Path(made), loops, before, given.seed, given.stretches)
    proposed = {tag: row["settings"]["gains"] for tag, row in rows.items() if row.get("settings")}
    of = {tag: {"kc": gains["kc"], "tau_i_s": gains["tau_i"]} for tag, gains in proposed.items()}
    cured = [replace(loop, **of.get(loop.tag, {})) for loop in loops]
    after, off = trends(cured, given.days, given.seed), []
    for j, loop in enumerate(loops):
        row = rows[loop.tag]
        if row.get("basis") != "simulated":
            print(f"{loop.tag:8} {loop.kind:10} called {row['cause']}, {row['action']}")
            continue
        told, calmer = row["process"]["foreseen"]["saved"], row["process"]["foreseen"]["calmer"]
        went, less = shares(before, after, j)
        if loop.tag in proposed:
            off.append((told, went, row["screen"]["harris"]))
        print(
            f"{loop.tag:8} {loop.kind:10} called {row['cause']}, {row['action']}: error told {told:+.2f}, "
            + (f"went {went:+.2f}; travel told {calmer:+.2f}, went {less:+.2f}" if loop.tag in proposed else "")
        )
    if off:
        told, went, harris = np.array(off).T
        print(json.dumps({
            "seed": given.seed, "loops": len(loops), "proposed": len(off),
            "median |told - went|": round(float(np.median(np.abs(told - went))), 3),
            "largest": round(float(np.max(np.abs(told - went))), 3),
            "median |Harris - went|": round(float(np.median(np.abs(1 - np.sqrt(1 - harris) - went))), 3),
        }))  # fmt: skip


if __name__ == "__main__":
    main()
