//! Finds the difference between two rows, by field and part.

use fiatlux_grading::Difference;
use fiatlux_proto::v3;
use fiatlux_rules::{By, Group, Row};
use fiatlux_wire::{WireError, layout_of, read_row};

const AXES: [&str; 3] = ["x", "y", "z"];
const QUATERNION: [&str; 4] = ["w", "x", "y", "z"];
const LIMBS: [&str; 4] = ["left foot", "right foot", "left palm", "right palm"];
const SUPPORTS: [&str; 4] = ["left foot", "right foot", "left arm", "right arm"];

fn named(row: &Row, header: &v3::EpisodeHeader) -> Vec<(String, f64)> {
    let mut found = Vec::new();
    // A measure of vectors comes in parts: numbers of one field count on.
    let (mut last, mut first) = (String::new(), 0);
    row.visit(&mut |field, numbers| {
        let name = field.to_string();
        first = if name == last { first } else { 0 };
        let parts = numbers.iter().enumerate();
        found
            .extend(parts.map(|(index, number)| (format!("{name}{}", part(field.by, first + index, header)), *number)));
        first += numbers.len();
        last = name;
    });
    found
}

/// The first number in which two rows differ, to the last bit.
pub(super) fn first_row_difference(
    simulated: &v3::State,
    recorded: &v3::State,
    header: &v3::EpisodeHeader,
) -> Option<Difference> {
    let unreadable = |(found, recorded): (&Result<Row, WireError>, &Result<Row, WireError>)| {
        let text = |row: &Result<Row, WireError>| row.as_ref().map_or_else(ToString::to_string, |_| "a row".into());
        Some(Difference { field: "the row".into(), found: text(found), recorded: text(recorded) })
    };
    let rows = [simulated, recorded].map(|state| layout_of(header).and_then(|layout| read_row(state, layout)));
    let [Ok(simulated), Ok(recorded)] = &rows else { return unreadable((&rows[0], &rows[1])) };
    let pairs = named(simulated, header).into_iter().zip(named(recorded, header));
    let differ =
        |((field, a), (other, b)): &((String, f64), (String, f64))| field != other || a.to_bits() != b.to_bits();
    pairs.into_iter().find(differ).map(|((field, found), (_, recorded))| Difference {
        field,
        found: format!("{found:?}"),
        recorded: format!("{recorded:?}"),
    })
}

/// The part that the number at this index of a field belongs to, as a suffix of the field's name.
fn part(by: By, index: usize, header: &v3::EpisodeHeader) -> String {
    let of = |names: &[String], index: usize| names.get(index).cloned().unwrap_or_else(|| index.to_string());
    match by {
        By::Nothing => String::new(),
        By::Axis => format!(".{}", AXES[index % 3]),
        By::Quaternion => format!(".{}", QUATERNION[index % 4]),
        By::Joint => format!(" of {}", of(&header.joint_names, index)),
        By::Part { of: group, axes } => {
            let (axis, part) = if axes { (format!(".{}", AXES[index % 3]), index / 3) } else { (String::new(), index) };
            match group {
                Group::HandBodies => format!("{axis} of {}", of(&header.hand_bodies, part)),
                Group::Limbs => format!("{axis} of {}", LIMBS[part % 4]),
                Group::Supports => format!("{axis} of {}", SUPPORTS[part % 4]),
                Group::Robot | Group::Thing(_) => axis,
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use fiatlux_rules::{Limb, RobotLayout, errand};
    use fiatlux_wire::state_message;

    use super::*;

    #[test]
    fn the_first_number_is_named() {
        let header = v3::EpisodeHeader {
            joint_names: vec!["left_knee_joint".into(), "right_knee_joint".into()],
            hand_bodies: vec!["thumb".into(), "index".into()],
            ..v3::EpisodeHeader::default()
        };
        let mut recorded = Row::zeros(RobotLayout { joints: 2, hand_bodies_per_side: 1 });
        recorded.joint_position = vec![0.25, 0.5];
        let message = state_message(&recorded);
        assert_eq!(first_row_difference(&message, &message, &header), None);
        let differs = |change: fn(&mut Row)| {
            let mut simulated = recorded.clone();
            change(&mut simulated);
            let found = first_row_difference(&state_message(&simulated), &message, &header);
            found.map(|found| (found.field, found.found, found.recorded))
        };
        let named = |field: &str, found: &str, recorded: &str| Some((field.into(), found.into(), recorded.into()));
        let knee = named("joint_position of right_knee_joint", "0.5000000000000001", "0.5");
        assert_eq!(differs(|row| row.joint_position[1] = 0.500_000_000_000_000_1), knee);
        let force = named("fresh_bulb.hand_force.z of index", "-0.0", "0.0");
        assert_eq!(differs(|row| row.force_mut(errand::HAND_FORCE[1])[1].z = -0.0), force);
        let palm = named("floor_force.y of left palm", "1.0", "0.0");
        assert_eq!(differs(|row| row.force_mut(errand::FLOOR_FORCE)[Limb::LeftPalm as usize].y = 1.0), palm);
        let press = named("old_bulb.other_force_peak", "2.0", "0.0");
        assert_eq!(differs(|row| row.load_mut(errand::OTHER_FORCE_PEAK[0])[0] = 2.0), press);
        assert_eq!(differs(|row| row.present[errand::CRATE] = false), named("crate.present", "0.0", "1.0"));
        let unreadable = named("the row", "action has 3 numbers instead of 2", "a row");
        assert_eq!(differs(|row| row.action.push(1.0)), unreadable);
    }
}
