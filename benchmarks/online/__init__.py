"""How good is retuning on line? The measurements behind docs/online.md, as one command: `python benchmarks/online`."""
