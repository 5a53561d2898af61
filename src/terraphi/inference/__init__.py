"""From measured forces to a friction angle with its uncertainty, and whether to believe it."""
