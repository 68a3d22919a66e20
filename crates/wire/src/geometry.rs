//! The constants of a scene that rules read, as a message and back.

use fiatlux_proto::v3;
use fiatlux_rules::{BulbGeometry, Geometry};

use crate::WireError;
use crate::error::{array, check_finite};

/// Points of the longest outline that is read: the published bulb has 97.
const MAX_OUTLINE: usize = 256;

pub fn geometry_message(geometry: &Geometry) -> v3::SceneGeometry {
    let [old, fresh] = geometry.bulbs.each_ref().map(|bulb| v3::BulbGeometry {
        plug_z: bulb.plug_z,
        outline: bulb.outline.iter().flatten().copied().collect(),
    });
    v3::SceneGeometry {
        ladder_top: geometry.ladder_top.to_vec(),
        ladder_feet: geometry.ladder_feet.iter().flatten().copied().collect(),
        seat_z: geometry.seat_z,
        old_bulb: Some(old),
        fresh_bulb: Some(fresh),
        crate_outer_half: geometry.crate_outer_half.to_vec(),
        crate_interior_half: geometry.crate_interior_half.to_vec(),
        crate_rim: geometry.crate_rim,
        crate_floor: geometry.crate_floor,
        bench_surface: geometry.bench_surface,
        robot_mass: geometry.robot_mass,
    }
}

pub fn read_geometry(message: &Option<v3::SceneGeometry>) -> Result<Geometry, WireError> {
    let message = message.as_ref().ok_or(WireError::Missing { field: "geometry" })?;
    let feet: [f64; 12] = array("geometry.ladder_feet", &message.ladder_feet)?;
    let numbers = [message.seat_z, message.crate_rim, message.crate_floor, message.bench_surface, message.robot_mass];
    check_finite("geometry", &numbers)?;
    Ok(Geometry {
        ladder_top: array("geometry.ladder_top", &message.ladder_top)?,
        ladder_feet: std::array::from_fn(|foot| std::array::from_fn(|axis| feet[3 * foot + axis])),
        seat_z: message.seat_z,
        bulbs: [
            read_bulb("geometry.old_bulb", &message.old_bulb)?,
            read_bulb("geometry.fresh_bulb", &message.fresh_bulb)?,
        ],
        crate_outer_half: array("geometry.crate_outer_half", &message.crate_outer_half)?,
        crate_interior_half: array("geometry.crate_interior_half", &message.crate_interior_half)?,
        crate_rim: message.crate_rim,
        crate_floor: message.crate_floor,
        bench_surface: message.bench_surface,
        robot_mass: message.robot_mass,
    })
}

fn read_bulb(field: &'static str, bulb: &Option<v3::BulbGeometry>) -> Result<BulbGeometry, WireError> {
    let bulb = bulb.as_ref().ok_or(WireError::Missing { field })?;
    let numbers = bulb.outline.len();
    if numbers < 4 || numbers % 2 == 1 || numbers > 2 * MAX_OUTLINE {
        let problem = format!(".outline has {numbers} numbers; it needs z and radius of 2 to {MAX_OUTLINE} points");
        return Err(WireError::Value { field, problem });
    }
    check_finite(field, &bulb.outline)?;
    check_finite(field, &[bulb.plug_z])?;
    let outline = bulb.outline.chunks_exact(2).map(|point| [point[0], point[1]]).collect();
    Ok(BulbGeometry { plug_z: bulb.plug_z, outline })
}
