//! `fiatlux render`.

use std::num::NonZeroUsize;
use std::path::{Path, PathBuf};
use std::process::ExitCode;

use crate::render::{Clip, Outcome, Output, Picture, RenderOptions, Span, View, find_ffmpeg, join_command, stride};
use anyhow::Context;
use clap::Args;
use fiatlux_cli::ProgressLine;
use nalgebra::Vector3;

/// Shown below the options.
pub const EXAMPLES: &str = "Examples:
  fiatlux render results/stand/bags/S05-s0-e0.mcap -o clip.mp4
  fiatlux render BAG -o clip.mp4 --view follow,head --speed 4
  fiatlux render BAG -o still.png --at 2.5 --samples 4
  fiatlux render BAG -o frames/ --from 1 --to 3 --eye 3,-4,2 --target 0,0,1

Exit codes: 0 ok, 1 failed, 2 usage, 3 finished with rows that are missing, or stopped.";

/// Largest side of a picture, pixels.
const MAX_PIXELS: usize = 4096;
/// Most samples of a picture: with them a thread takes about 1 GB.
const MAX_SAMPLES: usize = 4096 * 4096 * 4;

/// Options of the command.
#[derive(Debug, Args)]
pub struct RenderArgs {
    /// Bags of episodes, shown one after the other.
    #[arg(required = true, value_name = "BAG")]
    bags: Vec<PathBuf>,
    /// NAME.mp4 is a video, NAME.png a still; a name without an ending is a folder of PNG files.
    #[arg(short, long, value_name = "OUT")]
    out: PathBuf,
    /// Views: follow (the robot and what its task is about; follow:S05 for another task, such as a part of the errand), room (all of it, from above), head (what the head camera
    /// sees), or a list of them such as follow,head, of which the first fills the picture and the others are insets.
    #[arg(long, default_value = "follow", value_delimiter = ',', value_parser = view, conflicts_with = "eye")]
    view: Vec<View>,
    /// Where a camera of your own is, m in the world; z is up.
    #[arg(long, value_name = "X,Y,Z", value_parser = point, requires = "target", allow_hyphen_values = true)]
    eye: Option<Vector3<f64>>,
    /// The point that it looks at, m in the world.
    #[arg(long, value_name = "X,Y,Z", value_parser = point, requires = "eye", allow_hyphen_values = true)]
    target: Option<Vector3<f64>>,
    /// Field of view from the upper to the lower edge, degrees; the head camera has its own.
    #[arg(long, value_name = "DEG", default_value_t = 38.0, value_parser = fov)]
    fov: f64,
    /// Size of the picture, pixels [default: 1280x720; 720x720 for the head camera alone]
    #[arg(long, value_name = "WxH", value_parser = size)]
    size: Option<[usize; 2]>,
    /// Frames a second of the video. A bag has 50 rows a second, and a frame is a row.
    #[arg(long, default_value_t = 25, value_parser = fiatlux_cli::whole::<u32>(1..=50))]
    fps: u32,
    /// Playing speed, in times real time.
    #[arg(long, default_value_t = 1.0, value_parser = speed)]
    speed: f64,
    /// Simulated time of the first frame, s [default: the first row]
    #[arg(long, value_name = "S", value_parser = seconds)]
    from: Option<f64>,
    /// Simulated time of the last frame, s [default: the last row]
    #[arg(long, value_name = "S", value_parser = seconds)]
    to: Option<f64>,
    /// Simulated time of a still, s [default: the middle]
    #[arg(long, value_name = "S", value_parser = seconds)]
    at: Option<f64>,
    /// Samples a pixel, each way: 1 is fast, 2 has smoother edges and takes about four times as long [default: 1; 3 for
    /// a still]
    #[arg(long, value_name = "N", value_parser = fiatlux_cli::whole::<u8>(1..=4))]
    samples: Option<u8>,
    /// Threads that draw [default: one a core]
    #[arg(long, value_name = "N", value_parser = fiatlux_cli::whole::<u8>(1..=64))]
    workers: Option<u8>,
    /// Folder of meshes of the robot's links in metres, LINK.stl or LINK.obj such as those of Unitree's description, to show
    /// in place of our own shapes.
    #[arg(long, value_name = "DIR")]
    meshes: Option<PathBuf>,
    /// Replaces a file or a folder of frames of that name.
    #[arg(long)]
    force: bool,
}

