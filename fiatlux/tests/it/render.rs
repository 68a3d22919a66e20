//! Clips of made-up episodes: through the program where its words and exit codes matter, through the library elsewhere.

use fiatlux_rules::errand;
use std::fs;
use std::num::NonZeroUsize;
use std::os::unix::fs::PermissionsExt;
use std::path::{Path, PathBuf};
use std::process::{Command, Output as Done};
use std::sync::atomic::{AtomicBool, Ordering};

use crate::common::{bag, begin, check, folder, header, rows, text, write};
use fiatlux::render::{Clip, Output, Picture, RenderError, RenderOptions, Span, View};
use fiatlux_proto::v3::EpisodeHeader;

const SIZE: [usize; 2] = [96, 54];

/// Runs `fiatlux render` with small pictures and no program in `PATH`.
fn render(args: &[&str]) -> Done {
    let mut command = Command::new(env!("CARGO_BIN_EXE_fiatlux"));
    command.arg("render").args(["--samples", "1"]);
    if !args.contains(&"--size") {
        command.args(["--size", "96x54"]);
    }
    command.args(args).env("PATH", "").output().unwrap()
}

fn names(folder: &Path) -> Vec<String> {
    let name = |entry: std::io::Result<fs::DirEntry>| entry.unwrap().file_name().into_string().unwrap();
    let mut names: Vec<String> = fs::read_dir(folder).unwrap().map(name).collect();
    names.sort();
    names
}

/// Size and bytes of a PNG file.
fn decode(path: &Path) -> ([usize; 2], Vec<u8>) {
    let file = std::io::BufReader::new(fs::File::open(path).unwrap());
    let mut reader = png::Decoder::new(file).read_info().unwrap();
    let mut bytes = vec![0; reader.output_buffer_size().unwrap()];
    let info = reader.next_frame(&mut bytes).unwrap();
    ([info.width as usize, info.height as usize], bytes)
}

/// A program in place of ffmpeg.
fn script(folder: &Path, body: &str) -> PathBuf {
    let path = folder.join("ffmpeg");
    fs::write(&path, format!("#!/bin/sh\n{body}\n")).unwrap();
    fs::set_permissions(&path, fs::Permissions::from_mode(0o755)).unwrap();
    path
}

/// Keeps the raw frames.
const KEEP: &str = "for last; do :; done; exec /bin/cat > \"${last#file:}\"";

fn options(bag: &Path, output: Output) -> RenderOptions {
    let [width, height] = SIZE;
    RenderOptions {
        bags: vec![bag.into()],
        output,
        force: false,
        picture: Picture {
            width,
            height,
            samples: 2,
            soft_shadows: false,
            views: vec![View::Room, View::Head],
            fov: 0.7,
        },
        span: Span { from_s: None, to_s: None, stride: 1 },
        at_s: None,
        fps: 50,
        speed: 1.0,
        meshes: None,
        workers: NonZeroUsize::MIN,
    }
}

#[test]
fn a_bag_becomes_a_folder_of_pictures() {
    let folder = folder("pictures");
    let (bag, out) = (bag(&folder), folder.join("frames"));
    check(&render(&[text(&bag), "-o", text(&out)]), 0, &["5 frames"]);
    let files = names(&out);
    assert_eq!(files, ["0000.png", "0001.png", "0002.png", "0003.png", "0004.png"]);
    let pictures: Vec<_> = files.iter().map(|file| decode(&out.join(file))).collect();
    for (size, bytes) in &pictures {
        assert_eq!(*size, SIZE);
        // More than a flat colour.
        assert!(bytes.iter().max().unwrap() - bytes.iter().min().unwrap() > 60);
    }
    assert!(pictures.windows(2).all(|pair| pair[0].1 != pair[1].1), "the robot moves");
    assert_eq!(names(&folder), ["S05.mcap", "frames"], "nothing else is left");
}

#[test]
fn without_ffmpeg_a_video_becomes_a_folder() {
    let folder = folder("no_ffmpeg");
    let (bag, out) = (bag(&folder), folder.join("clip.mp4"));
    let frames = folder.join("clip");
    let joins = format!("ffmpeg -framerate 25 -i {}/%04d.png", frames.display());
    let done = render(&[text(&bag), "-o", text(&out), "--to", "0.05"]);
    check(&done, 0, &["ffmpeg is not in PATH", &joins]);
    assert_eq!(names(&frames), ["0000.png", "0001.png"]);
    assert_eq!(String::from_utf8_lossy(&done.stdout).trim(), text(&frames));
}

