//! Postures of an arm that reach a pose from a stance, and ways between postures that strike neither robot nor room.

use fiatlux_client::PolicyError;
use fiatlux_dynamics::{Gaps, ShapeId, Site};
use fiatlux_kinematics::Goal;
use fiatlux_skills::{heading, towards};
use fiatlux_wbc::{ARMS, BodyCommand, LEGS, MOVED};
use nalgebra::{Isometry3, Rotation3, UnitQuaternion, Vector3};
use rand_pcg::Pcg64Mcg;
use rand_pcg::rand_core::Rng as _;

use super::apart::Apart;
use super::arm::{Arm, ELBOW, STRAIGHT, TURN_M, ToolGoal};
use super::retries::Manner;

/// Angles of the arm from the shoulder down, rad.
pub(super) type ArmAngles = [f64; ARMS / 2];

/// Work of a search in a control step.
pub(super) const SLICE: u32 = 80_000;
/// Work of measuring a gap besides that of its pairs of shapes.
const GAP_WORK: usize = 40;
/// Gaps from here on count as this, m.
const WIDE: f64 = 0.03;
/// Turn of the joints between two checks of a way, and length of a step of the search, rad.
const CHECK: f64 = 0.04;
const STEP: f64 = 0.25;
/// A posture is near another one where no joint differs by more, rad.
const NEAR: f64 = 0.3;
/// Most steps of the search for a way, and tries to shorten it.
const STEPS: usize = 4000;
const SHORTCUTS: usize = 120;
/// Left arm beside the guard rail, where there is no room for that, and at rest, rad, and how fast it gets there, rad/s.
const LEFT_AWAY: ArmAngles = [0.0, 0.9, 0.0, 0.6, 0.0, 0.0, 0.0];
const LEFT_IN: ArmAngles = [0.9, 0.25, 0.0, 1.3, 0.0, 0.0, 0.0];
const LEFT_DOWN: ArmAngles = [0.3, 0.3, 0.0, 1.3, 0.0, 0.0, 0.0];
const LEFT_RATE: f64 = 0.7;
/// Postures that are tried as a haven, and how far beyond the way between two others, rad.
const HAVENS: usize = 1500;
const SPREAD: f64 = 1.2;
/// Share that the pelvis has in the torso's roll and pitch where the robot stands, as in `fiatlux_wbc`.
const PELVIS_SHARE: [f64; 2] = [0.2, 0.25];

impl Arm {
    /// Distance of the hand, as sensed, from where it is commanded to be, m; a turn of 0.1 rad counts as much as 0.03.
    pub fn lag(&mut self) -> f64 {
        let target = self.world_from_hand();
        self.distance_to(&target)
    }

    /// Sets pelvis and waist to where a command brings them, the feet staying and the centre of mass over them, while the arm has
    /// these angles. It holds until the next [`Arm::sense`].
    pub fn assume(&mut self, command: &BodyCommand, angles: &ArmAngles) {
        self.set(angles);
        for (joint, angle) in (MOVED..).zip(self.left_away()) {
            self.state.qpos[self.qpos[joint]] = angle;
        }
        let pelvis = self.pelvis();
        let yaw = heading(&pelvis);
        let [roll, pitch, turn] = command.torso;
        let [pelvis_roll, pelvis_pitch] = [PELVIS_SHARE[0] * roll, PELVIS_SHARE[1] * pitch];
        let upright = Rotation3::from_euler_angles(pelvis_roll, pelvis_pitch, 0.0);
        let waist = upright.inverse() * Rotation3::from_euler_angles(roll, pitch, turn);
        let waist = waist.matrix();
        // The waist turns about z, then x, then y.
        let bent = [
            libm::atan2(-waist[(0, 1)], waist[(1, 1)]),
            libm::asin(waist[(2, 1)].clamp(-1.0, 1.0)),
            libm::atan2(-waist[(2, 0)], waist[(2, 2)]),
        ];
        for (joint, angle) in (LEGS..).zip(bent) {
            let [lower, upper] = self.limits[joint];
            self.state.qpos[self.qpos[joint]] = angle.clamp(lower, upper);
        }
        let rotation = UnitQuaternion::from_euler_angles(pelvis_roll, pelvis_pitch, yaw);
        let mut place = pelvis.translation.vector;
        place.z = self.floor + command.height;
        self.set_pelvis(&Isometry3::from_parts(place.into(), rotation));
        let shift = self.middle - self.center_of_mass();
        place += Vector3::new(shift.x, shift.y, 0.0);
        self.set_pelvis(&Isometry3::from_parts(place.into(), rotation));
    }

