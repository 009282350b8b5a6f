"""Which loops of a plant deserve a visit: what months of a loop's record say, over time and beside its neighbours."""
