//! The numbers that rules compare with, overridable one by one.

use serde::{Deserialize, Serialize};
use thiserror::Error;

/// Why a threshold was refused.
#[derive(Debug, Clone, PartialEq, Eq, Error)]
#[allow(missing_docs)] // The messages say it.
pub enum ThresholdError {
    #[error("'{0}' is not of the form key=value; for example fragility_n=30")]
    Form(String),
    #[error("there is no threshold '{key}'; known ones are {}", Thresholds::KEYS.join(", "))]
    Key { key: String },
    #[error("threshold '{key}' cannot be '{value}'; it must be {rule}")]
    Value { key: &'static str, value: String, rule: &'static str },
}

/// A kind of number that a threshold can be.
trait Number: Sized {
    const RULE: &'static str;
    fn read(text: &str) -> Option<Self>;
    fn is_valid(&self) -> bool;
}

impl Number for f64 {
    const RULE: &'static str = "a finite number, zero or above";
    fn read(text: &str) -> Option<Self> {
        text.parse().ok()
    }
    fn is_valid(&self) -> bool {
        self.is_finite() && *self >= 0.0
    }
}

impl Number for u32 {
    const RULE: &'static str = "a whole number, zero or above";
    fn read(text: &str) -> Option<Self> {
        text.parse().ok()
    }
    fn is_valid(&self) -> bool {
        true
    }
}

