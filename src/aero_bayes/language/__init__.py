"""Modelica text: tokens, classes, expressions as syntax trees with their values and units, and edits of the text."""
