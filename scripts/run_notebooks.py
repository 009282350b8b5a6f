"""Run the notebooks of docs/notebooks as they stand, and compare what they print with what they show.

python scripts/run_notebooks.py            # 1 when one fails or prints something else
python scripts/run_notebooks.py --write    # put what comes now in place of what stood there
"""

import argparse
import asyncio
import os
import sys
from pathlib import Path

import nbformat
from nbclient import NotebookClient
from nbformat import NotebookNode
from run_pages import agrees

NOTEBOOKS = Path(__file__).resolve().parents[1] / "docs" / "notebooks"
LONGEST_S = 300


def printed(notebook: NotebookNode) -> list[str]:
    """What each cell of code prints: streams and plain results, not pictures."""
    cells = [cell for cell in notebook.cells if cell.cell_type == "code"]
    return ["".join(_text(output) for output in cell.outputs).strip() for cell in cells]


def _text(output: NotebookNode) -> str:
    if output.output_type == "stream":
        return str(output.text)
    shown = output.get("data", {})
    return "" if "image/png" in shown or output.output_type == "display_data" else str(shown.get("text/plain", ""))


def run(path: Path) -> NotebookNode:
    """The notebook with what its cells print now; raises where one fails."""
    notebook = nbformat.read(path, as_version=4)
    client = NotebookClient(notebook, timeout=LONGEST_S, resources={"metadata": {"path": str(path.parent)}})
    client.execute()
    for cell in notebook.cells:
        cell.metadata = NotebookNode()  # times of execution, which differ every time
        if cell.cell_type == "code":
            joined: list[NotebookNode] = []
            for output in cell.outputs:
                if (
                    joined
                    and output.output_type == joined[-1].output_type == "stream"
                    and output.name == joined[-1].name
                ):
                    joined[-1].text += output.text
                else:
                    joined.append(output)
            cell.outputs = joined
    notebook.metadata = NotebookNode({"kernelspec": notebook.metadata.kernelspec})
    return notebook


def main() -> int:
    """Run all; 1 when one does not show what comes."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--write", action="store_true", help="put what comes now in place of what stood there")
    write = parser.parse_args().write
    os.environ.update(OPENBLAS_NUM_THREADS="1", PYDEVD_DISABLE_FILE_VALIDATION="1")
    asyncio.set_event_loop(asyncio.new_event_loop())
    differ = 0
    for path in sorted(NOTEBOOKS.glob("*.ipynb")):
        stood, now = nbformat.read(path, as_version=4), run(path)
        for number, (told, came) in enumerate(zip(printed(stood), printed(now), strict=True), start=1):
            if not agrees(told, came):
                differ += 1
                sys.stdout.write(f"{path.name}, cell of code {number}: told\n{told}\n--- came\n{came}\n")
        if write:
            nbformat.write(now, path)
    return 1 if differ and not write else 0


if __name__ == "__main__":
    sys.exit(main())
