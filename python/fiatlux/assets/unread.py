"""Features of USD that `verify` does not look into: a stage that has one is refused by its name."""

from __future__ import annotations

import math
from collections.abc import Iterator

from .error import needs

try:
    from pxr import Usd, UsdGeom, UsdLux, UsdPhysics, UsdSkel
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
#: Prims of a scene that are no part of an object, and what filters contacts.
OTHERS = (UsdGeom.Camera, UsdLux.BoundableLightBase, UsdLux.NonboundableLightBase, UsdPhysics.CollisionGroup)
SKELETONS = (UsdSkel.Root, UsdSkel.Skeleton, UsdSkel.Animation, UsdSkel.BlendShape)


def prims(stage: Usd.Stage) -> Iterator[Usd.Prim]:
    """All prims of a stage, also those inside of instances."""
    return iter(stage.Traverse(Usd.TraverseInstanceProxies(Usd.PrimDefaultPredicate)))


def hidden(prim: Usd.Prim) -> Iterator[str]:
    """Parts of a prim that a renderer does not show, or shows inside out."""
    if prim.IsA(UsdGeom.Imageable) and UsdGeom.Imageable(prim).GetVisibilityAttr().Get() == UsdGeom.Tokens.invisible:
        yield "it is invisible, which is not read; remove it, or make it visible"
    if prim.IsA(UsdGeom.Gprim) and UsdGeom.Gprim(prim).GetOrientationAttr().Get() == UsdGeom.Tokens.leftHanded:
        yield "its faces are leftHanded, which is not read; reverse them, and make it rightHanded"
    if prim.IsA(UsdGeom.Mesh) and UsdGeom.Mesh(prim).GetHoleIndicesAttr().Get():
        yield "it has holeIndices, which are not read; remove those faces"


def applied(prim: Usd.Prim) -> Iterator[str]:
    """Drives and pairs without contact that mean nothing, and limits that are not read."""
    for schema, _, name in (schema.partition(":") for schema in prim.GetAppliedSchemas()):
        if schema == "PhysicsLimitAPI":
            yield f"its limit of '{name}' is not read; use revolute, prismatic and fixed joints"
        elif schema == "PhysicsDriveAPI":
            drive = UsdPhysics.DriveAPI(prim, name)
            numbers = [drive.GetStiffnessAttr().Get(), drive.GetDampingAttr().Get(), drive.GetMaxForceAttr().Get()]
            kinds = {"angular": UsdPhysics.RevoluteJoint, "linear": UsdPhysics.PrismaticJoint}
            if name not in kinds or not prim.IsA(kinds[name]):
                yield f"its drive '{name}' is not of its joint; a revolute one has 'angular', a prismatic one 'linear'"
            elif not (all(number >= 0.0 for number in numbers) and math.isfinite(numbers[0] + numbers[1])):
                yield f"its drive '{name}' has a number that is negative, NaN or infinite; author another"
        elif schema == "PhysicsFilteredPairsAPI":
            for target in UsdPhysics.FilteredPairsAPI(prim).GetFilteredPairsRel().GetTargets():
                if not prim.GetStage().GetPrimAtPath(target):
                    yield f"a pair without contact names {target}, which does not exist; remove it"


def switched(prim: Usd.Prim) -> Iterator[str]:
    """Physics that is there but switched off, or begins or ends otherwise than an object's at rest."""
    if prim.HasAPI(UsdPhysics.RigidBodyAPI):
        body = UsdPhysics.RigidBodyAPI(prim)
        if body.GetRigidBodyEnabledAttr().Get() is False:
            yield "its rigid body is switched off, which is not read; remove the schema, or switch it on"
        if body.GetKinematicEnabledAttr().Get():
            yield "it is kinematic, which is not read; fix it by a joint to the world"
        if body.GetStartsAsleepAttr().Get():
            yield "it starts asleep, which is not read; remove startsAsleep"
        if any(body.GetVelocityAttr().Get() or ()) or any(body.GetAngularVelocityAttr().Get() or ()):
            yield "it starts with a velocity, which is not read; objects start at rest"
    if prim.HasAPI(UsdPhysics.CollisionAPI) and UsdPhysics.CollisionAPI(prim).GetCollisionEnabledAttr().Get() is False:
        yield "its collider is switched off, which is not read; remove it, or switch it on"
    if prim.IsA(UsdPhysics.Joint):
        joint = UsdPhysics.Joint(prim)
        if joint.GetJointEnabledAttr().Get() is False:
            yield "it is switched off, which is not read; remove it, or switch it on"
        if joint.GetExcludeFromArticulationAttr().Get():
            yield "it is not part of the articulation, which is not read; remove excludeFromArticulation"
        if joint.GetCollisionEnabledAttr().Get():
            yield "its bodies touch each other, which is not read; remove collisionEnabled"
        if any(math.isfinite(most) for most in (joint.GetBreakForceAttr().Get(), joint.GetBreakTorqueAttr().Get())):
            yield "it breaks at a force, which is not read; remove breakForce and breakTorque"
    if prim.IsA(UsdGeom.Xformable) and UsdGeom.Xformable(prim).GetResetXformStack() and prim.GetParent().GetParent():
        yield "it leaves its parent's frame (resetXformStack), which is not read; place it in that frame"


def unread(stage: Usd.Stage) -> Iterator[str]:
    """Features of a stage that are not read: prim, feature and remedy."""
    for prim in Usd.PrimRange.Stage(stage, Usd.TraverseInstanceProxies(Usd.PrimAllPrimsPredicate)):
        # `verify` has a line for the default prim.
        if not prim.IsActive() and prim != stage.GetDefaultPrim():
            yield f"{prim.GetPath()}: it is inactive, which is not read; remove it, or activate it"
    for prim in prims(stage):
        path = prim.GetPath()
        yield from (f"{path}: {problem}" for problem in [*hidden(prim), *applied(prim), *switched(prim)])
        if any(prim.IsA(kind) for kind in OTHERS):
            yield f"{path}: a {prim.GetTypeName()} is not read; remove it"
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
