"""The user's filter of candidates: which effects a search may consider, and which it must include."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass

from aero_bayes.errors import InputError
from aero_bayes.unknown_names import closest_name

#: What the names under each key mean.
KEY_MEANINGS = {
    "effects": "effect", "exclude": "effect, law or port", "ports": "port", "laws": "law", "require": "effect",
}  # fmt: skip


@dataclass(frozen=True)
class CandidateFilter:
    """A filter of effects by id, law and port."""

    effects: tuple[str, ...] | None = None
    exclude: tuple[str, ...] = ()
    ports: tuple[str, ...] | None = None
    laws: tuple[str, ...] | None = None
    require: tuple[str, ...] = ()

    def accepts(self, id_: str, law: str, port: str) -> bool:
        """Return whether an effect is accepted."""
        return id_ in self.require or (
            not {id_, law, port} & set(self.exclude)
            and (self.effects is None or bool({id_, law} & set(self.effects)))
            and (self.ports is None or port in self.ports)
            and (self.laws is None or law in self.laws)
        )

    def check(self, ids: Collection[str], laws: Collection[str], ports: Collection[str]) -> None:
        """Raise InputError for an unknown name, with the closest known one, or a name both required and excluded."""
        for key, names, known in (
            ("effects", self.effects or (), [*ids, *laws]),
            ("exclude", self.exclude, [*ids, *laws, *ports]),
            ("ports", self.ports or (), [*ports]),
            ("laws", self.laws or (), [*laws]),
            ("require", self.require, [*ids]),
        ):
            for name in names:
                if name not in known:
                    close = closest_name(name, known, cutoff=0.0)
                    hint = f"did you mean {close!r}?" if close is not None else "there is none"
                    raise InputError(f"[loop] {key}: unknown {KEY_MEANINGS[key]} {name!r}; {hint}")
        for name in self.require:
            if name in self.exclude:
                raise InputError(f"[loop] require and exclude both name {name!r}")
