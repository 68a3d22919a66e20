//! Finds where two rows differ, by field and part.

use fiatlux_proto::v3;

use fiatlux_grading::Difference;

const AXES: [&str; 3] = ["x", "y", "z"];
const QUATERNION: [&str; 4] = ["w", "x", "y", "z"];
const CONTACT_LIMBS: [&str; 4] = ["left foot", "right foot", "left palm", "right palm"];
const SUPPORTS: [&str; 4] = ["left foot", "right foot", "left arm", "right arm"];

/// How the numbers of a field are grouped.
#[derive(Debug, Clone, Copy)]
enum By {
    Joint,
    /// A number for each hand body.
    HandBody,
    /// A vector for each hand body.
    HandBodyAxis,
    /// A vector for each limb in contact.
    LimbAxis,
    /// A number for each limb that can bear weight.
    Support,
    Axis,
    Quaternion,
    Nothing,
}

/// The numbers of a row, field by field.
struct Fields(Vec<(String, By, Vec<f64>)>);

impl Fields {
    fn of(state: &v3::State) -> Self {
        let mut fields = Self(Vec::new());
        let flag = |value: bool| f64::from(u8::from(value));
        fields.push("step", By::Nothing, &[state.step as f64]);
        fields.body("robot", &state.robot);
        for (name, numbers) in [
            ("joint_position", &state.joint_position),
            ("joint_velocity", &state.joint_velocity),
            ("joint_target", &state.joint_target),
            ("joint_effort", &state.joint_effort),
            ("action", &state.action),
        ] {
            fields.push(name, By::Joint, numbers);
        }
        fields.body("ladder", &state.ladder);
        for (name, bulb) in [("old_bulb", &state.old_bulb), ("fresh_bulb", &state.fresh_bulb)] {
            let bulb = bulb.clone().unwrap_or_default();
            fields.body(&format!("{name}.body"), &bulb.body);
            fields.push(&format!("{name}.hand_force"), By::HandBodyAxis, &bulb.hand_force);
            fields.push(&format!("{name}.hand_force_peak"), By::HandBody, &bulb.hand_force_peak);
            fields.push(&format!("{name}.other_force_peak"), By::Nothing, &[bulb.other_force_peak]);
            fields.push(&format!("{name}.seated"), By::Nothing, &[flag(bulb.seated)]);
            fields.push(&format!("{name}.steps_beyond"), By::Nothing, &[f64::from(bulb.steps_beyond)]);
        }
        for (name, pose) in [
            ("fixture", &state.fixture),
            ("crate", &state.crate_),
            ("left_palm", &state.left_palm),
            ("right_palm", &state.right_palm),
        ] {
            let pose = pose.clone().unwrap_or_default();
            fields.push(&format!("{name}.position"), By::Axis, &pose.position);
            fields.push(&format!("{name}.quaternion"), By::Quaternion, &pose.quaternion);
        }
        fields.push("floor_force", By::LimbAxis, &state.floor_force);
        fields.push("ladder_force", By::LimbAxis, &state.ladder_force);
        fields.push("floor_load", By::Support, &state.floor_load);
        fields.push("tread_load", By::Support, &state.tread_load);
        fields.push("com_velocity", By::Axis, &state.com_velocity);
        fields.push("unconverged", By::Nothing, &[f64::from(state.unconverged)]);
        fields.push("retried", By::Nothing, &[f64::from(state.retried)]);
        fields.push("joint_speed_peak", By::Nothing, &[state.joint_speed_peak]);
        fields.push("penetration", By::Nothing, &[state.penetration]);
        fields
    }

    fn push(&mut self, name: &str, by: By, numbers: &[f64]) {
        self.0.push((name.to_owned(), by, numbers.to_vec()));
    }

