"""What a term may be: laws read from Modelica, at a port, in a flat model, in the source, around an FMU."""
