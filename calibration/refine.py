"""Joint refinement: reprojection error over both poses, lens and board scale at once.

The arm's reported poses err, so the residuals of one view are correlated: their covariance is
sigma^2 I + G P G^T, with G the derivative by the pose error and P its variances. The pose errors
are thereby marginalised out (Woodbury keeps every inverse 6x6), which is what makes both the
estimate efficient and its covariance true.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt
from scipy.linalg import cho_factor, cho_solve
from scipy.optimize import brentq
from scipy.stats import chi2

from calibration.projection import (
    LENS,
    PARAMETERS,
    SCALE,
    Estimate,
    Linearised,
    Observations,
    linearise,
)
from tdpg_deploy.geometry import Array

CAUCHY = 2.0  # views whose chi-square is this many times the usual lose half their weight
MAX_STEPS = 50


@dataclass(frozen=True, kw_only=True)
class Freedom:
    """What may differ from nominal, besides the two poses."""

    lens: bool = False
    scale: bool = False

    def mask(self) -> npt.NDArray[np.bool_]:
        """(19,)"""
        free = np.ones(PARAMETERS, bool)
        free[LENS] = self.lens
        free[SCALE] = self.scale
        return free


# Standard deviations of the priors: what a factory calibration and a printer may be off by. D435s
# report fx and fy of their colour streams up to 0.3 % apart, though their pixels are square, and
# no distortion, though the datasheet allows 1.5 % (k1 of 0.024 in the corners). All are wide: 25
# views know the focal length to 0.04 %, fx / fy to 0.009 %, the centre to 0.2 px, k1 and k2 to
# 0.0012 and 0.003, so that a prior which changed the result would have to know the camera better
# than its maker does.
PRIOR = np.full(PARAMETERS, np.inf)
PRIOR[LENS] = [5e-3, 5e-3, 5.0, 5.0, 0.05, 0.1]
PRIOR[SCALE] = 1e-2


@dataclass(frozen=True, kw_only=True, eq=False)
class Noise:
    """pixel: standard deviation of a corner's coordinate. pose: (6,) variances, see PoseNoise."""

    pixel: float
    pose: Array


@dataclass(frozen=True, kw_only=True, eq=False)
class Fit:
    """information: (19, 19), zero where held fixed. ratios: (V,) chi-square over its mean."""

    estimate: Estimate
    freedom: Freedom
    information: Array
    ratios: Array

    def covariance(self) -> Array:
        """(19, 19) of the steps in `Estimate.moved`; zero where held fixed."""
        free = np.flatnonzero(self.freedom.mask())
        covariance = np.zeros_like(self.information)
        covariance[np.ix_(free, free)] = np.linalg.inv(self.information[np.ix_(free, free)])
        return covariance


def fit(
    begin: Estimate,
    nominal: Estimate,
    seen: Observations,
    noise: Noise,
    freedom: Freedom,
    *,
    robust: bool = False,
) -> Fit:
    """Levenberg-Marquardt from `begin`; lens and scale are drawn to `nominal`.

    robust: views that do not fit count less (Cauchy), on a scale that tightens as the fit
    improves, so that a poor start does not look like bad views.
    """
    free = np.flatnonzero(freedom.mask())
    estimate, damping = _restricted(begin, nominal, freedom), 1e-6
    terms = _terms(linearise(estimate, seen), noise)
    for _ in range(MAX_STEPS):
        ratios = terms.chi2 / seen.counts
        scale = CAUCHY * max(1.0, float(np.median(ratios)))
        weights = 1 / (1 + ratios / scale) if robust else np.ones_like(ratios)
        deviation = _deviation(estimate, nominal)
        H = np.einsum("v,vij->ij", weights, terms.information) + np.diag(PRIOR**-2.0)
        g = weights @ terms.gradient + deviation * PRIOR**-2.0
        H, g = H[np.ix_(free, free)], g[free]
        step = np.zeros(PARAMETERS)
        step[free] = -cho_solve(cho_factor(H + damping * np.diag(np.diag(H))), g)
        tried = estimate.moved(step)
        tried_terms = _terms(linearise(tried, seen), noise)
        before = _cost(terms.chi2, seen.counts, scale, robust) + _penalty(deviation)
        after = _cost(tried_terms.chi2, seen.counts, scale, robust) + _penalty(
            _deviation(tried, nominal)
        )
        if after <= before:
            estimate, terms, damping = tried, tried_terms, damping / 10
        else:
            damping *= 10
        # A step this short, in standard deviations of the answer, no longer matters.
        if -float(g @ step[free]) < 1e-6 or damping > 1e9:
            break
    ratios = terms.chi2 / seen.counts
    information = terms.information.sum(axis=0) + np.diag(PRIOR**-2.0)
    fixed = ~freedom.mask()
    information[fixed] = information[:, fixed] = 0
    return Fit(estimate=estimate, freedom=freedom, information=information, ratios=ratios)


def chi_squares(estimate: Estimate, seen: Observations, noise: Noise) -> Array:
    """(V,) squared Mahalanobis length of each view's residuals, pose error marginalised."""
    return _terms(linearise(estimate, seen), noise).chi2


def view_information(estimate: Estimate, seen: Observations, noise: Noise) -> Array:
    """(V, 12, 12) what each view tells about both poses."""
    information = _terms(linearise(estimate, seen), noise).information
    return np.asarray(information[:, :12, :12], np.float64)


