"""Small models from Modelica written in the tests, exported once a session."""

from __future__ import annotations