    fn body(&mut self, name: &str, body: &Option<v3::Body>) {
        let body = body.clone().unwrap_or_default();
        self.push(&format!("{name}.position"), By::Axis, &body.position);
        self.push(&format!("{name}.quaternion"), By::Quaternion, &body.quaternion);
        self.push(&format!("{name}.linear_velocity"), By::Axis, &body.linear_velocity);
        self.push(&format!("{name}.angular_velocity"), By::Axis, &body.angular_velocity);
    }
}

/// The first number in which two rows differ, to the last bit.
pub(super) fn first_row_difference(
    simulated: &v3::State,
    recorded: &v3::State,
    header: &v3::EpisodeHeader,
) -> Option<Difference> {
    let fields = Fields::of(simulated).0.into_iter().zip(Fields::of(recorded).0);
    for ((name, by, simulated), (_, _, recorded)) in fields {
        let (a, b) = (simulated.len(), recorded.len());
        if a != b {
            return Some(Difference { field: name, found: format!("{a} numbers"), recorded: format!("{b} numbers") });
        }
        let pairs = simulated.iter().zip(&recorded).enumerate();
        if let Some((index, (a, b))) = pairs.into_iter().find(|(_, (a, b))| a.to_bits() != b.to_bits()) {
            let field = format!("{name}{}", part(by, index, header));
            return Some(Difference { field, found: format!("{a:?}"), recorded: format!("{b:?}") });
        }
    }
    None
}

/// The part that the number at this index belongs to, as a suffix of the field's name.
fn part(by: By, index: usize, header: &v3::EpisodeHeader) -> String {
    let named = |names: &[String], index: usize| names.get(index).cloned().unwrap_or_else(|| index.to_string());
    match by {
        By::Joint => format!(" of {}", named(&header.joint_names, index)),
        By::HandBody => format!(" of {}", named(&header.hand_bodies, index)),
        By::HandBodyAxis => format!(".{} of {}", AXES[index % 3], named(&header.hand_bodies, index / 3)),
        By::LimbAxis => format!(".{} of {}", AXES[index % 3], CONTACT_LIMBS[index / 3 % 4]),
        By::Support => format!(" of {}", SUPPORTS[index % 4]),
        By::Axis => format!(".{}", AXES[index % 3]),
        By::Quaternion => format!(".{}", QUATERNION[index % 4]),
        By::Nothing => String::new(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_first_number_is_named() {
        let header = v3::EpisodeHeader {
            joint_names: vec!["left_knee_joint".into(), "right_knee_joint".into()],
            hand_bodies: vec!["thumb".into(), "index".into()],
            ..v3::EpisodeHeader::default()
        };
        let bulb = v3::Bulb { hand_force: vec![0.0; 6], ..v3::Bulb::default() };
        let recorded = v3::State {
            joint_position: vec![0.25, 0.5],
            fresh_bulb: Some(bulb),
            floor_force: vec![0.0; 12],
            ..v3::State::default()
        };
        assert_eq!(first_row_difference(&recorded, &recorded, &header), None);
        let differs = |change: fn(&mut v3::State)| {
            let mut simulated = recorded.clone();
            change(&mut simulated);
            first_row_difference(&simulated, &recorded, &header).map(|found| (found.field, found.found, found.recorded))
        };
        let named = |field: &str, found: &str, recorded: &str| Some((field.into(), found.into(), recorded.into()));
        let knee = named("joint_position of right_knee_joint", "0.5000000000000001", "0.5");
        assert_eq!(differs(|state| state.joint_position[1] = 0.500_000_000_000_000_1), knee);
        let force = named("fresh_bulb.hand_force.z of index", "-0.0", "0.0");
        assert_eq!(differs(|state| state.fresh_bulb.as_mut().expect("a bulb").hand_force[5] = -0.0), force);
        let palm = named("floor_force.y of left palm", "1.0", "0.0");
        assert_eq!(differs(|state| state.floor_force[7] = 1.0), palm);
        assert_eq!(differs(|state| state.action.push(1.0)), named("action", "1 numbers", "0 numbers"));
    }
}
