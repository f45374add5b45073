"""Whether a stationary point is a minimum: the Hessian of the Lagrangian where equations and bounds leave freedom.

See Nocedal and Wright, Numerical Optimization (2006), theorem 12.5. There are few such directions, as many as states
and free parameters less conditions: random vectors projected on them span them all.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from casadi_skin.bvp.problem import Array

CURVED = 1e-6  # of what the Hessian does to the directions: less is rounding


def negative_curvature(hessian: Any, jacobian: Any, sizes: Array, left: NDArray[np.bool_]) -> float:
    """The most negative curvature, relative to what the Hessian does; 0 where there is none beyond rounding.

    `hessian` and `jacobian` are sparse matrices of scipy, `sizes` what unknowns are measured by, and `left` tells which
    are held by no bound. 0 as well where the equations with the bounds that hold leave no direction or are singular.
    """
    from scipy.linalg import eigvalsh
    from scipy.sparse import bmat, diags, identity
    from scipy.sparse.linalg import splu

    scale = diags(sizes[left])
    J, H = jacobian[:, left] @ scale, scale @ hessian[left][:, left] @ scale
    m, n = J.shape
    if n <= m:
        return 0.0
    rows = np.asarray(abs(J).max(axis=1).todense()).ravel()
    J = diags(1.0 / np.where(rows > 0.0, rows, 1.0)) @ J
    try:
        project = splu(bmat([[identity(n), J.T], [J, None]]).tocsc())
    except RuntimeError:  # SuperLU: "Factor is exactly singular"
        return 0.0
    vectors = np.random.default_rng(0).normal(size=(n, n - m))
    for _ in range(2):  # the second time takes away what rounding left of the first
        vectors, _ = np.linalg.qr(project.solve(np.vstack([vectors, np.zeros((m, n - m))]))[:n])
    curved = np.asarray(H @ vectors)
    size = float(np.linalg.norm(curved, 2))
    least = float(eigvalsh(vectors.T @ curved)[0])
    return least / size if least < -CURVED * size else 0.0