#[test]
fn what_is_there_is_kept() {
    let folder = folder("kept");
    let bag = bag(&folder);
    let still = folder.join("still.png");
    fs::write(&still, "mine").unwrap();
    check(&render(&[text(&bag), "-o", text(&still)]), 1, &["it exists already", "--force"]);
    assert_eq!(fs::read(&still).unwrap(), b"mine");
    check(&render(&[text(&bag), "-o", text(&still), "--at", "0.1", "--force"]), 0, &[]);
    assert_eq!(decode(&still).0, SIZE);

    let mine = folder.join("mine");
    fs::create_dir(&mine).unwrap();
    check(&render(&[text(&bag), "-o", text(&mine), "--force", "--to", "0.05"]), 0, &[]);
    check(&render(&[text(&bag), "-o", text(&mine), "--force", "--to", "0"]), 0, &[]);
    assert_eq!(names(&mine), ["0000.png"]);
    fs::write(mine.join("notes.txt"), "mine").unwrap();
    check(&render(&[text(&bag), "-o", text(&mine), "--force"]), 1, &["holds other things"]);
    assert_eq!(names(&mine), ["0000.png", "notes.txt"]);
    let below = text(&still).to_owned() + "/clip";
    check(&render(&[text(&bag), "-o", &below]), 1, &["a part of its path is a file"]);
}

#[test]
fn a_missing_folder_is_made() {
    let folder = folder("made");
    let bag = bag(&folder);
    let still = folder.join("not/yet/still.png");
    check(&render(&[text(&bag), "-o", text(&still), "--at", "0.1"]), 0, &[]);
    assert_eq!(decode(&still).0, SIZE);
}

#[test]
fn wrong_options() {
    let folder = folder("usage");
    let bag = bag(&folder);
    let (bag, out) = (text(&bag), folder.join("clip"));
    let out = text(&out);
    let cases: &[(&[&str], &str)] = &[
        (&["-o", out, "--fps", "30"], "use --fps 50, 25, 10, 5, 2, 1"),
        (&["-o", out, "--fps", "60"], "give a whole number from 1 to 50"),
        (&["-o", "clip.gif"], "NAME.mp4 for a video"),
        (&["-o", out, "--size", "1280x721"], "even numbers"),
        (&["-o", out, "--eye", "1,2,3"], "--target"),
        (&["-o", out, "--eye", "1,2,3", "--target", "1,2"], "three numbers"),
        (&["-o", out, "--eye", "1,2,3", "--target", "nan,0,0"], "three numbers"),
        (&["-o", out, "--view", "top"], "there is no view 'top'"),
        (&["-o", out, "--view", "head,head"], "a view twice"),
        (&["-o", out, "--from", "2", "--to", "1"], "--from 2 is after --to 1"),
        (&["-o", out, "--at", "1"], "--at is for a still"),
        (&["-o", "still.png", bag], "a still is of one bag"),
        (&[], "--out"),
    ];
    for (args, words) in cases {
        check(&render(&[&[bag], *args].concat()), 2, &[words]);
    }
    check(&render(&["-o", out]), 2, &["BAG"]);
    assert_eq!(names(&folder), ["S05.mcap"]);
}

#[test]
fn a_time_without_rows() {
    let folder = folder("time");
    let bag = bag(&folder);
    let out = folder.join("still.png");
    for args in [["--from", "7"], ["--at", "0.2"]] {
        let done = render(&[&[text(&bag), "-o", text(&out)], &args[..]].concat());
        check(&done, 1, &["its rows go from 0.00 to 0.16 s"]);
    }
}

/// A bag that ends early, with rows that are not rows: what can be shown is shown, and the rest is reported.
#[test]
fn damaged_bags() {
    let folder = folder("damaged");
    let bag = folder.join("cut.mcap");
    let mut rows = rows(60);
    rows[3].robot.pose.translation.vector.z = f64::NAN;
    rows[4].joint_position[7] = f64::INFINITY;
    rows[5].things[errand::LADDER].pose.rotation.as_mut_unchecked().w = 1e200;
    rows.drain(40..45);
    begin(&bag, &header(), &rows).finish_cut("the disk was full").unwrap();
    let out = folder.join("frames");
    let words = ["3 rows that cannot be drawn", "5 rows missing between others", "the bag is cut (the disk was full)"];
    check(&render(&[text(&bag), "-o", text(&out), "--fps", "5"]), 3, &words);
    assert_eq!(names(&out).len(), 5, "rows 0, 10, 20, 30 and 50");
}

