"""Formulas of models as MathML.

What a class states in plain letters, such as ``D = (n+1)/(2 pi) (n·h)^n``, is parsed by the usual rules: a product is
the letters beside each other, a quotient has the product before the stroke above and the factor after it below. A
statement in words stays as it is.
"""

import re
from html import escape

from markupsafe import Markup

from brdfatlas.reports.formats import SIGNS, formula

WORDS = re.compile(r"\b(of|as|for|by|the|inside|with|scattering|separable|albedo|one|both|EON)\b")
TOKEN = re.compile(
    r"\s*(?:(\d+(?:\.\d+)?)|([A-Za-z][A-Za-z0-9]*)(?:_(\{[^}]*\}|[A-Za-z0-9]+))?|(\.\.|[-+=/^(),|\[\]·<>*]))"
)
SPACE = '<mspace width="0.17em"></mspace>'
CLOSING = {"(": ")", "[": "]", "|": "|"}


class FormulaError(ValueError):
    """A text that is no formula."""


def mathml(text: str) -> Markup:
    """A formula, its statements divided by semicolons, as one block of HTML with a line a statement."""
    lines = []
    for statement in re.split(r";\s+", text):
        try:
            lines.append(f'<math display="block">{statement_as_mathml(statement)}</math>')
        except (FormulaError, RecursionError):
            lines.append(f'<p class="formula-text">{formula(statement)}</p>')
    return Markup("".join(lines))


def statement_as_mathml(text: str) -> str:
    """The elements of one statement. FormulaError for words or signs that are not of a formula."""
    if WORDS.search(text):
        raise FormulaError(text)
    text = re.sub(r"\\[dt]?frac\{([^{}]*)\}\{([^{}]*)\}", r"((\1)/(\2))", text)
    text = re.sub(r"\\(?:left|right|,|;|!|quad)\s*", " ", text).replace("\\cdot", "·").replace("\\", " ")
    tokens, place = [], 0
    text = text.rstrip()
    while place < len(text):
        found = TOKEN.match(text, place)
        if found is None:
            raise FormulaError(text)
        # A name and its subscript, or a number, or a sign.
        tokens.append((found[1], found[2], (found[3] or "").strip("{}"), found[4]))
        place = found.end()
    parser = Parser(tokens)
    made = parser.listed("")
    if parser.place < len(tokens):
        raise FormulaError(text)
    return made


class Parser:
    """Recursive descent over (number, name, subscript, sign)."""

    def __init__(self, tokens: list[tuple]):
        self.tokens, self.place = tokens, 0

    def sign(self) -> str:
        """The sign that comes next, "" where there is none."""
        return (self.tokens[self.place][3] or "") if self.place < len(self.tokens) else ""

    def take(self) -> str:
        self.place += 1
        return f"<mo>{escape(self.tokens[self.place - 1][3]).replace('-', '−')}</mo>"

    def listed(self, end: str) -> str:
        """Sums with = and , between them, up to ``end``."""
        parts = [self.sum(end)]
        while self.sign() in ("=", ",") and self.sign() != end:
            parts += [self.take(), self.sum(end)]
        return "".join(parts)

    def sum(self, end: str) -> str:
        parts = [self.take()] if self.sign() in ("+", "-") else []
        parts.append(self.product(end))
        while self.sign() in ("+", "-"):
            parts += [self.take(), self.product(end)]
        return "".join(parts)

    def product(self, end: str) -> str:
        factors: list[tuple[str, str]] = []
        while (
            self.place < len(self.tokens)
            and self.sign() not in ("+", "-", "=", ",", ")", "]")
            and (self.sign() != end or not end)
        ):
            if self.sign() == "/":
                if not factors:
                    raise FormulaError("nothing above the stroke")
                self.place += 1
                above = factors[0][1] if len(factors) == 1 else spaced([whole for whole, _ in factors])
                fraction = f"<mfrac><mrow>{above}</mrow><mrow>{self.factor()[1]}</mrow></mfrac>"
                factors = [(fraction, fraction)]
            elif self.sign() in ("·", "*"):
                dot = self.take()
                factors.append((dot, dot))
            else:
                factors.append(self.factor())
        if not factors:
            raise FormulaError("nothing where a product should be")
        return spaced([whole for whole, _ in factors])

    def factor(self) -> tuple[str, str]:
        """A factor with its power, and the same without outer parentheses, as it stands in a fraction."""
        whole, bare = self.base()
        if self.sign() != "^":
            return whole, bare
        self.place += 1
        minus = self.take() if self.sign() == "-" else ""
        power = f"<msup><mrow>{whole}</mrow><mrow>{minus}{self.base()[1]}</mrow></msup>"
        return power, power

    def base(self) -> tuple[str, str]:
        if self.place >= len(self.tokens):
            raise FormulaError("the formula ends too early")
        number, name, below, sign = self.tokens[self.place]
        if sign in CLOSING:
            close = CLOSING[sign]
            opened = self.take()
            inner = self.listed(close)
            if self.sign() != close:
                raise FormulaError(f"{close} is missing")
            whole = f"<mrow>{opened}{inner}{self.take()}</mrow>"
            return whole, inner if sign == "(" else whole
        if sign:
            raise FormulaError(sign)
        self.place += 1
        if number:
            return (f"<mn>{number}</mn>",) * 2
        if name == "sqrt" and self.sign() == "(":
            root = f"<msqrt>{self.base()[1]}</msqrt>"
            return root, root
        if name == "sum":
            made = f"<munder><mo>∑</mo><mrow>{letters(below)}</mrow></munder>" if below else "<mo>∑</mo>"
            return made, made
        made = letters(name)
        made = f"<msub>{made}<mrow>{letters(below)}</mrow></msub>" if below else made
        return made, made


def spaced(factors: list[str]) -> str:
    """Factors beside each other, a little apart unless a parenthesis follows."""
    parts = [factors[0]]
    for factor in factors[1:]:
        parts += [factor] if factor.startswith(("<mrow><mo>(", "<mo>")) else [SPACE, factor]
    return "".join(parts)


def letters(text: str) -> str:
    """A name, or what stands below a sum, with its Greek letters."""
    if re.fullmatch(r"[A-Za-z]+", text):
        return f"<mi>{SIGNS.get(text, text)}</mi>"
    return f"<mtext>{escape(text)}</mtext>" if re.search(r"[=.,]", text) else f"<mi>{escape(text)}</mi>"
