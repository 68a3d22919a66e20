"""The 27 structural assertions on a USD stage, and usd-core's own validators."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from .error import AssetError, needs
from .files import read_bytes

try:
    from pxr import Ar, Sdf, Usd, UsdGeom, UsdPhysics, UsdShade, UsdUtils, UsdValidation
except ImportError as error:
    raise needs(error) from error

from .unread import prims, unread

MAX_BYTES = 1 << 30


@dataclass
class Expected:
    """Expectations of a stage; None where nothing is known."""

    #: Of colliders: "convexHull", "convexDecomposition", or "none" for a stage without colliders.
    approximation: str | None = None
    bodies: int | None = None
    joints: int | None = None
    #: Smallest and largest extent of the whole, m.
    size: tuple[float, float] = (0.01, 10.0)
    on_floor: bool = True


@dataclass
class Check:
    """A row of the report."""

    number: int
    name: str
    #: `pass`, `fail`, `warn` or `skip`.
    status: str
    #: Prim, value and remedy of each finding.
    findings: list[str] = field(default_factory=list)


class Skip(Exception):
    """A check that does not apply to a stage."""


@dataclass
class Stage:
    """A stage and what its checks share."""

    file: Path
    usd: Usd.Stage
    expected: Expected

    def of(self, kind: Any) -> list[Usd.Prim]:
        return [prim for prim in prims(self.usd) if prim.IsA(kind)]

    @property
    def meshes(self) -> list[UsdGeom.Mesh]:
        return [UsdGeom.Mesh(prim) for prim in self.of(UsdGeom.Mesh)]

    @property
    def colliders(self) -> list[Usd.Prim]:
        return [prim for prim in prims(self.usd) if prim.HasAPI(UsdPhysics.CollisionAPI)]

    @property
    def bodies(self) -> list[Usd.Prim]:
        return [prim for prim in prims(self.usd) if prim.HasAPI(UsdPhysics.RigidBodyAPI)]

    @property
    def joints(self) -> list[UsdPhysics.Joint]:
        return [UsdPhysics.Joint(prim) for prim in self.of(UsdPhysics.Joint)]

    def some_joints(self) -> list[UsdPhysics.Joint]:
        if not self.joints:
            raise Skip("it has no joints")
        return self.joints

    def skip_without_colliders(self) -> None:
        if self.expected.approximation == "none":
            raise Skip("no colliders are expected")


Assertion = Callable[[Stage], Iterator[str]]


def default_prim(stage: Stage) -> Iterator[str]:
    """A default prim is authored, exists, and is active and defined."""
    name = stage.usd.GetRootLayer().defaultPrim
    if not name:
        yield "/: defaultPrim is not authored; set it to the root prim"
        return
    prim = stage.usd.GetDefaultPrim()
    if not (prim and prim.IsActive() and prim.IsDefined()):
        yield f"/{name}: the default prim does not exist, is inactive or not defined; define it, or name another prim"


def up_axis(stage: Stage) -> Iterator[str]:
    """The up axis is authored as Z."""
    if not stage.usd.HasAuthoredMetadata("upAxis") or UsdGeom.GetStageUpAxis(stage.usd) != UsdGeom.Tokens.z:
        yield f"/: upAxis is {UsdGeom.GetStageUpAxis(stage.usd)}; author Z, and turn the geometry"


def linear_unit(stage: Stage) -> Iterator[str]:
    """metersPerUnit is authored as 1."""
    value = UsdGeom.GetStageMetersPerUnit(stage.usd)
    if not UsdGeom.StageHasAuthoredMetersPerUnit(stage.usd) or not abs(value - 1.0) <= 1e-9:
        yield f"/: metersPerUnit is {value}; author 1, and scale the points"


def mass_unit(stage: Stage) -> Iterator[str]:
    """kilogramsPerUnit is 1 or not authored."""
    value = UsdPhysics.GetStageKilogramsPerUnit(stage.usd)
    if value != 1.0:
        yield f"/: kilogramsPerUnit is {value}; author 1, and convert the masses"


def meshes_present(stage: Stage) -> Iterator[str]:
    """At least one mesh has a face."""
    if not any(len(mesh.GetFaceVertexCountsAttr().Get() or []) for mesh in stage.meshes):
        yield "/: no mesh has a face; export the geometry as Mesh prims"


def mesh_indices(stage: Stage) -> Iterator[str]:
    """Counts of faces are at least 3 and sum to the number of indices; each index names a point."""
    for mesh in stage.meshes:
        counts, indices = topology(mesh)
        points = len(mesh.GetPointsAttr().Get() or [])
        if counts.size and counts.min() < 3:
            yield f"{mesh.GetPath()}: a face has {counts.min()} corners; remove faces with fewer than 3"
        if counts.sum() != indices.size:
            yield f"{mesh.GetPath()}: faceVertexCounts sum to {counts.sum()}, faceVertexIndices has {indices.size}; author both anew"
        wrong = indices[(indices < 0) | (indices >= points)]
        if wrong.size:
            yield f"{mesh.GetPath()}: index {wrong[0]} names none of its {points} points; author faceVertexIndices anew"


def finite_points(stage: Stage) -> Iterator[str]:
    """No point is NaN or infinite."""
    for mesh in stage.meshes:
        points = points_of(mesh)
        wrong = np.flatnonzero(~np.isfinite(points).all(axis=1))
        if wrong.size:
            yield f"{mesh.GetPath()}: point {wrong[0]} is NaN or infinite; export the mesh again"


def subdivision(stage: Stage) -> Iterator[str]:
    """The subdivision scheme of each mesh is none."""
    for mesh in stage.meshes:
        scheme = mesh.GetSubdivisionSchemeAttr().Get()
        if scheme != UsdGeom.Tokens.none:
            yield f"{mesh.GetPath()}: subdivisionScheme is {scheme}, which smooths it; author none"


def extent(stage: Stage) -> Iterator[str]:
    """The authored extent of each mesh is the box of its points, within 0.1 mm."""
    for mesh in stage.meshes:
        authored, points = mesh.GetExtentAttr().Get(), points_of(mesh)
        if not authored or len(authored) != 2:
            yield f"{mesh.GetPath()}: no extent is authored; author the box of its points"
        elif len(points) and not np.allclose(
            np.array(authored), [points.min(axis=0), points.max(axis=0)], rtol=0.0, atol=1e-4
        ):
            yield f"{mesh.GetPath()}: extent {authored} is not the box of its points; author it anew"


def texture_coordinates(stage: Stage) -> Iterator[str]:
    """Texture coordinates are per vertex or per corner, as many as needed, indexed within range, and finite."""
    found = False
    for mesh in stage.meshes:
        primvar = UsdGeom.PrimvarsAPI(mesh).GetPrimvar("st")
        if not primvar or not primvar.HasAuthoredValue():
            continue
        found = True
        values, indices = np.array(primvar.Get()).reshape(-1, 2), primvar.GetIndices()
        interpolation = primvar.GetInterpolation()
        needed = {"vertex": len(points_of(mesh)), "faceVarying": int(topology(mesh)[0].sum())}.get(interpolation)
        count = len(indices) if primvar.IsIndexed() else len(values)
        if needed is None:
            yield f"{mesh.GetPath()}.primvars:st: interpolation is {interpolation}; use vertex or faceVarying"
        elif count != needed:
            yield f"{mesh.GetPath()}.primvars:st: {count} coordinates for {needed}; author one for each ({interpolation})"
        if primvar.IsIndexed() and len(indices) and not 0 <= min(indices) <= max(indices) < len(values):
            yield f"{mesh.GetPath()}.primvars:st: index {max(indices)} of {len(values)} values; author the indices anew"
        if not np.isfinite(values).all():
            yield f"{mesh.GetPath()}.primvars:st: a coordinate is NaN or infinite; unwrap the mesh again"
    if not found:
        raise Skip("no mesh has texture coordinates")


def collider(stage: Stage) -> Iterator[str]:
    """Bodies with meshes have colliders, and meshes collide by the expected approximation; drawn ones may leave that to pieces."""
    stage.skip_without_colliders()
    expected = stage.expected.approximation
    for body in stage.bodies:
        below = below_of(body)
        if any(prim.IsA(UsdGeom.Mesh) for prim in below) and not any(
            prim.HasAPI(UsdPhysics.CollisionAPI) for prim in below
        ):
            yield f"{body.GetPath()}: no collider below it; apply CollisionAPI to its meshes"
    for mesh in stage.meshes:
        prim = mesh.GetPrim()
        collides, has_mesh = prim.HasAPI(UsdPhysics.CollisionAPI), prim.HasAPI(UsdPhysics.MeshCollisionAPI)
        is_piece = UsdGeom.Imageable(prim).ComputePurpose() == UsdGeom.Tokens.guide
        if not collides and not is_piece and pieces_beside(prim):
            continue
        if not (collides and has_mesh):
            yield f"{prim.GetPath()}: it has no CollisionAPI with MeshCollisionAPI; apply both"
            continue
        found = UsdPhysics.MeshCollisionAPI(prim).GetApproximationAttr().Get()
        allowed = ("convexHull", "convexDecomposition") if expected is None else (expected,)
        if found not in allowed:
            yield f"{prim.GetPath()}: approximation is {found}; author {' or '.join(allowed)}"


def physics_material(stage: Stage) -> Iterator[str]:
    """Each collider is bound to a physics material."""
    stage.skip_without_colliders()
    for prim in stage.colliders:
        material, _ = UsdShade.MaterialBindingAPI(prim).ComputeBoundMaterial("physics")
        if not material or not material.GetPrim().HasAPI(UsdPhysics.MaterialAPI):
            yield f"{prim.GetPath()}: no physics material is bound; bind one with MaterialAPI by material:binding:physics"


def transforms(stage: Stage) -> Iterator[str]:
    """Prims are moved and turned alone: no scale, shear or matrix."""
    allowed = {UsdGeom.XformOp.TypeTranslate, UsdGeom.XformOp.TypeOrient}
    for prim in stage.of(UsdGeom.Xformable):
        for op in UsdGeom.Xformable(prim).GetOrderedXformOps():
            if op.GetOpType() not in allowed:
                yield f"{prim.GetPath()}.{op.GetOpName()}: only translate and orient are allowed; bake it into the points"


def body_count(stage: Stage) -> Iterator[str]:
    """There are as many rigid bodies as expected, or at least one."""
    found, expected = len(stage.bodies), stage.expected.bodies
    if found < 1 if expected is None else found != expected:
        wanted = "at least 1" if expected is None else str(expected)
        yield f"/: {found} rigid bodies instead of {wanted}; apply RigidBodyAPI to each part"


def no_nesting(stage: Stage) -> Iterator[str]:
    """No rigid body is below another one."""
    paths = [prim.GetPath() for prim in stage.bodies]
    for path in paths:
        above = [other for other in paths if other != path and path.HasPrefix(other)]
        if above:
            yield f"{path}: it is below the rigid body {above[0]}; make them siblings, joined by a joint"


def mass(stage: Stage) -> Iterator[str]:
    """Each body has a mass or density, its own or of what is below it, and none is negative or NaN."""
    for body in stage.bodies:
        values = []
        for prim in below_of(body):
            if prim.HasAPI(UsdPhysics.MassAPI):
                api = UsdPhysics.MassAPI(prim)
                values += [api.GetMassAttr().Get(), api.GetDensityAttr().Get()]
            material, _ = UsdShade.MaterialBindingAPI(prim).ComputeBoundMaterial("physics")
            if material and material.GetPrim().HasAPI(UsdPhysics.MaterialAPI):
                values.append(UsdPhysics.MaterialAPI(material.GetPrim()).GetDensityAttr().Get())
        values = [value for value in values if value is not None]
        if any(not (math.isfinite(value) and value >= 0.0) for value in values):
            yield f"{body.GetPath()}: a mass or density is negative, NaN or infinite; author a positive one"
        elif not any(value > 0.0 for value in values):
            yield f"{body.GetPath()}: neither it nor anything below it has a mass or density; apply MassAPI with a positive mass"


def articulation(stage: Stage) -> Iterator[str]:
    """Several bodies have exactly one articulation root."""
    roots = [prim for prim in stage.usd.Traverse() if prim.HasAPI(UsdPhysics.ArticulationRootAPI)]
    if len(stage.bodies) > 1 and len(roots) != 1:
        yield f"{roots[1].GetPath() if roots else '/'}: {len(roots)} articulation roots; apply ArticulationRootAPI to one prim"
    elif len(stage.bodies) == 1 and roots:
        raise UserWarning(f"{roots[0].GetPath()}: an articulation root of a single body; remove ArticulationRootAPI")


def joint_count(stage: Stage) -> Iterator[str]:
    """There are as many joints as expected."""
    if stage.expected.joints is None:
        raise Skip("no number of joints is expected")
    if len(stage.joints) != stage.expected.joints:
        yield f"/: {len(stage.joints)} joints instead of {stage.expected.joints}; author the missing ones, or remove the others"


def joint_bodies(stage: Stage) -> Iterator[str]:
    """Both ends of each joint exist and differ, and at least one is a rigid body."""
    for joint in stage.some_joints():
        ends = [joint.GetBody0Rel().GetTargets(), joint.GetBody1Rel().GetTargets()]
        targets = [target for end in ends for target in end]
        missing = [target for target in targets if not stage.usd.GetPrimAtPath(target)]
        if any(len(end) > 1 for end in ends):
            yield f"{joint.GetPath()}: an end has two bodies; name one"
        elif missing:
            yield f"{joint.GetPath()}: {missing[0]} does not exist; name a rigid body"
        elif len(targets) == 2 and targets[0] == targets[1]:
            yield f"{joint.GetPath()}: both ends are {targets[0]}; name two bodies"
        elif not any(stage.usd.GetPrimAtPath(target).HasAPI(UsdPhysics.RigidBodyAPI) for target in targets):
            yield f"{joint.GetPath()}: neither end is a rigid body; apply RigidBodyAPI to one of them"


def joint_quaternions(stage: Stage) -> Iterator[str]:
    """The rotations of joint frames are unit quaternions."""
    for joint in stage.some_joints():
        for attribute in (joint.GetLocalRot0Attr(), joint.GetLocalRot1Attr()):
            length = attribute.Get().GetLength()
            if not abs(length - 1.0) <= 1e-5:
                yield f"{attribute.GetPath()}: its length is {length:.6g}; normalise it"


def joint_frames(stage: Stage) -> Iterator[str]:
    """Both bodies of a joint place it at the same pose, within 0.1 mm and 1e-4 of a quaternion."""
    cache = UsdGeom.XformCache()
    for joint in stage.some_joints():
        poses = []
        sides = [
            (joint.GetBody0Rel(), joint.GetLocalPos0Attr(), joint.GetLocalRot0Attr()),
            (joint.GetBody1Rel(), joint.GetLocalPos1Attr(), joint.GetLocalRot1Attr()),
        ]
        for body, position, rotation in sides:
            targets = body.GetTargets()
            prim = stage.usd.GetPrimAtPath(targets[0]) if targets else stage.usd.GetPseudoRoot()
            if not prim:
                break
            world = cache.GetLocalToWorldTransform(prim)
            at = world.Transform(position.Get())
            turn = (world.ExtractRotationQuat() * rotation.Get()).GetNormalized()
            poses.append((np.array(at), np.array([turn.GetReal(), *turn.GetImaginary()])))
        if len(poses) < 2:
            continue
        (p0, q0), (p1, q1) = poses
        apart = float(np.linalg.norm(p0 - p1))
        turned = float(min(np.abs(q0 - q1).max(), np.abs(q0 + q1).max()))
        if not (apart <= 1e-4 and turned <= 1e-4):
            yield (
                f"{joint.GetPath()}: its two frames are {1000.0 * apart:.3f} mm and {turned:.2g} of a quaternion apart; author"
                " localPos and localRot of both bodies from one pose"
            )


def joint_axis(stage: Stage) -> Iterator[str]:
    """The axis of each revolute or prismatic joint is X, Y or Z."""
    for joint in stage.some_joints():
        for kind in (UsdPhysics.RevoluteJoint, UsdPhysics.PrismaticJoint):
            if joint.GetPrim().IsA(kind):
                axis = kind(joint.GetPrim()).GetAxisAttr().Get()
                if axis not in ("X", "Y", "Z"):
                    yield f"{joint.GetPath()}: axis is '{axis}'; use X, Y or Z and turn the frames by the rest"


def joint_limits(stage: Stage) -> Iterator[str]:
    """Limits are no NaN, and span at most 360 degrees or 100 m; a lower one above the upper one means none."""
    for joint in stage.some_joints():
        for kind, most in ((UsdPhysics.RevoluteJoint, 360.0), (UsdPhysics.PrismaticJoint, 100.0)):
            if not joint.GetPrim().IsA(kind):
                continue
            typed = kind(joint.GetPrim())
            lower, upper = typed.GetLowerLimitAttr().Get(), typed.GetUpperLimitAttr().Get()
            authored = [
                attribute.HasAuthoredValue() for attribute in (typed.GetLowerLimitAttr(), typed.GetUpperLimitAttr())
            ]
            values = [value for value, is_authored in zip((lower, upper), authored) if is_authored]
            if any(not math.isfinite(value) for value in values):
                yield f"{joint.GetPath()}: limits {lower} to {upper}; author finite ones, or none for a free joint"
            elif all(authored) and lower <= upper and upper - lower > most + 1e-3:
                yield f"{joint.GetPath()}: limits {lower} to {upper} span more than {most:g}; narrow them, or author none"


def size(stage: Stage) -> Iterator[str]:
    """The largest extent is within the expected range."""
    box = bounds(stage)
    largest = float(max(box.GetSize())) if not box.IsEmpty() else 0.0
    low, high = stage.expected.size
    if not low <= largest <= high:
        yield f"{root_path(stage)}: its largest extent is {largest:.6g} m instead of {low:g} to {high:g}; build it with --size"


def on_floor(stage: Stage) -> Iterator[str]:
    """The lowest point is at z = 0, within 1 mm."""
    if not stage.expected.on_floor:
        raise Skip("it need not stand on the floor")
    lowest = bounds(stage).GetMin()[2]
    if not abs(lowest) <= 1e-3:
        yield f"{root_path(stage)}: its lowest point is at z = {lowest:.6g} m; move it to 0"


def asset_paths(stage: Stage) -> Iterator[str]:
    """Every asset path that is authored resolves."""
    for layer, path in authored_paths(stage):
        if not resolved(layer, path):
            yield f"{layer.GetDisplayName()}: @{path}@ does not resolve; add the file, or correct the path"


def files_inside(stage: Stage) -> Iterator[str]:
    """Layers, references and textures are files within the folder of the stage, by relative paths."""
    folder = stage.file.resolve().parent
    for layer, path in authored_paths(stage):
        found = resolved(layer, path)
        where = Path(found.split("[")[0]) if found else Path(layer.realPath).parent / path
        is_relative = not Path(path).is_absolute() and "://" not in path and not path.startswith("file:")
        if not is_relative or not where.resolve().is_relative_to(folder):
            yield f"{layer.GetDisplayName()}: @{path}@ lies outside of the folder of the stage; copy it there and name it relatively"
        elif not where.is_file():
            yield f"{layer.GetDisplayName()}: @{path}@ is no file; add it"


#: In the order of the published verifier.
ASSERTIONS: tuple[Assertion, ...] = (
    default_prim,
    up_axis,
    linear_unit,
    mass_unit,
    meshes_present,
    mesh_indices,
    finite_points,
    subdivision,
    extent,
    texture_coordinates,
    collider,
    physics_material,
    transforms,
    body_count,
    no_nesting,
    mass,
    articulation,
    joint_count,
    joint_bodies,
    joint_quaternions,
    joint_frames,
    joint_axis,
    joint_limits,
    size,
    on_floor,
    asset_paths,
    files_inside,
)
#: Their findings are warnings.
WARNINGS = (mass_unit, on_floor)


def verify(file: str | Path, expected: Expected | None = None) -> list[Check]:
    """Checks a stage.

    The layers that a stage names are opened only if its paths stay within its folder.

    Raises:
        AssetError: The file cannot be opened as a stage, or has something that no assertion looks into.
    """
    file = Path(file)
    read_bytes(file, MAX_BYTES)
    expected = expected or Expected()
    try:
        usd = Usd.Stage.Open(str(file), Usd.Stage.LoadAll)
    except Exception as error:
        raise AssetError(f"{file}: cannot be opened as USD: {error}") from error
    for problem in unread(usd):
        raise AssetError(f"{file}: {problem}")
    stage = Stage(file, usd, expected)
    return [row(number, assertion, stage) for number, assertion in enumerate(ASSERTIONS, start=1)]


def row(number: int, assertion: Assertion, stage: Stage) -> Check:
    check = Check(number, assertion.__name__, "pass")
    try:
        check.findings = list(assertion(stage))
        if check.findings:
            check.status = "warn" if assertion in WARNINGS else "fail"
    except Skip as reason:
        check.status, check.findings = "skip", [str(reason)]
    except UserWarning as warning:
        check.status, check.findings = "warn", [str(warning)]
    return check


def validators(file: str | Path) -> list[str]:
    """Findings of usd-core's own validators; empty for a clean stage."""
    registry = UsdValidation.ValidationRegistry()
    every = [
        registry.GetOrLoadValidatorByName(data.name) for data in registry.GetAllValidatorMetadata() if not data.isSuite
    ]
    stage = Usd.Stage.Open(str(file))
    errors = UsdValidation.ValidationContext(every).Validate(stage)
    return [f"{error.GetIdentifier()}: {error.GetMessage()}" for error in errors]


