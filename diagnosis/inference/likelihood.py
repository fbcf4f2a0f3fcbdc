"""A multivariate Student t of a residual, and what directions in it explain."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

__all__ = ["Likelihood", "log_gain"]


@dataclass(frozen=True, eq=False)
class Likelihood:
    """Student t with ``factor`` L (B, B), lower, of its scale L L', and ``degrees`` of freedom."""

    factor: np.ndarray
    degrees: float

    @classmethod
    def of(cls, scale, degrees: float) -> Likelihood:
        """Raises ValueError where ``scale`` (B, B) is not positive definite."""
        try:
            return cls(np.linalg.cholesky(scale), float(degrees))
        except np.linalg.LinAlgError:
            raise ValueError(f"a covariance must be positive definite, got least eigenvalue {np.linalg.eigvalsh(scale)[0]:.3g}") from None

    def whitened(self, values) -> np.ndarray:
        """L^-1 x of ``values`` (B,) or (B, m)."""
        from scipy.linalg import solve_triangular

        return solve_triangular(self.factor, values, lower=True)

    def misfit(self, residual) -> float:
        """x' C^-1 x, B on average where the scale is right."""
        return float(np.sum(self.whitened(residual) ** 2))

    def log_density(self, residual) -> float:
        """Natural logarithm of the density at ``residual`` (B,)."""
        from scipy.special import gammaln

        n, d = len(residual), self.degrees
        half = np.log(np.diag(self.factor)).sum()
        constant = gammaln((d + n) / 2) - gammaln(d / 2) - n / 2 * np.log(d * np.pi) - half
        return float(constant - (d + n) / 2 * np.log1p(self.misfit(residual) / d))


def log_gain(white, ways, degrees: float) -> float:
    """What a whitened residual (B,) is likelier by, as a logarithm, if a standard normal multiple of each of ``ways`` (B, m) is in it.

    The Bayes factor of a linear effect with a normal prior over none: the scale grows from 1 to 1 + W W', by the matrix determinant lemma.
    """
    grown = np.eye(ways.shape[1]) + ways.T @ ways
    explained = ways.T @ white
    before = float(white @ white)
    after = before - float(explained @ np.linalg.solve(grown, explained))
    half = (degrees + len(white)) / 2
    return float(half * (np.log1p(before / degrees) - np.log1p(after / degrees)) - np.linalg.slogdet(grown)[1] / 2)
