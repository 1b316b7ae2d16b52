"""The statue: a trefoil knot of changing thickness that grows out of a round base, one closed smooth surface.

It shows every mix of principal curvatures, convex, saddle and nearly flat, and it shadows itself.
"""

import numpy as np


def _knot(n: int) -> tuple[np.ndarray, np.ndarray]:
    """Points on a trefoil that stands upright, and the thickness of the tube there."""
    t = np.arange(n) / n * 2 * np.pi
    ring = 2 + np.cos(3 * t)
    x, y, z = ring * np.cos(2 * t), ring * np.sin(2 * t), 1.35 * np.sin(3 * t)
    thickness = 0.66 + 0.14 * np.cos(3 * t) + 0.06 * np.sin(8 * t)
    return np.stack([x, y + 3.95, z], -1), thickness


def statue_field(resolution: int) -> tuple[np.ndarray, np.ndarray, float]:
    """The statue as a field that is about the signed distance to its surface, negative inside.

    Values (nx, ny, nz) at the points ``low + step * index``, in lengths of the knot; the statue stands on the plane
    y = 0 and is about 8 high. ``resolution``: points along the height.
    """
    from scipy.spatial import cKDTree

    low, high = np.array([-4.3, -0.6, -3.2]), np.array([4.3, 8.2, 3.2])
    step = (high[1] - low[1]) / resolution
    axes = [np.arange(a, b + step, step) for a, b in zip(low, high)]
    points = np.stack(np.meshgrid(*axes, indexing="ij"), -1)
    curve, thickness = _knot(1200)
    distance, nearest = cKDTree(curve).query(points.reshape(-1, 3), workers=-1)
    tube = (distance - thickness[nearest]).reshape(points.shape[:3])
    # A round base with a rolled edge: a disc's distance, thickened.
    radial = np.hypot(points[..., 0], points[..., 2])
    base = np.hypot(np.maximum(radial - 2.1, 0), np.maximum(np.abs(points[..., 1] - 0.35) - 0.1, 0)) - 0.35
    # Smooth union (polynomial), so that the knot grows out of the base.
    blend = 0.9
    h = np.clip(0.5 + 0.5 * (tube - base) / blend, 0, 1)
    return tube * (1 - h) + base * h - blend * h * (1 - h), low, step


def statue_mesh(resolution: int = 120) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Vertices (n, 3), triangles (m, 3) and unit normals (n, 3), outwards; height 1, standing on y = 0.

    ``resolution``: marching cubes along the height.
    """
    from scipy.ndimage import map_coordinates
    from skimage.measure import marching_cubes

    field, low, step = statue_field(resolution)
    vertices, faces, _, _ = marching_cubes(field, 0.0)
    gradient = np.stack([map_coordinates(g, vertices.T, order=1) for g in np.gradient(field)], -1)
    normals = gradient / np.linalg.norm(gradient, axis=1, keepdims=True)
    vertices = vertices * step + low
    vertices[:, 1] -= vertices[:, 1].min()
    vertices /= vertices[:, 1].max()
    faces = faces.astype(np.int64)
    corner = vertices[faces]
    facing = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    if (facing * normals[faces].mean(1)).sum() < 0:
        faces = faces[:, ::-1]
    return vertices.astype(np.float32), np.ascontiguousarray(faces, np.uint32), normals.astype(np.float32)
