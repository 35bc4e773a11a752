"""Modelica source to FMU: flat models, their solution for the derivatives, and the C code and description of the FMU.

>>> from pathlib import Path
>>> from aero_bayes import export_fmu
>>> export_fmu("Aero.Systems.OneDof", Path("OneDof.fmu"))  # doctest: +SKIP
"""
