//! Video through `ffmpeg` as a child process.

use std::collections::VecDeque;
use std::ffi::OsString;
use std::io::{BufRead, BufReader, Read, Write};
use std::os::unix::process::CommandExt;
use std::path::{Path, PathBuf};
use std::process::{Child, ChildStderr, ChildStdin, Command, Stdio};
use std::thread::JoinHandle;

use super::RenderError;
use super::view::Picture;

const FFMPEG: &str = "ffmpeg";
/// Last lines that are kept of what it says, and the longest of them, bytes.
const LINES: usize = 8;
const LINE_BYTES: u64 = 400;
/// H.264 as every player takes it, of a quality that shows no artefacts. Colours are those of HD video.
const CODEC: &str = "-c:v libx264 -preset veryfast -crf 18 -pix_fmt yuv420p -movflags +faststart";
const COLOURS: &str = "-vf scale=out_color_matrix=bt709:out_range=tv -colorspace bt709 -color_primaries bt709 \
    -color_trc bt709 -color_range tv";

/// The program `ffmpeg`, where `PATH` has one.
pub fn find_ffmpeg() -> Option<PathBuf> {
    let folders = std::env::var_os("PATH")?;
    std::env::split_paths(&folders).filter(|folder| folder.is_absolute()).map(|folder| folder.join(FFMPEG)).find(
        |program| {
            use std::os::unix::fs::PermissionsExt;
            std::fs::metadata(program).is_ok_and(|found| found.is_file() && found.permissions().mode() & 0o111 != 0)
        },
    )
}

pub fn join_command(folder: &Path, video: &Path, fps: u32) -> String {
    let quoted = |path: &Path| {
        let text = path.display().to_string();
        let plain = text.bytes().all(|b| b.is_ascii_alphanumeric() || b"/._-%".contains(&b));
        if plain { text } else { format!("'{}'", text.replace('\'', r"'\''")) }
    };
    // A percent sign in the folder's own name would be read as a number's place.
    let frames = PathBuf::from(folder.display().to_string().replace('%', "%%")).join("%04d.png");
    format!("{FFMPEG} -framerate {fps} -i {} {COLOURS} {CODEC} {}", quoted(&frames), quoted(video))
}

/// An `ffmpeg` that takes raw frames.
#[derive(Debug)]
pub(super) struct Encoder {
    child: Child,
    stdin: Option<ChildStdin>,
    said: Option<JoinHandle<String>>,
}

impl Encoder {
    pub fn start(ffmpeg: &Path, path: &Path, picture: &Picture, fps: u32) -> Result<Self, RenderError> {
        let mut command = Command::new(ffmpeg);
        command.args("-hide_banner -loglevel error -y -f rawvideo -pixel_format rgb24".split(' '));
        command.arg("-video_size").arg(format!("{}x{}", picture.width, picture.height));
        command.arg("-framerate").arg(fps.to_string()).args(["-i", "pipe:0", "-an"]);
        command.args(COLOURS.split_whitespace()).args(CODEC.split_whitespace()).args(["-f", "mp4"]);
        // A name that begins with a dash is a name all the same.
        let mut name = OsString::from("file:");
        name.push(path);
        command.arg(name);
        command.stdin(Stdio::piped()).stdout(Stdio::null()).stderr(Stdio::piped());
        // A group of its own: Ctrl-C is ours to handle, and the video is ended properly.
        command.process_group(0);
        let mut child = command.spawn().map_err(RenderError::io("start", ffmpeg))?;
        let said = child.stderr.take().map(|stderr| std::thread::spawn(move || last_lines(stderr)));
        Ok(Self { stdin: child.stdin.take(), child, said })
    }

    /// Takes a frame: red, green, blue of all pixels.
    pub fn write(&mut self, rgb: &[u8]) -> Result<(), RenderError> {
        match self.stdin.as_mut().map(|stdin| stdin.write_all(rgb)) {
            Some(Ok(())) => Ok(()),
            _ => Err(self.end().err().unwrap_or_else(|| RenderError::Encoder {
                how: "ended before the last frame".into(),
                said: String::new(),
            })),
        }
    }

    pub fn finish(mut self) -> Result<(), RenderError> {
        self.end()
    }

    fn end(&mut self) -> Result<(), RenderError> {
        drop(self.stdin.take());
        let status = self.child.wait().map_err(RenderError::io("wait for", Path::new(FFMPEG)))?;
        let said = self.said.take().and_then(|said| said.join().ok()).unwrap_or_default();
        if status.success() {
            return Ok(());
        }
        Err(RenderError::Encoder { how: format!("failed ({status})"), said })
    }
}

impl Drop for Encoder {
    fn drop(&mut self) {
        // Ended already, or not wanted any more.
        if self.stdin.take().is_some() {
            let _ = self.child.kill();
            let _ = self.child.wait();
        }
    }
}

/// The last lines of what it says, however much that is.
fn last_lines(stderr: ChildStderr) -> String {
    let mut reader = BufReader::new(stderr);
    let mut lines: VecDeque<String> = VecDeque::new();
    loop {
        let mut line = Vec::new();
        match reader.by_ref().take(LINE_BYTES).read_until(b'\n', &mut line) {
            Ok(0) | Err(_) => break,
            Ok(_) => {
                if lines.len() == LINES {
                    lines.pop_front();
                }
                lines.push_back(String::from_utf8_lossy(&line).trim_end().to_owned());
            }
        }
    }
    lines.iter().map(|line| format!("\n  {line}")).collect()
}
