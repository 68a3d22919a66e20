//! The numbers of the published room, as `crates/world/scene.toml` has them: one module for each of its sections, one constant
//! for each number. Units and sources are there. It is for what knows the room without linking the world, such as policies;
//! a scene of another size is not in it.
//!
//! ```
//! use fiatlux_room::{bulb, ladder};
//!
//! // A bulb's plug is above the origin; the ladder's top point is the middle of its platform's edge.
//! assert!(bulb::SEAT_Z > 0.0 && ladder::TOP_POINT[2] == ladder::PLATFORM_HEIGHT);
//! ```

// The numbers stand as the scene has them.
#![allow(clippy::approx_constant, clippy::excessive_precision)]

include!(concat!(env!("OUT_DIR"), "/numbers.rs"));

#[cfg(test)]
mod tests {
    use super::*;

    /// The build script reads the same as a parser of TOML.
    #[test]
    fn the_numbers_are_those_of_the_scene() {
        let scene: toml::Table = include_str!("../../world/scene.toml").parse().expect("TOML");
        let number = |section: &str, name: &str| scene[section][name].clone().try_into::<f64>().expect("a number");
        assert_eq!(number("bulb", "seat_z"), bulb::SEAT_Z);
        assert_eq!(number("bulb", "axial_inertia"), bulb::AXIAL_INERTIA);
        assert_eq!(number("fixture", "mouth_height"), fixture::MOUTH_HEIGHT);
        assert_eq!(number("bench", "surface_height"), bench::SURFACE_HEIGHT);
        let list = |section: &str, name: &str| scene[section][name].clone().try_into::<Vec<f64>>().expect("numbers");
        assert_eq!(list("room", "zone_x"), room::ZONE_X);
        assert_eq!(list("crate", "interior_half"), crate_::INTERIOR_HALF);
        assert_eq!(list("ladder", "top_point"), ladder::TOP_POINT);
        let lists = |name: &str| scene["bulb"][name].clone().try_into::<Vec<Vec<f64>>>().expect("lists");
        assert_eq!(lists("solids"), bulb::SOLIDS.map(Vec::from));
        assert_eq!(lists("outline"), bulb::OUTLINE.map(Vec::from));
        let grip = scene["start"]["carry"]["grip"].clone();
        let grip: std::collections::BTreeMap<String, f64> = grip.try_into().expect("angles");
        assert_eq!(grip, grasp::GRIP.map(|(name, angle)| (name.to_owned(), angle)).into());
        assert_eq!(scene["bulb"]["cap_balls"].as_integer(), Some(i64::from(bulb::CAP_BALLS)));
    }
}
