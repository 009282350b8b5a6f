"""`python -m retuner`, and the command `retuner`."""

import gc

OBJECTS = 50_000  # new ones after which rings of them are looked for; at Python's 700 that takes 4 % of a command


def main() -> int:
    """Run the command line of this process; the exit status."""
    gc.set_threshold(OBJECTS)
    from retuner.cli import main as command  # noqa: PLC0415  loading makes most of them

    return command()


if __name__ == "__main__":
    raise SystemExit(main())
