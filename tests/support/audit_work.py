"""Work that a process of an audit's pool can import: stands in for an audit of a loop."""

import os

from retuner.audit.catalogue import Task
from retuner.audit.loop_row import Row


def dies_or_works(task: Task) -> list[Row]:
    """One loop takes its process with it."""
    if task.tags[0] == "killer":
        os._exit(9)
    return [{"tag": tag, "rank": 0.5} for tag in task.tags]
