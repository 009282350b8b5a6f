"""What a response says where no model is known: pattern rules and the slow-oscillation rule, step by step."""
