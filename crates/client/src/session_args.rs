//! Command-line flags for the session to open.

use std::path::{Path, PathBuf};

use clap::{Args, ValueEnum};
use fiatlux_cli::whole;
use fiatlux_proto::v3::{OpenRequest, PropScale, Range, Sensor};
use fiatlux_robot::Robot;
use fiatlux_rules::{NamedRange, PRESETS, preset};

/// Flags that describe a session. Each flag that is given overrides the request's own value.
#[derive(Debug, Clone, Default, Args)]
#[command(next_help_heading = "Session")]
pub struct SessionArgs {
    /// Set of gains for the joints' drives: fiatlux, sonic, gear or gear-lerobot
    #[arg(long, value_name = "NAME")]
    gains: Option<String>,
    /// Robot, by its name or that of its hands, such as bare for g1_bare, whose fingers are welded [default: the benchmark's]
    #[arg(long, value_name = "NAME", visible_alias = "hands", value_parser = robot)]
    robot: Option<String>,
    /// Sensors, such as proprioception,lidar@10,camera@look: with a rate in Hz, or only when the policy looks; by
    /// default in every observation. proprioception, hand_contact, limb_contact, last_action, lidar (lidar+room also
    /// sees bench, crate and walls), camera, chest_camera, features, flat, privileged, verdict, or another one that the
    /// server has
    #[arg(long, value_name = "LIST", value_delimiter = ',', value_parser = sensor)]
    sensors: Vec<Sensor>,
    /// Large sensors to record in the bag, such as camera,lidar@5, with a rate in Hz [default rate: 10]
    #[arg(long, value_name = "LIST", value_delimiter = ',', value_parser = sensor)]
    record: Vec<Sensor>,
    /// Size of the head camera's image, pixels [default: 256x256]
    #[arg(long, value_name = "WxH", value_parser = size)]
    image: Option<[u32; 2]>,
    /// Weights for the camera's features: a safetensors file in the server's folder of weights [default: seeded
    /// weights]
    #[arg(long, value_name = "FILE")]
    weights: Option<String>,
    /// Time from the arrival of an action to its effect, ms: 0, 20, ... 100, to test how a policy tolerates latency
    /// [default: 0]
    #[arg(long, value_name = "MS", value_parser = whole::<u32>(0..=100))]
    action_delay: Option<u32>,
    /// In real time: how long a whole-body command stays in force without a new action, ms; then the robot stands
    /// [default: 500]
    #[arg(long, value_name = "MS", value_parser = whole::<u32>(20..=10_000))]
    command_timeout: Option<u32>,
    /// Rulebook by which episodes end: strict, whose bags have both verdicts, or published [default: strict]
    #[arg(long, value_name = "NAME")]
    protocol: Option<String>,
    /// Reward to record: benchmark or training
    #[arg(long, value_name = "NAME")]
    reward: Option<String>,
    /// Quantities to keep fixed, such as start,noise
    #[arg(long, value_name = "LIST", value_delimiter = ',')]
    fix: Vec<Fixed>,
    /// Sizes of props: random, or factors such as ladder_z=1.05,socket=0.95 (ladder_x, ladder_y, ladder_z, socket,
    /// fresh_bulb). In one random draw of seven the fresh bulb is too large for its socket
    #[arg(long, value_name = "SIZES", value_parser = sizes)]
    prop_scale: Option<Sizes>,
    /// Ranges from which each episode draws what the benchmark holds constant, such as
    /// gravity=9.6..10,noise=0.5..2,friction.floor=0.5..1.1: gravity (m/s^2), noise (factor), action_delay (ms), floor_friction (floor
    /// and soles), hand_friction, friction.SURFACE, robot_mass, gains, thing_mass.THING (factors); of pictures camera.x, .y, .z (m),
    /// .roll, .pitch, .yaw (rad), .angle (factor), .exposure (powers of two), .noise (levels), .blur (pixels), .delay (ms), .colours
    /// (share), .pattern (1 to 8), .look (1, or 2 for people's); or real for those of a real robot, which later ones override: real,noise=1
    #[arg(long = "range", value_name = "NAME=LEAST..MOST", value_delimiter = ',', value_parser = range)]
    ranges: Vec<Given>,
    /// Override a threshold, such as fragility_n=30; may be repeated
    #[arg(long, value_name = "NAME=VALUE", value_parser = assignment)]
    set: Vec<(String, f64)>,
    /// Conditions that end an episode in place of the task's own, such as fall,time-out
    #[arg(long, value_name = "CAUSES", value_delimiter = ',')]
    end_on: Vec<String>,
}

