"""Features of USD that `verify` does not look into: a stage that has one is refused by its name."""

from __future__ import annotations

from collections.abc import Iterator

from .error import needs

try:
    from pxr import Usd, UsdGeom, UsdPhysics, UsdSkel
except ImportError as error:
    raise needs(error) from error

#: Shapes that are looked at.
SHAPES = (
    UsdGeom.Mesh,
    UsdGeom.Cube,
    UsdGeom.Sphere,
    UsdGeom.Cylinder,
    UsdGeom.Capsule,
    UsdGeom.Cone,
    UsdGeom.Plane,
)
JOINTS = (UsdPhysics.RevoluteJoint, UsdPhysics.PrismaticJoint, UsdPhysics.FixedJoint)
SKELETONS = (UsdSkel.Root, UsdSkel.Skeleton, UsdSkel.Animation, UsdSkel.BlendShape)


def prims(stage: Usd.Stage) -> Iterator[Usd.Prim]:
    """All prims of a stage, also those inside of instances."""
    return iter(stage.Traverse(Usd.TraverseInstanceProxies(Usd.PrimDefaultPredicate)))


def unread(stage: Usd.Stage) -> Iterator[str]:
    """Features of a stage that are not read: prim, feature and remedy."""
    for prim in prims(stage):
        path = prim.GetPath()
        sets = prim.GetVariantSets()
        for name in sets.GetNames():
            count = len(sets.GetVariantSet(name).GetVariantNames())
            if count > 1:
                yield f"{path}: variant set '{name}' has {count} variants, of which only the selected one would be read; flatten it"
        if prim.IsA(UsdGeom.PointInstancer):
            yield f"{path}: a PointInstancer is not read; write its copies as prims"
        elif prim.IsA(UsdGeom.Gprim) and not any(prim.IsA(kind) for kind in SHAPES):
            yield f"{path}: a {prim.GetTypeName()} is not read; write it as a Mesh"
        elif any(prim.IsA(kind) for kind in SKELETONS):
            yield f"{path}: a {prim.GetTypeName()} is not read; write the mesh in its pose"
        elif prim.IsA(UsdPhysics.Joint) and not any(prim.IsA(kind) for kind in JOINTS):
            yield f"{path}: a {prim.GetTypeName()} is not read; use revolute, prismatic and fixed joints"
        for attribute in prim.GetAttributes():
            if attribute.GetNumTimeSamples() > 0:
                yield f"{attribute.GetPath()}: it changes in time, which is not read; author one default value"
