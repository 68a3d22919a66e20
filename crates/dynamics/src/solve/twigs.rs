//! Fingers that touch nothing, eliminated as articulated bodies.
//!
//! A finger's row of the Hessian runs through hand, arm and trunk to the root, but all that these feel of the finger passes
//! through the hand. So a finger without a contact has no rows in the factor. As in Featherstone's articulated-body algorithm,
//! its joints are eliminated in the six dimensions of the hand's motion: they give way, and so relieve the hand of a part of
//! the inertia that the mass matrix ascribes to it. It is the same elimination in fewer operations.

use super::Problem;
use super::body_pair::force_of;
use crate::contact::Contact;
use crate::factor::Factor;
use crate::kinematics::Kinematics;
use crate::model::Model;
use crate::row_set::RowSet;
use crate::spatial::{Force, Motion};
use crate::spec::Joint;

/// Degrees of freedom from a free root down to a base, the body that twigs hang on: a row this long costs more than six
/// dimensions.
const BASE_DOFS: usize = 16;

type Vector = [f64; 6];

/// The unbranched twigs of a model, by base. What branches, or has a joint that follows another, keeps its rows
/// in the factor.
#[derive(Debug, Clone)]
pub(crate) struct Twigs<const W: usize> {
    bases: Vec<Base<W>>,
    free: RowSet<W>,
}

#[derive(Debug, Clone)]
struct Base<const W: usize> {
    /// Degrees of freedom from the root down to the body.
    chain: Vec<u16>,
    twigs: Vec<Twig<W>>,
    /// Rows of the twigs that nothing touches in this step.
    free: RowSet<W>,
}

#[derive(Debug, Clone)]
struct Twig<const W: usize> {
    /// From the base to the tip.
    links: Vec<Link>,
    rows: RowSet<W>,
    is_free: bool,
}

/// A joint, and what its elimination leaves.
#[derive(Debug, Clone)]
struct Link {
    dof: usize,
    axis: Vector,
    /// Force on the parent for a unit of the joint's effort.
    response: Vector,
    /// Of the inertia at the joint, its stiffness included.
    inverse: f64,
}

impl<const W: usize> Twigs<W> {
    pub fn new(model: &Model) -> Self {
        let mut bases = Vec::<Base<W>>::new();
        for chain in &model.chains {
            let Some((chain, rest)) = chain.split_at_checked(BASE_DOFS) else { continue };
            let root = model.bodies[model.dof_body[usize::from(chain[0])]].spec.joint == Joint::Free;
            if !root || rest.is_empty() {
                continue;
            }
            let at = bases.iter().position(|base| base.chain == chain).unwrap_or_else(|| {
                bases.push(Base { chain: chain.to_vec(), twigs: Vec::new(), free: RowSet::EMPTY });
                bases.len() - 1
            });
            bases[at].push(rest);
        }
        let follows = |link: &Link| model.follows(model.dof_body[link.dof]);
        for base in &mut bases {
            base.twigs.retain(|twig| twig.rows.len() == twig.links.len() && !twig.links.iter().any(follows));
        }
        Self { bases, free: RowSet::EMPTY }
    }

    /// Finds the twigs that none of these contacts can load, and returns their rows: they are eliminated here.
    pub fn find_free(&mut self, model: &Model, contacts: &[Contact]) -> RowSet<W> {
        self.free = RowSet::EMPTY;
        if self.bases.is_empty() {
            return RowSet::EMPTY;
        }
        let mut touched = RowSet::<W>::EMPTY;
        for shape in contacts.iter().flat_map(|contact| [contact.shape_a, contact.shape_b]) {
            let chain = &model.chains[model.shapes[shape.0].body.0];
            if let Some(&dof) = chain.get(BASE_DOFS) {
                touched.insert(usize::from(dof));
            }
        }
        for base in &mut self.bases {
            base.free = RowSet::EMPTY;
            for twig in &mut base.twigs {
                twig.is_free = (twig.rows & touched).is_empty();
                if twig.is_free {
                    base.free |= twig.rows;
                }
            }
            self.free |= base.free;
        }
        self.free
    }

    /// Rows that are eliminated here in this step.
    pub fn free(&self) -> RowSet<W> {
        self.free
    }

    /// Free rows of the bases of which some free rows, but not all, are among these.
    pub fn in_part(&self, rows: RowSet<W>) -> RowSet<W> {
        let in_part = |base: &&Base<W>| !(base.free & rows).is_empty() && !(base.free & !rows).is_empty();
        self.bases.iter().filter(in_part).fold(RowSet::EMPTY, |all, base| all | base.free)
    }

    /// Eliminates the free ones of these rows, with that on their diagonal, and takes from the factor's rows what their bases
    /// are relieved of. False if a pivot is not positive.
    pub fn eliminate(
        &mut self,
        rows: RowSet<W>,
        problem: &Problem<'_>,
        diagonal: &[f64],
        factor: &mut Factor<W>,
    ) -> bool {
        let mut positive = true;
        let axes = &problem.kin.axes;
        for base in self.bases.iter_mut().filter(|base| !(base.free & rows).is_empty()) {
            let mut relief = [[0.0; 6]; 6];
            for twig in base.twigs.iter_mut().filter(|twig| twig.is_free) {
                positive &= twig.eliminate(problem, diagonal, &mut relief);
            }
            for (r, &dof) in base.chain.iter().enumerate() {
                let dof = usize::from(dof);
                let force = force_of(&relief, &axes[dof]);
                let of_root = by_root(&force);
                let columns = &base.chain[..=r];
                factor.add_to_row(dof, columns, |c| {
                    if c < 6 { -of_root[c] } else { -axes[usize::from(columns[c])].dot(&force) }
                });
            }
        }
        positive
    }

