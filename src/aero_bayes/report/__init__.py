"""Figures of results in the look of the page, the page itself, and what ``result.json`` holds."""
