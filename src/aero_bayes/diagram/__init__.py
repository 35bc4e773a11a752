"""A model's structure as a picture: from its Modelica annotations, else laid out from what it says of itself."""

from aero_bayes.diagram.build import model_diagrams

__all__ = ["model_diagrams"]
