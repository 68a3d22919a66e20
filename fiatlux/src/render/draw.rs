//! Draws frames on several threads, and gives them out in order.

use std::num::NonZeroUsize;
use std::panic::resume_unwind;
use std::sync::Arc;
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};

use fiatlux_render::{Camera, Lighting, Visuals};
use fiatlux_rules::Row;

use super::RenderError;
use super::view::{Composer, Picture};

/// Frames that wait on either side of a thread: what bounds the memory.
const WAITING: usize = 2;

/// Shared by the frames of an episode.
#[derive(Debug)]
pub(super) struct Stage {
    pub visuals: Visuals,
    pub light: Lighting,
}

#[derive(Debug)]
pub(super) struct Job {
    pub stage: Arc<Stage>,
    pub row: Row,
    pub cameras: Vec<Camera>,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Form {
    /// Red, green, blue of all pixels.
    Rgb,
    /// The bytes of a PNG file.
    Png,
}

type Frame = Result<Vec<u8>, RenderError>;

/// Draws what `jobs` hands to its argument, which is false once no more is wanted. `take` gets the frames in that order
/// and is false once it wants no more. Returns what `jobs` returned.
///
/// # Errors
/// The first error of a frame or of `take`.
pub(super) fn draw<T: Send>(
    picture: &Picture,
    form: Form,
    workers: NonZeroUsize,
    jobs: impl FnOnce(&mut dyn FnMut(Job) -> bool) -> T + Send,
    mut take: impl FnMut(Vec<u8>) -> Result<bool, RenderError>,
) -> Result<T, RenderError> {
    std::thread::scope(|scope| {
        let mut inputs = Vec::new();
        let mut outputs = Vec::new();
        for _ in 0..workers.get() {
            let (input, todo) = sync_channel::<Job>(WAITING);
            let (done, output) = sync_channel::<Frame>(WAITING);
            scope.spawn(move || work(picture, form, &todo, &done));
            inputs.push(input);
            outputs.push(output);
        }
        let produced = scope.spawn(move || {
            let mut turns = (0..inputs.len()).cycle();
            jobs(&mut |job| turns.next().is_some_and(|turn| inputs[turn].send(job).is_ok()))
        });
        // Each thread in its turn; the first that is at its end has had the last frame before it.
        let mut taken = Ok(());
        for output in outputs.iter().cycle() {
            let Ok(frame) = output.recv() else { break };
            match frame.and_then(&mut take) {
                Ok(true) => {}
                Ok(false) => break,
                Err(error) => {
                    taken = Err(error);
                    break;
                }
            }
        }
        // The threads end when nobody takes what they have.
        drop(outputs);
        let produced = produced.join().unwrap_or_else(|panic| resume_unwind(panic));
        taken.map(|()| produced)
    })
}

fn work(picture: &Picture, form: Form, todo: &Receiver<Job>, done: &SyncSender<Frame>) {
    let mut composer = Composer::new(picture);
    while let Ok(Job { stage, row, cameras }) = todo.recv() {
        let image = composer.draw(&stage.visuals, &row, &cameras, &stage.light);
        let frame = match form {
            Form::Rgb => Ok(image.rgb().to_vec()),
            Form::Png => image.to_png().map_err(RenderError::from),
        };
        if done.send(frame).is_err() {
            return;
        }
    }
}
