//! Limits of messages and rates, in one place.

use std::time::Duration;

/// Largest request or action that a server reads, bytes. An action takes about 450.
pub const MAX_CLIENT_MESSAGE: usize = 16 * 1024;

/// Largest request to a run, bytes: it may list 10,000 seeds of 64 bits.
pub const MAX_RUN_REQUEST: usize = 128 * 1024;

/// Numbers of a model's chunk in an action; a larger chunk is recorded without them.
pub const MAX_CHUNK_NUMBERS: usize = 3_300;

/// Keys of a chunk, and bytes of each.
pub const MAX_CHUNK_KEYS: [usize; 2] = [32, 64];

/// Bytes of a chunk's `problem`.
pub const MAX_CHUNK_PROBLEM: usize = 256;

/// Bytes of a chunk's `phase`.
pub const MAX_CHUNK_PHASE: usize = 64;

/// Largest message that a client or a recorder reads, bytes. A truth takes about 8,000.
pub const MAX_SERVER_MESSAGE: usize = 4 * 1024 * 1024;

/// Sides of the head camera's image, pixels: the least and the most.
pub const IMAGE_SIDES: [u32; 2] = [16, 640];

/// Client messages that wait in a session; more are dropped with a notice.
pub const MAX_WAITING_MESSAGES: usize = 32;

/// Notices that a session sends a second; those in between are counted in the next one.
pub const MAX_NOTICES_PER_S: u32 = 10;

/// Rows that lockstep runs ahead of what a recorder has on disk; the server keeps as many.
pub const RECORDING_WINDOW: u64 = 512;

/// Bytes of rows that a server keeps for a recorder: with pictures among them a row is no longer small. The window is full
/// at either bound.
pub const RECORDING_WINDOW_BYTES: usize = 64 << 20;

/// StepRecords that one reply to a [`crate::v3::StepRecordRequest`] covers at most.
pub const MAX_TRUTHS_PER_REQUEST: u64 = 128;

/// A recorder that has not acknowledged anything for this time is gone.
pub const RECORDER_TIMEOUT: Duration = Duration::from_secs(10);

/// A recorder acknowledges at least so often.
pub const ACK_PERIOD: Duration = Duration::from_secs(1);
