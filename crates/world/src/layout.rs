//! Where things stand: the draw of a room by its seed, and the fixed scene of `climb`.

mod python_random;
mod walls;

use std::f64::consts::{FRAC_1_SQRT_2, FRAC_PI_2, TAU};

use fiatlux_rules::measure;
use nalgebra::{Isometry3, Quaternion, Translation3, UnitQuaternion, Vector2, Vector3};

use self::python_random::PythonRandom;
use self::walls::clear_of_walls;
use crate::parts::{LadderPart, SceneParts};
use crate::{SceneConfig, SceneError};

/// Largest distance or angle in a recorded layout, m or rad.
const FAR: f64 = 100.0;

/// A place on the floor with a heading about the vertical.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Place {
    /// Position on the floor, m.
    pub position: Vector2<f64>,
    /// Heading, rad, from +x towards +y.
    pub yaw: f64,
}

impl Place {
    /// The place as a pose at height `z`.
    pub fn world_from_place(&self, z: f64) -> Isometry3<f64> {
        let half = 0.5 * self.yaw;
        let rotation = Quaternion::new(libm::cos(half), 0.0, 0.0, libm::sin(half));
        let translation = Translation3::new(self.position.x, self.position.y, z);
        Isometry3::from_parts(translation, UnitQuaternion::new_normalize(rotation))
    }

    fn from_config(values: &[f64; 3]) -> Self {
        Self { position: Vector2::new(values[0], values[1]), yaw: values[2] }
    }
}

/// The surface that the fixture hangs on.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Mount {
    /// A rod from the ceiling; opens downwards.
    Ceiling,
    /// The west wall; opens towards +x.
    West,
    /// The east wall; opens towards -x.
    East,
    /// The south wall; opens towards +y.
    South,
}

impl Mount {
    /// Rotation of the socket, exact to the last bit.
    fn rotation(self) -> UnitQuaternion<f64> {
        let s = FRAC_1_SQRT_2;
        UnitQuaternion::new_normalize(match self {
            Mount::Ceiling => Quaternion::new(0.0, 0.0, 1.0, 0.0),
            // A quarter turn about y, then the wall's yaw about z.
            Mount::West => Quaternion::new(s, 0.0, s, 0.0),
            Mount::East => Quaternion::new(0.0, -s, 0.0, s),
            Mount::South => Quaternion::new(0.5, -0.5, 0.5, 0.5),
        })
    }
}

/// Start state of the ladder.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum LadderStart {
    /// Anywhere in the room, with any heading: S01 and the full errand.
    Free,
    /// Ready below the fixture, its steps away from it: S02 to S12.
    Coupled,
}

/// Where everything stands, as drawn by the layout seed or as recorded.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Layout {
    /// The surface that the fixture hangs on.
    pub mount: Mount,
    /// Pose of the socket.
    pub world_from_fixture: Isometry3<f64>,
    /// Place of the published coupled ladder: in front of the fixture, steps away from it. Ours stands there too,
    /// unless that is inside a wall.
    pub anchor: Place,
    /// Where the ladder stands at the start.
    pub ladder: Place,
    /// Robot, in the zone drawn for it.
    pub robot: Place,
    /// Centre of the bench, which never turns; `None` in `climb`.
    pub bench: Option<Vector2<f64>>,
    /// Centre of the crate, which never turns; `None` in `climb`.
    pub crate_: Option<Vector2<f64>>,
}

impl Layout {
    /// Where the parts of a scene stand; [`SceneParts`] says which places the seed draws.
    ///
    /// # Errors
    /// As for [`Layout::draw`].
    pub fn of(config: &SceneConfig, parts: impl Into<SceneParts>, seed: u64) -> Result<Self, SceneError> {
        let parts = parts.into();
        match parts.ladder {
            Some(LadderPart::Coupled | LadderPart::Fixed) if parts.furniture => {
                Self::draw(config, seed, LadderStart::Coupled)
            }
            _ if parts.furniture => Self::draw(config, seed, LadderStart::Free),
            None if !parts.fixture && !parts.bulbs => Ok(Self::at_origin()),
            _ => Ok(Self::climb(config)),
        }
    }

