"""Numbers, units and names as a person reads them."""

from __future__ import annotations

import math
import re
import unicodedata
from collections.abc import Collection, Mapping
from dataclasses import dataclass

from markupsafe import Markup, escape

_SUPERSCRIPT = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")
_PREFIXED = {"V", "A", "rad", "rad/s", "N", "N·m", "s", "m", "Ω", "H"}
NO_VALUE = "–"
#: What a unit begins with.
_UNIT = r"(?:[µmk]?(?:m|s|V|A|K|Hz|g|N|rad|J|W|Pa|Ω|Ohm|H|F)|%|°|min|h|degC|bar)(?![A-Za-z])"


def significant(value: float | None, digits: int = 3) -> str:
    """Write ``digits`` significant digits, a power of ten only where the number would be unreadable without."""
    if value is None or not math.isfinite(value):
        return NO_VALUE
    if value == 0:
        return "0"
    if not 1e-4 <= abs(value) < 1e5:
        mantissa, exponent = f"{value:.{digits - 1}e}".split("e")
        return minus(f"{mantissa}×10{str(int(exponent)).translate(_SUPERSCRIPT)}")
    rounded = float(f"{value:.{digits - 1}e}")
    decimals = max(0, digits - 1 - math.floor(math.log10(abs(rounded))))
    return minus(f"{rounded:.{decimals}f}")


def tidy(value: float | None, digits: int = 4) -> str:
    """Write a number as ``significant`` does, without zeros that only pad; whole numbers in full."""
    if value is not None and float(value).is_integer() and abs(value) < 1e15:
        return count(value) if abs(value) >= 1e4 else minus(f"{value:.0f}")
    mantissa, times, power = significant(value, digits).partition("×")
    return (mantissa.rstrip("0").rstrip(".") if "." in mantissa else mantissa) + times + power


def minus(text: str) -> str:
    """Return a true minus sign in place of the hyphen."""
    return text.replace("-", "−")


def signed(value: float, decimals: int) -> str:
    """Return a change with its sign, none where it rounds to zero."""
    text = f"{value:+.{decimals}f}"
    return minus(text if float(text) else text[1:])


def count(value: float | None) -> str:
    """Return a whole number in groups of three digits, set apart by thin spaces."""
    return NO_VALUE if value is None or not math.isfinite(value) else minus(f"{round(value):,}".replace(",", "\u202f"))


