//! Postures of a climb: feet on treads and platform, the shins clear of what is above.

use fiatlux_dynamics::{ShapeId, State};
use fiatlux_kinematics::{
    Clearance, Goal, InverseKinematics, Mechanics, Outcome, SearchOptions, Site, Stance, StanceController,
};
use fiatlux_world::Scene;
use nalgebra::{Isometry3, Point3, UnitQuaternion, Vector3};

use crate::holding::Own;
use crate::stances::{ladder, soles, world_from_tread};

/// Surfaces under the feet, by height.
const SURFACES: [&str; 5] = ["ladder_tread_0", "ladder_tread_1", "ladder_tread_2", "ladder_tread_3", "ladder_platform"];
const PLATFORM: usize = 4;
/// Half the depth of a tread and of the platform, m.
const HALF_DEPTH: [f64; 2] = [0.045, 0.2];
/// Smallest gap between shapes, m.
const MARGIN: f64 = 0.002;
/// Distances of a sole's middle behind that of its tread, or of a tread at the platform's edge, m.
const BEHIND: [f64; 5] = [0.012, -0.01, -0.03, -0.045, 0.042];
/// Distances of a sole from the ladder's middle, m.
const ASIDE: [f64; 2] = [0.1, 0.15];

/// Where the feet are.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Feet {
    /// Under the left and the right foot; the right one is the upper one where they differ.
    pub surfaces: [usize; 2],
    /// Turn of the toes outwards, rad.
    pub out: f64,
    /// Part of the weight on the right foot.
    pub share: f64,
    /// Height of the left foot above its surface, m; above 0 it bears nothing.
    pub lift: f64,
}

/// A posture with these feet.
pub struct Placed {
    pub feet: Feet,
    pub state: State,
    pub stance: Stance,
}

/// A sole's pose and how far what bears reaches to the rear and ahead of its middle, m.
type Foothold = (Isometry3<f64>, [f64; 2]);

impl Feet {
    /// All of a climb: both feet on a surface, or on neighbours; weight shared, mostly on the right foot, or all of it.
    pub fn all() -> Vec<Self> {
        let mut all = Vec::new();
        for out in [0.0, 0.35] {
            let mut add = |left, right, share, lift| all.push(Self { surfaces: [left, right], out, share, lift });
            for k in 0..=PLATFORM {
                add(k, k, 0.5, 0.0);
                add(k, k, 1.0, 0.03);
                if k < PLATFORM {
                    add(k, k + 1, 0.5, 0.0);
                    add(k, k + 1, 0.9, 0.0);
                    add(k, k + 1, 1.0, 0.03);
                }
            }
        }
        all
    }

    /// True for the upper foot of two alone.
    pub fn is_narrow(&self) -> bool {
        self.lift > 0.0 && self.surfaces[0] != self.surfaces[1]
    }

    /// A posture in which shapes keep apart and the supports bear the robot.
    pub fn place(&self, scene: &Scene) -> Option<Placed> {
        let mut inverse = self.inverse_kinematics(scene);
        let same = self.surfaces[0] == self.surfaces[1];
        let aside = ASIDE.into_iter().flat_map(|aside| BEHIND.map(|left| (aside, left)));
        let places = aside.flat_map(|(aside, left)| BEHIND.map(|right| (aside, [left, right])));
        let mut places = places.filter(|(_, behind)| !same || behind[0] == behind[1]);
        places.find_map(|(aside, behind)| self.try_place(scene, &mut inverse, behind, aside))
    }

    fn rest(&self, scene: &Scene) -> Vec<f64> {
        let is_straight = self.surfaces[0] == self.surfaces[1] && self.lift == 0.0;
        let angle = |name: &str| {
            let (side, joint) = name.split_once('_').unwrap();
            let outwards = if side == "left" { 1.0 } else { -1.0 };
            let [hip, knee, ankle] = match (is_straight, side) {
                (true, _) => [-0.03, 0.06, -0.03],
                (_, "left") => [-0.3, 0.5, -0.2],
                _ => [-1.1, 1.6, -0.5],
            };
            match joint {
                "hip_pitch_joint" => hip,
                "hip_yaw_joint" => outwards * self.out,
                "knee_joint" => knee,
                "ankle_pitch_joint" => ankle,
                "shoulder_pitch_joint" => 0.2,
                "shoulder_roll_joint" => outwards * 0.3,
                "elbow_joint" => 1.2,
                _ => 0.0,
            }
        };
        scene.robot.joints().iter().map(|joint| angle(&joint.name)).collect()
    }

    fn inverse_kinematics(&self, scene: &Scene) -> InverseKinematics {
        let (model, ids) = (&scene.model, &scene.robot_ids);
        let joints: Vec<_> = ids.joints.iter().map(|joint| joint.body).collect();
        let mut inverse = InverseKinematics::new(model, ids.root, &joints, true).unwrap();
        inverse.options = SearchOptions {
            tries: 12,
            steps: 80,
            limit_margin: 0.02,
            spread: 0.4,
            rest_pull: 0.05,
            ..SearchOptions::default()
        };
        inverse.set_rest(&self.rest(scene)).unwrap();
        let apart = model.shape_pairs().filter(|&(a, b)| self.keeps_apart(scene, a, b));
        let clearances: Vec<_> = apart.map(|shapes| Clearance { shapes, margin: MARGIN }).collect();
        inverse.set_clearances(model, &clearances).unwrap();
        inverse
    }

