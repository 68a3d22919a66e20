"""Fixture of contact geometry: random pairs of shapes near touching."""

from itertools import count, islice

import mujoco
import numpy as np
from motion import random_rotation
from scene import numbers

KINDS = ["plane", "sphere", "capsule", "box"]
PER_PAIR = 30
PER_HULL_PAIR = 15
VERTICES = 12
MARGIN = 0.02
SCENE = """
<mujoco>
  <asset>{meshes}</asset>
  <worldbody>
    <geom name="a" type="{a}" {size_a} pos="{pos_a}" quat="{quat_a}" margin="{margin}" contype="1" conaffinity="1"/>
    <body pos="{pos_b}" quat="{quat_b}">
      <freejoint/>
      <geom name="b" type="{b}" {size_b} margin="{margin}" contype="1" conaffinity="1"/>
    </body>
  </worldbody>
</mujoco>
"""


def contacts():
    """Poses, and what MuJoCo finds: every contact, deepest first; normals point from a to b."""
    kinds = [(a, b) for i, a in enumerate(KINDS) for b in KINDS[max(i, 1) :]]
    pairs = random_pairs(np.random.default_rng(24), kinds, PER_PAIR)
    pairs += random_pairs(np.random.default_rng(25), [(a, "mesh") for a in [*KINDS, "mesh"]], PER_HULL_PAIR)
    return {"margin": MARGIN, "pairs": pairs}


def random_pairs(rng, kinds, per_pair):
    pairs = []
    for a, b in kinds:
        found = list(islice((case for case in (try_pair(rng, a, b) for _ in count()) if case), per_pair))
        overlapping = sum(case["distance"] < 0 for case in found)
        print(f"contacts: {a}-{b}: {len(found)} cases, {overlapping} overlap")
        pairs += found
    return pairs


def random_size(rng, kind):
    """The numbers of a geom's size; of a mesh, the hull of its vertices."""
    if kind == "mesh":
        return np.round(rng.uniform(-0.12, 0.12, 3 * VERTICES), 3)
    return np.round(rng.uniform(0.02, 0.15, {"plane": 3, "sphere": 1, "capsule": 2, "box": 3}[kind]), 3)


def try_pair(rng, a, b):
    """One random pair, or None when it does not come near enough."""
    shapes = {}
    for key, kind in (("a", a), ("b", b)):
        size = random_size(rng, kind)
        pos = np.round(rng.uniform(-0.2, 0.2, 3), 4)
        quat = random_rotation(rng)
        shapes[key] = {
            "kind": kind,
            "size": numbers([0, 0, 1] if kind == "plane" else size),
            "pos": numbers(pos),
            "quat": numbers(quat),
        }
    text = lambda values: " ".join(repr(v) for v in values)
    fields = {f"{f}_{key}": text(s[f]) for key, s in shapes.items() for f in ("pos", "quat")}
    meshes = ""
    for key, shape in shapes.items():
        fields[f"size_{key}"] = f'size="{text(shape["size"])}"'
        if shape["kind"] == "mesh":
            meshes += f'<mesh name="{key}" vertex="{text(shape["size"])}"/>'
            fields[f"size_{key}"] = f'mesh="{key}"'
    m = mujoco.MjModel.from_xml_string(SCENE.format(a=a, b=b, meshes=meshes, margin=MARGIN / 2, **fields))
    d = mujoco.MjData(m)
    mujoco.mj_fwdPosition(m, d)
    if d.ncon == 0 or not -0.01 < min(d.contact.dist) < 0.01:
        return None
    first = m.geom("a").id
    order = np.argsort(d.contact.dist, kind="stable")
    sign = 1 if d.contact.geom[order[0]][0] == first else -1
    # Nearest distance by the other routine, which knows no manifolds: where both agree, the case is unambiguous.
    direct = mujoco.mj_geomDistance(m, d, m.geom("a").id, m.geom("b").id, 1.0, None)
    return {
        **shapes,
        "distance": numbers(d.contact.dist[order[0]], 12),
        "normal": numbers(sign * d.contact.frame[order[0]][:3], 12),
        "direct_distance": numbers(direct, 9),
        "points": numbers(np.column_stack([d.contact.dist, d.contact.pos])[order], 9),
    }
