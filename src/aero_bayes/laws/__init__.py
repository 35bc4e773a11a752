"""Physical laws that a model may lack: read from Modelica, placed at ports, put into models."""