    /// First half of a solve, before that of the factor: from the tips to the bases.
    pub fn solve_down(&self, rows: RowSet<W>, kin: &Kinematics, x: &mut [f64]) {
        for base in self.bases.iter().filter(|base| !(base.free & rows).is_empty()) {
            let mut sum = [0.0; 6];
            for twig in base.twigs.iter().filter(|twig| twig.is_free) {
                let mut force = [0.0; 6];
                for link in twig.links.iter().rev() {
                    let value = x[link.dof] - dot(&link.axis, &force);
                    force = plus_scaled(&force, &link.response, value);
                    x[link.dof] = value * link.inverse;
                }
                sum = plus_scaled(&sum, &force, 1.0);
            }
            let [tx, ty, tz, fx, fy, fz] = sum;
            let force = Force { torque: [tx, ty, tz].into(), force: [fx, fy, fz].into() };
            let (root, rest) = base.chain.split_at(6);
            for (&dof, value) in root.iter().zip(by_root(&force)) {
                x[usize::from(dof)] -= value;
            }
            for dof in rest.iter().map(|&dof| usize::from(dof)) {
                x[dof] -= kin.axes[dof].dot(&force);
            }
        }
    }

    /// Second half of a solve, after that of the factor: from the bases to the tips.
    pub fn solve_up(&self, rows: RowSet<W>, kin: &Kinematics, x: &mut [f64]) {
        for base in self.bases.iter().filter(|base| !(base.free & rows).is_empty()) {
            let root = usize::from(base.chain[0]);
            let root = &x[root..root + 6];
            let mut motion =
                Motion { angular: [root[3], root[4], root[5]].into(), linear: [root[0], root[1], root[2]].into() };
            for dof in base.chain[6..].iter().map(|&dof| usize::from(dof)) {
                motion.add_scaled(&kin.axes[dof], x[dof]);
            }
            for twig in base.twigs.iter().filter(|twig| twig.is_free) {
                let mut motion = of_motion(&motion);
                for link in &twig.links {
                    let value = x[link.dof] - dot(&link.response, &motion);
                    motion = plus_scaled(&motion, &link.axis, value);
                    x[link.dof] = value;
                }
            }
        }
    }
}

impl<const W: usize> Base<W> {
    /// Takes in a link, given the degrees of freedom from the base down to it.
    fn push(&mut self, path: &[u16]) {
        let at = self.twigs.iter().position(|twig| twig.rows.contains(path[0].into())).unwrap_or_else(|| {
            self.twigs.push(Twig { links: Vec::new(), rows: RowSet::EMPTY, is_free: false });
            self.twigs.len() - 1
        });
        let (twig, dof) = (&mut self.twigs[at], path[path.len() - 1]);
        twig.rows.insert(dof.into());
        if path.len() == twig.links.len() + 1 {
            twig.links.push(Link { dof: dof.into(), axis: [0.0; 6], response: [0.0; 6], inverse: 0.0 });
        }
    }
}

impl<const W: usize> Twig<W> {
    /// Adds what the base is relieved of.
    fn eliminate(&mut self, problem: &Problem<'_>, diagonal: &[f64], sum: &mut [Vector; 6]) -> bool {
        let &Problem { model, kin, equation, .. } = problem;
        let mut positive = true;
        // Inertia that the joints beyond relieve the link of.
        let mut relief = [[0.0; 6]; 6];
        let tip = self.links.len() - 1;
        for (k, link) in self.links.iter_mut().enumerate().rev() {
            let axis = &kin.axes[link.dof];
            link.axis = of_motion(axis);
            let mut felt = of_force(&equation.axis_momentum[link.dof]);
            let mut inertia = equation.mass_matrix[model.diagonal(link.dof)] + diagonal[link.dof];
            if k < tip {
                let relieved = of_force(&force_of(&relief, axis));
                felt = plus_scaled(&felt, &relieved, -1.0);
                inertia -= dot(&link.axis, &relieved);
            }
            positive &= inertia > 0.0;
            link.inverse = 1.0 / inertia;
            link.response = felt.map(|value| value * link.inverse);
            for (row, value) in relief.iter_mut().zip(link.response) {
                *row = plus_scaled(row, &felt, value);
            }
        }
        for (row, relief) in sum.iter_mut().zip(&relief) {
            *row = plus_scaled(row, relief, 1.0);
        }
        positive
    }
}

/// A force along the axes of a free root, which are unit vectors.
#[inline(always)]
fn by_root(f: &Force) -> Vector {
    [f.force.x, f.force.y, f.force.z, f.torque.x, f.torque.y, f.torque.z]
}

#[inline(always)]
fn of_motion(m: &Motion) -> Vector {
    [m.angular.x, m.angular.y, m.angular.z, m.linear.x, m.linear.y, m.linear.z]
}

#[inline(always)]
fn of_force(f: &Force) -> Vector {
    [f.torque.x, f.torque.y, f.torque.z, f.force.x, f.force.y, f.force.z]
}

#[inline(always)]
fn plus_scaled(a: &Vector, b: &Vector, scale: f64) -> Vector {
    std::array::from_fn(|i| a[i] + b[i] * scale)
}

#[inline(always)]
fn dot(a: &Vector, b: &Vector) -> f64 {
    (a[0] * b[0] + a[2] * b[2] + a[4] * b[4]) + (a[1] * b[1] + a[3] * b[3] + a[5] * b[5])
}
