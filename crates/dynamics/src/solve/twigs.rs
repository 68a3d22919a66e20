//! Fingers that touch nothing, eliminated as articulated bodies.
//!
//! A finger's row of the Hessian runs through hand, arm and trunk to the root, but all that these feel of the finger passes
//! through the hand. So a finger without a contact has no rows in the factor. As in Featherstone's articulated-body algorithm,
//! its joints are eliminated in the six dimensions of the hand's motion: they give way, and so relieve the hand of a part of
//! the inertia that the mass matrix ascribes to it. It is the same elimination in fewer operations.

use super::body_pair::force_of;
use crate::contact::Contact;
use crate::equation_of_motion::EquationOfMotion;
use crate::factor::Factor;
use crate::kinematics::Kinematics;
use crate::model::Model;
use crate::spatial::{Force, Motion};

/// Degrees of freedom from the root down to a base, the body that twigs hang on. A row this long costs more than six
/// dimensions.
const BASE_DOFS: usize = 16;

type Vector = [f64; 6];
type Matrix = [Vector; 6];

/// The twigs of a model, by base.
#[derive(Debug, Clone)]
pub(crate) struct Twigs {
    bases: Vec<Base>,
    free: u128,
}

/// A body and the twigs that hang on it.
#[derive(Debug, Clone)]
struct Base {
    body: usize,
    /// Degrees of freedom from the root down to the body.
    chain: Vec<u16>,
    links: Vec<Link>,
    /// Rows of the twigs that nothing touches in this step.
    free: u128,
    /// Of the base and then of each link: the inertia that it is relieved of, and a force or motion while rows are solved.
    relief: Vec<Matrix>,
    vector: Vec<Vector>,
}

/// A link of a twig, with what its elimination leaves.
#[derive(Debug, Clone)]
struct Link {
    dof: usize,
    /// First degree of freedom of its twig.
    twig: u16,
    /// Place of the parent: 0 for the base, `k + 1` for link `k`.
    parent: usize,
    is_free: bool,
    axis: Vector,
    /// Force on the parent for a unit of the joint's effort.
    response: Vector,
    /// Of the inertia at the joint, with its stiffness.
    inverse: f64,
}

impl Twigs {
    pub fn new(model: &Model) -> Self {
        let mut bases = Vec::<Base>::new();
        for (dof, &body) in model.dof_body.iter().enumerate() {
            let chain = &model.chains[body];
            let Some(&twig) = chain.get(BASE_DOFS) else { continue };
            let body = model.dof_body[usize::from(chain[BASE_DOFS - 1])];
            let at = bases.iter().position(|base| base.body == body).unwrap_or_else(|| {
                bases.push(Base::new(body, chain[..BASE_DOFS].to_vec()));
                bases.len() - 1
            });
            let parent = usize::from(chain[chain.len() - 2]);
            bases[at].push(dof, twig, parent);
        }
        Self { bases, free: 0 }
    }

    /// Finds the twigs that none of these contacts can load.
    pub fn find_free(&mut self, model: &Model, contacts: &[Contact]) {
        let twig_of = |body: usize| model.chains[body].get(BASE_DOFS).map_or(0, |&twig| 1_u128 << twig);
        let bodies = contacts.iter().flat_map(|c| [c.shape_a, c.shape_b]).map(|shape| model.shapes[shape.0].body.0);
        let touched = if self.bases.is_empty() { 0 } else { bodies.fold(0, |touched, body| touched | twig_of(body)) };
        self.free = 0;
        for base in &mut self.bases {
            base.free = 0;
            for link in &mut base.links {
                link.is_free = touched >> link.twig & 1 == 0;
                base.free |= u128::from(link.is_free) << link.dof;
            }
            self.free |= base.free;
        }
    }

    /// Rows that are eliminated here and not in the factor.
    pub fn free(&self) -> u128 {
        self.free
    }

    /// Rows of those bases of which some rows, but not all, are among these.
    pub fn in_part(&self, rows: u128) -> u128 {
        let in_part = |base: &&Base| base.free & rows != 0 && base.free & !rows != 0;
        self.bases.iter().filter(in_part).fold(0, |all, base| all | base.free)
    }

