"""What to make of a structure: what it leaves, what it predicts, and whether its terms may be named."""