/// Quantities that can be kept fixed.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
enum Fixed {
    /// The room of seed 0, whatever the seed
    Layout,
    /// The start state without noise
    Start,
    /// The hands' nominal friction
    HandFriction,
    /// The nominal dome and key light
    Light,
    /// The room's nominal colours
    Tint,
    /// Exact sensors, without noise
    Noise,
    /// Everything but the layout: every episode of a seed is the same
    Episodes,
}

#[derive(Debug, Clone, Copy, PartialEq)]
enum Sizes {
    Random,
    Factors(PropScale),
}

/// A range, or several under one name.
#[derive(Debug, Clone)]
enum Given {
    Range(String, Range),
    Preset(&'static [NamedRange]),
}

impl SessionArgs {
    /// Name of the robot; empty for the benchmark's.
    pub fn robot(&self) -> &str {
        self.robot.as_deref().unwrap_or_default()
    }

    /// Writes the given flags into a request.
    pub fn apply(&self, request: &mut OpenRequest) {
        let set = |field: &mut String, given: &Option<String>| {
            if let Some(given) = given {
                field.clone_from(given);
            }
        };
        set(&mut request.gains, &self.gains);
        set(&mut request.robot, &self.robot);
        set(&mut request.weights, &self.weights);
        set(&mut request.reward, &self.reward);
        set(&mut request.episode_protocol, &self.protocol);
        request.action_delay_ms = self.action_delay.unwrap_or(request.action_delay_ms);
        request.command_timeout_ms = self.command_timeout.unwrap_or(request.command_timeout_ms);
        if !self.sensors.is_empty() {
            request.sensors.clone_from(&self.sensors);
        }
        for record in &self.record {
            let found = request.sensors.iter().position(|sensor| sensor.name == record.name);
            if found.is_some_and(|index| record.see_room && !request.sensors[index].see_room) {
                tracing::warn!(
                    "--record {0}+room: the policy has {0}, which is recorded as the policy has it",
                    record.name
                );
            }
            let index = found.unwrap_or_else(|| {
                let see_room = record.see_room;
                request.sensors.push(Sensor { bag_only: true, see_room, ..Sensor::from(record.name.as_str()) });
                request.sensors.len() - 1
            });
            (request.sensors[index].recorded, request.sensors[index].record_hz) = (true, record.rate_hz);
        }
        if let Some([width, height]) = self.image {
            (request.image_width, request.image_height) = (width, height);
        }
        if !self.fix.is_empty() {
            let fixed = request.randomization.get_or_insert_default();
            let has = |what: Fixed| {
                self.fix.contains(&what) || (what != Fixed::Layout && self.fix.contains(&Fixed::Episodes))
            };
            fixed.fixed_layout |= has(Fixed::Layout);
            fixed.fixed_start |= has(Fixed::Start);
            fixed.fixed_hand_friction |= has(Fixed::HandFriction);
            fixed.fixed_light |= has(Fixed::Light);
            fixed.fixed_tint |= has(Fixed::Tint);
            fixed.exact_sensors |= has(Fixed::Noise);
        }
        match self.prop_scale {
            None => {}
            Some(Sizes::Random) => request.randomization.get_or_insert_default().prop_scale = true,
            Some(Sizes::Factors(factors)) => request.prop_scale = Some(factors),
        }
        for given in &self.ranges {
            match given {
                Given::Range(name, range) => {
                    request.ranges.insert(name.clone(), *range);
                }
                Given::Preset(ranges) => {
                    request
                        .ranges
                        .extend(ranges.iter().map(|&(name, [least, most])| (name.to_owned(), Range { least, most })));
                }
            }
        }
        request.thresholds.extend(self.set.iter().cloned());
        if !self.end_on.is_empty() {
            request.end_on.clone_from(&self.end_on);
        }
    }

    /// Records a large sensor at the default rate, unless the user named some.
    #[must_use]
    pub fn recording(mut self, sensor: &str) -> Self {
        if self.record.is_empty() {
            self.record.push(sensor.into());
        }
        self
    }

