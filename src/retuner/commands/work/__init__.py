"""What commands do once their options are read: loaded when one is called, so that `--help` waits for none of it."""
