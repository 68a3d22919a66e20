//! Observations by their fields, whatever sensors there are: what a client needs to handle a sensor that it was not
//! written for.

use std::collections::BTreeMap;

use prost::Message;
use prost::encoding::{WireType, decode_key, decode_varint};
use prost_types::field_descriptor_proto::Type;
use thiserror::Error;

use crate::decode::{Field, messages};
use crate::v3::{Observation, ObservationTerm, SessionInfo};

const OBSERVATION: &str = "fiatlux.v3.Observation";
/// Messages of a picture: a width, a height and a number of values a pixel.
const PICTURES: [&str; 3] = ["fiatlux.v3.Image", "fiatlux.v3.DepthImage", "fiatlux.v3.LabelImage"];
/// Fields of an observation that no sensor fills.
const NO_SENSORS: [&str; 3] = ["episode", "step", "end"];
/// Messages made of a camera's image.
const MADE_OF_IMAGES: [&str; 5] =
    [PICTURES[0], PICTURES[1], PICTURES[2], "fiatlux.v3.Features", "fiatlux.v3.FlatObservation"];

/// Why an observation, or a session's description of its own, was refused.
#[derive(Debug, Clone, PartialEq, Eq, Error)]
#[allow(missing_docs)] // The messages say it.
pub enum TermError {
    #[error(
        "sensor '{sensor}' fills field '{field}', which this client does not know; use one of the server's version"
    )]
    UnknownField { sensor: String, field: String },
    #[error("{field} is not a term of the session; ask for its sensor, or use a client of the server's version")]
    NoTerm { field: String },
    #[error("{field} has {found} numbers, not {expected}")]
    Count { field: String, found: usize, expected: usize },
    #[error("{field} is {} x {}, not {} x {} pixels", found[0], found[1], expected[0], expected[1])]
    Image { field: String, found: [u64; 2], expected: [u64; 2] },
}

impl ObservationTerm {
    /// Count of numbers in it.
    pub fn length(&self) -> usize {
        self.shape.iter().fold(1, |length, extent| length.saturating_mul(*extent as usize))
    }
}

impl SessionInfo {
    /// The terms of one sensor, in their order.
    pub fn terms_of<'a>(&'a self, sensor: &'a str) -> impl Iterator<Item = &'a ObservationTerm> {
        self.terms.iter().filter(move |term| term.sensor == sensor)
    }
}

/// Fields of a session's observations, as the server described them.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct ObservationLayout {
    counts: BTreeMap<String, usize>,
    /// Width and height by the field of the image.
    images: BTreeMap<String, [u64; 2]>,
}

impl ObservationLayout {
    /// Of a session.
    ///
    /// # Errors
    /// [`TermError`]: a sensor of the session fills a field that these messages do not have.
    pub fn new(info: &SessionInfo) -> Result<Self, TermError> {
        let mut layout = Self::default();
        for term in &info.terms {
            let unknown = || TermError::UnknownField { sensor: term.sensor.clone(), field: term.field.clone() };
            find(&term.field).ok_or_else(unknown)?;
            *layout.counts.entry(term.field.clone()).or_default() += term.length();
            if let (Some((image, _)), [height, width, ..]) = (term.field.rsplit_once('.'), term.shape.as_slice())
                && find(image).is_some_and(Field::is_picture)
            {
                layout.images.insert(image.into(), [u64::from(*width), u64::from(*height)]);
            }
        }
        Ok(layout)
    }