@dataclass(frozen=True, kw_only=True, eq=False)
class Split:
    """Each view's residuals in two: what moving its board explains, and what is left.

    left: (V,) squared pixels, 2n - 6 of freedom; the arm has no part in it.
    moves: (V, 6) the moves, rad and m at the tool. sharpness: (V, 6, 6) their information for
    corners of 1 px.
    """

    left: Array
    moves: Array
    sharpness: Array
    counts: npt.NDArray[np.int64]

    def pixel_noise(self) -> float:
        """Standard deviation of a corner: the median over views, so that bad ones do not matter."""
        return float(np.sqrt(np.median(self.left / (self.counts - 6))))

    def corner_ratio(self, pixel: float) -> Array:
        """(V,) how badly the corners fit any board, 1 is usual."""
        return self.left / (self.counts - 6) / pixel**2

    def pose_chi2(self, noise: Noise) -> Array:
        """(V,) how badly the pose fits, chi-square of 6."""
        spread = noise.pixel**2 * np.linalg.inv(self.sharpness) + np.diag(noise.pose)
        return np.asarray(
            np.einsum(
                "vi,vi->v", self.moves, np.linalg.solve(spread, self.moves[..., None])[..., 0]
            )
        )

    def pose_noise_factor(self, noise: Noise, *, robust: bool) -> float:
        """At least 1: how many times the standard deviations of `noise.pose` the views show.

        The most likely one, so that directions in which the corners are too blurred to show the
        arm's error hardly count. robust: the one that makes the median view usual.
        """
        views = len(self.counts)
        if views < 8:  # too few to tell
            return 1.0
        left = 1 - 2 / views  # of the moves' variance, 12 parameters having been fitted
        usual = float(chi2.ppf(0.5, 6 * left))
        corners = noise.pixel**2 * np.linalg.inv(self.sharpness)

        def excess(log_factor: float) -> float:
            arm = np.exp(2 * log_factor) * noise.pose
            if robust:
                ratios = self.pose_chi2(Noise(pixel=noise.pixel, pose=arm))
                return float(np.median(ratios)) - usual
            precision = np.linalg.inv(corners + np.diag(arm))
            pull = np.einsum("vij,vj->vi", precision, self.moves)
            usual_pull = left * np.einsum("vii->vi", precision)  # of its square
            return float(np.sum((pull**2 - usual_pull) * arm))  # slope of the log-likelihood

        highest = np.log(100.0)
        if excess(0.0) <= 0:
            return 1.0
        if excess(highest) >= 0:
            return float(np.exp(highest))
        return float(np.exp(brentq(excess, 0.0, highest, xtol=1e-3)))


def split(estimate: Estimate, seen: Observations) -> Split:
    lin = linearise(estimate, seen)
    G, r = lin.pose_jacobian, lin.residuals
    sharpness = np.einsum("vni,vnj->vij", G, G)
    Gr = np.einsum("vni,vn->vi", G, r)
    moves = np.linalg.solve(sharpness, Gr[..., None])[..., 0]
    left = np.einsum("vn,vn->v", r, r) - np.einsum("vi,vi->v", Gr, moves)
    return Split(left=np.maximum(left, 1e-9), moves=moves, sharpness=sharpness, counts=seen.counts)


def _restricted(estimate: Estimate, nominal: Estimate, freedom: Freedom) -> Estimate:
    """`estimate` with what is not free put back to nominal."""
    return replace(
        estimate,
        intrinsics=estimate.intrinsics if freedom.lens else nominal.intrinsics,
        scale=estimate.scale if freedom.scale else nominal.scale,
    )


@dataclass(frozen=True, kw_only=True, eq=False)
class _Terms:
    """Per view: chi2 (V,), gradient (V, 19), information (V, 19, 19)."""

    chi2: Array
    gradient: Array
    information: Array


def _terms(lin: Linearised, noise: Noise) -> _Terms:
    r, J = lin.residuals / noise.pixel, lin.jacobian / noise.pixel
    G = lin.pose_jacobian * np.sqrt(noise.pose) / noise.pixel
    Gt, Jt = np.swapaxes(G, 1, 2), np.swapaxes(J, 1, 2)
    GJ, Gr = Gt @ J, (Gt @ r[..., None])[..., 0]
    inner = np.linalg.inv(np.eye(6) + Gt @ G)
    GJt = np.swapaxes(GJ, 1, 2)
    known = (inner @ Gr[..., None])[..., 0]
    return _Terms(
        # Not below zero, where rounding of a large difference could take it.
        chi2=np.maximum(np.einsum("vn,vn->v", r, r) - np.einsum("vi,vi->v", Gr, known), 0.0),
        gradient=(Jt @ r[..., None] - GJt @ known[..., None])[..., 0],
        information=Jt @ J - GJt @ inner @ GJ,
    )


def _cost(chi2: Array, counts: npt.NDArray[np.int64], scale: float, robust: bool) -> float:
    if not robust:
        return float(chi2.sum())
    return float((counts * scale * np.log1p(chi2 / counts / scale)).sum())


def _penalty(deviation: Array) -> float:
    return float(((deviation / PRIOR) ** 2).sum())


def _deviation(estimate: Estimate, nominal: Estimate) -> Array:
    """(19,) how far lens and scale are from nominal, in the units of the steps."""
    k, k0 = estimate.intrinsics, nominal.intrinsics
    deviation = np.zeros(PARAMETERS)
    deviation[LENS] = [
        k.fx / k0.fx - 1,
        k.fy / k0.fy - 1,
        k.cx - k0.cx,
        k.cy - k0.cy,
        k.distortion[0] - k0.distortion[0],
        k.distortion[1] - k0.distortion[1],
    ]
    deviation[SCALE] = estimate.scale / nominal.scale - 1
    return deviation
