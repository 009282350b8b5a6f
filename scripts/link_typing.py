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
    """Make the tree, anew where it is not as it should be: a type checker may be reading it."""
    tree = ROOT / ".typing" / "retuner"
    sources = [*(ROOT / "src" / "retuner").iterdir(), *(ROOT / room for room in ROOMS)]
    wanted = {  # an editable install links the rooms in src, too
        source.name: os.path.relpath(source, tree)
        for source in sources
        if source.name != "__pycache__" and not source.is_symlink()
    }
    if tree.is_dir() and {link.name: str(link.readlink()) for link in tree.iterdir() if link.is_symlink()} == wanted:
        return
    shutil.rmtree(tree.parent, ignore_errors=True)
    tree.mkdir(parents=True)
    for name, target in wanted.items():
        (tree / name).symlink_to(target)


if __name__ == "__main__":
    main()