    fn left_away(&self) -> ArmAngles {
        if self.left_is_drawn_in { LEFT_IN } else { LEFT_AWAY }
    }

    /// Brings the left arm's targets a step nearer to where it is clear of the guard rail while the robot leans, or down again.
    pub fn put_left_arm(&self, targets: &mut [f64], is_away: bool) {
        let goal = if is_away { self.left_away() } else { LEFT_DOWN };
        for (target, wanted) in targets[MOVED..].iter_mut().zip(goal) {
            *target = towards(*target, wanted, LEFT_RATE);
        }
    }

    /// Angles at which a tool is where it is wanted, searched from some on, on request with gaps to all around, and how far it stays
    /// from there, m.
    pub async fn find(
        &mut self,
        is_careful: bool,
        goal: &ToolGoal,
        from: &ArmAngles,
        tries: usize,
    ) -> Result<(ArmAngles, f64), PolicyError> {
        let Site { body, body_from_site } = self.hand;
        let tool = Site { body, body_from_site: body_from_site * goal.hand_from_tool };
        let wanted = match goal.free {
            Some(axis) => Goal::pose_about(tool, goal.world_from_tool, axis),
            None => Goal::pose(tool, goal.world_from_tool),
        };
        self.set(from);
        let inverse = if is_careful { &mut self.careful } else { &mut self.inverse };
        inverse.options.tries = tries;
        let found = inverse.solve_in_slices(&self.model, &mut self.state, &[wanted], &self.work).await;
        let found = found.map_err(PolicyError::of("hands"))?;
        let mut solved = *from;
        for (joint, angle) in self.joints.clone().zip(&mut solved) {
            *angle = self.state.qpos[self.qpos[joint]];
        }
        Ok((solved, found.position_error.max(TURN_M * found.rotation_error).max(found.clearance_error)))
    }

    /// Least room of the joints to their limits, and of the elbow until the arm is straight, rad.
    pub fn room(&self, angles: &ArmAngles) -> f64 {
        let room = |(angle, [lower, upper]): (&f64, &[f64; 2])| (angle - lower).min(upper - angle);
        let bent = (STRAIGHT - angles[ELBOW]).abs();
        angles.iter().zip(&self.limits[self.joints.clone()]).map(room).fold(bent, f64::min)
    }

    /// Smallest gap between the arm with its hand and all else, m, at most [`WIDE`].
    pub async fn gap(&mut self, angles: &ArmAngles, apart: Apart) -> f64 {
        let (gaps, pairs) = self.gaps(angles, apart).await;
        gaps.nearest_pair(pairs, WIDE).map_or(WIDE, |(_, nearest)| nearest.distance)
    }

    /// Gaps with the arm in a posture, and the pairs that are kept apart.
    async fn gaps(&mut self, angles: &ArmAngles, apart: Apart) -> (Gaps<'_>, &[(ShapeId, ShapeId)]) {
        self.set(angles);
        self.mechanics.update(&self.model, &self.state);
        let pairs = &self.pairs[apart as usize];
        self.work.spend(GAP_WORK + pairs.len()).await;
        (self.mechanics.gaps(&self.model), pairs)
    }

    /// True if the gap between the arm with its hand and all else is wider than so much, m, which is below [`WIDE`].
    async fn is_apart(&mut self, angles: &ArmAngles, least: f64, apart: Apart) -> bool {
        let (gaps, pairs) = self.gaps(angles, apart).await;
        least < WIDE && !gaps.any_within(pairs, least)
    }

    /// Smallest gap between trunk, hips, head or other arm and what surrounds the robot, m, at most [`WIDE`].
    pub async fn body_gap(&mut self) -> f64 {
        self.mechanics.update(&self.model, &self.state);
        self.work.spend(GAP_WORK + self.body_pairs.len()).await;
        let nearest = self.mechanics.gaps(&self.model).nearest_pair(&self.body_pairs, WIDE);
        nearest.map_or(WIDE, |(_, nearest)| nearest.distance)
    }

