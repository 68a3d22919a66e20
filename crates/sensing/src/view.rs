use fiatlux_rules::{Judge, Row, Task};
use fiatlux_world::{Episode, Scene};
use nalgebra::Isometry3;

/// Inputs of the sensors: a row, and what the rules say of it.
#[derive(Debug, Clone, Copy)]
pub struct View<'a> {
    /// The scene that the row belongs to.
    pub scene: &'a Scene,
    /// Index of the episode.
    pub episode: u64,
    /// The row that is sensed.
    pub row: &'a Row,
    /// Pose of the pelvis in row 0, world, m.
    pub start: &'a Isometry3<f64>,
    /// The task that is played.
    pub task: Task,
    /// The judge, who has seen the row.
    pub judge: &'a Judge,
    /// Reward of the step to this row.
    pub reward: f64,
}

impl<'a> View<'a> {
    /// The last row of an episode.
    pub fn of(episode: &'a Episode) -> Self {
        Self {
            scene: episode.scene(),
            episode: episode.spec().episode,
            row: episode.row(),
            start: episode.start_pose(),
            task: episode.spec().task,
            judge: episode.judge(),
            reward: episode.reward(),
        }
    }
}
