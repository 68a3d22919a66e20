//! Collision shapes of a robot file.

use fiatlux_dynamics::Geometry;
use nalgebra::{Isometry3, Translation3, UnitQuaternion, Vector3};

use crate::RobotError;
use crate::file::{RobotFile, ShapeDef, ShapeKind};
use crate::kinematics::pose;
use crate::refuse::{Part, Refuse};
use crate::shape::{Shape, Surface};

/// The shapes and the names of their cull groups, numbered as the links name them.
pub(crate) fn shapes(
    file: &RobotFile,
    surfaces: &[Surface],
    refuse: &Refuse<'_>,
) -> Result<(Vec<Shape>, Vec<String>), RobotError> {
    let mut groups: Vec<String> = Vec::new();
    for (index, link) in file.link.iter().enumerate() {
        if let Some(group) = &link.group
            && !groups.contains(group)
        {
            if groups.len() > 1000 {
                return Err(refuse
                    .part("link", index, &link.name)
                    .refuse("group", "is one too many; use up to 1000 groups"));
            }
            groups.push(group.clone());
        }
    }
    let mut shapes: Vec<Shape> = Vec::new();
    for (index, def) in file.shape.iter().enumerate() {
        let part = refuse.part("shape", index, &def.name);
        if shapes.iter().any(|s| s.name == def.name) {
            return Err(part.refuse("name", "is taken; names must be unique"));
        }
        let Some(link) = file.link.iter().position(|l| l.name == def.link) else {
            let problem = format!("names link '{}', which the file does not have; add or correct it", def.link);
            return Err(part.refuse("link", problem));
        };
        let on = &file.link[link];
        let Some(group) = groups.iter().position(|g| Some(g) == on.group.as_ref()) else {
            return Err(refuse
                .part("link", link, &on.name)
                .refuse("group", "is missing; a link with shapes needs one"));
        };
        let surface = match &on.material {
            Some(name) => surfaces.iter().position(|s| s.name == *name),
            None => (!surfaces.is_empty()).then_some(0),
        };
        let Some(surface) = surface else {
            let problem = "names no [[material]] of the file; add or correct it";
            return Err(refuse.part("link", link, &on.name).refuse("material", problem));
        };
        let (link_from_shape, geometry) = placed_geometry(def, &part)?;
        shapes.push(Shape { name: def.name.clone(), link, link_from_shape, geometry, surface, group: group as u16 });
    }
    Ok((shapes, groups))
}

/// Fields that one kind of shape takes.
fn check_fields(def: &ShapeDef, part: &Part<'_>, needed: &[&str], allowed: &[&str]) -> Result<(), RobotError> {
    let fields = [
        ("pos", def.pos.is_some()),
        ("rpy", def.rpy.is_some()),
        ("from", def.from.is_some()),
        ("to", def.to.is_some()),
        ("radius", def.radius.is_some()),
        ("half_extents", def.half_extents.is_some()),
    ];
    for (field, given) in fields {
        if !given && needed.contains(&field) {
            return Err(part.refuse(field, "is missing; this kind of shape needs it"));
        }
        if given && !needed.contains(&field) && !allowed.contains(&field) {
            return Err(part.refuse(field, "does not belong to this kind of shape; remove it"));
        }
    }
    Ok(())
}

fn placed_geometry(def: &ShapeDef, part: &Part<'_>) -> Result<(Isometry3<f64>, Geometry), RobotError> {
    let (pos, rpy) = (def.pos.unwrap_or_default(), def.rpy.unwrap_or_default());
    let (from, to) = (def.from.unwrap_or_default(), def.to.unwrap_or_default());
    let radius = def.radius.unwrap_or_default();
    for (field, values) in [("pos", pos), ("rpy", rpy), ("from", from), ("to", to)] {
        part.finite(field, &values)?;
    }
    match def.kind {
        ShapeKind::Sphere => {
            check_fields(def, part, &["radius"], &["pos"])?;
            part.positive("radius", radius)?;
            Ok((pose(pos, [0.0; 3]), Geometry::Sphere { radius }))
        }
        ShapeKind::Capsule => {
            check_fields(def, part, &["from", "to", "radius"], &[])?;
            part.positive("radius", radius)?;
            let (from, to) = (Vector3::from(from), Vector3::from(to));
            let along = to - from;
            if along.norm() < 1e-6 {
                return Err(part.refuse("to", "is the same point as from; use a sphere or move it"));
            }
            // No unique rotation takes z to -z; half a turn about x does.
            let rotation = UnitQuaternion::rotation_between(&Vector3::z(), &along)
                .unwrap_or_else(|| UnitQuaternion::from_axis_angle(&Vector3::x_axis(), std::f64::consts::PI));
            let link_from_shape = Isometry3::from_parts(Translation3::from((from + to) / 2.0), rotation);
            Ok((link_from_shape, Geometry::Capsule { radius, half_length: along.norm() / 2.0 }))
        }
        ShapeKind::Box => {
            check_fields(def, part, &["half_extents"], &["pos", "rpy"])?;
            let half_extents = def.half_extents.unwrap_or_default();
            for extent in half_extents {
                part.positive("half_extents", extent)?;
            }
            Ok((pose(pos, rpy), Geometry::Cuboid { half_extents: half_extents.into() }))
        }
    }
}