    /// A posture that keeps a margin, m, in several stances, near to two others.
    pub async fn haven(
        &mut self,
        commands: &[BodyCommand],
        [from, to]: [&ArmAngles; 2],
        margin: f64,
        apart: Apart,
    ) -> Option<ArmAngles> {
        let mut random = Pcg64Mcg::new(2);
        let far = |a: &ArmAngles, b: &ArmAngles| a.iter().zip(b).map(|(a, b)| (a - b).abs()).sum::<f64>();
        let mut best: Option<(f64, ArmAngles)> = None;
        for sample in 0..HAVENS {
            let angles: ArmAngles = match sample {
                0 => *from,
                1 => *to,
                _ => {
                    let share = unit(&mut random);
                    std::array::from_fn(|joint| {
                        let [lower, upper] = self.limits[self.joints.start + joint];
                        let between = from[joint] + share * (to[joint] - from[joint]);
                        (between + SPREAD * (2.0 * unit(&mut random) - 1.0)).clamp(lower, upper)
                    })
                }
            };
            let distance = far(from, &angles) + far(&angles, to);
            if best.as_ref().is_some_and(|(least, _)| distance >= *least) {
                continue;
            }
            let mut is_clear = true;
            for command in commands {
                self.assume(command, &angles);
                is_clear = self.is_apart(&angles, margin, apart).await;
                if !is_clear {
                    break;
                }
            }
            if is_clear {
                best = Some((distance, angles));
            }
        }
        best.map(|(_, angles)| angles)
    }

    /// A way between two postures on which the gaps stay above `margin`, m, or near its ends above theirs; as corners, the ends
    /// included. None is found where the search ends before.
    pub async fn way(
        &mut self,
        from: &ArmAngles,
        to: &ArmAngles,
        margin: f64,
        manner: Manner,
    ) -> Option<Vec<ArmAngles>> {
        let Manner { apart, keeps_margin, .. } = manner;
        let ends = [(*from, self.gap(from, apart).await - 1e-3), (*to, self.gap(to, apart).await - 1e-3)];
        if keeps_margin && let Some(way) = self.way_within(&Margin { usual: margin, ends }, apart).await {
            return Some(way);
        }
        if keeps_margin && apart != Apart::Carrying {
            return None;
        }
        // What the hand holds may begin or end too close to what is around.
        let usual = margin.min(ends[0].1).min(ends[1].1);
        self.way_within(&Margin { usual, ends }, apart).await
    }

    async fn way_within(&mut self, margin: &Margin, apart: Apart) -> Option<Vec<ArmAngles>> {
        let [from, to] = &margin.ends.map(|(angles, _)| angles);
        if self.is_clear(from, to, margin, apart).await {
            return Some(vec![*from, *to]);
        }
        let mut random = Pcg64Mcg::new(1);
        let mut trees = [vec![(*from, 0)], vec![(*to, 0)]];
        for step in 0..STEPS {
            let [grows, other] = [step % 2, 1 - step % 2];
            let sample: ArmAngles = std::array::from_fn(|joint| {
                let [lower, upper] = self.limits[self.joints.start + joint];
                lower + (upper - lower) * unit(&mut random)
            });
            let (node, _) = nearest(&trees[grows], &sample);
            let grown = moved(&trees[grows][node].0, &sample, STEP);
            if !self.is_clear(&trees[grows][node].0, &grown, margin, apart).await {
                continue;
            }
            trees[grows].push((grown, node));
            let (mut node, _) = nearest(&trees[other], &grown);
            loop {
                let last = trees[other][node].0;
                let next = moved(&last, &grown, STEP);
                if !self.is_clear(&last, &next, margin, apart).await {
                    break;
                }
                trees[other].push((next, node));
                node = trees[other].len() - 1;
                if next == grown {
                    let mut halves = [branch(&trees[0], 0), branch(&trees[1], 0)];
                    halves[grows] = branch(&trees[grows], trees[grows].len() - 1);
                    halves[other] = branch(&trees[other], node);
                    let [mut way, back] = halves;
                    way.reverse();
                    way.extend(back.into_iter().skip(1));
                    return Some(self.shorten(way, margin, apart, &mut random).await);
                }
            }
        }
        None
    }

