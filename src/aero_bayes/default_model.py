"""What is worked on where no model is named."""

DEFAULT_MODEL = "Aero.Systems.OneDof"
