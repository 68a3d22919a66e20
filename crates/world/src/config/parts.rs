use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use fiatlux_dynamics::Material;

use crate::object::Role;

/// Defines a section, whose fields are documented in `scene.toml`.
macro_rules! section {
    ($(#[$meta:meta])* $name:ident { $($(#[$field_meta:meta])* $field:ident: $type:ty,)* }) => {
        $(#[$meta])*
        #[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
        #[serde(deny_unknown_fields)]
        #[allow(missing_docs)]
        pub struct $name { $($(#[$field_meta])* pub $field: $type,)* }
    };
}

section! {
    /// `[room]`: floor, walls and ceiling, world axes.
    RoomConfig {
        zone_x: [f64; 2],
        zone_y: [f64; 2],
        wall_x: [f64; 2],
        wall_side_y: [f64; 2],
        wall_south_y: f64,
        wall_south_x: [f64; 2],
        outer_x: [f64; 2],
        outer_y: [f64; 2],
        wall_top: f64,
        ceiling_height: f64,
        ceiling_thickness: f64,
    }
}

section! {
    /// `[bench]`; its origin is on the floor below the centre of the top.
    BenchConfig {
        surface_height: f64,
        slab_half: [f64; 2],
        footprint_half: [f64; 2],
        frame_height: f64,
        leg_half: [f64; 2],
        leg_inset: [f64; 2],
        beam_height: [f64; 2],
        tray_center: [f64; 2],
        tray_half: [f64; 2],
        tray_height: [f64; 2],
        tray_wall: f64,
        bulb_spot: [f64; 2],
    }
}

section! {
    /// `[crate]`; its origin is the centre of its base.
    CrateConfig {
        outer_half: [f64; 2],
        interior_half: [f64; 2],
        rim_height: f64,
        floor_height: f64,
        placing_height: f64,
    }
}

section! {
    /// `[fixture]`; its origin is the socket's, +z points out of it. Heights named `stop`, `mouth` and `sleeve` count
    /// from the seat point.
    FixtureConfig {
        height: f64,
        standoff_ceiling: f64,
        standoff_wall: f64,
        rod_radius: f64,
        base_half: [f64; 2],
        collar_half: f64,
        stop_height: f64,
        mouth_height: f64,
        mouth_radius: f64,
        sleeve_height: [f64; 2],
        sleeve_radius: [f64; 2],
        sleeve_facets: u32,
    }
}

section! {
    /// `[bulb]`; a solid of revolution about its +z.
    BulbConfig {
        mass: f64,
        axial_inertia: f64,
        transverse_inertia: f64,
        com_z: f64,
        seat_z: f64,
        outline: Vec<[f64; 2]>,
        solids: Vec<[f64; 3]>,
        cap_balls: u32,
        cap_ball_radius: f64,
        cap_ring_radius: f64,
        lying_height: f64,
    }
}

section! {
    /// `[ladder]`; its origin is on the floor in the centre of the footprint, its steps are on -y.
    LadderConfig {
        mass: f64,
        com_z: f64,
        size: [f64; 3],
        rail_radius: f64,
        rail_top: [f64; 2],
        leg_top: [f64; 2],
        tread_heights: Vec<f64>,
        tread_depth: f64,
        tread_thickness: f64,
        tread_half_width: f64,
        platform_x: [f64; 2],
        platform_y: [f64; 2],
        platform_height: f64,
        platform_thickness: f64,
        guard_y: f64,
        top_point: [f64; 3],
    }
}

section! {
    /// `[attachment]`: the socket's hold on a bulb; see [`crate::hold_wrench`].
    AttachmentConfig {
        seat_gap: f64,
        seat_lateral: f64,
        seat_tilt: f64,
        release_gap: f64,
        release_steps: u32,
        hold_force: f64,
        hold_range: f64,
        axial_damping: f64,
        axial_limit: f64,
        lateral_stiffness: f64,
        lateral_damping: f64,
        lateral_limit: f64,
        tilt_stiffness: f64,
        tilt_damping: f64,
        torque_limit: f64,
    }
}

section! {
    /// Friction of one surface.
    #[derive(Copy)]
    Surface {
        /// Published static coefficient; recorded, not used.
        static_friction: f64,
        friction: f64,
        priority: i32,
        /// Levers of the resistance to turning about a contact's normal and to rolling, m.
        #[serde(default)]
        torsion: f64,
        #[serde(default)]
        rolling: f64,
    }
}

impl Surface {
    /// As the engine takes it.
    pub fn material(&self) -> Material {
        let &Self { friction, torsion, rolling, priority, .. } = self;
        Material { friction, torsion, rolling, priority }
    }
}

section! {
    /// `[surfaces]`: friction of all surfaces but the robot's.
    Surfaces {
        floor: Surface,
        room: Surface,
        bench: Surface,
        #[serde(rename = "crate")]
        crate_: Surface,
        fixture: Surface,
        sleeve: Surface,
        bulb: Surface,
        ladder: Surface,
    }
}

impl Surfaces {
    /// The surface whose resistance to turning an object has, of which its file says nothing: what is round is a bulb.
    pub(crate) fn levers(&self, role: Role) -> Surface {
        match role {
            Role::Bulb => self.bulb,
            _ => Surface { torsion: 0.0, rolling: 0.0, ..self.bench },
        }
    }
}

section! {
    /// `[layout]`; zones are axis-aligned squares.
    LayoutConfig {
        ceiling_probability: f64,
        fixture_inset: f64,
        robot_half: f64,
        table_half: f64,
        ladder_half: f64,
        crate_half: f64,
        gap: f64,
        placement_tries: u32,
        redraws: u32,
        robot_yaw_spread: f64,
    }
}

section! {
    /// `[climb]`: where things stand in the fixed scene of `climb`.
    ClimbConfig {
        ladder: [f64; 3],
        fixture: [f64; 3],
        robot: [f64; 3],
        bulb_parking: [[f64; 2]; 2],
    }
}

section! {
    /// `[robot]`: the standing posture at the start.
    RobotStartConfig {
        pelvis_height: f64,
    }
}

section! {
    /// Reset noise, uniform and symmetric.
    #[derive(Copy)]
    StartNoise {
        shift: f64,
        turn: f64,
        joint: f64,
    }
}

section! {
    /// `[start]`: where the robot starts a task, and how much that varies.
    StartConfig {
        noise: StartNoise,
        ladder_noise: StartNoise,
        mounting_distance: f64,
        dispose_distance: f64,
        leave_distance: f64,
        grab_place: [f64; 2],
        carry_place: [f64; 2],
        platform_pelvis: f64,
        clearance: f64,
        head_start: f64,
        turn_step: f64,
        back_step: f64,
        redraws: u32,
        carry: CarryConfig,
    }
}

section! {
    /// `[start.carry]`: how a bulb is held in the hand at the start.
    CarryConfig {
        arm: BTreeMap<String, f64>,
        platform_arm: BTreeMap<String, f64>,
        hand_link: String,
        glass_center: [f64; 3],
        glass_height: f64,
        glass_tilt: [f64; 2],
        closing_time: f64,
        settling_time: f64,
        settling_friction: f64,
        holding_time: f64,
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
