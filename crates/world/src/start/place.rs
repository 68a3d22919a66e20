//! Where the robot stands.

use std::f64::consts::{FRAC_PI_2, PI};

use fiatlux_dynamics::Contact;
use fiatlux_rules::{Landmark, ResetNoise, Row, Stand as StandSpec, StartDistance, StartSpec, errand, measure};
use nalgebra::Vector2;

use super::{Start, StartError, StartOffset};
use crate::config::{StartConfig, StartNoise};
use crate::layout::Place;
use crate::{Random, Scene, ShapeOwner, Stream, World};

/// The robot exactly in its nominal place and posture.
pub(super) const NO_NOISE: StartNoise = StartNoise { shift: 0.0, turn: 0.0, joint: 0.0 };

/// Height above the nominal from which the search for the surface below the soles starts, and the depth that it covers, m.
const LIFT: f64 = 0.2;

/// Places to try straight behind the one on the platform, before others on it.
const BACK_STEPS: i32 = 5;
/// Farthest back and to either side on the platform, in steps: the feet stay on it.
const PLATFORM_STEPS: [i32; 2] = [10, 6];

/// Places in which the hand may try to close around its bulb; each costs a second of simulation.
const MAX_GRASPS: usize = 8;

/// Deepest overlap of two links that a start may have, m.
const SELF_OVERLAP: f64 = 5e-4;

/// Where a task puts the robot.
enum Stand {
    /// On the floor at that place.
    Floor(Place),
    /// On the floor at a distance from a thing, in a direction that may turn.
    Around { center: Vector2<f64>, distance: f64, bearing: f64, facing: Vector2<f64> },
    /// On the ladder's platform, or a little farther back or aside.
    Platform(Place),
}

/// The task's reset noise.
pub(super) fn noise(scene: &Scene, spec: &StartSpec) -> StartNoise {
    match spec.noise {
        ResetNoise::None => NO_NOISE,
        ResetNoise::Usual => scene.config.start.noise,
        ResetNoise::AtLadder => scene.config.start.ladder_noise,
    }
}

fn facing(position: Vector2<f64>, target: Vector2<f64>) -> Place {
    Place { position, yaw: measure::bearing(&position, &target) }
}

fn stand(scene: &Scene, spec: StandSpec, row: &Row) -> Stand {
    let (config, layout) = (&scene.config.start, &scene.layout);
    let zone = layout.robot.position;
    let ladder = layout.ladder.position;
    let fresh = row.things[errand::FRESH_BULB].pose.translation.vector.xy();
    let place_of = |landmark| match landmark {
        Landmark::Ladder => ladder,
        Landmark::Crate => layout.crate_.unwrap_or(zone),
        Landmark::FreshBulb => fresh,
    };
    match spec {
        StandSpec::OwnZone => Stand::Floor(layout.robot),
        StandSpec::OwnZoneFacing(landmark) => Stand::Floor(facing(zone, place_of(landmark))),
        StandSpec::LadderSteps => Stand::Around {
            center: ladder,
            distance: config.mounting_distance,
            bearing: layout.ladder.yaw - FRAC_PI_2,
            facing: ladder,
        },
        StandSpec::Platform => {
            let top = measure::world_point(&scene.world_from(errand::LADDER), &scene.ladder_points.top);
            Stand::Platform(Place { position: top.xy(), yaw: layout.ladder.yaw + FRAC_PI_2 })
        }
        StandSpec::Beside { landmark, distance, facing } => {
            let center = place_of(landmark);
            let distance = match distance {
                StartDistance::Mounting => config.mounting_distance,
                StartDistance::Dispose => config.dispose_distance,
                StartDistance::Leave => config.leave_distance,
            };
            // Towards the robot's own zone, never beyond it.
            Stand::Around {
                center,
                distance: distance.min((zone - center).norm()),
                bearing: measure::bearing(&center, &zone),
                facing: place_of(facing),
            }
        }
        StandSpec::BenchAtBulb => Stand::Floor(facing(fresh + Vector2::from(config.grab_place), fresh)),
        StandSpec::BenchFacing(landmark) => {
            let bench = layout.bench.unwrap_or(zone);
            Stand::Floor(facing(bench + Vector2::from(config.carry_place), place_of(landmark)))
        }
    }
}