    async fn is_clear(&mut self, from: &ArmAngles, to: &ArmAngles, margin: &Margin, apart: Apart) -> bool {
        let length = from.iter().zip(to).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
        let count = libm::ceil(length / CHECK).max(1.0);
        for index in 1..=count as usize {
            let share = index as f64 / count;
            let angles = std::array::from_fn(|joint| from[joint] + share * (to[joint] - from[joint]));
            if !self.is_apart(&angles, margin.at(&angles), apart).await {
                return false;
            }
        }
        true
    }

    async fn shorten(
        &mut self,
        mut way: Vec<ArmAngles>,
        margin: &Margin,
        apart: Apart,
        random: &mut Pcg64Mcg,
    ) -> Vec<ArmAngles> {
        for _ in 0..SHORTCUTS {
            let legs = way.len() - 1;
            if legs < 2 {
                break;
            }
            let mut ends = [0, 1].map(|_| legs as f64 * unit(random));
            ends.sort_by(f64::total_cmp);
            let [low, high] = ends;
            let at = |place: f64| -> ArmAngles {
                let (leg, share) = (place as usize, place - libm::floor(place));
                std::array::from_fn(|joint| way[leg][joint] + share * (way[leg + 1][joint] - way[leg][joint]))
            };
            let (first, last) = (at(low), at(high));
            if low as usize == high as usize || !self.is_clear(&first, &last, margin, apart).await {
                continue;
            }
            let mut shorter = way[..=low as usize].to_vec();
            shorter.extend([first, last]);
            shorter.extend_from_slice(&way[high as usize + 1..]);
            way = shorter;
        }
        way
    }
}

/// Gaps that a way keeps, m.
struct Margin {
    usual: f64,
    /// Postures near which less is enough, and how much.
    ends: [(ArmAngles, f64); 2],
}

impl Margin {
    fn at(&self, angles: &ArmAngles) -> f64 {
        let is_near = |end: &ArmAngles| end.iter().zip(angles).all(|(end, angle)| (end - angle).abs() < NEAR);
        let near = self.ends.iter().filter(|(end, _)| is_near(end)).map(|(_, gap)| *gap);
        near.fold(self.usual, f64::min)
    }
}

fn unit(random: &mut Pcg64Mcg) -> f64 {
    (random.next_u64() >> 11) as f64 / (1_u64 << 53) as f64
}

fn nearest(tree: &[(ArmAngles, usize)], to: &ArmAngles) -> (usize, f64) {
    let distance = |angles: &ArmAngles| angles.iter().zip(to).map(|(a, b)| (a - b) * (a - b)).sum::<f64>();
    let distances = tree.iter().map(|(angles, _)| distance(angles)).enumerate();
    distances.fold((0, f64::INFINITY), |best, next| if next.1 < best.1 { next } else { best })
}

fn moved(from: &ArmAngles, to: &ArmAngles, step: f64) -> ArmAngles {
    let length = from.iter().zip(to).map(|(a, b)| (a - b) * (a - b)).sum::<f64>().sqrt();
    if length <= step {
        return *to;
    }
    std::array::from_fn(|joint| from[joint] + step / length * (to[joint] - from[joint]))
}

/// From a node to its root.
fn branch(tree: &[(ArmAngles, usize)], mut node: usize) -> Vec<ArmAngles> {
    let mut nodes = vec![tree[node].0];
    while node != 0 {
        node = tree[node].1;
        nodes.push(tree[node].0);
    }
    nodes
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Less than the usual gap is enough near an end whose own gap is smaller, and nowhere else.
    #[test]
    fn a_way_keeps_its_margin_away_from_its_ends() {
        let (tight, wide) = ([0.0; ARMS / 2], [2.0; ARMS / 2]);
        let margin = Margin { usual: 0.01, ends: [(tight, 0.002), (wide, 0.02)] };
        assert_eq!(margin.at(&[0.9 * NEAR; ARMS / 2]), 0.002);
        assert_eq!(margin.at(&[1.1 * NEAR; ARMS / 2]), 0.01);
        assert_eq!(margin.at(&wide), 0.01);
    }
}
