"""A fitted parameter, or why there is none."""

from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True)
class StereoEstimate:
    """A parameter as a recording shows it."""

    value: float | None = None
    """None where the recording cannot show it."""
    error: float | None = None
    """Standard error."""
    note: str = ""
    """Why it is untestable, or what the value rests on."""

    def __str__(self) -> str:
        value = "untestable" if self.value is None else f"{self.value:.4g} +- {self.error:.2g}"
        return f"{value:22} {self.note}".rstrip()

    @property
    def testable(self) -> bool:
        """True where there is a value."""
        return self.value is not None


def measured(value: float, error: float, note: str = "") -> StereoEstimate:
    """A value with its standard error."""
    return StereoEstimate(value=float(value), error=float(error), note=note)


def untestable(reason: str) -> StereoEstimate:
    """No value, and why."""
    return StereoEstimate(note=reason)
