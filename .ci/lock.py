"""Write requirements.lock from what is installed: first what the program needs, then what its tests need besides."""

import re
from importlib.metadata import distribution, distributions
from pathlib import Path

from packaging.requirements import Requirement

OURS = "aero-bayes"


def key(name: str) -> str:
    return re.sub(r"[-_.]+", "-", name).lower()


def needed(name: str, extras: frozenset[str], seen: set[str]) -> None:
    """Add the keys of a package and of all that it needs, here and with these extras."""
    if key(name) not in seen or extras:
        seen.add(key(name))
        for text in distribution(name).requires or ():
            one = Requirement(text)
            if one.marker is None or any(one.marker.evaluate({"extra": extra}) for extra in ("", *extras)):
                needed(one.name, frozenset(one.extras), seen)


program = {key("pip")}  # which the virtual environment is made without
needed(OURS, frozenset(), program)
found = {key(d.metadata["Name"]): f"{d.metadata['Name']}=={d.version}" for d in distributions()}
del found[OURS]
lines = ["# What the program needs, each package that a package needs, too"]
lines += [found[name] for name in sorted(program & set(found))]
lines += ["# What tests, studies and documentation need besides"]
lines += [found[name] for name in sorted(set(found) - program)]
(Path(__file__).parents[1] / "requirements.lock").write_text("\n".join(lines) + "\n", encoding="utf-8")
