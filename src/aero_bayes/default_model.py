"""The model that is used if none is named."""

DEFAULT_MODEL = "Aero.Systems.OneDof"
