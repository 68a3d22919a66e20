"""Convex pieces of a solid, for contact."""

from __future__ import annotations

import numpy as np
import trimesh
from scipy.spatial import ConvexHull

from .error import AssetError, needs

#: Corners of a piece. The engine takes 128; contact between two pieces takes time by the product of their edges.
MAX_CORNERS = 48
MAX_PIECES = 64
#: Least thickness of a piece as a part of its length; thinner ones the engine refuses.
MIN_THICKNESS = 2e-3


def pieces(solid: trimesh.Trimesh, name: str, threshold: float = 0.03, seed: int = 0) -> list[np.ndarray]:
    """The corners of convex pieces that together fill a solid, each (n, 3).

    Shells that are convex already are pieces as they are; CoACD cuts the others.

    Args:
        solid: A closed surface, m; it may have several shells.
        name: For the message of an error.
        threshold: Concavity that CoACD leaves, as a part of the shell's size.
        seed: Of CoACD's search.

    Raises:
        AssetError: There are more than :data:`MAX_PIECES`.
    """
    found: list[np.ndarray] = []
    for shell in shells(solid):
        hull = ConvexHull(shell.vertices)
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
    """The connected parts of a surface, in the order of their lowest vertex."""
    labels = trimesh.graph.connected_component_labels(solid.face_adjacency, node_count=len(solid.faces))
    parts = [
        solid.submesh([np.flatnonzero(labels == label)], append=True, repair=False) for label in range(labels.max() + 1)
    ]
    return sorted(parts, key=lambda part: part.vertices[:, [2, 1, 0]].min(axis=0).tolist())


def cut(shell: trimesh.Trimesh, threshold: float, seed: int) -> list[np.ndarray]:
    try:
        import coacd
    except ImportError as error:
        raise needs("coacd") from error
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
