"""How good is retuning on line? The measurements of docs/developers/online.md: `python benchmarks/online`."""