    /// Refuses an observation in which a sensor's part is not as described. A sensor that is not due has none.
    ///
    /// # Errors
    /// [`TermError`] with the field.
    pub fn check(&self, observation: &Observation) -> Result<(), TermError> {
        let bytes = observation.encode_to_vec();
        let mut found: BTreeMap<&str, usize> = BTreeMap::new();
        let mut images: BTreeMap<&str, [u64; 2]> = BTreeMap::new();
        let parts = parts(&bytes);
        for part in &parts {
            match (part.field.kind, part.path.rsplit_once('.')) {
                // Words that go with the numbers, such as the label of weights.
                (Type::String, Some(_)) => {}
                (Type::Message, None) if !self.counts.keys().any(|field| within(field, &part.path)) => {
                    return Err(TermError::NoTerm { field: part.path.clone() });
                }
                (Type::Message, _) => {
                    if part.field.is_picture() {
                        images.entry(&part.path).or_default();
                    }
                }
                (_, Some((image, side))) if images.contains_key(image) && matches!(side, "width" | "height") => {
                    let sides = images.entry(image).or_default();
                    sides[usize::from(side == "height")] = part.value();
                }
                _ => *found.entry(&part.path).or_default() += part.count(),
            }
        }
        for (image, sides) in images {
            if let Some(expected) = self.images.get(image).filter(|expected| **expected != sides) {
                return Err(TermError::Image { field: image.into(), found: sides, expected: *expected });
            }
        }
        if let Some((field, _)) = found.iter().find(|(field, _)| !self.counts.contains_key(**field)) {
            return Err(TermError::NoTerm { field: (*field).into() });
        }
        for (field, expected) in &self.counts {
            let is_here = parts.iter().any(|part| within(field, &part.path) || *field == part.path);
            let count = found.get(field.as_str()).copied().unwrap_or_default();
            // A single number that is zero is not sent.
            if is_here && count != *expected && !(count == 0 && is_single(field)) {
                return Err(TermError::Count { field: field.clone(), found: count, expected: *expected });
            }
        }
        Ok(())
    }
}

impl Observation {
    /// Takes over what another one has of its sensors, in place of what is here of the same ones.
    pub fn overlay(&mut self, seen: &Observation) {
        let (base, over) = (self.encode_to_vec(), seen.encode_to_vec());
        let taken: Vec<u32> = Fields(&over).map(|field| field.number).collect();
        let kept = Fields(&base).filter(|field| !taken.contains(&field.number));
        let both = kept.flat_map(|field| field.whole.iter().copied()).chain(over.iter().copied()).collect::<Vec<u8>>();
        // Whole fields of two observations are an observation.
        if let Ok(both) = Observation::decode(both.as_slice()) {
            *self = both;
        }
    }

    /// The observation as a session of these sensors alone has it. `terms` are those of the session that it comes from.
    #[must_use]
    pub fn of_sensors(&self, terms: &[ObservationTerm], sensors: impl Fn(&str) -> bool) -> Self {
        let kept = terms.iter().filter(|term| sensors(&term.sensor)).map(|term| term.field.as_str());
        let kept = kept.map(|path| path.split_once('.').map_or(path, |(field, _)| field)).chain(NO_SENSORS);
        let kept: Vec<u32> = kept.filter_map(number_of).collect();
        let bytes = self.encode_to_vec();
        let shown = Fields(&bytes).filter(|field| kept.contains(&field.number));
        let shown: Vec<u8> = shown.flat_map(|field| field.whole.iter().copied()).collect();
        // Whole fields of an observation are an observation.
        Observation::decode(shown.as_slice()).unwrap_or_default()
    }

    /// The fields that sensors have filled, with their sizes in a message, bytes.
    pub fn sizes(&self) -> BTreeMap<&'static str, usize> {
        let (bytes, mut sizes) = (self.encode_to_vec(), BTreeMap::new());
        let known = messages().get(OBSERVATION);
        for raw in Fields(&bytes) {
            if let Some(field) = known.and_then(|fields| fields.get(&raw.number)) {
                *sizes.entry(field.name.as_str()).or_default() += raw.whole.len();
            }
        }
        sizes.retain(|name, _| !NO_SENSORS.contains(name));
        sizes
    }

    /// The numbers of a field by its path, as [`ObservationTerm`] has it; none where the observation lacks it.
    pub fn numbers(&self, field: &str) -> Vec<f64> {
        let bytes = self.encode_to_vec();
        parts(&bytes).iter().filter(|part| part.path == field).flat_map(Part::numbers).collect()
    }
}

/// True if a sensor of that name shows a camera's image, or data made of one.
pub fn is_of_images(sensor: &str) -> bool {
    find(sensor).and_then(|field| field.message.as_deref()).is_some_and(|made| MADE_OF_IMAGES.contains(&made))
}

fn find(path: &str) -> Option<&'static Field> {
    let (mut message, mut found) = (OBSERVATION, None);
    for name in path.split('.') {
        let field = messages().get(message)?.values().find(|field| field.name == name)?;
        message = field.message.as_deref().unwrap_or_default();
        found = Some(field);
    }
    found
}

/// Number of a field of an observation.
fn number_of(name: &str) -> Option<u32> {
    messages().get(OBSERVATION)?.iter().find(|(_, field)| field.name == name).map(|(number, _)| *number)
}