    /// The robot at the origin, facing along +x.
    fn at_origin() -> Self {
        let origin = Place { position: Vector2::zeros(), yaw: 0.0 };
        Self {
            mount: Mount::Ceiling,
            world_from_fixture: Isometry3::identity(),
            anchor: origin,
            ladder: origin,
            robot: origin,
            bench: None,
            crate_: None,
        }
    }

    /// Checks a recorded layout.
    ///
    /// # Errors
    /// [`SceneError::Recorded`] if numbers or parts do not fit a scene of these parts.
    pub(crate) fn check(&self, config: &SceneConfig, parts: &SceneParts) -> Result<(), SceneError> {
        let ensure = |ok: bool, field, rule| if ok { Ok(()) } else { Err(SceneError::Recorded { field, rule }) };
        let reach = |numbers: &[f64]| numbers.iter().all(|number| number.abs() <= FAR);
        let furnished = parts.furniture;
        let rule = if furnished { "is missing" } else { "is in a scene that has none" };
        ensure(self.bench.is_some() == furnished, "bench", rule)?;
        ensure(self.crate_.is_some() == furnished, "crate", rule)?;
        let center = |center: Option<Vector2<f64>>| center.unwrap_or_default();
        for (field, position, yaw) in [
            ("anchor", self.anchor.position, self.anchor.yaw),
            ("ladder", self.ladder.position, self.ladder.yaw),
            ("robot", self.robot.position, self.robot.yaw),
            ("bench", center(self.bench), 0.0),
            ("crate", center(self.crate_), 0.0),
        ] {
            ensure(reach(position.as_slice()) && reach(&[yaw]), field, "is not within 100 m and 100 rad")?;
        }
        if !parts.fixture {
            return Ok(());
        }
        let fixture = &self.world_from_fixture;
        ensure(reach(fixture.translation.vector.as_slice()), "fixture", "is not within 100 m")?;
        let below = config.room.ceiling_height - 2.0 * config.fixture.rod_radius;
        let hangs = fixture.translation.z > 0.0 && fixture.translation.z < below;
        ensure(hangs, "fixture", "is not between floor and ceiling")?;
        let turn = fixture.rotation.coords - self.mount.rotation().coords;
        ensure(turn.norm() < 1e-9, "fixture", "is not turned as its mount has it")
    }

    /// Draws the room of a seed, with the published generator and order of draws: it is the published room of this seed.
    /// The ladder's start changes the ladder's place and nothing else.
    ///
    /// A ceiling fixture's bearing to the ladder is flipped where the ladder would leave the floor; where it would come
    /// nearer to the floor's edge than the inset, it is moved to the inset, and so nearer to the fixture. All that differs
    /// from the published room: a coupled ladder that would stand in a wall is moved out of it.
    ///
    /// # Errors
    /// [`SceneError::Layout`] when the zones do not fit within the config's number of tries.
    pub fn draw(config: &SceneConfig, seed: u64, start: LadderStart) -> Result<Self, SceneError> {
        let mut random = PythonRandom::new(seed);
        let mut failed = "";
        for _ in 0..config.layout.redraws {
            match draw_once(config, &mut random, start) {
                Ok(layout) => return Ok(layout),
                Err(zone) => failed = zone,
            }
        }
        Err(SceneError::Layout { seed, redraws: config.layout.redraws, zone: failed })
    }

    /// The fixed scene of `climb`.
    pub fn climb(config: &SceneConfig) -> Self {
        let climb = &config.climb;
        let ladder = Place::from_config(&climb.ladder);
        Self {
            mount: Mount::Ceiling,
            world_from_fixture: Isometry3::from_parts(
                Translation3::from(Vector3::from(climb.fixture)),
                Mount::Ceiling.rotation(),
            ),
            anchor: ladder,
            ladder,
            robot: Place::from_config(&climb.robot),
            bench: None,
            crate_: None,
        }
    }
}