impl Stand {
    /// Nominal height of the pelvis, m.
    fn height(&self, scene: &Scene) -> f64 {
        match self {
            Stand::Floor(_) | Stand::Around { .. } => scene.config.robot.pelvis_height,
            Stand::Platform(_) => scene.ladder_points.top.z + scene.config.start.platform_pelvis,
        }
    }

    /// The nominal place, then those to go to where it is taken.
    fn places(&self, config: &StartConfig) -> Vec<Place> {
        match *self {
            Stand::Floor(place) => vec![place],
            Stand::Platform(place) => {
                let back = -Vector2::new(libm::cos(place.yaw), libm::sin(place.yaw)) * config.back_step;
                let left = Vector2::new(back.y, -back.x);
                let [most, aside] = PLATFORM_STEPS;
                let all = (0..=most).flat_map(|k| (-aside..=aside).map(move |side| (k, side)));
                let mut steps: Vec<(i32, i32)> = all.collect();
                steps.sort_by_key(|&(k, side)| (side != 0 || k > BACK_STEPS, k * k + side * side));
                let at = |(k, side)| Place {
                    position: place.position + f64::from(k) * back + f64::from(side) * left,
                    ..place
                };
                steps.into_iter().map(at).collect()
            }
            Stand::Around { center, distance, bearing, facing: target } => {
                let turns = 1..=libm::floor(PI / config.turn_step) as u32;
                let turns = turns.flat_map(|k| [1.0, -1.0].map(|side| side * f64::from(k) * config.turn_step));
                let at = |turn: f64| {
                    let angle = bearing + turn;
                    let arm = Vector2::new(libm::cos(angle), libm::sin(angle));
                    facing(center + distance * arm, target)
                };
                std::iter::once(0.0).chain(turns).map(at).collect()
            }
        }
    }
}

impl Start<'_> {
    /// Puts the robot into its place, noise included, its soles on what it stands on, and a bulb into its hand, which closes
    /// around it. Returns the noise.
    pub(super) fn put_robot(
        &self,
        world: &mut World,
        row: &mut Row,
        noise: &StartNoise,
    ) -> Result<StartOffset, StartError> {
        let scene = self.scene;
        let config = &scene.config.start;
        let stand = stand(scene, self.task.spec().start.robot, row);
        let places = stand.places(config);
        let mut random = Random::new(Stream::Reset, self.seed, self.episode);
        let Start { task, seed, episode, .. } = *self;
        let taken = |obstacle| StartError::Place { task, seed, episode, obstacle };
        let (mut first_fault, mut grasps) = (None, 0);
        let draws = if *noise == NO_NOISE { 1 } else { config.redraws };
        for _ in 0..draws {
            // Always the same numbers of the stream, whatever the size of the noise.
            let mut draw = |half: f64| random.uniform(-half, half);
            let shift = [draw(noise.shift), draw(noise.shift)];
            let turn = draw(noise.turn);
            let offset = StartOffset { shift, turn, joints: self.posture.iter().map(|_| draw(noise.joint)).collect() };
            for (joint, limits) in scene.robot.joints().iter().enumerate() {
                let angle = self.posture[joint] + offset.joints[joint];
                row.joint_position[joint] = angle.clamp(limits.lower, limits.upper);
            }
            scene.robot.follow(&mut row.joint_position);
            let moved = |nominal: &Place| Place {
                position: nominal.position + Vector2::from(offset.shift),
                yaw: measure::wrap_angle(nominal.yaw + offset.turn),
            };
            let lifted = stand.height(scene) + LIFT;
            self.put(world, row, &moved(&places[0]), lifted)?;
            if let Some(link) = self_overlap(world)? {
                first_fault.get_or_insert(taken(link));
                continue;
            }
            let height = lifted - stand.gap_below_soles(world)?;
            for nominal in &places {
                self.put(world, row, &moved(nominal), height)?;
                if let Some(obstacle) = self.obstacle(world, &stand)? {
                    first_fault.get_or_insert(taken(obstacle));
                    continue;
                }
                // What is clear of the open hand may be in the way of its fingers as they close.
                grasps += 1;
                match self.carried.map_or(Ok(()), |bulb| self.close_hand(world, row, bulb)) {
                    Err(slipped @ StartError::Hold { .. }) if grasps < MAX_GRASPS => {
                        first_fault.get_or_insert(slipped);
                    }
                    ended => return ended.map(|()| offset),
                }
            }
        }
        Err(first_fault.unwrap_or(taken(stand.support())))
    }

    /// Sets the world to the row with the robot's pelvis at a place, `z` m above the floor, and the bulb in its hand.
    fn put(&self, world: &mut World, row: &mut Row, place: &Place, z: f64) -> Result<(), StartError> {
        row.robot.pose = place.world_from_place(z);
        if let Some(bulb) = self.carried {
            row.things[bulb.thing()].pose = self.world_from_held_bulb(row, bulb)?;
        }
        Ok(world.reset_to(row)?)
    }

    /// The obstacle that is nearer to the robot or its bulb than the clearance. Where the gate asks to come near the crate,
    /// also the crate that is nearly reached.
    fn obstacle(&self, world: &World, stand: &Stand) -> Result<Option<ShapeOwner>, StartError> {
        let (scene, row) = (self.scene, world.row());
        let pelvis = &row.robot.pose.translation.vector;
        let crate_gap =
            measure::footprint_distance(&row.things[errand::CRATE].pose, &scene.config.crate_.outer_half, pelvis);
        if self.task.spec().start.away_from_crate
            && crate_gap < self.thresholds.crate_near_m + scene.config.start.head_start
        {
            return Ok(Some(ShapeOwner::CRATE));
        }
        let in_hand = self.carried.map(|bulb| ShapeOwner::Thing(bulb.thing()));
        let is_own = |owner: ShapeOwner| matches!(owner, ShapeOwner::Robot(_)) || Some(owner) == in_hand;
        let mut pairs = nearby(world, scene.config.start.clearance)?.map(|(owners, _)| owners);
        let in_the_way = |[a, b]: &[ShapeOwner; 2]| is_own(*a) && !is_own(*b) && !stand.bears([*a, *b], scene);
        Ok(pairs.find(in_the_way).map(|[_, b]| b))
    }
}