def topology(mesh: UsdGeom.Mesh) -> tuple[np.ndarray, np.ndarray]:
    counts, indices = mesh.GetFaceVertexCountsAttr().Get(), mesh.GetFaceVertexIndicesAttr().Get()
    return np.array(counts or [], np.int64), np.array(indices or [], np.int64)


def points_of(mesh: UsdGeom.Mesh) -> np.ndarray:
    return np.array(mesh.GetPointsAttr().Get() or [], float).reshape(-1, 3)


def below_of(prim: Usd.Prim) -> list[Usd.Prim]:
    return list(Usd.PrimRange(prim, Usd.TraverseInstanceProxies(Usd.PrimDefaultPredicate)))


def pieces_beside(prim: Usd.Prim) -> bool:
    """True if the body of a drawn mesh has colliders of purpose guide."""
    while prim and not prim.HasAPI(UsdPhysics.RigidBodyAPI):
        prim = prim.GetParent()
    if not prim:
        return False
    below = (other for other in below_of(prim) if other.HasAPI(UsdPhysics.CollisionAPI))
    return any(UsdGeom.Imageable(other).ComputePurpose() == UsdGeom.Tokens.guide for other in below)


def bounds(stage: Stage) -> Any:
    """The box of all shapes in the world; empty where a point is not finite."""
    from pxr import Gf

    cache, box = UsdGeom.XformCache(), Gf.Range3d()
    for mesh in stage.meshes:
        world = np.array(cache.GetLocalToWorldTransform(mesh.GetPrim()))
        points = points_of(mesh) @ world[:3, :3] + world[3, :3]
        for point in (points.min(axis=0), points.max(axis=0)) if len(points) and np.isfinite(points).all() else ():
            box.UnionWith(Gf.Vec3d(*point.tolist()))
    for prim in stage.of(UsdGeom.Gprim):
        # Planes have no end.
        if not prim.IsA(UsdGeom.Mesh) and not prim.IsA(UsdGeom.Plane):
            extent = UsdGeom.Boundable.ComputeExtentFromPlugins(UsdGeom.Boundable(prim), Usd.TimeCode.Default())
            if extent:
                whole = Gf.BBox3d(Gf.Range3d(*map(Gf.Vec3d, extent)), cache.GetLocalToWorldTransform(prim))
                box.UnionWith(whole.ComputeAlignedRange())
    return box


def root_path(stage: Stage) -> str:
    prim = stage.usd.GetDefaultPrim()
    return str(prim.GetPath()) if prim else "/"


def authored_paths(stage: Stage) -> list[tuple[Sdf.Layer, str]]:
    """Asset paths as authored, of all layers of the stage, each once."""
    found: dict[tuple[str, str], tuple[Sdf.Layer, str]] = {}
    for layer in stage.usd.GetUsedLayers():
        if layer.anonymous:
            continue
        UsdUtils.ModifyAssetPaths(
            copy_of(layer), lambda path, layer=layer: found.setdefault((layer.identifier, path), (layer, path))[1]
        )
    return [found[key] for key in sorted(found) if key[1]]


def copy_of(layer: Sdf.Layer) -> Sdf.Layer:
    copy = Sdf.Layer.CreateAnonymous(".usda")
    copy.TransferContent(layer)
    return copy


def resolved(layer: Sdf.Layer, path: str) -> str:
    return str(Ar.GetResolver().Resolve(layer.ComputeAbsolutePath(path)))
