"""A multivariate Student t of a residual, and what directions in it explain.

A Student t is a normal distribution whose common scale nobody knows: x ~ N(0, s C), with s inverse gamma around 1 (Gelman et al. 2013,
section 3.2). Of a recording whose error is far smaller than a covariance promises, it says that all of the error is, and an effect that
explains a tenth of it seems certain. A covariance that has a floor (``DiagnosisConfig.floor``) promises too much on purpose. What is said
of effects (``guarded``) therefore asks s >= 1: errors may all be larger than those of sound twins, as of a recording that a twin fits
badly, and never smaller.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

__all__ = ["Likelihood", "log_gain"]

UNDERFLOW = 1e-280  # below it a sum tells a gamma function


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

    def log_density(self, residual, *, guarded: bool = False) -> float:
        """Natural logarithm of the density at ``residual`` (B,); ``guarded``: of one that is never narrower than C."""
        from scipy.special import gammaln

        n, d, misfit = len(residual), self.degrees, self.misfit(residual)
        half = np.log(np.diag(self.factor)).sum()
        constant = gammaln((d + n) / 2) - gammaln(d / 2) - n / 2 * np.log(d * np.pi) - half
        if guarded:
            return float(constant + _log_guarded(misfit, n, d) - _log_wider(0.0, 0, d))
        return float(constant + _log_plain(misfit, n, d))

    def weight(self, misfit: float, count: int) -> float:
        """Expected 1 / s of a guarded density where ``count`` numbers have such a ``misfit``: twice its fall by the misfit, 1 at most."""
        from scipy.special import gammaln

        a, x = (self.degrees + count) / 2, (self.degrees + misfit) / 2
        edge = (a - 1) * np.log(x) - x - gammaln(a) - _log_wider(misfit, count, self.degrees)
        return float(a / x - np.exp(edge))


def _log_plain(misfit: float, count: int, degrees: float) -> float:
    return -(degrees + count) / 2 * np.log1p(misfit / degrees)


def _log_guarded(misfit: float, count: int, degrees: float) -> float:
    return _log_plain(misfit, count, degrees) + _log_wider(misfit, count, degrees)


def _log_wider(misfit: float, count: int, degrees: float) -> float:
    """Logarithm of the probability of s >= 1, given ``count`` numbers with a ``misfit``: a regularised lower incomplete gamma function."""
    from scipy.special import gammainc, gammaln

    a, x = (degrees + count) / 2, (degrees + misfit) / 2
    share = float(gammainc(a, x))
    if share > UNDERFLOW:
        return float(np.log(share))
    total, term, k = 1.0, 1.0, 0
    while term > np.finfo(float).eps * total:  # x < a here: DLMF 8.7.1
        k += 1
        term *= x / (a + k)
        total += term
    return float(a * np.log(x) - x - gammaln(a + 1) + np.log(total))


def log_gain(white, ways, degrees: float) -> float:
    """What a whitened residual (B,) is likelier by, as a logarithm, if a standard normal multiple of each of ``ways`` (B, m) is in it.

    The Bayes factor of a linear effect with a normal prior over none, guarded: of a normal distribution with a common scale s >= 1 the
    covariance grows from s to s (1 + W W'), by the matrix determinant lemma. Its mean over members of a rope, each weighed by the others,
    is mostly below 1, as it should be, and was exp(5) to exp(22) without the guard (results/inference.md).
    """
    grown = np.eye(ways.shape[1]) + ways.T @ ways
    explained = ways.T @ white
    before, count = float(white @ white), len(white)
    after = before - float(explained @ np.linalg.solve(grown, explained))
    likelier = _log_guarded(after, count, degrees) - _log_guarded(before, count, degrees)
    return float(likelier - np.linalg.slogdet(grown)[1] / 2)