impl Field {
    fn is_picture(&self) -> bool {
        self.message.as_deref().is_some_and(|message| PICTURES.contains(&message))
    }
}

fn is_single(path: &str) -> bool {
    find(path).is_some_and(|field| !field.is_repeated && field.kind != Type::Bytes)
}

/// True if a field is within the message at that path.
fn within(field: &str, path: &str) -> bool {
    field.strip_prefix(path).is_some_and(|rest| rest.starts_with('.'))
}

/// A field that an observation has, and what it holds.
struct Part<'a> {
    path: String,
    field: &'static Field,
    contents: &'a [u8],
}

impl Part<'_> {
    fn count(&self) -> usize {
        match self.field.kind {
            Type::Float => self.contents.len() / 4,
            Type::Double => self.contents.len() / 8,
            Type::Bytes => self.contents.len(),
            // The last byte of a whole number has its first bit clear.
            _ => self.contents.iter().filter(|byte| **byte < 0x80).count(),
        }
    }

    fn numbers(&self) -> Vec<f64> {
        match self.field.kind {
            Type::Float => {
                self.contents.as_chunks().0.iter().map(|bytes| f64::from(f32::from_le_bytes(*bytes))).collect()
            }
            Type::Double => self.contents.as_chunks().0.iter().map(|bytes| f64::from_le_bytes(*bytes)).collect(),
            Type::Bytes => self.contents.iter().map(|byte| f64::from(*byte)).collect(),
            Type::String | Type::Message => Vec::new(),
            _ => {
                let mut rest = self.contents;
                std::iter::from_fn(|| decode_varint(&mut rest).ok()).map(|value| value as f64).collect()
            }
        }
    }

    fn value(&self) -> u64 {
        decode_varint(&mut &*self.contents).unwrap_or_default()
    }
}

/// All fields of an observation that sensors have filled, each message before what is in it.
fn parts(observation: &[u8]) -> Vec<Part<'_>> {
    let mut all = Vec::new();
    add_parts(observation, OBSERVATION, "", &mut all);
    all.retain(|part| !NO_SENSORS.iter().any(|name| part.path == *name || within(&part.path, name)));
    all
}

fn add_parts<'a>(bytes: &'a [u8], message: &str, prefix: &str, all: &mut Vec<Part<'a>>) {
    let Some(fields) = messages().get(message) else { return };
    for raw in Fields(bytes) {
        // Unknown fields were refused when the message was decoded.
        let Some(field) = fields.get(&raw.number) else { continue };
        let path = format!("{prefix}{}", field.name);
        let inner = field.message.as_deref().map(|inner| (inner, format!("{path}.")));
        all.push(Part { path, field, contents: raw.contents });
        if let Some((inner, prefix)) = inner {
            add_parts(raw.contents, inner, &prefix, all);
        }
    }
}

/// The fields of an encoded message, one after another.
struct Fields<'a>(&'a [u8]);

struct RawField<'a> {
    number: u32,
    /// The bytes with key and length.
    whole: &'a [u8],
    /// Without key and length.
    contents: &'a [u8],
}

impl<'a> Iterator for Fields<'a> {
    type Item = RawField<'a>;

    fn next(&mut self) -> Option<RawField<'a>> {
        let start = self.0;
        let (number, wire_type) = decode_key(&mut self.0).ok()?;
        let length = match wire_type {
            WireType::LengthDelimited => usize::try_from(decode_varint(&mut self.0).ok()?).ok()?,
            WireType::Varint => self.0.iter().position(|byte| *byte < 0x80)? + 1,
            WireType::SixtyFourBit => 8,
            WireType::ThirtyTwoBit => 4,
            WireType::StartGroup | WireType::EndGroup => return None,
        };
        let (contents, rest) = self.0.split_at_checked(length)?;
        self.0 = rest;
        Some(RawField { number, whole: &start[..start.len() - rest.len()], contents })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::v3::{Image, Proprioception, Verdict};

    fn info(terms: &[(&str, &str, &[u32])]) -> SessionInfo {
        let term = |(sensor, field, shape): &(&str, &str, &[u32])| ObservationTerm {
            sensor: (*sensor).into(),
            field: (*field).into(),
            shape: (*shape).into(),
            ..ObservationTerm::default()
        };
        SessionInfo { terms: terms.iter().map(term).collect(), ..SessionInfo::default() }
    }

