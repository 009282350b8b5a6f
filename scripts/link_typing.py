"""Lay .typing/retuner: a git-ignored tree of links in which a type checker finds retuner.schedule and the rest.

The rooms stand at the top level and are installed as subpackages; editable installs do that with an import hook,
which type checkers do not run. Run from anywhere: python scripts/link_typing.py
"""

import os
import shutil
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
ROOMS = ("schedule", "adaptive", "drivers")


def main() -> None:
    """Make the tree anew."""
    tree = ROOT / ".typing" / "retuner"
    shutil.rmtree(tree.parent, ignore_errors=True)
    tree.mkdir(parents=True)
    sources = [*(ROOT / "src" / "retuner").iterdir(), *(ROOT / room for room in ROOMS)]
    for source in sources:
        if source.name != "__pycache__" and not source.is_symlink():  # an editable install links the rooms there
            (tree / source.name).symlink_to(os.path.relpath(source, tree))


if __name__ == "__main__":
    main()