impl Stand {
    /// The surface that the robot stands on.
    fn support(&self) -> ShapeOwner {
        if matches!(self, Stand::Platform(_)) { ShapeOwner::LADDER } else { ShapeOwner::Floor }
    }

    /// True if the first is a foot and the second the surface below it.
    fn bears(&self, [foot, support]: [ShapeOwner; 2], scene: &Scene) -> bool {
        support == self.support() && matches!(foot, ShapeOwner::Robot(link) if scene.robot.feet().contains(&link))
    }

    /// Height of the lowest sole above what the robot is to stand on, m; the nominal one where nothing is there.
    fn gap_below_soles(&self, world: &World) -> Result<f64, StartError> {
        let near = nearby(world, 2.0 * LIFT)?.filter(|(owners, _)| self.bears(*owners, world.scene()));
        // Bars next to the feet bear nothing.
        let below = near.filter(|(_, contact)| contact.normal.z.abs() > 0.99);
        let gap = below.map(|(_, contact)| contact.distance).fold(f64::INFINITY, f64::min);
        Ok(if gap.is_finite() { gap } else { LIFT })
    }
}

/// A link of the robot that the noise has put into another one.
fn self_overlap(world: &World) -> Result<Option<ShapeOwner>, StartError> {
    let is_robot = |owner: &ShapeOwner| matches!(owner, ShapeOwner::Robot(_));
    let deep = nearby(world, 0.0)?.filter(|(_, contact)| contact.distance < -SELF_OVERLAP);
    Ok(deep.map(|(owners, _)| owners).find(|owners| owners.iter().all(is_robot)).map(|[link, _]| link))
}

/// Contact points of shapes with a gap of at most `margin` m, each with their owners in both orders.
fn nearby(
    world: &World,
    margin: f64,
) -> Result<impl Iterator<Item = ([ShapeOwner; 2], Contact)> + use<'_>, StartError> {
    let scene = world.scene();
    let found = scene.model.contacts_at(&world.state().qpos, margin)?;
    Ok(found.into_iter().flat_map(|contact| {
        let (a, b) = (scene.owner(contact.shape_a), scene.owner(contact.shape_b));
        [([a, b], contact), ([b, a], contact)]
    }))
}