    fn seen() -> Observation {
        Observation {
            step: 7,
            lidar: vec![1.0, 2.5],
            camera: Some(Image { width: 2, height: 1, rgb: vec![9; 6] }),
            verdict: Some(Verdict { criteria: vec![true, false], gate_progress: 0.5, reward: 0.0 }),
            ..Observation::default()
        }
    }

    #[test]
    fn what_was_looked_at_takes_the_place_of_what_was_there() {
        let mut observation = Observation { lidar: vec![5.0; 4], last_action: vec![1.0], ..seen() };
        observation.overlay(&Observation { step: 7, lidar: vec![3.0], ..Observation::default() });
        assert_eq!(observation, Observation { lidar: vec![3.0], last_action: vec![1.0], ..seen() });
    }

    /// Guards that nobody is shown a sensor that another one asked for.
    #[test]
    fn an_observation_of_fewer_sensors_has_those_alone() {
        let info =
            info(&[("lidar", "lidar", &[2]), ("camera", "camera.rgb", &[1, 2, 3]), ("verdict", "verdict.reward", &[])]);
        let of = |sensors: &[&str]| seen().of_sensors(&info.terms, |name| sensors.contains(&name));
        assert_eq!(of(&["camera"]), Observation { lidar: Vec::new(), verdict: None, ..seen() });
        assert_eq!(of(&["lidar", "verdict", "camera"]), seen());
        assert_eq!(of(&[]), Observation { step: 7, ..Observation::default() });
    }

    #[test]
    fn numbers_are_read_by_their_path() {
        assert_eq!(seen().numbers("lidar"), [1.0, 2.5]);
        assert_eq!(seen().numbers("camera.rgb"), [9.0; 6]);
        assert_eq!(seen().numbers("verdict.criteria"), [1.0, 0.0]);
        assert_eq!(seen().numbers("verdict.gate_progress"), [0.5]);
        assert!(seen().numbers("features.values").is_empty() && seen().numbers("smell").is_empty());
        // Keys, lengths and the sides of the image; `step` belongs to no sensor.
        assert_eq!(seen().sizes(), BTreeMap::from([("camera", 14), ("lidar", 10), ("verdict", 15)]));
        assert!(is_of_images("camera") && is_of_images("flat") && !is_of_images("lidar") && !is_of_images("smell"));
    }

    /// Each refusal names the field.
    #[test]
    fn parts_that_are_not_as_described_are_refused() {
        let verdict: [(&str, &str, &[u32]); 3] = [
            ("verdict", "verdict.criteria", &[2]),
            ("verdict", "verdict.gate_progress", &[]),
            ("verdict", "verdict.reward", &[]),
        ];
        let all = [("lidar", "lidar", &[2][..]), ("camera", "camera.rgb", &[1, 2, 3])].into_iter().chain(verdict);
        let layout = ObservationLayout::new(&info(&all.collect::<Vec<_>>())).expect("known fields");
        assert_eq!(layout.check(&seen()), Ok(()));
        assert_eq!(layout.check(&Observation::default()), Ok(()), "nothing is due");
        let own = Some(Proprioception { joint_position: vec![0.0], ..Proprioception::default() });
        let bare = Some(Verdict { reward: 1.0, ..Verdict::default() });
        let wide = Some(Image { width: 6, height: 1, rgb: vec![9; 6] });
        let short = Some(Image { width: 2, height: 1, rgb: vec![9; 5] });
        let cases = [
            (Observation { lidar: vec![1.0], ..seen() }, "lidar has 1 numbers, not 2"),
            (Observation { last_action: vec![1.0], ..seen() }, "last_action is not a term of the session"),
            (Observation { proprioception: own, ..seen() }, "proprioception is not a term of the session"),
            (Observation { verdict: bare, ..seen() }, "verdict.criteria has 0 numbers, not 2"),
            (Observation { camera: wide, ..seen() }, "camera is 6 x 1, not 2 x 1 pixels"),
            (Observation { camera: short, ..seen() }, "camera.rgb has 5 numbers, not 6"),
        ];
        for (observation, message) in cases {
            let error = layout.check(&observation).expect_err(message).to_string();
            assert!(error.contains(message), "{error}");
        }
        let error = ObservationLayout::new(&info(&[("nose", "smell", &[3])])).expect_err("unknown").to_string();
        assert!(error.contains("sensor 'nose' fills field 'smell'"), "{error}");
    }
}