    /// Eliminates the free ones of these rows, with that on their diagonal, into the factor's rows of their bases. False if a
    /// pivot is not positive.
    pub fn eliminate(
        &mut self,
        rows: u128,
        kin: &Kinematics,
        equation: &EquationOfMotion,
        model: &Model,
        diagonal: &[f64],
        factor: &mut Factor,
    ) -> bool {
        let mut positive = true;
        for base in self.bases.iter_mut().filter(|base| base.free & rows != 0) {
            positive &= base.eliminate(kin, equation, model, diagonal);
            for (r, &dof) in base.chain.iter().enumerate() {
                let force = force_of(&base.relief[0], &kin.axes[usize::from(dof)]);
                let columns = &base.chain[..=r];
                factor.add_to_row(usize::from(dof), columns, |c| -kin.axes[usize::from(columns[c])].dot(&force));
            }
        }
        positive
    }

    /// First half of a solve, before that of the factor: leaves to bases.
    pub fn solve_down(&mut self, rows: u128, kin: &Kinematics, x: &mut [f64]) {
        for base in self.bases.iter_mut().filter(|base| base.free & rows != 0) {
            base.vector.fill([0.0; 6]);
            for (k, link) in base.links.iter().enumerate().rev().filter(|(_, link)| link.is_free) {
                let carried = base.vector[k + 1];
                let value = x[link.dof] - dot(&link.axis, &carried);
                let target = &mut base.vector[link.parent];
                *target = std::array::from_fn(|i| target[i] + carried[i] + link.response[i] * value);
                x[link.dof] = value * link.inverse;
            }
            let [tx, ty, tz, fx, fy, fz] = base.vector[0];
            let force = Force { torque: [tx, ty, tz].into(), force: [fx, fy, fz].into() };
            for &dof in &base.chain {
                x[usize::from(dof)] -= kin.axes[usize::from(dof)].dot(&force);
            }
        }
    }

    /// Second half of a solve, after that of the factor: bases to leaves.
    pub fn solve_up(&mut self, rows: u128, kin: &Kinematics, x: &mut [f64]) {
        for base in self.bases.iter_mut().filter(|base| base.free & rows != 0) {
            let mut motion = Motion::ZERO;
            for &dof in &base.chain {
                motion.add_scaled(&kin.axes[usize::from(dof)], x[usize::from(dof)]);
            }
            base.vector[0] = of_motion(&motion);
            for (k, link) in base.links.iter().enumerate().filter(|(_, link)| link.is_free) {
                let carried = base.vector[link.parent];
                let value = x[link.dof] - dot(&link.response, &carried);
                base.vector[k + 1] = std::array::from_fn(|i| carried[i] + link.axis[i] * value);
                x[link.dof] = value;
            }
        }
    }
}

impl Base {
    fn new(body: usize, chain: Vec<u16>) -> Self {
        Self { body, chain, links: Vec::new(), free: 0, relief: vec![[[0.0; 6]; 6]], vector: vec![[0.0; 6]] }
    }

    fn push(&mut self, dof: usize, twig: u16, parent: usize) {
        let parent = self.links.iter().position(|link| link.dof == parent).map_or(0, |k| k + 1);
        let (axis, response) = ([0.0; 6], [0.0; 6]);
        self.links.push(Link { dof, twig, parent, is_free: false, axis, response, inverse: 0.0 });
        self.relief.push([[0.0; 6]; 6]);
        self.vector.push([0.0; 6]);
    }

    fn eliminate(&mut self, kin: &Kinematics, equation: &EquationOfMotion, model: &Model, diagonal: &[f64]) -> bool {
        let mut positive = true;
        self.relief.fill([[0.0; 6]; 6]);
        for (k, link) in self.links.iter_mut().enumerate().rev().filter(|(_, link)| link.is_free) {
            let (dof, relief) = (link.dof, self.relief[k + 1]);
            link.axis = of_motion(&kin.axes[dof]);
            let momentum = of_force(&equation.axis_momentum[dof]);
            let relieved = of_force(&force_of(&relief, &kin.axes[dof]));
            let felt: Vector = std::array::from_fn(|i| momentum[i] - relieved[i]);
            let inertia = equation.mass_matrix[model.diagonal(dof)] - dot(&link.axis, &relieved) + diagonal[dof];
            positive &= inertia > 0.0;
            link.inverse = 1.0 / inertia;
            link.response = felt.map(|value| value * link.inverse);
            for (r, row) in self.relief[link.parent].iter_mut().enumerate() {
                *row = std::array::from_fn(|c| row[c] + (relief[r][c] + link.response[r] * felt[c]));
            }
        }
        positive
    }
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
fn dot(a: &Vector, b: &Vector) -> f64 {
    (a[0] * b[0] + a[2] * b[2] + a[4] * b[4]) + (a[1] * b[1] + a[3] * b[3] + a[5] * b[5])
}
