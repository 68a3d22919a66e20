"""Scenes as USD: from the MJCF that `sim-server export` or :meth:`fiatlux.Env.to_mjcf` writes, read by MuJoCo."""

from __future__ import annotations

import json
import math
import re
from pathlib import Path
from typing import Any

import numpy as np

from .build import MANIFEST, in_folder
from .error import AssetError, needs
from .usd import add_piece, bind_physics, new_stage, physics_material, set_frames, set_mass

try:
    from pxr import Gf, Sdf, UsdGeom, UsdPhysics
except ImportError as error:
    raise needs(error) from error


def write_scene(mjcf: str, out: str | Path, force: bool = False) -> dict[str, Any]:
    """Writes a folder with `scene.usda`: bodies, colliders, hinges with limits and drives, masses and inertias.

    Free bodies are where the keyframe `start` has them; hinges are at 0, where the frames of both their bodies coincide, with the
    keyframe's targets in their drives. Boxes are meshes, so that nothing is scaled.

    Args:
        mjcf: Text of the model.
        out: Folder to write.
        force: Replace the folder.

    Returns:
        Numbers of bodies, joints and colliders, and the total mass, kg.

    Raises:
        AssetError: MuJoCo refuses the model.
    """
    try:
        import mujoco
    except ImportError as error:
        raise needs(error) from error
    try:
        model = mujoco.MjModel.from_xml_string(mjcf)
    except ValueError as error:
        raise AssetError(f"scene: MuJoCo refuses the model: {error}") from error
    data = mujoco.MjData(model)
    if model.nkey:
        mujoco.mj_resetDataKeyframe(model, data, 0)
    hinges = model.jnt_type == mujoco.mjtJoint.mjJNT_HINGE
    if not np.isin(model.jnt_type, [mujoco.mjtJoint.mjJNT_HINGE, mujoco.mjtJoint.mjJNT_FREE]).all():
        raise AssetError("scene: it has joints other than hinges and free ones")
    data.qpos[model.jnt_qposadr[hinges]] = 0.0
    mujoco.mj_kinematics(model, data)
    return in_folder(Path(out), force, lambda folder: Writer(model, data, folder).write())


