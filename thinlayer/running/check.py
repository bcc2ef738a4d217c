"""Checks of a study: numbers that must lie in a range."""

from __future__ import annotations

from dataclasses import dataclass, field


@dataclass
class Check:
    """A number that a study promises to lie in a range.

    Attributes:
        name: description of the number.
        value: the number.
        low, high: ends of the range; None: no bound.
        passed: whether the number lies in the range.
    """

    name: str
    value: float
    low: float | None
    high: float | None
    passed: bool = field(init=False)

    def __post_init__(self) -> None:
        above = self.low is None or self.value >= self.low
        below = self.high is None or self.value <= self.high
        self.passed = above and below  # NaN passes neither

    def __str__(self) -> str:
        ends = [
            f">= {self.low:.6g}" if self.low is not None else "",
            f"<= {self.high:.6g}" if self.high is not None else "",
        ]
        return f"{self.name}: {self.value:.6g} ({' and '.join(e for e in ends if e)})"
