"""Calls of the library as one types them; ``test_calls.py`` runs every line in a copy of ``examples/cart``."""

from pathlib import Path

import numpy as np
import pandas as pd

import aero_bayes
from aero_bayes import LogNormal, LoopSettings, ParameterSpec, Recording

model = aero_bayes.load_model("Rig.mo")
model = aero_bayes.load_model(Path("Rig.mo"), folder="built")
model = aero_bayes.load_model("Rig", sources=["Rig.mo"])
model = aero_bayes.load_model("Rig", sources=Path("Rig.mo"))
aero_bayes.export_fmu("Rig", "Rig.fmu", sources="Rig.mo")
fmu = aero_bayes.load_model("Rig.fmu")
train = aero_bayes.read_recording("train.csv", inputs=["F"], outputs=["position"], units={"F": "N", "position": "m"})
test = aero_bayes.read_recording(Path("test.csv"), model=model)
frame = pd.read_csv("train.csv")
train = Recording.from_frame(frame, inputs=["F"], outputs=["position"], name="train")
train = Recording.from_frame(frame.set_index("time"), inputs="F", outputs="position", name="train")
t, F, y = (frame[c].to_numpy() for c in ("time", "F", "position"))
same = Recording("arrays", t, {"F": F}, {"position": y})
lists = Recording("lists", t.tolist(), {"F": F.tolist()}, {"position": y.tolist()})
early = train.slice(0.0, 28.0)
print(train.summary())
aero_bayes.data.write_csv(early, "early.csv")
fit = aero_bayes.fit(train, model, parameters="k", workers=0)
fit = aero_bayes.fit(train, model, parameters={"k": (10, 100), "d": None}, workers=0)
fit = aero_bayes.fit(train, model, parameters={"k": 40, "d": ParameterSpec(lower=0.1, upper=30)}, workers=0)
fit = aero_bayes.fit(train, model, parameters={"k": LogNormal.tolerance(50.0, 0.2), "d": (0.1, 30.0)}, workers=0)
fit = aero_bayes.fit([train, test], model, parameters=("k", "d"), workers=0)
fit = aero_bayes.fit(train, model, parameters=["k", "d"], seed=2, workers=0)
k = fit["k"].value
k, sd, unit = float(fit["k"]), fit["k"].sd, fit["k"].unit
low, high = fit["k"].q05, fit["k"].q95
table = fit.to_frame()
print(table.loc["k", "value"], fit.rms, fit.warnings)
stiffer = fit.simulate(test, parameters={"k": 100.0})
step = fit.simulate({"time": np.linspace(0.0, 2.0, 201), "F": 1.0})
fit.export_fmu("fitted.fmu")
fit.calibrated.write("fitted")
fit.to_html("fit.html")
short = aero_bayes.SampleSettings(max_steps=40)
posterior = aero_bayes.sample(fit, draws=50, chains=4, seed=3, workers=0, settings=short)
median = posterior["k"].value
posterior.save("posterior.nc")
draws = posterior.samples("k")
unseen = posterior.predict(test, draws=20)
print(unseen.rms, unseen.coverage, posterior.to_frame().loc["d", "q95"])
posterior.to_html(Path("posterior.html"))
idata = posterior.to_arviz()
print(idata.prior["k"].shape, idata.log_likelihood["train"].shape)
settings = LoopSettings(parameters=["k", "d"], laws=["coulomb_friction", "gain"])
loop = aero_bayes.close_loop(train, test, model=model, settings=settings, workers=0, out_dir="loop")
print(loop.sentence, loop["F_c"].value, float(loop["k"]), loop.to_frame())
loop.export_fmu(Path("loop.fmu"))
loop.calibrated.write(Path("loop"))
train.plot().save("train.svg")
fit.plot(dark=True).save(Path("fit.svg"))
posterior.plot(["k", "d"]).save("pairs.svg")
posterior.plot_bands().save("bands.svg")
unseen.plot().save("unseen.svg")
loop.plot().save("loop.svg")
loop.plot_rounds().save("rounds.svg")
again = aero_bayes.close_loop(fit, test, settings=LoopSettings(laws=["coulomb_friction", "gain"]), workers=0)
