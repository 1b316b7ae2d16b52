"""Triangle meshes from .ply and .obj files: parsed here, checked and repaired.

No native reader sees a file: an index or a count that lies ends in a message, not in the process.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from brdfatlas.files import digits

#: More degenerate triangles than this share mean a broken file, not a scanner's leftovers.
MOST_DEGENERATE = 0.05
#: Bytes of a file; some ten million triangles.
MOST_BYTES = 2**30
#: Beyond this, squares of coordinates leave float32.
LARGEST = 1e15
#: Types of PLY properties.
_PLY_TYPES = {"char": "i1", "uchar": "u1", "short": "i2", "ushort": "u2", "int": "i4", "uint": "u4"}
_PLY_TYPES |= {"float": "f4", "double": "f8", "int8": "i1", "uint8": "u1", "int16": "i2", "uint16": "u2"}
_PLY_TYPES |= {"int32": "i4", "uint32": "u4", "float32": "f4", "float64": "f8"}


class MeshError(ValueError):
    """A mesh that cannot be used; the message is one line that names key and file."""


@dataclass(frozen=True)
class _Parsed:
    """Vertices (n, 3), corners of triangles (m, 3) as indices into them, and normals (n, 3) or None; unchecked."""

    vertices: np.ndarray
    faces: np.ndarray
    normals: np.ndarray | None


def read_mesh(path: str, key: str) -> tuple[np.ndarray, np.ndarray, np.ndarray, list[str]]:
    """Vertices (n, 3) float, triangles (m, 3) uint32, unit vertex normals (n, 3), and notes on what was repaired.

    Polygons become fans of triangles. Degenerate triangles are dropped; normals that the file lacks are computed,
    weighted by angles. Raises MeshError naming ``key`` and the file: missing, of another format, unreadable, without
    triangles, not finite, or more than 5 % degenerate.
    """
    file = Path(path)
    if not file.is_file():
        fault = "not a regular file" if file.exists() else "no such file"
        raise MeshError(f"{key}: {path}: {fault}; correct the path or leave the scene out")
    parse = {".ply": _parse_ply, ".obj": _parse_obj}.get(file.suffix.lower())
    if parse is None:
        raise MeshError(f"{key}: {path}: not a .ply or .obj file")
    if file.stat().st_size > MOST_BYTES:
        raise MeshError(f"{key}: {path}: {file.stat().st_size:,} bytes, more than {MOST_BYTES:,}; decimate the mesh")
    try:
        with np.errstate(all="ignore"):
            mesh = parse(file.read_bytes())
    except OSError as error:
        raise MeshError(f"{key}: {path}: cannot be read ({error.strerror or error})") from None
    except (ValueError, OverflowError) as error:
        reason = " ".join(str(error).split())
        raise MeshError(f"{key}: {path}: cannot be read, truncated or damaged ({reason})") from None
    try:
        return _repaired(mesh)
    except ValueError as error:
        raise MeshError(f"{key}: {path}: {error}") from None


def _repaired(mesh: _Parsed) -> tuple[np.ndarray, np.ndarray, np.ndarray, list[str]]:
    """What :func:`read_mesh` returns. ValueError for a mesh that cannot be used."""
    vertices, faces, stored = mesh.vertices, mesh.faces, mesh.normals
    if not len(faces) or not len(vertices):
        raise ValueError("no triangles")
    if faces.min() < 0 or faces.max() >= len(vertices):
        wrong = faces.min() if faces.min() < 0 else faces.max()
        raise ValueError(f"a triangle names vertex {wrong}, the last is {len(vertices) - 1}")
    if not np.isfinite(vertices[faces]).all():
        raise ValueError("vertices are NaN or Inf")
    if np.abs(vertices[faces]).max() > LARGEST:
        raise ValueError(f"vertices lie beyond {LARGEST:g}; scale the mesh")
    notes = []
    corner = vertices[faces]
    longest = np.max([((corner[:, i] - corner[:, i - 1]) ** 2).sum(-1) for i in range(3)], axis=0)
    area = np.linalg.norm(np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0]), axis=1)
    degenerate = area <= 1e-7 * np.maximum(longest, 1e-30)
    if degenerate.any():
        if degenerate.mean() > MOST_DEGENERATE:
            share = f"{degenerate.sum():,} of {len(faces):,} triangles"
            raise ValueError(f"{share} are degenerate (no area); repair the mesh")
        faces = faces[~degenerate]
        notes.append(f"{degenerate.sum():,} degenerate triangles dropped")
    used = np.zeros(len(vertices), bool)
    used[faces] = True
    if not used.all():
        faces = (np.cumsum(used) - 1)[faces]
        vertices, stored = vertices[used], None if stored is None else stored[used]
    extent = np.ptp(vertices, axis=0)
    if extent[1] <= 1e-5 * extent.max():  # rounding, which a scene would scale to its size
        raise ValueError("the mesh has no height (y is up)")
    if stored is None or not np.isfinite(stored).all() or (np.linalg.norm(stored, axis=1) < 0.5).any():
        stored = vertex_normals(vertices, faces)
        notes.append("normals computed")
    normals = stored / np.linalg.norm(stored, axis=1, keepdims=True)
    return vertices, faces.astype(np.uint32), normals, notes


def _fans(polygons: Sequence[np.ndarray]) -> np.ndarray:
    """Triangles (m, 3) of polygons, each an array of indices; an array of triangles as it is."""
    if isinstance(polygons, np.ndarray):
        return polygons
    parts = [np.stack([np.repeat(p[:1], len(p) - 2), p[1:-1], p[2:]], -1) for p in polygons if len(p) > 2]
    return np.concatenate(parts) if parts else np.empty((0, 3), np.int64)


@dataclass(frozen=True)
class _Property:
    """A property of a PLY element; ``count_type`` is "" for one number, else the type of a list's length."""

    name: str
    type: str
    count_type: str = ""

    @property
    def names_vertices(self) -> bool:
        return self.name in ("vertex_indices", "vertex_index")


