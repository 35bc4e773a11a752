"""Recordings of the AERO: with the columns that its package declares."""

from functools import partial

from aero_bayes.data import Layout, read_recording
from aero_bayes.modelica.library import declaration_of

read_aero = partial(read_recording, layout=Layout.of(declared=declaration_of("Aero.Systems.OneDof")))