def duration(seconds: float | None) -> str:
    """Return a time span in the unit a person would say."""
    if seconds is None:
        return NO_VALUE
    if seconds < 1:
        return f"{significant(1e3 * seconds, 2)} ms"
    if seconds < 120:
        return f"{significant(seconds, 3)} s"
    minutes, rest = divmod(round(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours} h {minutes:02d} min" if hours else f"{minutes} min {rest:02d} s"


@dataclass(frozen=True)
class RoundedValue:
    """A value and its interval, rounded to what the interval justifies, over a common power of ten."""

    value: str
    low: str
    high: str
    unit: str

    @property
    def apart(self) -> RoundedValue:
        """The numbers with the power of ten at each, where unit and number stand apart."""
        power, _, unit = self.unit.partition(" ") if self.unit.startswith("×") else ("", "", self.unit)
        value, low, high = (x if x == NO_VALUE else x + power for x in (self.value, self.low, self.high))
        return RoundedValue(value, low, high, unit)


def rounded_value(
    value: float | None, low: float | None, high: float | None, unit: str, digits: int = 2
) -> RoundedValue:
    """Round a value to two digits of its interval's half-width; without an interval, to four digits.

    Of a half-width from 3.55 on that is small beside the value one digit is enough, as results of measurements are
    rounded: it moves no end by more than a seventh of the half-width."""
    sizes = [abs(x) for x in (value, low, high) if x is not None and math.isfinite(x) and x != 0]
    largest = max(sizes, default=1.0)
    power = 0 if 1e-4 <= largest < 1e5 else 3 * math.floor(math.log10(largest) / 3)
    scale = 10.0**power
    decimals = max(0, min(9, 3 - math.floor(math.log10(largest / scale))))
    if low is not None and high is not None and high > low:
        half = 0.5 * (high - low)
        mantissa, exponent = f"{half / scale:.2e}".split("e")
        fewer = value is not None and float(mantissa) >= 3.55 and half < 0.1 * abs(value)
        decimals = max(0, min(9, max(digits - fewer, 1) - 1 - int(exponent)))
    label = pretty_unit(unit)
    if power:
        label = f"×10{str(power).translate(_SUPERSCRIPT)} {label}".strip()

    def show(x: float | None) -> str:
        if x is None or not math.isfinite(x):
            return NO_VALUE
        return minus(f"{x / scale + 0.0:.{decimals}f}")

    exact = low is None or high is None
    shown = show(value)
    if exact and "." in shown:
        shown = shown.rstrip("0").rstrip(".")
    return RoundedValue(shown, show(low), show(high), label)


def pretty_unit(unit: object) -> str:
    """Write ``kg.m2`` and ``kg m^2`` as kg·m², ``ohm`` as Ω; what is not understood stays as it is."""
    text = "" if unit is None else str(unit).strip()
    if text in {"1", "-"}:
        return ""
    text = re.sub(r"\b[Oo]hms?\b", "Ω", text).replace("sqrt(s)", "√s")
    text = re.sub(r"(?<=[A-Za-zΩ)])\^?\(?(-?\d+)\)?", lambda match: match[1].translate(_SUPERSCRIPT), text)
    return re.sub(r"(?<=[\w⁰¹²³⁴⁵⁶⁷⁸⁹Ω)])\s*[ .*·]\s*(?=[A-Za-zΩ(])", "·", text)


def scaled_unit(largest: float, unit: object) -> tuple[float, str]:
    """Choose factor and unit for an axis whose greatest magnitude is ``largest``: 0.002 rad reads better as 2 mrad."""
    label = pretty_unit(unit)
    if label not in _PREFIXED or not 0 < largest < 0.1:
        return 1.0, label
    return (1e3, f"m{label}") if largest >= 1e-4 else (1e6, f"µ{label}")


def _greek(name: str) -> str:
    """Return the letter that a name spells; the name itself where it spells none."""
    try:
        return unicodedata.lookup(f"GREEK SMALL LETTER {'LAMDA' if name == 'lambda' else name.upper()}")
    except KeyError:
        return name


def greek_name(name: str) -> str:
    """Return a name with its Greek letters, for use within a figure: ``omega_m`` becomes ω_m."""
    if name.endswith("_dot") and name.count("_") == 1:
        return f"{_greek(name[:-4])}\u0307"
    head, separator, tail = name.partition("_")
    return f"{_greek(head)}{separator}{tail}"


def symbol(name: str) -> Markup:
    """Return a name as mathematics where it is a symbol (R_a, theta), else as code; always safe to put in the page."""
    head, separator, tail = name.partition("_")
    letter = _greek(head)
    if len(letter) > 2 or not letter.isalpha() or "_" in tail or not (tail.isalnum() or not separator):
        return Markup("<code>{}</code>").format(name)
    subscript = Markup("<sub>{}</sub>").format(tail) if separator else Markup("")
    return Markup('<span class="symbol"><i>{}</i>{}</span>').format(letter, subscript)


def role_words(role: str) -> str:
    """Return a recording's role as a person says it."""
    return {"train": "training"}.get(role, role)


def signal_title(name: str, unit: str, meaning: str = "") -> str:
    """Return the title of a panel: symbol, meaning, unit."""
    title = f"{greek_name(name)}: {meaning}" if meaning else greek_name(name)
    return f"{title} ({unit})" if unit else title


def named_effect(id_: str, words: Mapping[str, str]) -> Markup:
    """Write ``pivot_friction (dry friction at the pivot)``, the id set as code; ``words`` by id."""
    code = Markup("<code>{}</code>").format(id_)
    return Markup("{} ({})").format(code, words[id_]) if words.get(id_) else code


def sentence(text: object, words: Mapping[str, str] | None = None, signals: Collection[str] = ()) -> Markup:
    """Escape a text, with ``backquoted`` names and signals set as symbols, and ids of effects put in words."""
    words = words or {}
    text = re.sub(rf"(?<=\d) (?={_UNIT})", "\u00a0", str(text))  # a number keeps its unit
    parts = text.split("`")
    if len(parts) % 2 == 0:
        return _with_words(text, words, signals)
    return Markup("").join(
        (named_effect(part, words) if part in words else symbol(part))
        if index % 2
        else _with_words(part, words, signals)
        for index, part in enumerate(parts)
    )


def _with_words(text: str, words: Mapping[str, str], signals: Collection[str]) -> Markup:
    known = {*words, *(name for name in signals if symbol(name)[:5] == "<span")} - {"a"}  # the article
    names = "|".join(map(re.escape, sorted(known, key=len, reverse=True)))
    if not known:
        return escape(text)
    parts = re.split(rf"(?<!\w)({names})(?!\w)", text)
    return Markup("").join(
        escape(part) if index % 2 == 0 else named_effect(part, words) if part in words else symbol(part)
        for index, part in enumerate(parts)
    )