    /// Reduces the path of the weights to a name in a folder, and returns the folder, for a server in the same process.
    pub fn split_weights(&mut self) -> Option<PathBuf> {
        let path = PathBuf::from(self.weights.as_ref()?);
        self.weights = Some(path.file_name()?.to_string_lossy().into_owned());
        Some(path.parent().map_or_else(PathBuf::new, Path::to_owned))
    }
}

fn sensor(text: &str) -> Result<Sensor, String> {
    let (name, rate) = text.split_once('@').map_or((text, None), |(name, rate)| (name, Some(rate)));
    let (name, see_room) = name.strip_suffix("+room").map_or((name, false), |name| (name, true));
    let mut sensor = Sensor { see_room, ..Sensor::from(name.trim()) };
    match rate {
        None => {}
        Some("look") => sensor.on_request = true,
        Some(rate) => {
            let wrong = || format!("'{rate}' is not a rate; write NAME@HZ, such as camera@10, or NAME@look");
            sensor.rate_hz = rate.parse().ok().filter(|hz: &f64| hz.is_finite() && *hz > 0.0).ok_or_else(wrong)?;
        }
    }
    Ok(sensor)
}

/// The robot's own name. One that this version lacks, the server may know.
fn robot(text: &str) -> Result<String, String> {
    Ok(Robot::known(text).unwrap_or(text).into())
}

fn size(text: &str) -> Result<[u32; 2], String> {
    let sides = text.split_once('x').and_then(|(w, h)| Some([w.parse().ok()?, h.parse().ok()?]));
    sides.ok_or_else(|| format!("'{text}' is not a size; write WIDTHxHEIGHT, such as 256x256"))
}

fn sizes(text: &str) -> Result<Sizes, String> {
    if text == "random" {
        return Ok(Sizes::Random);
    }
    let mut factors = PropScale::default();
    for part in text.split(',') {
        let (name, value) = assignment(part)?;
        let factor = match name.as_str() {
            "ladder_x" => &mut factors.ladder_x,
            "ladder_y" => &mut factors.ladder_y,
            "ladder_z" => &mut factors.ladder_z,
            "socket" => &mut factors.socket,
            "fresh_bulb" => &mut factors.fresh_bulb,
            _ => return Err(format!("'{name}' has no size; use ladder_x, ladder_y, ladder_z, socket or fresh_bulb")),
        };
        if value <= 0.0 {
            return Err(format!("{name} is {value}; use a factor above 0"));
        }
        *factor = value;
    }
    Ok(Sizes::Factors(factors))
}

fn range(text: &str) -> Result<Given, String> {
    if let Some(ranges) = preset(text) {
        return Ok(Given::Preset(ranges));
    }
    let presets = PRESETS.map(|(name, _)| name).join(", ");
    let wrong = || format!("'{text}' is not a range; write NAME=LEAST..MOST, such as gravity=9.6..10, or {presets}");
    let (name, range) = text.split_once('=').filter(|(name, _)| !name.is_empty()).ok_or_else(wrong)?;
    let (least, most) = range.split_once("..").unwrap_or((range, range));
    let number = |text: &str| text.parse().ok().filter(|number: &f64| number.is_finite()).ok_or_else(wrong);
    Ok(Given::Range(name.into(), Range { least: number(least)?, most: number(most)? }))
}

fn assignment(text: &str) -> Result<(String, f64), String> {
    let (name, value) = text.split_once('=').ok_or("write NAME=VALUE, such as fragility_n=30")?;
    let value: f64 = value.parse().map_err(|_| format!("'{value}' is not a number"))?;
    if name.is_empty() || !value.is_finite() {
        return Err("write NAME=VALUE with a finite number, such as fragility_n=30".into());
    }
    Ok((name.into(), value))
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use clap::Parser;

    use super::*;

    #[derive(Debug, Parser)]
    struct Cli {
        #[command(flatten)]
        session: SessionArgs,
    }

    fn applied(flags: &str, mut request: OpenRequest) -> OpenRequest {
        let cli = Cli::try_parse_from(std::iter::once("x").chain(flags.split_whitespace())).unwrap();
        cli.session.apply(&mut request);
        request
    }

    #[test]
    fn without_flags_nothing_changes() {
        let request = OpenRequest { gains: "sonic".into(), sensors: vec!["lidar".into()], ..OpenRequest::default() };
        assert_eq!(applied("", request.clone()), request);
    }

    #[test]
    fn flags_go_first() {
        let flags = "--sensors lidar+room@12.5,camera@look --record camera@5,features --image 64x32 --fix start,noise \
                     --prop-scale ladder_z=1.05,socket=0.95 --set fragility_n=30 --gains sonic \
                     --range gravity=9.6..10,friction.floor=0.5 --range noise=0.5..2";
        let request =
            applied(&flags.replace('\\', ""), OpenRequest { reward: "training".into(), ..OpenRequest::default() });
        let [lidar, camera, features] = request.sensors.as_slice() else { panic!("{:?}", request.sensors) };
        assert_eq!((lidar.rate_hz, lidar.on_request, lidar.recorded), (12.5, false, false));
        assert_eq!((lidar.name.as_str(), lidar.see_room, camera.see_room), ("lidar", true, false));
        assert_eq!((camera.on_request, camera.recorded, camera.record_hz), (true, true, 5.0));
        assert_eq!((features.bag_only, features.recorded, features.record_hz), (true, true, 0.0));
        assert_eq!((request.image_width, request.image_height), (64, 32));
        let random = request.randomization.unwrap();
        assert!(random.fixed_start && random.exact_sensors && !random.fixed_light && !random.fixed_layout);
        assert_eq!(request.prop_scale.map(|scale| (scale.ladder_z, scale.socket)), Some((1.05, 0.95)));
        let ranges: Vec<_> = request.ranges.iter().map(|(name, range)| (&**name, range.least, range.most)).collect();
        assert_eq!(ranges, [("friction.floor", 0.5, 0.5), ("gravity", 9.6, 10.0), ("noise", 0.5, 2.0)]);
        assert_eq!((request.gains.as_str(), request.reward.as_str()), ("sonic", "training"));
    }

    /// Demonstrations see the room, although the policy that gives them has no LiDAR.
    #[test]
    fn what_is_recorded_alone_sees_the_room_if_asked() {
        let request = applied("--record lidar+room@10,chest_camera", OpenRequest::default());
        let [lidar, camera] = request.sensors.as_slice() else { panic!("{:?}", request.sensors) };
        assert_eq!((lidar.bag_only, lidar.see_room, lidar.record_hz), (true, true, 10.0));
        assert_eq!((camera.bag_only, camera.see_room), (true, false));
    }

    /// A preset stands for its ranges; what is given after it overrides them.
    #[test]
    fn a_preset_is_many_ranges() {
        let request = applied("--range real,noise=1,gravity=9.6..10", OpenRequest::default());
        let of = |name: &str| request.ranges.get(name).map(|range| [range.least, range.most]);
        assert_eq!((of("hand_friction"), of("friction.ladder")), (Some([0.4, 0.8]), Some([0.5, 0.8])));
        assert_eq!((of("noise"), of("gravity")), (Some([1.0, 1.0]), Some([9.6, 10.0])));
        assert_eq!(request.ranges.len(), preset("real").unwrap().len() + 1);
    }

    #[test]
    fn a_robot_is_named_by_itself_or_its_hands() {
        for (flags, expected) in
            [("--hands bare", "g1_bare"), ("--robot g1_bare", "g1_bare"), ("--robot h1", "h1"), ("", "")]
        {
            assert_eq!(applied(flags, OpenRequest::default()).robot, expected, "{flags}");
        }
    }

    #[test]
    fn fixed_episodes_leave_the_layout() {
        let random = applied("--fix episodes --prop-scale random", OpenRequest::default()).randomization.unwrap();
        let fixed = [
            random.fixed_start,
            random.fixed_hand_friction,
            random.fixed_light,
            random.fixed_tint,
            random.exact_sensors,
        ];
        assert_eq!((fixed, random.fixed_layout, random.prop_scale), ([true; 5], false, true));
    }

    #[test]
    fn weights_are_a_file_in_a_folder() {
        let mut session = SessionArgs { weights: Some("a/b/c.safetensors".into()), ..SessionArgs::default() };
        assert_eq!(session.split_weights(), Some("a/b".into()));
        assert_eq!(session.weights.as_deref(), Some("c.safetensors"));
        assert_eq!(SessionArgs::default().split_weights(), None);
    }

    #[test]
    fn wrong_flags_are_refused() {
        for flags in [
            "--sensors lidar@fast",
            "--sensors lidar@-1",
            "--image 64",
            "--image ax2",
            "--prop-scale crate=1",
            "--prop-scale ladder_z=big",
            "--prop-scale socket=0",
            "--set fragility_n",
            "--fix wind",
            "--range gravity",
            "--range gravity=9.6..",
            "--range gravity=inf",
            "--range =1..2",
            "--range ideal",
        ] {
            assert!(Cli::try_parse_from(std::iter::once("x").chain(flags.split(' '))).is_err(), "{flags}");
        }
    }
}