class Writer:
    def __init__(self, model: Any, data: Any, folder: Path) -> None:
        self.model, self.data = model, data
        self.folder = folder
        self.stage = new_stage(folder / "scene.usda")
        self.root = Sdf.Path("/scene")
        self.materials: dict[float, Any] = {}
        self.paths = [self.root.AppendChild("fixed")]
        for body in range(1, model.nbody):
            self.paths.append(self.root.AppendChild(prim_name(model.body(body).name)))

    def write(self) -> dict[str, Any]:
        stage, model = self.stage, self.model
        stage.SetDefaultPrim(UsdGeom.Xform.Define(stage, self.root).GetPrim())
        scene = UsdPhysics.Scene.Define(stage, self.root.AppendChild("physics"))
        gravity = np.array(model.opt.gravity)
        scene.CreateGravityDirectionAttr(Gf.Vec3f(*(gravity / np.linalg.norm(gravity)).tolist()))
        scene.CreateGravityMagnitudeAttr(float(np.linalg.norm(gravity)))
        UsdGeom.Xform.Define(stage, self.paths[0])
        for body in range(1, model.nbody):
            self.body(body)
        for geom in range(model.ngeom):
            self.geom(geom)
        UsdGeom.Scope.Define(stage, self.root.AppendChild("joints"))
        joints = [joint for joint in range(model.njnt) if model.jnt_type[joint] == 3]
        for joint in joints:
            self.joint(joint)
        for pair in range(model.nexclude):
            first, second = divmod(int(model.exclude_signature[pair]), 1 << 16)
            api = UsdPhysics.FilteredPairsAPI.Apply(stage.GetPrimAtPath(self.paths[first]))
            api.CreateFilteredPairsRel().AddTarget(self.paths[second])
        stage.GetRootLayer().Save()
        counts = {
            "bodies": model.nbody - 1,
            "joints": len(joints),
            "colliders": model.ngeom,
            "mass_kg": float(model.body_mass.sum()),
        }
        (self.folder / MANIFEST).write_text(json.dumps({"scene": counts}) + "\n")
        return counts

    def body(self, body: int) -> None:
        model, path = self.model, self.paths[body]
        xform = UsdGeom.Xform.Define(self.stage, path)
        xform.AddTranslateOp().Set(Gf.Vec3d(*self.data.xpos[body].tolist()))
        w, x, y, z = self.data.xquat[body].tolist()
        xform.AddOrientOp(UsdGeom.XformOp.PrecisionDouble).Set(Gf.Quatd(w, x, y, z))
        prim = xform.GetPrim()
        UsdPhysics.RigidBodyAPI.Apply(prim)
        turn = rotation(model.body_iquat[body])
        set_mass(
            prim, float(model.body_mass[body]), model.body_ipos[body], turn @ np.diag(model.body_inertia[body]) @ turn.T
        )
        # The tree below is one articulation if it has joints.
        if model.body_parentid[body] == 0 and np.count_nonzero(model.body_rootid == body) > 1:
            UsdPhysics.ArticulationRootAPI.Apply(prim)

    def geom(self, geom: int) -> None:
        import mujoco

        model, stage = self.model, self.stage
        kinds = mujoco.mjtGeom
        path = self.paths[model.geom_bodyid[geom]].AppendChild(prim_name(model.geom(geom).name or f"geom_{geom}"))
        kind, size = model.geom_type[geom], model.geom_size[geom].tolist()
        turn, at = rotation(model.geom_quat[geom]), model.geom_pos[geom]
        if kind == kinds.mjGEOM_BOX:
            signs = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], float)
            made = add_piece(stage, path, (signs * size) @ turn.T + at)
        elif kind == kinds.mjGEOM_MESH:
            mesh = model.geom_dataid[geom]
            start, count = model.mesh_vertadr[mesh], model.mesh_vertnum[mesh]
            made = add_piece(stage, path, model.mesh_vert[start : start + count] @ turn.T + at)
        else:
            if kind == kinds.mjGEOM_PLANE:
                made = UsdGeom.Plane.Define(stage, path)
                made.CreateAxisAttr("Z")
            elif kind == kinds.mjGEOM_SPHERE:
                made = UsdGeom.Sphere.Define(stage, path)
                made.CreateRadiusAttr(size[0])
                made.CreateExtentAttr([Gf.Vec3f(-size[0]), Gf.Vec3f(size[0])])
            elif kind == kinds.mjGEOM_CAPSULE:
                made = UsdGeom.Capsule.Define(stage, path)
                made.CreateRadiusAttr(size[0])
                made.CreateHeightAttr(2.0 * size[1])
                made.CreateAxisAttr("Z")
                half = Gf.Vec3f(size[0], size[0], size[0] + size[1])
                made.CreateExtentAttr([-half, half])
            else:
                raise AssetError(f"scene: geom '{model.geom(geom).name}' is of a kind that is not written")
            made.AddTranslateOp().Set(Gf.Vec3d(*at.tolist()))
            w, x, y, z = model.geom_quat[geom].tolist()
            made.AddOrientOp(UsdGeom.XformOp.PrecisionDouble).Set(Gf.Quatd(w, x, y, z))
            UsdPhysics.CollisionAPI.Apply(made.GetPrim())
        # Colliders are what is seen here.
        made.CreatePurposeAttr(UsdGeom.Tokens.default_)
        self.color(geom, made)
        friction = float(model.geom_friction[geom, 0])
        if friction not in self.materials:
            name = f"materials/friction_{len(self.materials)}"
            self.materials[friction] = physics_material(stage, self.root.AppendPath(name), (friction, friction))
        bind_physics(made.GetPrim(), self.materials[friction])

    def color(self, geom: int, made: Any) -> None:
        material = self.model.geom_matid[geom]
        rgba = self.model.mat_rgba[material] if material >= 0 else self.model.geom_rgba[geom]
        made.CreateDisplayColorAttr([Gf.Vec3f(*rgba[:3].tolist())])
        made.CreateDisplayOpacityAttr([float(rgba[3])])

    def joint(self, joint: int) -> None:
        model = self.model
        body = int(model.jnt_bodyid[joint])
        parent = int(model.body_parentid[body])
        axis, anchor = model.jnt_axis[joint], model.jnt_pos[joint]
        path = self.root.AppendPath(f"joints/{prim_name(model.joint(joint).name)}")
        prim = UsdPhysics.RevoluteJoint.Define(self.stage, path)
        if parent != 0:
            prim.CreateBody0Rel().SetTargets([self.paths[parent]])
        prim.CreateBody1Rel().SetTargets([self.paths[body]])
        nearest = int(np.abs(axis).argmax())
        sign = math.copysign(1.0, axis[nearest])
        unit = np.eye(3)[nearest] * sign
        turn = Gf.Quatd(Gf.Rotation(Gf.Vec3d(*unit.tolist()), Gf.Vec3d(*axis.tolist())).GetQuat())
        w, x, y, z = model.body_quat[body].tolist()
        in_parent = Gf.Quatd(w, x, y, z)
        offset = rotation(model.body_quat[body]) @ anchor + model.body_pos[body]
        set_frames(prim, offset, anchor, Gf.Quatf(turn))
        prim.CreateLocalRot0Attr(Gf.Quatf(in_parent * turn))
        prim.CreateAxisAttr("XYZ"[nearest])
        if model.jnt_limited[joint]:
            lower, upper = sorted((sign * model.jnt_range[joint]).tolist())
            prim.CreateLowerLimitAttr(math.degrees(lower))
            prim.CreateUpperLimitAttr(math.degrees(upper))
        for actuator in np.flatnonzero(model.actuator_trnid[:, 0] == joint).tolist():
            drive = UsdPhysics.DriveAPI.Apply(prim.GetPrim(), "angular")
            drive.CreateTypeAttr("force")
            # USD's angles are in degrees.
            drive.CreateStiffnessAttr(math.radians(float(model.actuator_gainprm[actuator, 0])))
            drive.CreateDampingAttr(math.radians(float(-model.actuator_biasprm[actuator, 2])))
            if model.actuator_forcelimited[actuator]:
                drive.CreateMaxForceAttr(float(model.actuator_forcerange[actuator, 1]))
            drive.CreateTargetPositionAttr(math.degrees(sign * float(self.data.ctrl[actuator])))


def rotation(quaternion: np.ndarray) -> np.ndarray:
    w, x, y, z = quaternion
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


def prim_name(name: str) -> str:
    """A name of MuJoCo as that of a prim."""
    plain = re.sub(r"[^A-Za-z0-9_]", "_", name)
    return plain if not plain[:1].isdigit() else f"_{plain}"