fn view(name: &str) -> Result<View, String> {
    name.parse()
}

fn number(text: &str, least: f64, most: f64, what: &str) -> Result<f64, String> {
    match text.trim().parse::<f64>() {
        Ok(value) if (least..=most).contains(&value) => Ok(value),
        _ => Err(format!("give {what}")),
    }
}

fn fov(text: &str) -> Result<f64, String> {
    number(text, 1.0, 150.0, "an angle of 1 to 150 degrees")
}

fn speed(text: &str) -> Result<f64, String> {
    number(text, 0.02, 1000.0, "a number of 0.02 to 1000")
}

fn seconds(text: &str) -> Result<f64, String> {
    number(text, 0.0, 1e6, "a simulated time in seconds, 0 or more")
}

fn point(text: &str) -> Result<Vector3<f64>, String> {
    let what = "three numbers such as 3,-4,2, in metres and within 1000 of the origin";
    let parts: Vec<f64> = text.split(',').map(|part| number(part, -1000.0, 1000.0, what)).collect::<Result<_, _>>()?;
    match parts[..] {
        [x, y, z] => Ok(Vector3::new(x, y, z)),
        _ => Err(format!("give {what}")),
    }
}

fn size(text: &str) -> Result<[usize; 2], String> {
    let fits = |side: &usize| (16..=MAX_PIXELS).contains(side) && side.is_multiple_of(2);
    let side = |text: &str| text.trim().parse().ok().filter(fits);
    let parts = text.split_once('x').and_then(|(width, height)| Some([side(width)?, side(height)?]));
    parts.ok_or_else(|| format!("give WIDTHxHEIGHT such as 1280x720: even numbers of 16 to {MAX_PIXELS}"))
}

/// Kind of an output, by its name.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Kind {
    Video,
    Still,
    Folder,
}

fn kind(out: &Path) -> Result<Kind, String> {
    let is_folder = out.as_os_str().as_encoded_bytes().ends_with(b"/");
    match out.extension().map(|ending| ending.to_string_lossy().to_lowercase()) {
        _ if out.file_name().is_none() => Err("-o names no file and no new folder".into()),
        _ if is_folder => Ok(Kind::Folder),
        None => Ok(Kind::Folder),
        Some(ending) if ending == "mp4" => Ok(Kind::Video),
        Some(ending) if ending == "png" => Ok(Kind::Still),
        Some(ending) => Err(format!(
            "'{}' ends in .{ending}; use NAME.mp4 for a video, NAME.png for a still, or NAME/ for a folder",
            out.display()
        )),
    }
}

/// Runs the command: draws bags as a video, a still or a folder of pictures.
pub fn run(args: &RenderArgs) -> anyhow::Result<ExitCode> {
    fiatlux_cli::init_quiet_log();
    let (kind, stride) = match checked(args) {
        Ok(checked) => checked,
        Err(problem) => {
            return Ok(fiatlux_cli::usage(problem));
        }
    };
    let (output, join) = output(args, kind);
    if let Some(join) = &join {
        let folder = output.path().display();
        fiatlux_cli::report(format!(
            "ffmpeg is not in PATH; the frames go to {folder} as PNG files. This joins them:\n  {join}"
        ));
    }
    let clip = Clip::open(options(args, kind, output, stride))?;
    for warning in clip.warnings() {
        fiatlux_cli::report(format!("warning: {warning}"));
    }
    let stop = fiatlux_cli::stop_on_signal().context("cannot listen for Ctrl-C")?;
    let line = ProgressLine::default();
    let begun = std::time::Instant::now();
    let outcome = clip.render(&stop, &mut |progress| {
        let (done, all) = (progress.done, progress.all);
        line.show(|| format!("frame {done}/{all}, {:.1} frames/s, {} left", line.rate(done), line.left(done, all)));
    });
    line.clear();
    let outcome = outcome?;
    Ok(tell(&clip, &outcome, begun.elapsed().as_secs_f64())?)
}

