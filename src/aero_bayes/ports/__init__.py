"""Where a term may be missing in a flat model, and how large what acts there is."""
