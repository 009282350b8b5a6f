"""What a person reads after a session: report, pictures, scores, words."""
