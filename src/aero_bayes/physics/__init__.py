"""Ports found in a model, laws of a library, and laws written into the user's Modelica source."""
