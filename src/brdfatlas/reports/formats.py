"""How numbers look on a page: the same everywhere, for people."""

import math
import re
from typing import Any

from markupsafe import Markup, escape

MISSING = "–"


def _number(value: Any) -> float | None:
    if value is None or isinstance(value, bool | str):
        return None
    try:
        value = float(value)
    except (TypeError, ValueError):
        return None
    return None if math.isnan(value) else value


def digits(value: Any, places: int | None = 2) -> str:
    """A fixed number of decimals, significant digits without one; – for a missing number, ∞ for an exact match."""
    if places is None:
        return number(value)
    found = _number(value)
    if found is None:
        return MISSING
    if math.isinf(found):
        return "∞" if found > 0 else "−∞"
    return f"{found:.{places}f}".replace("-", "−")


def number(value: Any) -> str:
    """Four significant digits, with a power of ten only where it helps."""
    found = _number(value)
    if found is None:
        return MISSING
    if math.isinf(found):
        return "∞" if found > 0 else "−∞"
    if found == 0:
        return "0"
    size = abs(found)
    if 1e-4 <= size < 1e6:
        places = max(0, 3 - math.floor(math.log10(size)))
        return f"{found:.{places}f}".replace("-", "−")
    mantissa, exponent = f"{found:.2e}".split("e")
    superscript = str(int(exponent)).translate(str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹"))
    return f"{mantissa} · 10{superscript}".replace("-", "−")


def integer(value: Any) -> str:
    """A whole number with thousands apart; – where there is none."""
    found = _number(value)
    return MISSING if found is None or math.isinf(found) else f"{round(found):,}".replace(",", " ")


def error(value: Any) -> str:
    """A standard error with two significant digits at most: 0.013, 0.2, 1.4; never 0 for a positive one."""
    found = _number(value)
    if found is None:
        return MISSING
    if math.isinf(found):
        return "∞"
    if 0 < found < 0.0005:
        return "< 0.001"
    return f"{found:.1f}" if found >= 0.95 else f"{found:.2f}" if found >= 0.0095 else f"{found:.3f}"


def with_error(value: Any, spread: Any, places: int | None = 1) -> str:
    """A value with its standard error. An infinite error marks a lower bound: closer to the reference than the noise
    of the renders can tell (see brdfatlas.measures.errors)."""
    found, about = _number(value), _number(spread)
    if found is None or math.isinf(found) or about is None or about == 0:
        return digits(value, places)
    if math.isinf(about):
        return f"≥ {digits(value, places)}"
    return f"{digits(value, places)} ± {error(about)}"


def formula(text: str) -> Markup:
    """A formula of a model's class, plain or in TeX's manner, as HTML: Greek letters, sub- and superscripts, one line
    a statement."""
    text = re.sub(r"\\[dt]?frac\{([^{}]*)\}\{([^{}]*)\}", r"(\1) / (\2)", text)
    text = re.sub(r"\\(left|right|,|;|!|quad|mathrm|mathbf|text|operatorname)\b\s*|\\[,;!]", "", text)
    for name, sign in SIGNS.items():
        text = re.sub(rf"\\{name}(?![A-Za-z])\s?|(?<![A-Za-z\\]){name}(?![a-z])", sign, text)
    text = re.sub(r"\\([A-Za-z]+)", r"\1", text)
    html = str(escape(re.sub(r";\s+", "\n", text)))
    html = re.sub(r"_(?:\{([^{}]*)\}|([A-Za-z0-9θφ]+))", lambda m: f"<sub>{m[1] or m[2]}</sub>", html)
    html = re.sub(
        r"\^(?:\{([^{}]*)\}|\(([^()]*)\)|(-?[A-Za-z0-9.]+))", lambda m: f"<sup>{m[1] or m[2] or m[3]}</sup>", html
    )
    return Markup(html.replace("{", "").replace("}", ""))


def plain(text: str) -> str:
    """A symbol such as theta_d or rho_s with its Greek letter, as plain text."""
    return re.sub("|".join(rf"(?<![A-Za-z]){name}(?![a-z])" for name in SIGNS), lambda m: SIGNS[m[0]], text)


SIGNS = {
    "theta": "θ", "phi": "φ", "rho": "ρ", "alpha": "α", "beta": "β", "gamma": "γ", "delta": "δ", "eta": "η",
    "lambda": "λ", "sigma": "σ", "omega": "ω", "pi": "π", "sum": "Σ", "Gamma": "Γ", "sqrt": "√", "integral": "∫",
    "int": "∫", "cdot": "·", "times": "×", "infty": "∞", "sim": "~", "approx": "≈", "le": "≤", "ge": "≥",
}  # fmt: skip


def storage(value: Any) -> str:
    """Bytes for people: 152 B, 3.3 kB, 97.2 kB."""
    found = _number(value)
    if found is None:
        return MISSING
    for unit, scale in (("MB", 1e6), ("kB", 1e3)):
        if found >= scale:
            return f"{found / scale:.3g} {unit}"
    return f"{found:.0f} B"


def seconds(value: Any) -> str:
    """A duration for people: 12 ms, 3.1 s, 4 min."""
    found = _number(value)
    if found is None:
        return MISSING
    if found < 1:
        return f"{found * 1000:.0f} ms"
    return f"{found:.1f} s" if found < 100 else f"{found / 60:.0f} min"


FILTERS = {
    "with_error": with_error,
    "formula": formula,
    "digits": digits,
    "number": number,
    "integer": integer,
    "error": error,
    "storage": storage,
    "seconds": seconds,
}