#[test]
fn bags_that_give_no_picture() {
    let folder = folder("none");
    let out = folder.join("out");
    let nan = || {
        let mut rows = rows(2);
        rows.iter_mut().for_each(|row| row.robot.pose.translation.vector.x = f64::NAN);
        rows
    };
    let headers = [
        (EpisodeHeader { task: "S99".into(), ..header() }, rows(2), "S99"),
        (EpisodeHeader { robot: "g2".into(), ..header() }, rows(2), "robot"),
        (EpisodeHeader { gains: "soft".into(), ..header() }, rows(2), "gains"),
        (header(), nan(), "no row that can be drawn"),
    ];
    for (i, (header, rows, words)) in headers.iter().enumerate() {
        let bag = write(&folder.join(format!("{i}.mcap")), header, rows);
        check(&render(&[text(&bag), "-o", text(&out)]), 1, &[words]);
    }
    let other = folder.join("other.mcap");
    fs::write(&other, "no bag").unwrap();
    check(&render(&[text(&other), "-o", text(&out)]), 1, &["is not a bag"]);
    assert!(!out.exists());
}

#[test]
fn a_bag_of_another_robot_or_room_is_shown_with_a_warning() {
    let folder = folder("another");
    let rows = rows(1);
    let header = EpisodeHeader { model_digest: "1".into(), scene_digest: "2".into(), ..header() };
    let bag = write(&folder.join("bag.mcap"), &header, &rows);
    let words = ["warning", "another robot", "another room"];
    check(&render(&[text(&bag), "-o", text(&folder.join("still.png"))]), 0, &words);
}

#[test]
fn threads_change_no_byte_and_no_order() {
    let folder = folder("threads");
    let (bag, ffmpeg) = (bag(&folder), script(&folder, KEEP));
    let frames = |workers: usize| {
        let path = folder.join(format!("{workers}.mp4"));
        let output = Output::Video { path: path.clone(), ffmpeg: ffmpeg.clone() };
        let options = RenderOptions { workers: NonZeroUsize::new(workers).unwrap(), ..options(&bag, output) };
        let clip = Clip::open(options).unwrap();
        let outcome = clip.render(&AtomicBool::new(false), &mut |_| ()).unwrap();
        assert_eq!((outcome.frames, outcome.stopped, outcome.lost), (9, false, vec![]));
        fs::read(path).unwrap()
    };
    let one = frames(1);
    assert_eq!(one.len(), 9 * 3 * SIZE[0] * SIZE[1]);
    assert!(one == frames(4), "four threads");
}

#[test]
fn a_stop_leaves_a_shorter_clip() {
    let folder = folder("stop");
    let (bag, ffmpeg, path) = (bag(&folder), script(&folder, KEEP), folder.join("clip.mp4"));
    let clip = Clip::open(options(&bag, Output::Video { path: path.clone(), ffmpeg })).unwrap();
    let stop = AtomicBool::new(false);
    let outcome = clip.render(&stop, &mut |progress| stop.store(progress.done == 4, Ordering::Relaxed)).unwrap();
    assert_eq!((outcome.frames, outcome.stopped), (4, true));
    assert_eq!(fs::metadata(path).unwrap().len() as usize, 4 * 3 * SIZE[0] * SIZE[1]);
}

#[test]
fn what_ffmpeg_says_is_passed_on() {
    let folder = folder("says");
    let bag = bag(&folder);
    let ffmpeg = script(&folder, "echo one >&2; echo no such codec >&2; exit 3");
    let clip = Clip::open(options(&bag, Output::Video { path: folder.join("clip.mp4"), ffmpeg })).unwrap();
    let error = clip.render(&AtomicBool::new(false), &mut |_| ()).unwrap_err();
    assert!(matches!(error, RenderError::Encoder { .. }));
    let text = error.to_string();
    assert!(text.contains("exit status: 3") && text.ends_with("one\n  no such codec"), "{text}");
    assert_eq!(names(&folder), ["S05.mcap", "ffmpeg"], "nothing is left");
}
