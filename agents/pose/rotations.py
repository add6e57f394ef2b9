"""Rotations in space: between matrices and rotation vectors, and the one nearest to a matrix.

All functions take stacks: what is (3, 3) here may be (..., 3, 3).
"""

import numpy as np
from scipy.spatial.transform import Rotation

from agents.geometry import Floats


def from_vector(vector_rad: Floats) -> Floats:
    """Return the rotation (..., 3, 3) about a vector (..., 3) by its length in radians."""
    flat = np.asarray(vector_rad, dtype=np.float64)
    turned = Rotation.from_rotvec(flat.reshape(-1, 3)).as_matrix()
    return np.asarray(turned, dtype=np.float64).reshape(*flat.shape, 3)


def to_vector(rotation: Floats) -> Floats:
    """Return the rotation vector (..., 3), at most pi long, of rotations (..., 3, 3)."""
    flat = np.asarray(rotation, dtype=np.float64)
    vectors = Rotation.from_matrix(flat.reshape(-1, 3, 3)).as_rotvec()
    return np.asarray(vectors, dtype=np.float64).reshape(flat.shape[:-1])


def cross_matrix(vector: Floats) -> Floats:
    """Return the matrix (..., 3, 3) that a vector (..., 3) multiplies by in a cross product."""
    matrix = np.zeros((*vector.shape, 3))
    matrix[..., 0, 1], matrix[..., 0, 2] = -vector[..., 2], vector[..., 1]
    matrix[..., 1, 0], matrix[..., 1, 2] = vector[..., 2], -vector[..., 0]
    matrix[..., 2, 0], matrix[..., 2, 1] = -vector[..., 1], vector[..., 0]
    return matrix


def nearest(matrix: Floats) -> Floats:
    """Return the rotation (..., 3, 3) nearest to matrices in the Frobenius norm (by SVD).

    It is a proper one: where the nearest orthogonal matrix is a mirror, the least direction is
    turned round.
    """
    u, _, vt = np.linalg.svd(matrix)
    u[..., :, 2] *= np.sign(np.linalg.det(u) * np.linalg.det(vt))[..., None]
    return u @ vt
