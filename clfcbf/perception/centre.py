"""Centre of a partly seen board of known width, with the covariance of its pose."""

from __future__ import annotations

import numpy as np

from clfcbf.perception.columns import Array
from clfcbf.perception.extent import End, Extent
from clfcbf.perception.line import LineFit
from clfcbf.se2 import Pose2

__all__ = ["centre_of"]


def centre_of(fit: LineFit, extent: Extent, width: float) -> tuple[Pose2, Array]:
    r"""Centre of a partly seen board from its line and its free ends, in the camera's frame.

    A free end :math:`E = (1, \tau)/(a + b\tau)` on the side :math:`s` (+1 left) gives the
    centre with no trigonometry of the view's edge, :math:`d = E - s\frac{l}{2}t` with the
    tangent :math:`t = (-\sin\theta, \cos\theta)`; two free ends give their mean. With none the
    centre is somewhere in the :math:`l - \hat l` that leave the board's ends out of view: its
    middle is taken, with the variance :math:`(l - \hat l)^2/12` along the board.

    The covariance is first order in (a, b) and in the edges' tangents, each uniform between
    two columns: variance :math:`\Delta\tau^2/12`.

    Parameters
    ----------
    fit : line of the board
    extent : of its visible part
    width : of the board :math:`l` [m]

    Returns
    -------
    Pose of the centre, heading away from the camera, and its covariance (3, 3).
    """
    a, b = fit.line
    theta, c = fit.line.theta, fit.line.distance
    tangent = np.array([-b * c, a * c])
    turn = np.array([-b, a]) * c * c  # of theta by (a, b)
    chosen = [(edge, s) for edge, s in zip(extent, (-1.0, 1.0), strict=True)
              if edge.end is End.FREE]  # fmt: skip
    hidden = not chosen
    if hidden:
        chosen = list(zip(extent, (-1.0, 1.0), strict=True))
    centre = np.zeros(2)
    slope = np.zeros((3, 2 + len(chosen)))
    slope[2, :2] = turn
    share = 1.0 / len(chosen)
    variances = []
    for k, (edge, s) in enumerate(chosen):
        inverse = a + b * edge.tangent
        end = np.array([1.0, edge.tangent]) / inverse
        offset = 0.0 if hidden else -s * 0.5 * width
        centre += share * (end + offset * tangent)
        # The tangent turns towards minus the normal (a, b) c.
        turned = -offset * c * np.outer([a, b], turn)
        slope[:2, :2] += share * (turned - np.outer(end, [1.0, edge.tangent]) / inverse)
        slope[:2, 2 + k] = share * (np.array([0.0, 1.0]) - b * end) / inverse
        variances.append(edge.spacing**2 / 12.0)
    inner = np.zeros((2 + len(chosen),) * 2)
    inner[:2, :2] = fit.covariance
    inner[2:, 2:] = np.diag(variances)
    covariance = slope @ inner @ slope.T
    if hidden:
        unseen = max(width - extent.length(fit.line), 0.0)
        covariance[:2, :2] += unseen**2 / 12.0 * np.outer(tangent, tangent)
    return Pose2(float(centre[0]), float(centre[1]), theta), 0.5 * (covariance + covariance.T)
