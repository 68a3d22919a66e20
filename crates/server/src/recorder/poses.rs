//! Poses for viewers, which a bag has next to its rows.

use std::collections::BTreeMap;

use fiatlux_bag::{BagError, BagWriter, topic};
use fiatlux_proto::decode;
use fiatlux_proto::limits::MAX_SERVER_MESSAGE;
use fiatlux_proto::v3::{EpisodeHeader, State, StepRecord};
use fiatlux_robot::{Robot, RobotError};
use fiatlux_wire::{Frames, layout_of, read_row};

/// Number of rows from one set of poses to the next: 25 Hz.
const ROWS_PER_FRAMES: u64 = 2;

/// The frames of every robot.
pub(crate) struct Poses(BTreeMap<&'static str, Frames>);

impl Poses {
    pub fn load() -> Result<Self, RobotError> {
        let frames_of = |name| Ok((name, Frames::new(&Robot::by_name(name)?)));
        Robot::NAMES.into_iter().map(frames_of).collect::<Result<_, _>>().map(Self)
    }

    /// Adds a row to a bag, and every second time its poses before it.
    pub fn write(&self, writer: &mut BagWriter, header: &EpisodeHeader, record: &StepRecord) -> Result<(), BagError> {
        if record.step.is_multiple_of(ROWS_PER_FRAMES)
            && let Some(frames) = self.of(header, &record.state)
        {
            writer.message(topic::TF, record.step, &frames)?;
        }
        writer.push(record)
    }

    /// Encoded poses of a row; `None` if the record has no readable row, or the robot is unknown here.
    fn of(&self, header: &EpisodeHeader, state: &[u8]) -> Option<Vec<u8>> {
        if state.is_empty() {
            return None;
        }
        let state: State = decode(state, MAX_SERVER_MESSAGE).ok()?;
        let row = read_row(&state, layout_of(header).ok()?).ok()?;
        let frames = self.0.get(Robot::known(&header.robot).ok()?)?;
        Some(frames.encode(&row))
    }
}
