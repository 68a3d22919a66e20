use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use fiatlux_dynamics::Material;

/// Defines a section whose fields are documented in `scene.toml`, plus a line here that gives units and shapes.
macro_rules! section {
    ($(#[$meta:meta])* $name:ident { $($(#[$field_meta:meta])* $field:ident: $type:ty,)* }) => {
        $(#[$meta])*
        #[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
        #[serde(deny_unknown_fields)]
        pub struct $name { $($(#[$field_meta])* pub $field: $type,)* }
    };
}

section! {
    /// `[room]`: floor, walls and ceiling, world axes.
    RoomConfig {
        /// Floor for the layout, m.
        zone_x: [f64; 2],
        /// Floor for the layout, m.
        zone_y: [f64; 2],
        /// Inner faces of the west and east walls, m.
        wall_x: [f64; 2],
        /// Extent of the west and east walls, m.
        wall_side_y: [f64; 2],
        /// Inner face of the south wall, m.
        wall_south_y: f64,
        /// Extent of the south wall, m.
        wall_south_x: [f64; 2],
        /// Outer faces of the walls along x, m.
        outer_x: [f64; 2],
        /// Outer faces of the walls along y, m.
        outer_y: [f64; 2],
        /// Height of the walls, m.
        wall_top: f64,
        /// Height of the ceiling's underside, m.
        ceiling_height: f64,
        /// Thickness of the ceiling, m.
        ceiling_thickness: f64,
    }
}

section! {
    /// `[bench]`; its origin is on the floor below the centre of the top.
    BenchConfig {
        /// Height of the surface, m.
        surface_height: f64,
        /// Half extents of the top, x and y, m.
        slab_half: [f64; 2],
        /// Half extents of the footprint that the rulebook reads, m.
        footprint_half: [f64; 2],
        /// Underside of the top, m.
        frame_height: f64,
        /// Half extents of a leg, m.
        leg_half: [f64; 2],
        /// Distance of the leg centres from the top's edges, m.
        leg_inset: [f64; 2],
        /// Lower and upper edge of the beam between the back legs, m.
        beam_height: [f64; 2],
        /// Centre of the tray from the bench's centre, m.
        tray_center: [f64; 2],
        /// Outer half extents of the tray, m.
        tray_half: [f64; 2],
        /// Base and rim of the tray, m.
        tray_height: [f64; 2],
        /// Thickness of the tray's floor and walls, m.
        tray_wall: f64,
        /// Where the fresh bulb stands, from the bench's centre, m.
        bulb_spot: [f64; 2],
    }
}

section! {
    /// `[crate]`; its origin is the centre of its base.
    CrateConfig {
        /// Outer half extents, m.
        outer_half: [f64; 2],
        /// Half extents of the interior, m.
        interior_half: [f64; 2],
        /// Height of the rim, m.
        rim_height: f64,
        /// Top of the inner floor, m.
        floor_height: f64,
        /// Cap height of a bulb that a start state puts inside, m.
        placing_height: f64,
    }
}

section! {
    /// `[fixture]`; its origin is the socket's, +z points out of it. Heights named `stop`, `mouth` and `sleeve` count
    /// from the seat point.
    FixtureConfig {
        /// Height of the origin above the floor, m.
        height: f64,
        /// Horizontal distance to the ladder of a coupled layout, ceiling mount, m.
        standoff_ceiling: f64,
        /// The same for a wall mount, m.
        standoff_wall: f64,
        /// Radius of the rod of a ceiling mount, m.
        rod_radius: f64,
        /// Half extents of the housing, m.
        base_half: [f64; 2],
        /// Half width of the collar around the bore, m.
        collar_half: f64,
        /// Where the plug's bottom rests, m.
        stop_height: f64,
        /// Front face, which the plug enters by, m.
        mouth_height: f64,
        /// Radius of the bore at the front face, m.
        mouth_radius: f64,
        /// Lower and upper end of the guide sleeve, m.
        sleeve_height: [f64; 2],
        /// Inner and outer radius of the guide sleeve, m.
        sleeve_radius: [f64; 2],
        /// Number of boxes that form the sleeve.
        sleeve_facets: u32,
    }
}

section! {
    /// `[bulb]`; a solid of revolution about its +z.
    BulbConfig {
        /// Mass of one bulb, kg.
        mass: f64,
        /// About the axis, kg m^2.
        axial_inertia: f64,
        /// About an axis across it through the centre of mass, kg m^2.
        transverse_inertia: f64,
        /// Centre of mass on the axis, m.
        com_z: f64,
        /// Plug point of the bulb and seat point of the socket on their axes, m.
        seat_z: f64,
        /// Outline as (z, radius), ascending in z, m.
        outline: Vec<[f64; 2]>,
        /// Collision shapes: (from z, to z, radius) of swept balls, m.
        solids: Vec<[f64; 3]>,
        /// Number of small balls around the cap's bottom.
        cap_balls: u32,
        /// Radius of each of these balls, m.
        cap_ball_radius: f64,
        /// Radius of the ring of their centres, m.
        cap_ring_radius: f64,
        /// Height of the axis when the bulb lies on its side, m.
        lying_height: f64,
    }
}

section! {
    /// `[ladder]`; its origin is on the floor in the centre of the footprint, its steps are on -y.
    LadderConfig {
        /// Mass of the ladder, kg.
        mass: f64,
        /// Height of the centre of mass, m.
        com_z: f64,
        /// Overall extents along x, y and z, m.
        size: [f64; 3],
        /// Radius of rails, legs and guard rail, m.
        rail_radius: f64,
        /// y and z of the front rails' upper end, m.
        rail_top: [f64; 2],
        /// y and z of the rear legs' upper end, m.
        leg_top: [f64; 2],
        /// Tops of the treads below the platform, ascending, m.
        tread_heights: Vec<f64>,
        /// Depth of a tread along y, m.
        tread_depth: f64,
        /// Thickness of a tread, m.
        tread_thickness: f64,
        /// Half the width of a tread along x, m.
        tread_half_width: f64,
        /// Extent of the platform, m.
        platform_x: [f64; 2],
        /// Extent of the platform, m.
        platform_y: [f64; 2],
        /// Top of the platform, m.
        platform_height: f64,
        /// Thickness of the platform, m.
        platform_thickness: f64,
        /// y of the guard rail's top bar, m.
        guard_y: f64,
        /// The point that the rulebook measures to, m.
        top_point: [f64; 3],
    }
}

section! {
    /// `[attachment]`: the socket's hold on a bulb; see [`crate::hold_wrench`].
    AttachmentConfig {
        /// Largest axial gap for seating, m.
        seat_gap: f64,
        /// Largest lateral offset for seating and for the hold, m.
        seat_lateral: f64,
        /// Largest tilt for seating, rad.
        seat_tilt: f64,
        /// Axial offset that releases, m.
        release_gap: f64,
        /// Consecutive control steps beyond it that release.
        release_steps: u32,
        /// Axial force at the seat, N.
        hold_force: f64,
        /// Axial offset at which the force has fallen to zero, m.
        hold_range: f64,
        /// Damping along the axis, N s/m.
        axial_damping: f64,
        /// Largest force along the axis, N.
        axial_limit: f64,
        /// Stiffness across the axis, N/m.
        lateral_stiffness: f64,
        /// Damping across the axis, N s/m.
        lateral_damping: f64,
        /// Largest force across the axis, N.
        lateral_limit: f64,
        /// Torque per sine of the tilt, N m.
        tilt_stiffness: f64,
        /// Damping of turns across the axis, N m s.
        tilt_damping: f64,
        /// Largest torque on the bulb, N m.
        torque_limit: f64,
    }
}

section! {
    /// Friction of one surface.
    #[derive(Copy)]
    Surface {
        /// Published static coefficient; recorded, not used.
        static_friction: f64,
        /// Dynamic coefficient, the one in force.
        friction: f64,
        /// At a contact the higher priority decides.
        priority: i32,
    }
}

impl Surface {
    /// As the engine takes it.
    pub fn material(&self) -> Material {
        Material { friction: self.friction, priority: self.priority }
    }
}

section! {
    /// `[surfaces]`: friction of all surfaces but the robot's.
    Surfaces {
        /// The floor of the scene.
        floor: Surface,
        /// Walls and ceiling of the room.
        room: Surface,
        /// Work bench and its tray.
        bench: Surface,
        /// The crate for spent bulbs.
        #[serde(rename = "crate")]
        crate_: Surface,
        /// Fixture but for the sleeve.
        fixture: Surface,
        /// Guide sleeve of the socket.
        sleeve: Surface,
        /// Both bulbs, glass and cap.
        bulb: Surface,
        /// All of the ladder.
        ladder: Surface,
    }
}

section! {
    /// `[layout]`; zones are axis-aligned squares.
    LayoutConfig {
        /// Chance of a ceiling mount.
        ceiling_probability: f64,
        /// Half size of the fixture's zone and its distance from the floor's edge, m.
        fixture_inset: f64,
        /// Half size of the robot's zone, m.
        robot_half: f64,
        /// Half size of the bench's zone, m.
        table_half: f64,
        /// Half size of the ladder's zone, m.
        ladder_half: f64,
        /// Half size of the crate's zone, m.
        crate_half: f64,
        /// Least gap between zones, m.
        gap: f64,
        /// Tries to place one zone before the room is drawn anew.
        placement_tries: u32,
        /// Draws of the room before the config is refused.
        redraws: u32,
        /// Largest deviation of the robot's heading from the bench, rad.
        robot_yaw_spread: f64,
    }
}

section! {
    /// `[climb]`: where things stand in the fixed scene of `climb`.
    ClimbConfig {
        /// x, y (m) and yaw (rad).
        ladder: [f64; 3],
        /// Origin of the socket, m.
        fixture: [f64; 3],
        /// x, y (m) and yaw (rad).
        robot: [f64; 3],
        /// Where the old and the fresh bulb stand, m.
        bulb_parking: [[f64; 2]; 2],
    }
}

section! {
    /// `[robot]`: the standing posture at the start.
    RobotStartConfig {
        /// Height of the pelvis at the start, m.
        pelvis_height: f64,
    }
}

section! {
    /// Reset noise, uniform and symmetric.
    #[derive(Copy)]
    StartNoise {
        /// Along x and along y, m.
        shift: f64,
        /// About the vertical, rad.
        turn: f64,
        /// Of every joint, rad.
        joint: f64,
    }
}

section! {
    /// `[start]`: where the robot starts a task, and how much that varies.
    StartConfig {
        /// Noise of a start on the floor.
        noise: StartNoise,
        /// Noise of a start on the ladder.
        ladder_noise: StartNoise,
        /// From the ladder, m.
        mounting_distance: f64,
        /// From the crate with the bulb to throw away, m.
        dispose_distance: f64,
        /// From the crate on leaving it, m.
        leave_distance: f64,
        /// From the fresh bulb, m.
        grab_place: [f64; 2],
        /// From the bench, m.
        carry_place: [f64; 2],
        /// Height of the pelvis above the ladder's top point, m.
        platform_pelvis: f64,
        /// Least gap to what the robot does not stand on, m.
        clearance: f64,
        /// Least distance to where the gate of S05 would be met, m.
        head_start: f64,
        /// Turn about ladder or crate from one place to try to the next, rad.
        turn_step: f64,
        /// Step back on the platform from one place to try to the next, m.
        back_step: f64,
        /// Draws of reset noise before the start is refused.
        redraws: u32,
        /// A bulb in the hand.
        carry: CarryConfig,
    }
}

section! {
    /// `[start.carry]`: how a bulb is held in the hand at the start.
    CarryConfig {
        /// Angles of the carrying arm's joints by name, rad; the others stand as in the standing posture.
        arm: BTreeMap<String, f64>,
        /// Angles that differ on the platform, rad.
        platform_arm: BTreeMap<String, f64>,
        /// Link whose frame the grasp is given in.
        hand_link: String,
        /// Centre of the glass in that frame, m.
        glass_center: [f64; 3],
        /// Height of that centre on the bulb's axis, m.
        glass_height: f64,
        /// Tilt of the bulb about x, beyond half a turn, then about y, rad.
        glass_tilt: [f64; 2],
        /// Time in which the hand closes around a bulb that is held still, s.
        closing_time: f64,
        /// Time for which it then holds the bulb on its own, s.
        holding_time: f64,
        /// Targets of the hand's joints by name, rad.
        grip: BTreeMap<String, f64>,
    }
}

/// Where the place of a thing counts from.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum ThingAnchor {
    /// The middle of the floor.
    #[default]
    Floor,
    /// The bench's origin, on the floor below the centre of its top.
    Bench,
    /// The crate's origin.
    Crate,
    /// The ladder's origin as laid out.
    Ladder,
}

/// `[things.NAME]`: a thing of the manifest, made of boxes and balls in its own frame.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ThingConfig {
    /// Mass, kg; used only if it can move. Its inertia is that of its shapes, filled evenly.
    #[serde(default = "one")]
    pub mass: f64,
    /// Where `at` counts from.
    #[serde(default)]
    pub from: ThingAnchor,
    /// Origin of its frame at the start, m.
    pub at: [f64; 3],
    /// Its turn about the vertical, rad.
    #[serde(default)]
    pub yaw: f64,
    /// Friction of its surface.
    pub surface: Surface,
    /// Boxes, each by its low and its high corner, m.
    #[serde(default)]
    pub boxes: Vec<[[f64; 3]; 2]>,
    /// Balls: centre and radius, m.
    #[serde(default)]
    pub balls: Vec<[f64; 4]>,
}

fn one() -> f64 {
    1.0
}
