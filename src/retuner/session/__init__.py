"""The live session: what runs, writes, records and takes orders."""
