//! Numbers that a network finds in pictures: the place of the robot on the ladder, or in the room.

/// Names of the numbers, as a network's contract and `python/fiatlux/dagger/finds.py` have them.
pub(super) const ON_LADDER: [&str; 7] = ["x", "y", "heading", "log_x", "log_y", "log_heading", "wall"];
/// The same of one that finds the room.
pub(super) const IN_ROOM: [&str; 13] = [
    "x",
    "y",
    "cos",
    "sin",
    "bench_ahead",
    "bench_left",
    "crate_ahead",
    "crate_left",
    "log_x",
    "log_y",
    "log_heading",
    "log_bench",
    "log_crate",
];

/// A place on the ladder, as it was found.
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
            spread: [log_x, log_y, log_heading].map(deviation),
            wall: f64::from(wall),
        })
    }
}

/// A place in the room, as it was found.
#[derive(Debug, Clone, Copy)]
pub(super) struct InRoom {
    /// x and y of the pelvis in the room, m.
    pub at: [f64; 2],
    /// Its heading, rad.
    pub heading: f64,
    /// Standard deviations of x, y and heading, as the network says.
    pub spread: [f64; 3],
    /// Bench and crate: where their middles are from the pelvis, ahead and to the left, m, and how sure that is.
    pub things: [([f64; 2], f64); 2],
}

impl InRoom {
    /// Of what comes out of a network that finds the room.
    pub fn of(answer: &[f32]) -> Option<Self> {
        let answer: &[f32; IN_ROOM.len()] = answer.try_into().ok()?;
        let [x, y, cos, sin, bench_ahead, bench_left, crate_ahead, crate_left] =
            [0, 1, 2, 3, 4, 5, 6, 7].map(|place| f64::from(answer[place]));
        let [log_x, log_y, log_heading, log_bench, log_crate] =
            [8, 9, 10, 11, 12].map(|place| deviation(answer[place]));
        Some(Self {
            at: [x, y],
            heading: libm::atan2(sin, cos),
            spread: [log_x, log_y, log_heading],
            things: [([bench_ahead, bench_left], log_bench), ([crate_ahead, crate_left], log_crate)],
        })
    }
}

fn deviation(logarithm: f32) -> f64 {
    libm::exp(f64::from(logarithm))
}
