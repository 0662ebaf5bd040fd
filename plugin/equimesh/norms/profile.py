"""The profile of a mesh in a norm of the error over the whole domain."""

from __future__ import annotations

from dataclasses import dataclass

from equimesh.profile import Profile

__all__ = ["NormProfile"]


@dataclass(frozen=True, eq=False, kw_only=True)
class NormProfile(Profile):
    """A norm of the error of a mesh.

    Attributes
    ----------
    norm
        ``"L1"``: the integral of |f - f_h|; ``"L2"``: the root of the integral of its square;
        ``"gradient"``: the largest Euclidean length of the gradient of f - f_h.
    value
        The norm over the domain, as it was measured.
    value_bound
        The same with the estimated error of the measurement added.
    errors, bounds
        (m,) the same norm of each triangle alone, and with the error of the measurement.
    """

    norm: str
    value: float
    value_bound: float

    @property
    def max(self) -> float:
        """The norm over the domain."""
        return self.value

    @property
    def bound(self) -> float:
        """The norm with the estimated error of its measurement added."""
        return self.value_bound
