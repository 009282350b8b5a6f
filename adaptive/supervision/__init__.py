"""The decision: from a response by its stages to a proposal and a verdict, and the Retuner that keeps the state."""
