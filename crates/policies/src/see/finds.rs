//! The place of the robot on the ladder, as a network finds it in pictures.

/// Names of the numbers, as the network's contract and `python/fiatlux/dagger/finds.py` have them.
pub(super) const FINDS: [&str; 7] = ["x", "y", "heading", "log_x", "log_y", "log_heading", "wall"];

/// A place, as it was found.
#[derive(Debug, Clone, Copy)]
pub(super) struct Found {
    /// x and y of the pelvis in the ladder's frame, m, and by how much it looks to the left of the way up, rad.
    pub place: [f64; 3],
    /// Their standard deviations, as the network says.
    pub spread: [f64; 3],
    /// Above 0 where the socket is at a wall.
    pub wall: f64,
}

impl Found {
    /// Of what comes out of a network that finds.
    pub fn of(answer: &[f32]) -> Option<Self> {
        let &[x, y, heading, log_x, log_y, log_heading, wall] = answer else { return None };
        Some(Self {
            place: [x, y, heading].map(f64::from),
            spread: [log_x, log_y, log_heading].map(|logarithm| libm::exp(f64::from(logarithm))),
            wall: f64::from(wall),
        })
    }
}
