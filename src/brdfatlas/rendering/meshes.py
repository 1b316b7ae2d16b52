"""Triangle meshes from .ply and .obj files, checked and mended."""

from pathlib import Path

import numpy as np

#: More degenerate triangles than this share mean a broken file, not a scanner's leftovers.
MOST_DEGENERATE = 0.05


class MeshError(ValueError):
    """A mesh that cannot be used; the message is one line that names key and file."""


def read_mesh(path: str, key: str) -> tuple[np.ndarray, np.ndarray, np.ndarray, list[str]]:
    """Vertices (n, 3) float, triangles (m, 3) uint32, unit vertex normals (n, 3), and notes on what was mended.

    Degenerate triangles are dropped; normals that the file lacks are computed, weighted by angles.
    Raises MeshError naming ``key`` and the file: missing, of another format, unreadable, without triangles, not
    finite, or more than 5 % degenerate.
    """
    import mitsuba as mi

    file = Path(path)
    if not file.is_file():
        raise MeshError(f"{key}: {path}: no such file; correct the path or leave the scene out")
    kind = file.suffix.lower().lstrip(".")
    if kind not in ("ply", "obj"):
        raise MeshError(f"{key}: {path}: not a .ply or .obj file")
    try:
        mesh = mi.load_dict({"type": kind, "filename": str(file), "face_normals": False})
        parameters = mi.traverse(mesh)
        vertices = np.array(parameters["vertex_positions"], float).reshape(-1, 3)
        faces = np.array(parameters["faces"], np.int64).reshape(-1, 3)
        stored = np.array(parameters["vertex_normals"], float).reshape(-1, 3) if mesh.has_vertex_normals() else None
    except Exception as error:
        reason = str(error).strip().splitlines()[-1] if str(error).strip() else type(error).__name__
        raise MeshError(f"{key}: {path}: cannot be read ({reason})") from None
    if not len(faces) or not len(vertices):
        raise MeshError(f"{key}: {path}: no triangles")
    if faces.max() >= len(vertices):
        raise MeshError(f"{key}: {path}: a triangle names vertex {faces.max()}, the last is {len(vertices) - 1}")
    if not np.isfinite(vertices[faces]).all():
        raise MeshError(f"{key}: {path}: vertices are NaN or Inf")
    notes = []
    corner = vertices[faces]
    longest = np.max([((corner[:, i] - corner[:, i - 1]) ** 2).sum(-1) for i in range(3)], axis=0)
    area = np.linalg.norm(np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0]), axis=1)
    degenerate = area <= 1e-7 * np.maximum(longest, 1e-30)
    if degenerate.any():
        if degenerate.mean() > MOST_DEGENERATE:
            share = f"{degenerate.sum():,} of {len(faces):,} triangles"
            raise MeshError(f"{key}: {path}: {share} are degenerate (no area); mend the mesh")
        faces = faces[~degenerate]
        notes.append(f"{degenerate.sum():,} degenerate triangles dropped")
    used = np.zeros(len(vertices), bool)
    used[faces] = True
    if not used.all():
        faces = (np.cumsum(used) - 1)[faces]
        vertices, stored = vertices[used], None if stored is None else stored[used]
    height = np.ptp(vertices[:, 1])
    if height <= 0:
        raise MeshError(f"{key}: {path}: the mesh has no height (y is up)")
    if stored is None or not np.isfinite(stored).all() or (np.linalg.norm(stored, axis=1) < 0.5).any():
        stored = vertex_normals(vertices, faces)
        notes.append("normals computed")
    normals = stored / np.linalg.norm(stored, axis=1, keepdims=True)
    return vertices, faces.astype(np.uint32), normals, notes


def vertex_normals(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Unit normals (n, 3) of vertices: the triangles' normals weighted by their angles there (Thürmer and Wüthrich,
    "Computing vertex normals from polygonal facets", 1998)."""
    corner = vertices[faces]
    normals = np.zeros_like(vertices)
    facing = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    facing /= np.linalg.norm(facing, axis=1, keepdims=True)
    for i in range(3):
        a, b = corner[:, (i + 1) % 3] - corner[:, i], corner[:, (i + 2) % 3] - corner[:, i]
        cosine = (a * b).sum(1) / (np.linalg.norm(a, axis=1) * np.linalg.norm(b, axis=1))
        np.add.at(normals, faces[:, i], np.arccos(np.clip(cosine, -1, 1))[:, None] * facing)
    length = np.linalg.norm(normals, axis=1, keepdims=True)
    return np.where(length > 1e-12, normals / np.maximum(length, 1e-12), [0.0, 1.0, 0.0])