/// Checks options together, once each is right by itself.
fn checked(args: &RenderArgs) -> Result<(Kind, u64), String> {
    let kind = kind(&args.out)?;
    if kind == Kind::Still && args.bags.len() > 1 {
        return Err("a still is of one bag; name one, or a video or folder for all of them".into());
    }
    if kind != Kind::Still && args.at.is_some() {
        return Err("--at is for a still, NAME.png; use --from and --to".into());
    }
    if kind == Kind::Still && args.at.is_some() && (args.from.is_some() || args.to.is_some()) {
        return Err("--at is the time of the still; leave --from and --to out".into());
    }
    if let (Some(from), Some(to)) = (args.from, args.to)
        && from > to
    {
        return Err(format!("--from {from} is after --to {to}"));
    }
    if args.view.iter().enumerate().any(|(i, view)| args.view[..i].contains(view)) {
        return Err("--view names a view twice".into());
    }
    let Picture { width, height, samples, .. } = picture(args, kind);
    if width * samples * height * samples > MAX_SAMPLES {
        return Err(format!(
            "{width}x{height} with {samples} by {samples} samples a pixel is too large; lower one of them"
        ));
    }
    let stride = if kind == Kind::Still { 1 } else { stride(args.fps, args.speed)? };
    Ok((kind, stride))
}

/// Where the frames go, and without `ffmpeg` the command that joins them.
fn output(args: &RenderArgs, kind: Kind) -> (Output, Option<String>) {
    let path = args.out.clone();
    match (kind, find_ffmpeg()) {
        (Kind::Still, _) => (Output::Still { path }, None),
        (Kind::Folder, _) => (Output::Frames { folder: path }, None),
        (Kind::Video, Some(ffmpeg)) => (Output::Video { path, ffmpeg }, None),
        (Kind::Video, None) => {
            let folder = path.with_extension("");
            let join = join_command(&folder, &path, args.fps);
            (Output::Frames { folder }, Some(join))
        }
    }
}

fn picture(args: &RenderArgs, kind: Kind) -> Picture {
    let views = match (args.eye, args.target) {
        (Some(eye), Some(target)) => vec![View::Free { eye, target }],
        _ => args.view.clone(),
    };
    let default_size = if views == [View::Head] { [720, 720] } else { [1280, 720] };
    let [width, height] = args.size.unwrap_or(default_size);
    let still = kind == Kind::Still;
    Picture {
        width,
        height,
        samples: args.samples.map_or(if still { 3 } else { 1 }, usize::from),
        soft_shadows: still,
        views,
        fov: args.fov.to_radians(),
    }
}

fn options(args: &RenderArgs, kind: Kind, output: Output, stride: u64) -> RenderOptions {
    let cores = std::thread::available_parallelism().unwrap_or(NonZeroUsize::MIN);
    RenderOptions {
        bags: args.bags.clone(),
        output,
        force: args.force,
        picture: picture(args, kind),
        span: Span { from_s: args.from, to_s: args.to, stride },
        at_s: args.at,
        fps: args.fps,
        speed: args.speed,
        meshes: args.meshes.clone(),
        workers: if kind == Kind::Still { NonZeroUsize::MIN } else { workers(args).unwrap_or(cores) },
    }
}

fn workers(args: &RenderArgs) -> Option<NonZeroUsize> {
    args.workers.and_then(|workers| NonZeroUsize::new(workers.into()))
}

/// Says what came of it.
fn tell(clip: &Clip, outcome: &Outcome, seconds: f64) -> std::io::Result<ExitCode> {
    let (frames, all) = (outcome.frames, clip.frames());
    for lost in &outcome.lost {
        fiatlux_cli::report(format!("lost: {lost}"));
    }
    if outcome.stopped {
        fiatlux_cli::report(format!("stopped: the clip has {frames} of {all} frames"));
    }
    let noun = if frames == 1 { "frame" } else { "frames" };
    fiatlux_cli::report(format!(
        "{frames} {noun} in {seconds:.1} s, {:.1} frames/s",
        frames as f64 / seconds.max(1e-3)
    ));
    fiatlux_cli::print(format!("{}\n", clip.path().display()))?;
    let whole = outcome.lost.is_empty() && !outcome.stopped;
    Ok(if whole { ExitCode::SUCCESS } else { ExitCode::from(3) })
}