def _ply_header(data: bytes) -> tuple[str, list[tuple[str, int, list[_Property]]], int]:
    """Format, elements (name, count, properties) and where the body begins. ValueError for what is no PLY."""
    end = data[:65536].find(b"end_header")
    body = data.find(b"\n", end) + 1
    if not data.startswith(b"ply") or end < 0 or not body:
        raise ValueError("no PLY header")
    form, elements = "", []
    for line in data[:end].decode("latin-1").splitlines()[1:]:
        match line.split():
            case ["format", "ascii" | "binary_little_endian" | "binary_big_endian" as form, "1.0"]:
                pass
            case ["element", name, count] if count.isascii() and count.isdigit():
                elements.append((name, int(count), []))
            case ["property", "list", count_type, kind, name] if elements and {count_type, kind} <= _PLY_TYPES.keys():
                elements[-1][2].append(_Property(name, _PLY_TYPES[kind], _PLY_TYPES[count_type]))
            case ["property", kind, name] if elements and kind in _PLY_TYPES:
                elements[-1][2].append(_Property(name, _PLY_TYPES[kind]))
            case ["comment" | "obj_info", *_] | []:
                pass
            case _:
                raise ValueError(f"header line {line[:80]!r}")
    if not form:
        raise ValueError("the header states no format")
    return form, elements, body


def _parse_ply(data: bytes) -> _Parsed:
    form, elements, at = _ply_header(data)
    order = ">" if form == "binary_big_endian" else "<"
    words = iter(data[at:].split()) if form == "ascii" else None
    vertex, polygons = {}, []
    for element, count, properties in elements:
        if count > len(data):
            raise ValueError(f"{count:,} of {element} in a file of {len(data):,} bytes")
        if words is not None:
            columns, rows = _ascii_rows(words, element, count, properties)
        elif any(p.count_type for p in properties):
            columns, (rows, at) = {}, _binary_lists(data, at, order, element, count, properties)
        else:
            kind = np.dtype([(p.name, order + p.type) for p in properties])
            table, rows = _numbers(data, at, kind, count, element), []
            columns, at = {p.name: table[p.name] for p in properties}, at + count * kind.itemsize
        if element == "vertex":
            vertex = columns
        elif element == "face":
            polygons = rows
    if not {"x", "y", "z"} <= vertex.keys():
        raise ValueError("vertices without x, y, z")
    positions, normals = (
        np.stack([vertex[axis].astype(float) for axis in axes], -1) if set(axes) <= vertex.keys() else None
        for axes in (("x", "y", "z"), ("nx", "ny", "nz"))
    )
    assert positions is not None
    return _Parsed(positions, _fans(polygons), normals)


