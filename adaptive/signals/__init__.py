"""What a sample is, its noise band, and the recogniser that finds responses in a stream of them."""