fn draw_once(config: &SceneConfig, random: &mut PythonRandom, start: LadderStart) -> Result<Layout, &'static str> {
    let (mount, world_from_fixture, anchor) = draw_fixture(config, random);
    let free_yaw = random.uniform(0.0, 360.0).to_radians();
    let zones = &config.layout;
    // Largest first. The fixture's anchor is taken already.
    let order = [
        ("bench", zones.table_half),
        ("ladder", zones.ladder_half),
        ("robot", zones.robot_half),
        ("crate", zones.crate_half),
    ];
    let mut taken = vec![(anchor.position, zones.fixture_inset)];
    for (name, half) in order {
        let place = draw_zone(config, random, &taken, half).ok_or(name)?;
        taken.push((place, half));
    }
    let (bench, ladder, robot, crate_) = (taken[1].0, taken[2].0, taken[3].0, taken[4].0);
    let spread = random.uniform(-zones.robot_yaw_spread, zones.robot_yaw_spread);
    Ok(Layout {
        mount,
        world_from_fixture,
        anchor,
        ladder: match start {
            LadderStart::Free => Place { position: ladder, yaw: free_yaw },
            LadderStart::Coupled => clear_of_walls(config, anchor),
        },
        robot: Place { position: robot, yaw: measure::wrap_angle(measure::bearing(&robot, &bench) + spread) },
        bench: Some(bench),
        crate_: Some(crate_),
    })
}

fn draw_fixture(config: &SceneConfig, random: &mut PythonRandom) -> (Mount, Isometry3<f64>, Place) {
    let (room, fixture, inset) = (&config.room, &config.fixture, config.layout.fixture_inset);
    let draw_inset =
        |random: &mut PythonRandom, bounds: &[f64; 2]| random.uniform(bounds[0] + inset, bounds[1] - inset);
    let (mount, position, mut bearing, standoff);
    if random.random() < config.layout.ceiling_probability {
        mount = Mount::Ceiling;
        let x = draw_inset(random, &room.zone_x);
        position = Vector2::new(x, draw_inset(random, &room.zone_y));
        let angle = random.uniform(0.0, TAU);
        bearing = Vector2::new(libm::cos(angle), libm::sin(angle));
        standoff = fixture.standoff_ceiling;
        for (axis, zone) in [room.zone_x, room.zone_y].iter().enumerate() {
            let target = position[axis] + standoff * bearing[axis];
            if target < zone[0] || target > zone[1] {
                bearing[axis] = -bearing[axis];
            }
        }
    } else {
        mount = random.choice([Mount::West, Mount::East, Mount::South]);
        standoff = fixture.standoff_wall;
        (position, bearing) = match mount {
            Mount::West => (Vector2::new(room.wall_x[0], draw_inset(random, &room.wall_side_y)), Vector2::x()),
            Mount::East => (Vector2::new(room.wall_x[1], draw_inset(random, &room.wall_side_y)), -Vector2::x()),
            _ => (Vector2::new(draw_inset(random, &room.wall_south_x), room.wall_south_y), Vector2::y()),
        };
    }
    let target = position + standoff * bearing;
    let inside = |axis: usize, zone: &[f64; 2]| target[axis].max(zone[0] + inset).min(zone[1] - inset);
    let anchor = Place {
        position: Vector2::new(inside(0, &room.zone_x), inside(1, &room.zone_y)),
        // The steps are on the ladder's -y: they look along the bearing, away from the fixture.
        yaw: measure::wrap_angle(libm::atan2(-bearing.y, -bearing.x) - FRAC_PI_2),
    };
    let translation = Translation3::new(position.x, position.y, fixture.height);
    (mount, Isometry3::from_parts(translation, mount.rotation()), anchor)
}

fn draw_zone(
    config: &SceneConfig,
    random: &mut PythonRandom,
    taken: &[(Vector2<f64>, f64)],
    half: f64,
) -> Option<Vector2<f64>> {
    let (room, layout) = (&config.room, &config.layout);
    (0..layout.placement_tries).find_map(|_| {
        let x = random.uniform(room.zone_x[0] + half, room.zone_x[1] - half);
        let place = Vector2::new(x, random.uniform(room.zone_y[0] + half, room.zone_y[1] - half));
        let free = taken.iter().all(|(other, other_half)| (place - other).amax() >= half + other_half + layout.gap);
        free.then_some(place)
    })
}

#[cfg(test)]
mod tests;
