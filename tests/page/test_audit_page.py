"""The audit's page in a real browser: ten thousand rows, of which only those in sight are drawn; a loop on demand."""

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from chromium import Seen
from selenium.webdriver.common.by import By

from retuner import PidGains, ProcessModel, ProcessType
from retuner.audit.catalogue import Task
from retuner.audit.loop_row import AuditSettings, audit_task
from retuner.audit.ranked_loops import write_results
from retuner.drivers.plants.linear_plant import LinearPlant
from retuner.schedule import pid

pytestmark = [pytest.mark.slow, pytest.mark.uncounted]
VALVE = Path(__file__).parent.parent / "data" / "plant" / "FIC20102_1016_12.csv"
LOOPS = 10_000
SLOW = "FIC00777"
BEGIN, END = "const AUDIT = ", ";\n"


def sluggish(path: Path) -> Path:
    """A loop at an eighth of the rule's gain under load steps."""
    process, rng = ProcessModel(ProcessType.FOPDT, 1.0, 60.0, theta_s=20.0), np.random.default_rng(2)
    plant, law = LinearPlant(process.linear(), start_pv=50.0), pid.law(PidGains.from_ideal(0.19, 60.0))
    state: pid.StateTuple = pid.start(law, 50.0, 50.0, 50.0)
    pv, lines = 50.0, ["t,sp,pv,co"]
    for i in range(800):
        state, co = pid.step(law, state, 50.0 + 3.0 * (i > 500), pv, 5.0)
        lines.append(f"{5 * i},{50.0 + 3.0 * (i > 500)},{pv:.4f},{co:.4f}")
        pv = plant.step(co, 6.0 * (100 < i < 300), 5.0) + 0.05 * rng.normal()
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return path


@pytest.fixture(scope="module")
def plant(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """An audit of a real valve and of a loop that could not be judged, its list copied to ten thousand rows."""
    folder = tmp_path_factory.mktemp("audit")
    rows = audit_task(Task(("FIC20102",), (VALVE,), separate=True), AuditSettings(1))
    rows += audit_task(Task((SLOW,), (sluggish(folder / "slow.csv"),), separate=True), AuditSettings(1))
    rows += audit_task(Task(("gone",), (folder / "gone.csv",), separate=True), AuditSettings(1))
    write_results(folder, rows, [], [(folder / "notes.txt", "notes.txt: no row of numbers")], [folder])
    page = json.loads((folder / "audit-data.js").read_text(encoding="utf-8").removeprefix(BEGIN).removesuffix(END))
    by_tag = {row["tag"]: row for row in page["rows"]}
    first, slow, last = by_tag["FIC20102"], by_tag[SLOW], by_tag["gone"]
    rest = [first | {"tag": f"FIC{i:05d}", "place": i, "why": None, "confidence": i / LOOPS} for i in range(2, LOOPS)]
    rest[775] = slow | {"place": 777}
    page["rows"] = [first | {"place": 1}, *rest, last | {"place": LOOPS}]
    (folder / "audit-data.js").write_text(BEGIN + json.dumps(page) + END, encoding="utf-8")
    return folder


def rows_in_sight(seen: Seen) -> list[str]:
    tags: list[str] = seen.driver.execute_script(
        "return [...document.querySelectorAll('#tall .row')].map(row => row.children[1].textContent)"
    )
    return tags


def test_ten_thousand_rows_are_sorted_filtered_and_opened(plant: Path, browsers: Callable[..., Seen]) -> None:
    seen = browsers()
    seen.open(f"file://{plant / 'index.html'}")
    seen.sees("10000 of 10000 loops")
    assert rows_in_sight(seen)[:2] == ["FIC20102", "FIC00002"]
    assert len(rows_in_sight(seen)) < 100
    seen.sees("notes.txt: no row of numbers")
    seen.sees("Nothing was written to any controller")
    seen.sees("avoidable (Harris index)")
    small = "return document.querySelector('#first canvas').toDataURL().length"
    assert seen.driver.execute_script(small) > 1_000

    seen.press("sure")
    seen.wait(lambda: rows_in_sight(seen)[0] == "FIC09999", "the surest is not at the top")
    seen.driver.execute_script("document.getElementById('rows').scrollTop = 28 * 5000")
    seen.wait(lambda: "FIC05000" in rows_in_sight(seen), "rows further down are not drawn")
    seen.driver.find_element(By.ID, "tag").send_keys("20102")
    seen.sees("1 of 10000 loops")

    seen.driver.execute_script("document.querySelector('#tall .row').click()")
    seen.sees("FIC20102: stiction")
    seen.sees("To do: repair the valve")
    seen.sees(VALVE.name)
    drawn = "return [...document.querySelectorAll('canvas')].map(c => c.toDataURL().length)"
    assert min(seen.driver.execute_script(drawn)) > 5_000
    seen.picture("audit")

    seen.driver.find_element(By.ID, "tag").clear()
    seen.driver.find_element(By.ID, "tag").send_keys(SLOW)
    seen.sees("1 of 10000 loops")
    seen.driver.execute_script("document.querySelector('#tall .row').click()")
    seen.sees(f"{SLOW}: sluggish")
    seen.sees("avoidable (simulated on the identified process")
    seen.sees("by simulation with these settings")
    seen.sees("less over the plausible models")
    assert seen.errors() == []


def test_a_link_opens_its_loop_and_a_failed_one_tells_why(plant: Path, browsers: Callable[..., Seen]) -> None:
    seen = browsers(420, 900, dark=True)
    seen.open(f"file://{plant / 'index.html'}#gone")
    seen.sees("gone: could not be judged")
    seen.sees("no such file")
    assert not seen.wider_than_the_screen()
    assert seen.errors() == []
