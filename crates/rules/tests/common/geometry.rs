//! The published scene's figures, as an independent statement of what the scene file says.

use fiatlux_rules::{BulbGeometry, Geometry};

/// Sizes and points of the published scene, as tests know them without a world.
pub fn geometry() -> Geometry {
    let bulb = BulbGeometry {
        plug_z: 0.036259,
        outline: vec![
            [0.036259, 0.00759],
            [0.04583, 0.01532],
            [0.05326, 0.0170],
            [0.0676, 0.0170],
            [0.0715, 0.0203],
            [0.07436, 0.02196],
            [0.08479, 0.02440],
            [0.09706, 0.02442],
            [0.11086, 0.02558],
            [0.12366, 0.03025],
            [0.13688, 0.03652],
            [0.15224, 0.03956],
            [0.15748, 0.03922],
            [0.16764, 0.03653],
            [0.18181, 0.02640],
            [0.19267, 0.0],
        ],
    };
    // Half the footprint of 0.608 x 0.979, less the radius of the rails.
    let [x, y] = [0.288, 0.4735];
    Geometry {
        ladder_top: [0.0, 0.10, 1.18],
        ladder_feet: [[-x, -y, 0.0], [x, -y, 0.0], [-x, y, 0.0], [x, y, 0.0]],
        seat_z: 0.036259,
        bulbs: [bulb.clone(), bulb],
        crate_outer_half: [0.3007, 0.2009],
        crate_interior_half: [0.2873, 0.1876],
        crate_rim: 0.17,
        crate_floor: 0.004,
        bench_surface: 0.9941,
        robot_mass: 34.581_142_02,
    }
}
