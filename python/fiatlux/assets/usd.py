"""Objects as USD stages, by usd-core."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np

from .articulation import Joint
from .error import needs
from .mesh import Look, Surface
from .object import Object, Part

try:
    from pxr import Gf, Sdf, Usd, UsdGeom, UsdPhysics, UsdShade, Vt
except ImportError as error:
    raise needs(error) from error

#: Channel of a look, its input of UsdPreviewSurface, and whether it is a colour.
TEXTURES = {"color": True, "metallic_roughness": False, "normal": False}


def new_stage(file: Path) -> Usd.Stage:
    """An empty stage, z up, in m and kg."""
    stage = Usd.Stage.CreateNew(str(file))
    UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.z)
    UsdGeom.SetStageMetersPerUnit(stage, 1.0)
    UsdPhysics.SetStageKilogramsPerUnit(stage, 1.0)
    return stage


def write(thing: Object, file: Path) -> None:
    """Writes a stage, and its images into `textures` next to it.

    Each part is a rigid body with a visual mesh without a collider, and its convex pieces as meshes of purpose guide.
    """
    stage = new_stage(file)
    root = UsdGeom.Xform.Define(stage, f"/{thing.name}")
    stage.SetDefaultPrim(root.GetPrim())
    if len(thing.parts) > 1:
        UsdPhysics.ArticulationRootAPI.Apply(root.GetPrim())
    at = root.GetPath()
    surface = physics_material(stage, at.AppendPath("materials/surface"), thing.friction)
    looks = [preview(stage, at.AppendPath(f"materials/look_{part.name}"), part, file) for part in thing.parts]
    for part, look in zip(thing.parts, looks):
        body = add_body(stage, at.AppendChild(part.name), part)
        visual = add_mesh(stage, body.AppendChild("visual"), part.surface, part.origin)
        UsdShade.MaterialBindingAPI.Apply(visual.GetPrim()).Bind(look)
        UsdGeom.Scope.Define(stage, body.AppendChild("collision"))
        for index, corners in enumerate(part.pieces):
            piece = add_piece(stage, body.AppendPath(f"collision/piece_{index}"), corners - part.origin)
            bind_physics(piece.GetPrim(), surface)
    if thing.joints or thing.fixed:
        UsdGeom.Scope.Define(stage, at.AppendChild("joints"))
    for joint in thing.joints:
        add_joint(stage, at, thing, joint)
    if thing.fixed:
        base = UsdPhysics.FixedJoint.Define(stage, at.AppendPath("joints/base"))
        base.CreateBody1Rel().SetTargets([at.AppendChild(thing.parts[0].name)])
        set_frames(base, np.zeros(3), np.zeros(3), Gf.Quatf(1.0))
    stage.GetRootLayer().Save()


def add_body(stage: Usd.Stage, path: Sdf.Path, part: Part) -> Sdf.Path:
    body = UsdGeom.Xform.Define(stage, path)
    body.AddTranslateOp().Set(Gf.Vec3d(*part.origin.tolist()))
    UsdPhysics.RigidBodyAPI.Apply(body.GetPrim())
    set_mass(body.GetPrim(), part.mass, part.com - part.origin, part.inertia)
    return path


def set_mass(prim: Usd.Prim, mass: float, com: np.ndarray, inertia: np.ndarray) -> None:
    """Authors mass, centre of mass, principal moments and axes."""
    moments, axes = np.linalg.eigh(inertia)
    if np.linalg.det(axes) < 0.0:
        axes[:, 0] = -axes[:, 0]
    # Gf multiplies row vectors.
    turn = Gf.Matrix3d(*axes.T.flatten().tolist()).ExtractRotation().GetQuat()
    api = UsdPhysics.MassAPI.Apply(prim)
    api.CreateMassAttr(mass)
    api.CreateCenterOfMassAttr(Gf.Vec3f(*com.tolist()))
    api.CreateDiagonalInertiaAttr(Gf.Vec3f(*moments.tolist()))
    api.CreatePrincipalAxesAttr(Gf.Quatf(turn).GetNormalized())


def add_mesh(stage: Usd.Stage, path: Sdf.Path, surface: Surface, origin: np.ndarray) -> UsdGeom.Mesh:
    mesh = triangles(stage, path, surface.vertices - origin, surface.faces)
    if surface.uv is not None:
        primvar = UsdGeom.PrimvarsAPI(mesh).CreatePrimvar(
            "st", Sdf.ValueTypeNames.TexCoord2fArray, UsdGeom.Tokens.vertex
        )
        primvar.Set(Vt.Vec2fArray.FromNumpy(surface.uv.astype(np.float32)))
    return mesh


def triangles(stage: Usd.Stage, path: Sdf.Path, vertices: np.ndarray, faces: np.ndarray) -> UsdGeom.Mesh:
    points = Vt.Vec3fArray.FromNumpy(np.ascontiguousarray(vertices, np.float32))
    mesh = UsdGeom.Mesh.Define(stage, path)
    mesh.CreatePointsAttr(points)
    mesh.CreateFaceVertexCountsAttr(Vt.IntArray.FromNumpy(np.full(len(faces), 3, np.int32)))
    mesh.CreateFaceVertexIndicesAttr(Vt.IntArray.FromNumpy(np.ascontiguousarray(faces, np.int32).reshape(-1)))
    mesh.CreateSubdivisionSchemeAttr(UsdGeom.Tokens.none)
    mesh.CreateExtentAttr(UsdGeom.PointBased.ComputeExtent(points))
    return mesh


def add_piece(stage: Usd.Stage, path: Sdf.Path, corners: np.ndarray) -> UsdGeom.Mesh:
    """A convex piece as a collider that is not drawn."""
    try:
        from scipy.spatial import ConvexHull
    except ImportError as error:
        raise needs(error) from error

    hull = ConvexHull(corners)
    faces = hull.simplices.copy()
    normals = np.cross(corners[faces[:, 1]] - corners[faces[:, 0]], corners[faces[:, 2]] - corners[faces[:, 0]])
    inwards = np.einsum("ij,ij->i", normals, hull.equations[:, :3]) < 0.0
    faces[inwards] = faces[inwards][:, ::-1]
    mesh = triangles(stage, path, corners, faces)
    mesh.CreatePurposeAttr(UsdGeom.Tokens.guide)
    UsdPhysics.CollisionAPI.Apply(mesh.GetPrim())
    UsdPhysics.MeshCollisionAPI.Apply(mesh.GetPrim()).CreateApproximationAttr(UsdPhysics.Tokens.convexHull)
    return mesh


def physics_material(stage: Usd.Stage, path: Sdf.Path, friction: tuple[float, float]) -> UsdShade.Material:
    UsdGeom.Scope.Define(stage, path.GetParentPath())
    material = UsdShade.Material.Define(stage, path)
    api = UsdPhysics.MaterialAPI.Apply(material.GetPrim())
    api.CreateStaticFrictionAttr(friction[0])
    api.CreateDynamicFrictionAttr(friction[1])
    api.CreateRestitutionAttr(0.0)
    return material


def bind_physics(prim: Usd.Prim, material: UsdShade.Material) -> None:
    UsdShade.MaterialBindingAPI.Apply(prim).Bind(material, UsdShade.Tokens.weakerThanDescendants, "physics")


def preview(stage: Usd.Stage, path: Sdf.Path, part: Part, file: Path) -> UsdShade.Material:
    """The look of a part as UsdPreviewSurface, with its images as files."""
    look: Look = part.surface.look
    material = UsdShade.Material.Define(stage, path)
    shader = UsdShade.Shader.Define(stage, path.AppendChild("surface"))
    shader.CreateIdAttr("UsdPreviewSurface")
    inputs: dict[str, tuple[Any, Any]] = {
        "diffuseColor": (Sdf.ValueTypeNames.Color3f, Gf.Vec3f(*look.color)),
        "metallic": (Sdf.ValueTypeNames.Float, look.metallic),
        "roughness": (Sdf.ValueTypeNames.Float, look.roughness),
    }
    for name, (kind, value) in inputs.items():
        shader.CreateInput(name, kind).Set(value)
    material.CreateSurfaceOutput().ConnectToSource(shader.CreateOutput("surface", Sdf.ValueTypeNames.Token))
    if part.surface.uv is None or not look.images:
        return material

    reader = UsdShade.Shader.Define(stage, path.AppendChild("st"))
    reader.CreateIdAttr("UsdPrimvarReader_float2")
    reader.CreateInput("varname", Sdf.ValueTypeNames.String).Set("st")
    st = reader.CreateOutput("result", Sdf.ValueTypeNames.Float2)
    for channel, is_color in TEXTURES.items():
        if channel not in look.images:
            continue
        name = texture_file(file.parent, part, channel)
        texture = UsdShade.Shader.Define(stage, path.AppendChild(channel))
        texture.CreateIdAttr("UsdUVTexture")
        texture.CreateInput("file", Sdf.ValueTypeNames.Asset).Set(Sdf.AssetPath(f"./{name}"))
        space = "sRGB" if is_color else "raw"
        texture.CreateInput("sourceColorSpace", Sdf.ValueTypeNames.Token).Set(space)
        texture.CreateInput("st", Sdf.ValueTypeNames.Float2).ConnectToSource(st)
        if channel == "color":
            scale = Gf.Vec4f(*look.color, 1.0)
            texture.CreateInput("scale", Sdf.ValueTypeNames.Float4).Set(scale)
            rgb = texture.CreateOutput("rgb", Sdf.ValueTypeNames.Float3)
            shader.GetInput("diffuseColor").ConnectToSource(rgb)
        elif channel == "normal":
            texture.CreateInput("scale", Sdf.ValueTypeNames.Float4).Set(Gf.Vec4f(2.0, 2.0, 2.0, 1.0))
            texture.CreateInput("bias", Sdf.ValueTypeNames.Float4).Set(Gf.Vec4f(-1.0, -1.0, -1.0, 0.0))
            rgb = texture.CreateOutput("rgb", Sdf.ValueTypeNames.Float3)
            shader.CreateInput("normal", Sdf.ValueTypeNames.Normal3f).ConnectToSource(rgb)
        else:
            for output, name in [("g", "roughness"), ("b", "metallic")]:
                single = texture.CreateOutput(output, Sdf.ValueTypeNames.Float)
                shader.GetInput(name).ConnectToSource(single)
    return material


def texture_file(folder: Path, part: Part, channel: str) -> str:
    """Writes an image of a part, once, and returns its path in the folder."""
    name = f"textures/{part.name}_{channel}.png"
    path = folder / name
    if not path.exists():
        path.parent.mkdir(exist_ok=True)
        part.surface.look.images[channel].convert("RGB").save(path)
    return name


def add_joint(stage: Usd.Stage, at: Sdf.Path, thing: Object, joint: Joint) -> None:
    kinds = {
        "revolute": UsdPhysics.RevoluteJoint,
        "prismatic": UsdPhysics.PrismaticJoint,
        "fixed": UsdPhysics.FixedJoint,
    }
    prim = kinds[joint.kind].Define(stage, at.AppendPath(f"joints/{joint.name}"))
    prim.CreateBody0Rel().SetTargets([at.AppendChild(joint.parent)])
    prim.CreateBody1Rel().SetTargets([at.AppendChild(joint.child)])
    origins = {part.name: part.origin for part in thing.parts}
    turn = Gf.Quatf(1.0)
    if joint.kind != "fixed":
        # USD has joints about X, Y and Z alone: the nearest one, and its frame turned by the rest.
        nearest = int(np.abs(joint.axis).argmax())
        unit = np.eye(3)[nearest] * math.copysign(1.0, joint.axis[nearest])
        rotation = Gf.Rotation(Gf.Vec3d(*unit.tolist()), Gf.Vec3d(*joint.axis.tolist()))
        turn = Gf.Quatf(rotation.GetQuat())
        prim.CreateAxisAttr("XYZ"[nearest])
        lower, upper = joint.lower, joint.upper
        if joint.axis[nearest] < 0.0:
            lower, upper = -upper, -lower
        factor = 180.0 / math.pi if joint.kind == "revolute" else 1.0
        if math.isfinite(lower):
            prim.CreateLowerLimitAttr(factor * lower)
        if math.isfinite(upper):
            prim.CreateUpperLimitAttr(factor * upper)
    set_frames(prim, joint.anchor - origins[joint.parent], joint.anchor - origins[joint.child], turn)


def set_frames(joint: UsdPhysics.Joint, of_0: np.ndarray, of_1: np.ndarray, turn: Gf.Quatf) -> None:
    """Authors the frame of a joint in both bodies, which have parallel axes."""
    joint.CreateLocalPos0Attr(Gf.Vec3f(*of_0.tolist()))
    joint.CreateLocalPos1Attr(Gf.Vec3f(*of_1.tolist()))
    joint.CreateLocalRot0Attr(turn)
    joint.CreateLocalRot1Attr(turn)
