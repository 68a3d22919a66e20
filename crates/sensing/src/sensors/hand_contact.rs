//! Force of the bulbs on the hands.

use fiatlux_rules::{Row, errand};
use nalgebra::Vector3;

use crate::Setup;
use crate::sensor::{Class, Entry, Needs, Term};

pub(crate) const ENTRY: Entry = Entry {
    name: "hand_contact",
    class: Class::Standard,
    is_large: false,
    needs: Needs::ROW,
    terms,
    compute: |view, _, out| {
        hand_force(view.row).for_each(|force| out.extend(force.as_slice()));
        Ok(())
    },
    encode: |view, devices, observation| {
        observation.hand_contact_force = ENTRY.numbers(view, devices)?;
        Ok(())
    },
};

fn terms(setup: &Setup) -> Vec<Term> {
    let shape = [setup.layout.hand_bodies_per_side, 3];
    let term = |name, meaning| Term::new(name, "hand_contact_force", &shape, "N", meaning);
    vec![
        term("right_hand_contact", "force of both bulbs on each body of the right hand, world axes"),
        term("left_hand_contact", "the same of the left hand"),
    ]
}

/// Force of both bulbs together on each sensed hand body, right hand first, world axes, N.
pub fn hand_force(row: &Row) -> impl Iterator<Item = Vector3<f64>> {
    let [old, fresh] = errand::HAND_FORCE.map(|measure| row.force(measure));
    old.iter().zip(fresh).map(|(old, fresh)| old + fresh)
}
