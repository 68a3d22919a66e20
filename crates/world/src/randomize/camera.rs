use std::collections::BTreeMap;

use fiatlux_rules::CONTROL_DT;

const X: &str = "camera.x";
const Y: &str = "camera.y";
const Z: &str = "camera.z";
const ROLL: &str = "camera.roll";
const PITCH: &str = "camera.pitch";
const YAW: &str = "camera.yaw";
const ANGLE: &str = "camera.angle";
const EXPOSURE: &str = "camera.exposure";
const NOISE: &str = "camera.noise";
const BLUR: &str = "camera.blur";
pub(super) const DELAY: &str = "camera.delay";
const COLOURS: &str = "camera.colours";
pub(super) const PATTERN: &str = "camera.pattern";
pub(super) const LOOK: &str = "camera.look";

/// Name, limits and unit of each range.
pub(super) const CAMERA_RANGES: [(&str, [f64; 2], &str); 14] = [
    (X, [-0.1, 0.1], " m"),
    (Y, [-0.1, 0.1], " m"),
    (Z, [-0.1, 0.1], " m"),
    (ROLL, [-0.5, 0.5], " rad"),
    (PITCH, [-0.5, 0.5], " rad"),
    (YAW, [-0.5, 0.5], " rad"),
    (ANGLE, [0.5, 1.5], ""),
    (EXPOSURE, [-4.0, 4.0], " stops"),
    (NOISE, [0.0, 64.0], " levels of 255"),
    (BLUR, [0.0, 8.0], " pixels"),
    (DELAY, [0.0, 100.0], " ms in steps of 20"),
    (COLOURS, [0.0, 1.0], ""),
    (PATTERN, [0.0, 8.0], " as a whole number"),
    (LOOK, [1.0, 2.0], " as a whole number"),
];

/// Differences of an episode's pictures from the benchmark's, the same for all cameras. What is not drawn is as there.
#[derive(Debug, Clone, PartialEq)]
pub struct CameraVariation {
    /// Shift of each camera in its own frame: ahead, left, up, m.
    pub shift: [f64; 3],
    /// Turn of each camera about these axes: roll, then pitch, then yaw, rad.
    pub turn: [f64; 3],
    /// Factor of the angle of view.
    pub angle: f64,
    /// Brightness, by powers of two.
    pub exposure: f64,
    /// Half-width of the uniform noise of each byte.
    pub noise: f64,
    /// Standard deviation of the blur, pixels.
    pub blur: f64,
    /// Control steps between a row and its picture.
    pub delay_steps: usize,
    /// Largest change of each colour's red, green and blue, as a share.
    pub colours: f64,
    /// Pattern on floor and walls, from 1 to 8; 0 for none.
    pub pattern: usize,
    /// Look of things: 1 for the benchmark's, 2 for that of pictures for people.
    pub look: usize,
    /// Seed and episode, for the numbers that each colour and each picture draw.
    pub stream: (u64, u64),
}

impl CameraVariation {
    /// Of the values that an episode drew; `None` where none of them is of cameras.
    pub fn of(varied: &BTreeMap<String, f64>, seed: u64, episode: u64) -> Option<Self> {
        let or = |name: &str, nominal: f64| varied.get(name).copied().unwrap_or(nominal);
        let is_varied = CAMERA_RANGES.iter().any(|(name, ..)| varied.contains_key(*name));
        is_varied.then(|| Self {
            shift: [X, Y, Z].map(|name| or(name, 0.0)),
            turn: [ROLL, PITCH, YAW].map(|name| or(name, 0.0)),
            angle: or(ANGLE, 1.0),
            exposure: or(EXPOSURE, 0.0),
            noise: or(NOISE, 0.0),
            blur: or(BLUR, 0.0),
            delay_steps: (or(DELAY, 0.0) / (CONTROL_DT * 1e3)).round() as usize,
            colours: or(COLOURS, 0.0),
            pattern: or(PATTERN, 0.0) as usize,
            look: or(LOOK, 1.0) as usize,
            stream: (seed, episode),
        })
    }
}

/// Names of the ranges of cameras.
pub fn camera_ranges() -> impl Iterator<Item = &'static str> {
    CAMERA_RANGES.iter().map(|(name, ..)| *name)
}
