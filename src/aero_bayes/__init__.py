"""Modelica model -> FMU -> fit -> honest posterior -> the effect the model lacks."""