def _ascii_rows(
    words: Iterator[bytes], element: str, count: int, properties: list[_Property]
) -> tuple[dict[str, np.ndarray], list[np.ndarray]]:
    """Columns of an element's numbers, and its lists of vertices."""
    columns: dict[str, list[float]] = {p.name: [] for p in properties if not p.count_type}
    lists = []
    try:
        for _ in range(count):
            for p in properties:
                if not p.count_type:
                    columns[p.name].append(float(digits(next(words))))
                    continue
                row = [int(digits(next(words))) for _ in range(int(digits(next(words))))]
                if p.names_vertices:
                    lists.append(np.array(row, np.int64))
    except StopIteration:
        raise ValueError(f"truncated in {element}") from None
    return {name: np.array(column, float) for name, column in columns.items()}, lists


def _binary_lists(
    data: bytes, at: int, order: str, element: str, count: int, properties: list[_Property]
) -> tuple[Sequence[np.ndarray], int]:
    """The lists of vertices of an element with lists, and where the next element begins."""
    if len(properties) == 1 and properties[0].names_vertices:  # by far the most files: nothing but triangles
        p = properties[0]
        kind = np.dtype([("n", order + p.count_type), ("row", order + p.type, (3,))])
        if at + count * kind.itemsize <= len(data):
            table = np.frombuffer(data, kind, count, at)
            if (table["n"] == 3).all():
                return table["row"].astype(np.int64), at + count * kind.itemsize
    lists = []
    for _ in range(count):
        for p in properties:
            length = 1
            if p.count_type:
                kind = np.dtype(order + p.count_type)
                length, at = int(_numbers(data, at, kind, 1, element)[0]), at + kind.itemsize
            kind = np.dtype(order + p.type)
            row = _numbers(data, at, kind, length, element)
            at += length * kind.itemsize
            if p.names_vertices:
                lists.append(row.astype(np.int64))
    return lists, at


def _numbers(data: bytes, at: int, kind: np.dtype, length: int, element: str) -> np.ndarray:
    """``length`` values of a type at a place of the file. ValueError where it ends before them."""
    if length < 0 or at + length * kind.itemsize > len(data):
        raise ValueError(f"truncated in {element}")
    return np.frombuffer(data, kind, length, at)


def _parse_obj(data: bytes) -> _Parsed:
    """v, vn and f of an OBJ; a vertex that has several normals is taken once for each."""
    positions, normals, polygons = [], [], []
    known: dict[tuple[int, int], int] = {}
    for number, line in enumerate(data.removeprefix(b"\xef\xbb\xbf").splitlines(), 1):
        words = line.split(b"#")[0].split()
        if not words or words[0] not in (b"v", b"vn", b"f"):
            continue
        try:
            if words[0] == b"f":
                pairs = (_corner(word, len(positions), len(normals)) for word in words[1:])
                polygons.append(np.array([known.setdefault(pair, len(known)) for pair in pairs], np.int64))
            else:
                x, y, z = map(float, map(digits, words[1:4]))
                (positions if words[0] == b"v" else normals).append((x, y, z))
        except ValueError as error:
            raise ValueError(f"line {number}: {error}") from None
    if not known:
        return _Parsed(np.empty((0, 3)), np.empty((0, 3), np.int64), None)
    index = np.array(list(known))
    for column, last, what in ((0, len(positions), "vertex"), (1, len(normals), "normal")):
        if index[:, column].max() >= last:
            raise ValueError(f"a face names {what} {index[:, column].max() + 1}, the last is {last}")
    stored = np.array(normals, float)[index[:, 1]] if (index[:, 1] >= 0).all() else None
    return _Parsed(np.array(positions, float)[index[:, 0]], _fans(polygons), stored)


def _corner(word: bytes, n_positions: int, n_normals: int) -> tuple[int, int]:
    """Indices from 0 of a corner's position and normal, -1 for no normal; a file's negative ones count from the end."""
    parts = word.split(b"/")
    position, normal = int(digits(parts[0])), int(digits(parts[2])) if len(parts) > 2 and parts[2] else 0
    position = position - 1 if position >= 0 else n_positions + position
    normal = normal - 1 if normal >= 0 else n_normals + normal
    if not 0 <= position < 2**31 or not -1 <= normal < 2**31:
        raise ValueError(f"corner {word[:40].decode('latin-1')!r} names no vertex")
    return position, normal


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
