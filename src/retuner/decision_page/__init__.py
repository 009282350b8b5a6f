"""The one-page form of a decision: what was seen, learned, blamed, proposed, proved, promised, and what came of it."""
