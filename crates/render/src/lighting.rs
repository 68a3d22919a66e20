use fiatlux_world::Light;
use nalgebra::{UnitQuaternion, Vector3};

/// Nominal strength of the dome in the published benchmark.
const DOME_NOMINAL: f64 = 1000.0;
/// Nominal strength of the key light in the published benchmark.
const KEY_NOMINAL: f64 = 1500.0;
/// Tilt of the key light from straight down in the published benchmark, rad.
const KEY_TILT: f64 = 40.0 / 180.0 * std::f64::consts::PI;
/// Light that a surface gets from the nominal dome and, facing it, from the nominal key light; ours, for pictures of
/// even brightness.
const NOMINAL_LIGHT: [f64; 2] = [0.58, 1.55];

/// Light of a scene. The default is the published benchmark's nominal light.
#[derive(Debug, Clone, PartialEq)]
pub struct Lighting {
    /// Strength of the soft light from all around; nominal 1000.
    pub dome: f64,
    /// Bearing of the dome's brighter side, rad from +x towards +y.
    pub dome_yaw: f64,
    /// Strength of the distant key light; nominal 1500.
    pub key: f64,
    /// Colour of the key light, linear.
    pub key_colour: [f64; 3],
    /// Where the key light shines to, world; need not be a unit vector. Zero is straight down.
    pub key_direction: Vector3<f64>,
    /// Multiplies the colours of floor, walls and ceiling, linear.
    pub room_tint: [f64; 3],
}

impl Default for Lighting {
    fn default() -> Self {
        Self {
            dome: DOME_NOMINAL,
            dome_yaw: 0.0,
            key: KEY_NOMINAL,
            key_colour: [1.0, 0.98, 0.95],
            key_direction: key_direction(0.0, 0.0),
            room_tint: [1.0; 3],
        }
    }
}

impl Lighting {
    /// The same light with its key light turned away from the nominal direction: first by `pitch` about the world's x
    /// axis, then by `yaw` about its z axis, rad.
    pub fn with_key_turned(mut self, pitch: f64, yaw: f64) -> Self {
        self.key_direction = key_direction(pitch, yaw);
        self
    }

    /// The light of an episode. The tint multiplies linear colours.
    pub fn of(light: &Light) -> Self {
        Self {
            dome: light.dome,
            dome_yaw: light.dome_yaw,
            key: light.key,
            room_tint: rgb(light.tint_hue, light.tint_saturation, light.tint_value),
            ..Self::default()
        }
        .with_key_turned(light.key_pitch, light.key_yaw)
    }

    pub(crate) fn prepared(&self) -> PreparedLight {
        let towards = -self.key_direction;
        let towards = towards.try_normalize(1e-9).unwrap_or_else(Vector3::z);
        let key = self.key / KEY_NOMINAL * NOMINAL_LIGHT[1];
        let dome = self.dome / DOME_NOMINAL * NOMINAL_LIGHT[0];
        PreparedLight {
            towards_key: [towards.x as f32, towards.y as f32, towards.z as f32],
            key: self.key_colour.map(|c| (key * c) as f32),
            dome: dome as f32,
            dome_side: [libm::cos(self.dome_yaw) as f32, libm::sin(self.dome_yaw) as f32],
            room_tint: self.room_tint.map(|c| c as f32),
        }
    }
}

/// Lighting as the shader takes it.
#[derive(Debug, Clone)]
pub(crate) struct PreparedLight {
    pub towards_key: [f32; 3],
    pub key: [f32; 3],
    pub dome: f32,
    pub dome_side: [f32; 2],
    pub room_tint: [f32; 3],
}

/// From hue (degrees), saturation and value.
fn rgb(hue: f64, saturation: f64, value: f64) -> [f64; 3] {
    [5.0, 3.0, 1.0].map(|offset| {
        let k = libm::fmod(offset + hue / 60.0, 6.0);
        value * (1.0 - saturation * k.min(4.0 - k).clamp(0.0, 1.0))
    })
}

/// The tilt is about the world's x axis: the light comes from the closed side of the room, the south. (The source does not
/// say about which axis.)
fn key_direction(pitch: f64, yaw: f64) -> Vector3<f64> {
    let tilt = UnitQuaternion::from_axis_angle(&Vector3::x_axis(), KEY_TILT + pitch);
    UnitQuaternion::from_axis_angle(&Vector3::z_axis(), yaw) * (tilt * -Vector3::z())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn tints_by_hue() {
        let near = |hsv: [f64; 3], expected: [f64; 3]| {
            let found = rgb(hsv[0], hsv[1], hsv[2]);
            assert!(found.iter().zip(expected).all(|(a, b)| (a - b).abs() < 1e-12), "{hsv:?}: {found:?}");
        };
        near([0.0, 1.0, 1.0], [1.0, 0.0, 0.0]);
        near([60.0, 1.0, 0.5], [0.5, 0.5, 0.0]);
        near([120.0, 1.0, 1.0], [0.0, 1.0, 0.0]);
        near([240.0, 0.5, 1.0], [0.5, 0.5, 1.0]);
        near([330.0, 1.0, 1.0], [1.0, 0.0, 0.5]);
        near([77.0, 0.0, 1.2], [1.2; 3]);
    }

    #[test]
    fn nominal_light_is_the_default() {
        assert_eq!(Lighting::of(&Light::default()), Lighting::default());
    }
}
