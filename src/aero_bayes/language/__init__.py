"""The text of a model: reading Modelica, its expressions as trees, edits that keep comments, the diagram."""
