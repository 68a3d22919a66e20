"""Convex pieces of a solid, for contact."""

from __future__ import annotations

import numpy as np

from .error import AssetError, needs

try:
    import trimesh
    from scipy.spatial import ConvexHull, QhullError
except ImportError as error:
    raise needs(error) from error

#: Corners of a piece. The engine takes 128; contact between two pieces takes time by the product of their edges.
MAX_CORNERS = 48
MAX_PIECES = 64
#: Least thickness of a piece as a part of its length; thinner ones the engine refuses.
MIN_THICKNESS = 2e-3
#: Faces at an edge whose angles differ by less lie on each other, rad.
SAME_ANGLE = 1e-6


def pieces(solid: trimesh.Trimesh, name: str, threshold: float = 0.03, seed: int = 0) -> list[np.ndarray]:
    """The corners of convex pieces that together fill a solid, each (n, 3).

    Shells that are convex already are pieces as they are; CoACD cuts the others.

    Args:
        solid: A closed surface, m; it may have several shells.
        name: For the message of an error.
        threshold: Concavity that CoACD leaves, as a part of the shell's size.
        seed: Of CoACD's search.

    Raises:
        AssetError: There are more than :data:`MAX_PIECES`, or a shell is flat.
    """
    found: list[np.ndarray] = []
    for shell in shells(solid):
        try:
            hull = ConvexHull(shell.vertices)
        except QhullError as error:
            x, y, z = shell.vertices.mean(axis=0)
            raise AssetError(
                f"{name}: a part of {len(shell.faces)} triangles at ({x:.4g}, {y:.4g}, {z:.4g}) m is flat; delete it or make it thick"
            ) from error
        if shell.volume >= 0.999 * hull.volume:
            found.append(thinned(shell.vertices))
        else:
            found.extend(cut(shell, threshold, seed))
    found = [corners for corners in found if is_thick(corners)]
    if not 1 <= len(found) <= MAX_PIECES:
        raise AssetError(
            f"{name}: {len(found)} convex pieces; 1 to {MAX_PIECES} are allowed; raise --threshold (now {threshold})"
        )
    return found


def shells(solid: trimesh.Trimesh) -> list[trimesh.Trimesh]:
    """The connected parts of a surface, in the order of their lowest vertex. Solids that touch are parts of their own."""
    labels = trimesh.graph.connected_component_labels(neighbours(solid), node_count=len(solid.faces))
    parts = [
        solid.submesh([np.flatnonzero(labels == label)], append=True, repair=False) for label in range(labels.max() + 1)
    ]
    return sorted(parts, key=lambda part: part.vertices[:, [2, 1, 0]].min(axis=0).tolist())


def neighbours(solid: trimesh.Trimesh) -> np.ndarray:
    """Pairs of faces that meet at an edge and bound the same material, (n, 2)."""
    directed = solid.faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)
    _, at, count = np.unique(np.sort(directed, axis=1), axis=0, return_inverse=True, return_counts=True)
    order, start = np.argsort(at.reshape(-1), kind="stable"), np.cumsum(count) - count
    plain = start[count == 2]
    pairs = [np.stack((order[plain], order[plain + 1]), axis=1) // 3]
    for first, length in zip(start[count > 2], count[count > 2]):
        pairs.append(np.array(bounding(solid, directed, order[first : first + length])))
    return np.concatenate(pairs)


def bounding(solid: trimesh.Trimesh, directed: np.ndarray, group: np.ndarray) -> list[tuple[int, int]]:
    """The pairs of faces between which there is material, at an edge of more than two faces.

    Args:
        solid: The surface; as many faces run along the edge as against it.
        directed: The three edges of each face, (3 n, 2).
        group: Those of them that lie on the edge.
    """
    faces = group // 3
    start, end = solid.vertices[np.sort(directed[group[0]])]
    axis = (end - start) / np.linalg.norm(end - start)
    # The corner of each face that is not on the edge, as seen along the edge.
    opposite = solid.faces[faces, (group % 3 + 2) % 3]
    away = solid.vertices[opposite] - start
    away -= np.outer(away @ axis, axis)
    angle = np.arctan2(np.cross(away[0], away) @ axis, away @ away[0]) % (2 * np.pi)
    angle[angle > 2 * np.pi - SAME_ANGLE] = 0.0
    # Seen from outside, corners go round a face to the left: a face that runs along the edge has its material at smaller angles.
    closes = directed[group, 0] < directed[group, 1]
    turn = np.lexsort((~closes, np.round(angle / SAME_ANGLE)))
    pairs, opened = [], []
    # The second time round closes what was opened before the angle became zero again.
    for number in (*turn, *turn):
        if not closes[number]:
            opened.append(number)
        elif opened:
            pairs.append((int(faces[opened.pop()]), int(faces[number])))
    return pairs[: len(group) // 2]


def cut(shell: trimesh.Trimesh, threshold: float, seed: int) -> list[np.ndarray]:
    try:
        import coacd
    except ImportError as error:
        raise needs(error) from error
    coacd.set_log_level("error")
    parts = coacd.run_coacd(
        coacd.Mesh(shell.vertices, shell.faces),
        threshold=threshold,
        seed=seed,
        decimate=True,
        max_ch_vertex=MAX_CORNERS,
        preprocess_mode="auto",
    )
    return [thinned(np.asarray(vertices)) for vertices, _ in parts]


def thinned(points: np.ndarray) -> np.ndarray:
    """At most :data:`MAX_CORNERS` corners of the hull of points: those that are farthest from the corners taken so far."""
    corners = points[np.sort(ConvexHull(points).vertices)]
    if len(corners) <= MAX_CORNERS:
        return corners
    taken = sorted({int(at) for at in (*corners.argmin(axis=0), *corners.argmax(axis=0))})
    distance = np.min([np.linalg.norm(corners - corners[at], axis=1) for at in taken], axis=0)
    while len(taken) < MAX_CORNERS:
        at = int(distance.argmax())
        taken.append(at)
        distance = np.minimum(distance, np.linalg.norm(corners - corners[at], axis=1))
    return corners[sorted(taken)]


def is_thick(corners: np.ndarray) -> bool:
    """True if the engine takes a piece: CoACD leaves slivers."""
    hull = ConvexHull(corners, qhull_options="QJ")
    heights = corners @ hull.equations[:, :3].T
    thickness = np.ptp(heights, axis=0).min()
    return bool(thickness >= MIN_THICKNESS * np.linalg.norm(np.ptp(corners, axis=0)) and thickness > 2e-4)