    /// True for two shapes that are to keep apart: of the robot, or of it and something else, but for a sole and its surface.
    fn keeps_apart(&self, scene: &Scene, a: ShapeId, b: ShapeId) -> bool {
        let (model, ids) = (&scene.model, &scene.robot_ids);
        let shape = |id: ShapeId| &model.shapes()[id.0];
        let is_robot = |id: ShapeId| model.bodies()[shape(id).body.0].root == ids.root;
        let soles = scene.robot.soles();
        let stands = |a: ShapeId, b: ShapeId| {
            let sole = soles.iter().position(|sole| ids.site(&sole.site).body == shape(a).body);
            sole.is_some_and(|side| shape(b).name == SURFACES[self.surfaces[side]])
        };
        (is_robot(a) || is_robot(b)) && !stands(a, b) && !stands(b, a)
    }

    fn foothold(&self, scene: &Scene, mechanics: &Mechanics, side: usize, behind: f64, aside: f64) -> Foothold {
        let surface = self.surfaces[side];
        let half = HALF_DEPTH[usize::from(surface == PLATFORM)];
        // One foot on the platform is at its edge.
        let edge = if surface == PLATFORM && self.surfaces[0] != PLATFORM { half - HALF_DEPTH[0] } else { 0.0 };
        let outwards = [1.0, -1.0][side];
        let x = -behind - edge;
        let turn = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), outwards * self.out);
        let tread_from_sole = Isometry3::from_parts(Vector3::new(x, outwards * aside, 0.0).into(), turn);
        // A turned sole's corner gets to the tread's edge before its middle does.
        let corner = scene.robot.soles()[side].half_extents[1] * self.out.tan();
        let range = [corner - half - x, half - x - corner].map(|x| x.clamp(-0.101, 0.101));
        (world_from_tread(scene, mechanics, SURFACES[surface]) * tread_from_sole, range)
    }

    fn try_place(
        &self,
        scene: &Scene,
        inverse: &mut InverseKinematics,
        behind: [f64; 2],
        aside: f64,
    ) -> Option<Placed> {
        let (model, robot, ids) = (&scene.model, &scene.robot, &scene.robot_ids);
        let mut state = model.reference_state();
        let mut mechanics = Mechanics::new(model);
        mechanics.update(model, &state);
        let holds: [Foothold; 2] =
            std::array::from_fn(|side| self.foothold(scene, &mechanics, side, behind[side], aside));
        let bears = |(sole, range): &Foothold| (sole * Point3::new((range[0] + range[1]) / 2.0, 0.0, 0.0)).coords;
        let over = bears(&holds[0]).lerp(&bears(&holds[1]), self.share);
        let height = holds[0].0.translation.z + robot.standing_height() - 0.03;
        let facing = world_from_tread(scene, &mechanics, SURFACES[0]).rotation;
        let pelvis = Isometry3::from_parts(Vector3::new(over.x, over.y, height).into(), facing);
        state.set_pose(model, ids.root, &pelvis);
        ids.joints.iter().zip(self.rest(scene)).for_each(|(joint, angle)| state.qpos[joint.qpos] = angle);
        let sole = |side: usize| ids.site(&robot.soles()[side].site);
        let left = Isometry3::translation(0.0, 0.0, self.lift) * holds[0].0;
        let goals = [Goal::pose(sole(0), left), Goal::pose(sole(1), holds[1].0), Goal::com_over(over.x, over.y)];
        if inverse.solve(model, &mut state, &goals).unwrap().outcome != Outcome::Reached {
            return None;
        }
        let mut own = Own::new(scene);
        own.see(scene, &state);
        let link = |link: usize| {
            let ids = &own.ids.links[link];
            Site { body: ids.body, body_from_site: ids.body_from_link }
        };
        let mut supports = soles(robot, link, 0.6, holds.map(|(_, range)| range));
        if self.lift > 0.0 {
            supports.drain(..4);
        }
        let stance = Stance::new(&own.model, own.ids.root, &own.state, supports);
        let mut controller = StanceController::new(&own.model, own.ids.root).unwrap();
        controller.targets(&own.model, &own.state, &stance).unwrap();
        controller.is_borne().then_some(Placed { feet: *self, state, stance })
    }
}

#[test]
fn shins_keep_their_margin_from_the_next_tread() {
    let scene = ladder(5);
    let feet = Feet { surfaces: [2, 3], out: 0.0, share: 0.9, lift: 0.0 };
    let nearer = |state: &State| {
        let contacts = scene.model.contacts_at(&state.qpos, MARGIN - 2e-4).unwrap();
        contacts.into_iter().filter(|contact| feet.keeps_apart(&scene, contact.shape_a, contact.shape_b)).count()
    };
    assert_eq!(nearer(&feet.place(&scene).unwrap().state), 0);
    // Without margins the shin goes through the tread.
    let mut inverse = feet.inverse_kinematics(&scene);
    inverse.set_clearances(&scene.model, &[]).unwrap();
    let heedless = feet.try_place(&scene, &mut inverse, [0.012; 2], 0.1).unwrap();
    assert!(nearer(&heedless.state) > 0);
    let (model, none) = (&scene.model, ShapeId(9999));
    let refused = inverse.set_clearances(model, &[Clearance { shapes: (none, ShapeId(0)), margin: 0.0 }]).unwrap_err();
    assert!(refused.to_string().contains("clearance 0 names a shape"), "{refused}");
}
