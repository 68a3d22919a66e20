//! Exact readings of a world besides what its task observes.

use fiatlux_dynamics::Site;
use fiatlux_rules::{Measure, RobotLayout, manifest};
use fiatlux_world::{Scene, World};

use crate::{BatchError, Field};

/// Numbers of a link: position, quaternion, velocity and angular velocity.
const LINK: usize = 13;

/// Readings of a batch's worlds besides the task's observation, exactly and whatever the task. The fields follow those of the
/// task, and their names begin with `privileged.`.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Watch {
    /// Sites and links, by name: field `privileged.links`, with for each its position, m, its quaternion, w first, its velocity,
    /// m/s, and its angular velocity, rad/s, in world axes.
    pub links: Vec<String>,
    /// The contact forces that a row has, N: fields such as `privileged.floor_force` and `privileged.ladder_force`, by the names
    /// in `manifest.toml`.
    pub forces: bool,
    /// Each world keeps the contact points of its last step, for [`Batch::contacts`](crate::Batch::contacts).
    pub contacts: bool,
}

impl Watch {
    /// Fields that follow those of a task.
    pub(crate) fn fields(&self, layout: RobotLayout) -> Vec<Field> {
        let links = (!self.links.is_empty()).then(|| Field::new("privileged.links", &[self.links.len(), LINK]));
        let forces = manifest().contacts.iter().filter(|contact| self.forces && contact.measure != Measure::Number);
        let forces = forces.map(|contact| {
            let count = contact.range(layout).len();
            let shape = if contact.measure == Measure::Force { vec![count, 3] } else { vec![count] };
            Field::new(format!("privileged.{}", contact.name), &shape)
        });
        links.into_iter().chain(forces.filter(|field| field.length() > 0)).collect()
    }

    /// The sites in a scene.
    pub(crate) fn sites(&self, scene: &Scene) -> Result<Vec<Site>, BatchError> {
        let site = |name: &String| scene.site(name).ok_or_else(|| BatchError::Link { name: name.clone() });
        self.links.iter().map(site).collect()
    }

    /// Writes the numbers of the fields.
    pub(crate) fn observe(&self, world: &World, sites: &[Site], mut out: &mut [f32]) {
        let mut write = |numbers: &[f64]| {
            let (place, rest) = std::mem::take(&mut out).split_at_mut(numbers.len());
            place.iter_mut().zip(numbers).for_each(|(place, number)| *place = *number as f32);
            out = rest;
        };
        for site in sites {
            let (dynamics, lever) = (world.dynamics(), site.body_from_site.translation.vector);
            let world_from_body = dynamics.world_from_body(site.body);
            let pose = world_from_body * site.body_from_site;
            let velocity = dynamics.velocity(site.body);
            let linear = velocity.linear + velocity.angular.cross(&(world_from_body.rotation * lever));
            let turn = pose.rotation.quaternion();
            write(pose.translation.vector.as_slice());
            write(&[turn.w, turn.i, turn.j, turn.k]);
            write(linear.as_slice());
            write(velocity.angular.as_slice());
        }
        let row = world.row();
        for contact in manifest().contacts.iter().filter(|_| self.forces) {
            let range = contact.range(row.layout);
            match contact.measure {
                Measure::Number => {}
                Measure::Force => row.forces[range].iter().for_each(|force| write(force.as_slice())),
                _ => write(&row.loads[range]),
            }
        }
    }
}
