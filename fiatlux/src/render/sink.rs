//! Where frames go: a video, a folder of PNG files, or one PNG file. Each has another name until it is whole.

use std::fs;
use std::io::{self, Write};
use std::path::{Path, PathBuf};

use super::RenderError;
use super::draw::Form;
use super::encoder::Encoder;
use super::view::Picture;
use crate::part_of;

#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Output {
    /// One MP4 file, by `ffmpeg`.
    Video { path: PathBuf, ffmpeg: PathBuf },
    /// PNG files `0000.png`, `0001.png` and so on.
    Frames { folder: PathBuf },
    /// One PNG file of a single frame.
    Still { path: PathBuf },
}

impl Output {
    pub fn path(&self) -> &Path {
        match self {
            Output::Video { path, .. } | Output::Still { path } => path,
            Output::Frames { folder } => folder,
        }
    }

    pub(super) fn form(&self) -> Form {
        if matches!(self, Output::Video { .. }) { Form::Rgb } else { Form::Png }
    }

    /// Checks that nothing would be lost.
    pub(super) fn check(&self, force: bool) -> Result<(), RenderError> {
        let path = self.path();
        let refuse = |problem: &str| Err(RenderError::Output { path: path.into(), problem: problem.into() });
        let Some(parent) = path.file_name().and(path.parent()) else {
            return refuse("it has no name; name a file or a new folder");
        };
        if parent.ancestors().any(|folder| folder.is_file()) {
            return refuse("a part of its path is a file; choose another name");
        }
        let Ok(found) = fs::symlink_metadata(path) else { return Ok(()) };
        if !force {
            return refuse("it exists already; choose another name, or replace it with --force");
        }
        match (found.is_dir(), matches!(self, Output::Frames { .. })) {
            (true, false) => refuse("it is a folder; choose another name"),
            (false, true) => refuse("it is a file; choose another name"),
            (true, true) if !holds_frames_alone(path) => {
                refuse("it holds other things than numbered PNG files and is not replaced; choose another name")
            }
            _ => Ok(()),
        }
    }
}

/// Takes frames. What is not finished is removed.
#[derive(Debug)]
pub(super) struct Sink {
    output: Output,
    force: bool,
    /// Its name until it is whole.
    part: PathBuf,
    encoder: Option<Encoder>,
    frames: u64,
    finished: bool,
}

impl Sink {
    pub fn create(output: &Output, force: bool, picture: &Picture, fps: u32) -> Result<Self, RenderError> {
        output.check(force)?;
        if let Some(folder) = output.path().parent() {
            fs::create_dir_all(folder).map_err(RenderError::io("make the folder", folder))?;
        }
        let part = part_of(output.path());
        let encoder = match output {
            Output::Video { ffmpeg, .. } => Some(Encoder::start(ffmpeg, &part, picture, fps)?),
            Output::Frames { .. } => {
                fs::create_dir(&part).map_err(RenderError::io("make the folder", &part))?;
                None
            }
            Output::Still { .. } => None,
        };
        Ok(Self { output: output.clone(), force, part, encoder, frames: 0, finished: false })
    }

    pub fn write(&mut self, frame: &[u8]) -> Result<(), RenderError> {
        match (&mut self.encoder, &self.output) {
            (Some(encoder), _) => encoder.write(frame)?,
            (None, Output::Frames { .. }) => write(&self.part.join(frame_name(self.frames)), frame)?,
            (None, _) => write(&self.part, frame)?,
        }
        self.frames += 1;
        Ok(())
    }

    pub fn frames(&self) -> u64 {
        self.frames
    }

    /// Ends it and gives it its name.
    pub fn finish(mut self) -> Result<(), RenderError> {
        if let Some(encoder) = self.encoder.take() {
            encoder.finish()?;
        }
        // Something of that name may have come in the meantime.
        self.output.check(self.force)?;
        let path = self.output.path();
        if matches!(self.output, Output::Frames { .. }) && path.exists() {
            fs::remove_dir_all(path).map_err(RenderError::io("replace", path))?;
        }
        fs::rename(&self.part, path).map_err(RenderError::io("name", path))?;
        self.finished = true;
        Ok(())
    }
}

impl Drop for Sink {
    fn drop(&mut self) {
        if self.finished {
            return;
        }
        // The encoder ends before its file goes. What cannot be removed keeps a name that says what it is.
        drop(self.encoder.take());
        let _ = match self.output {
            Output::Frames { .. } => fs::remove_dir_all(&self.part),
            _ => fs::remove_file(&self.part),
        };
    }
}

pub(super) fn frame_name(index: u64) -> String {
    format!("{index:04}.png")
}

fn write(path: &Path, bytes: &[u8]) -> Result<(), RenderError> {
    let create = || fs::File::create_new(path)?.write_all(bytes);
    create().map_err(RenderError::io("write", path))
}

fn holds_frames_alone(folder: &Path) -> bool {
    let is_frame = |entry: io::Result<fs::DirEntry>| {
        let Ok(entry) = entry else { return false };
        let name = entry.file_name();
        let stem = name.to_str().and_then(|name| name.strip_suffix(".png")).unwrap_or_default();
        stem.len() >= 4
            && stem.bytes().all(|b| b.is_ascii_digit())
            && entry.file_type().is_ok_and(|kind| kind.is_file())
    };
    fs::read_dir(folder).is_ok_and(|mut entries| entries.all(is_frame))
}
