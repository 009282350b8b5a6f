"""What the loop's behaviour says and what to do about it: patterns, causes, models, rules, guard. Pure."""