macro_rules! thresholds {
    ($($(#[$doc:meta])* $key:ident: $type:ty = $default:expr,)*) => {
        /// All thresholds. Published values are the defaults; *paper* and *code* name the source of each: the Fiatlux
        /// paper's table of subtasks and its text, or the reference code where the paper gives no figure.
        #[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
        #[serde(deny_unknown_fields, default)]
        pub struct Thresholds { $($(#[$doc])* pub $key: $type,)* }

        impl Default for Thresholds {
            fn default() -> Self {
                Self { $($key: $default,)* }
            }
        }

        impl Thresholds {
            /// All names, in the order of the fields.
            pub const KEYS: &'static [&'static str] = &[$(stringify!($key),)*];

            /// Name and value of each.
            pub fn entries(&self) -> impl Iterator<Item = (&'static str, f64)> {
                [$((stringify!($key), f64::from(self.$key)),)*].into_iter()
            }

            /// Checks values that came from a file.
            ///
            /// # Errors
            /// [`ThresholdError::Value`] for the first that is negative or not finite.
            pub fn check(&self) -> Result<(), ThresholdError> {
                $(if !self.$key.is_valid() {
                    let value = self.$key.to_string();
                    return Err(ThresholdError::Value { key: stringify!($key), value, rule: <$type>::RULE });
                })*
                Ok(())
            }

            fn assign(&mut self, key: &str, text: &str) -> Result<(), ThresholdError> {
                match key {
                    $(stringify!($key) => {
                        let value = <$type>::read(text).filter(Number::is_valid);
                        self.$key = value.ok_or_else(|| ThresholdError::Value {
                            key: stringify!($key),
                            value: text.into(),
                            rule: <$type>::RULE,
                        })?;
                        Ok(())
                    })*
                    _ => Err(ThresholdError::Key { key: key.into() }),
                }
            }
        }
    };
}

thresholds! {
    /// Pelvis height below which the robot has fallen, m (paper).
    fall_height_m: f64 = 0.35,
    /// Tilt of the pelvis above which the robot has fallen, rad (paper).
    fall_tilt_rad: f64 = 1.0,
    /// Tilt of the ladder above which it has tipped, rad (paper).
    ladder_tip_rad: f64 = 0.6,
    /// Contact force on a hand body above which a bulb breaks, N (paper).
    fragility_n: f64 = 50.0,
    /// First rows in which a crush does not end an episode (code).
    crush_exempt_rows: u32 = 2,
    /// Largest contact force on a hand body above which a bulb is held and below which it is released, N (code; the
    /// paper states it for S08).
    touch_n: f64 = 1.0,
    /// Bodies of one hand that must touch a grabbed bulb (paper, S08).
    grip_bodies: u32 = 2,
    /// Speed below which a thing is at rest, m/s (paper for S06, code for the others).
    rest_speed_m_s: f64 = 0.05,
    /// Angular speed below which a thing is at rest, rad/s (code).
    rest_turn_rad_s: f64 = 0.10,
    /// Time constant of the speeds by which a bulb is settled, s (code, S11).
    settle_time_s: f64 = 0.1,
    /// Largest deviation of the robot's heading from its target, rad (paper).
    facing_rad: f64 = 0.5,
    /// Speed limit of the pelvis on arrival by foot, m/s (paper, S05, S07, S09).
    walk_speed_m_s: f64 = 1.0,
    /// Speed limit of the pelvis on and below the ladder, m/s (paper, S02, S04).
    climb_speed_m_s: f64 = 1.5,
    /// Horizontal distance from the ladder's top point to the fixture, m (paper, S01).
    placement_m: f64 = 0.67,
    /// Height of a standing ladder's feet, m (paper, S01).
    feet_height_m: f64 = 0.02,
    /// Largest height of the ladder's top point above the pelvis, m (paper, S02).
    top_slack_m: f64 = 0.15,
    /// Horizontal distance of the pelvis from the ladder on it and below it, m (paper, S02, S04).
    ladder_near_m: f64 = 0.6,
    /// Pelvis height below which the robot stands on the floor, m (code, S04: 0.79 + 0.15).
    floor_stance_m: f64 = 0.94,
    /// Distance of a removed bulb's plug from the seat, m (paper, S03).
    clear_of_seat_m: f64 = 0.10,
    /// Height below which the old bulb is dropped, m (paper).
    old_drop_m: f64 = 0.15,
    /// Height below which the fresh bulb is dropped, m (paper).
    fresh_drop_m: f64 = 0.40,
    /// The same in S08, m (code).
    grab_drop_m: f64 = 0.50,
    /// Distance of the pelvis from the crate's footprint, m (paper, S05; the code has the arm's reach, 0.5045).
    crate_near_m: f64 = 0.50,
    /// Deepest that a bulb at rest may press into the crate's walls, m (code, S06).
    crate_slack_m: f64 = 0.001,
    /// Horizontal distance of the pelvis from the fresh bulb, m (paper, S07; the code has 0.6265).
    bench_near_m: f64 = 0.63,
    /// Height of a lifted bulb's lowest point above the bench, m (paper, S08).
    lift_m: f64 = 0.03,
    /// Horizontal distance of the pelvis from the ladder before the climb, m (code, S09).
    mounting_m: f64 = 0.85,
    /// Jump of a bulb's velocity in one step, gravity apart, above which it was struck, m/s (code).
    impact_m_s: f64 = 2.4,
    /// First rows in which nothing counts as struck (code).
    impact_exempt_rows: u32 = 2,
    /// Pelvis height of a robot that has climbed to working height, m (paper, `climb`: 1.18 + 0.79 - 0.15).
    working_height_m: f64 = 1.82,
    /// Load above which a limb touches the ladder, N (paper, `climb`).
    limb_contact_n: f64 = 1.0,
    /// Tilt of the pelvis below which the robot is upright, rad (ours, strict): half the tilt of a fall.
    strict_tilt_rad: f64 = 0.5,
    /// Upward force above which a limb is loaded, N (ours, strict): a twentieth of the robot's weight.
    strict_load_n: f64 = 20.0,
    /// Share of the robot's weight that the floor carries through the soles after a descent (ours, strict).
    strict_floor_share: f64 = 0.8,
    /// Speed limit of the pelvis where the robot has arrived on foot, m/s (ours, strict).
    strict_walk_speed_m_s: f64 = 0.3,
    /// Angle between two forces of one hand from which they hold a bulb between them, rad (ours, strict).
    strict_grip_angle_rad: f64 = std::f64::consts::FRAC_PI_2,
    /// Low-passed speed in the palm's frame below which a bulb moves with the hand, m/s (ours, strict).
    strict_slip_m_s: f64 = 0.1,
    /// Vertical speed of the centre of mass above which the robot leaps or drops, m/s (ours, strict): a free fall of 0.2 m.
    strict_leap_m_s: f64 = 2.0,
    /// Force of anything but the hand that holds it, above which a bulb leans on that, N (ours, strict): a third of its weight.
    strict_stray_n: f64 = 0.1,
}

impl Thresholds {
    /// Changes one threshold, given as `key=value`.
    ///
    /// # Errors
    /// [`ThresholdError`] for another form, an unknown key (all known ones are listed) or a value that does not fit.
    pub fn set(&mut self, assignment: &str) -> Result<(), ThresholdError> {
        let (key, value) = assignment.split_once('=').ok_or_else(|| ThresholdError::Form(assignment.into()))?;
        self.assign(key.trim(), value.trim())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn one_threshold_is_overridden() {
        let mut thresholds = Thresholds::default();
        thresholds.set("fragility_n=30").expect("a known key");
        thresholds.set(" grip_bodies = 3 ").expect("a known key");
        assert_eq!(thresholds, Thresholds { fragility_n: 30.0, grip_bodies: 3, ..Thresholds::default() });
    }

    #[test]
    fn refusals_name_the_remedy() {
        let mut thresholds = Thresholds::default();
        for (input, expected) in [
            ("fragility=30", "there is no threshold 'fragility'; known ones are fall_height_m, "),
            ("fragility_n", "not of the form key=value"),
            ("fragility_n=soft", "threshold 'fragility_n' cannot be 'soft'; it must be a finite number"),
            ("fragility_n=nan", "'nan'"),
            ("fragility_n=-1", "zero or above"),
            ("grip_bodies=1.5", "a whole number"),
        ] {
            let error = thresholds.set(input).expect_err(input).to_string();
            assert!(error.contains(expected), "{input}: {error}");
        }
        assert_eq!(thresholds, Thresholds::default());
        let broken = Thresholds { lift_m: f64::NAN, ..Thresholds::default() };
        assert!(broken.check().expect_err("not a number").to_string().contains("lift_m"));
    }

    #[test]
    fn files_may_leave_out_but_not_invent() {
        let read = |text| serde_json::from_str::<Thresholds>(text);
        assert_eq!(read(r#"{"touch_n": 2.0}"#).expect("valid"), Thresholds { touch_n: 2.0, ..Thresholds::default() });
        assert!(read(r#"{"touch": 2.0}"#).expect_err("unknown").to_string().contains("`touch`"));
    }

    #[test]
    fn keys_and_entries_agree() {
        let thresholds = Thresholds::default();
        let entries: Vec<_> = thresholds.entries().collect();
        assert!(entries.iter().map(|(key, _)| *key).eq(Thresholds::KEYS.iter().copied()));
        assert!(entries.contains(&("fragility_n", 50.0)));
    }
}
