//! Bags as NumPy arrays, topic by topic.

mod values;

use std::collections::BTreeMap;
use std::ops::Range;
use std::sync::Arc;

use fiatlux_bag::{Bag as File, BagError, Completeness, Messages};
use fiatlux_proto::v3::{ContactMeasure, EpisodeHeader};
use fiatlux_proto::{DESCRIPTORS, Message};
use fiatlux_render::Lighting;
use fiatlux_rules::{RobotLayout, UnknownProtocol, manifest};
use fiatlux_sensing::{Sensor, Sensors, Setup, term_messages};
use fiatlux_wire::{light_of, read_row, robot_of, scene_of};
use numpy::{IntoPyArray, PyArray1};
use prost::Name;
use prost_reflect::{DescriptorPool, DynamicMessage, ReflectMessage, Value};
use pyo3::exceptions::{PyFileNotFoundError, PyKeyError, PyValueError};
use pyo3::prelude::*;
use pyo3::types::{PyBytes, PyDict, PyList};

use crate::build;
use crate::fault::{failed, guarded, refused};
use crate::numbers::Numbers;
use crate::painter::Painter;
use values::{dictionary, object};

/// Names of the topics that can be read as columns.
const TOPICS: [&str; 7] = ["/state", "/action", "/observation", "/reward", "/event", "/camera", "/lidar"];

/// Fields, and numbers of all observations.
type Observed<'py> = (Vec<(String, Vec<usize>, f32, f32, bool)>, Bound<'py, PyArray1<f32>>);

/// A bag, whose topics are read on first use.
#[pyclass(module = "fiatlux._native", frozen)]
pub(crate) struct Bag {
    file: File,
    pool: DescriptorPool,
}

#[pymethods]
impl Bag {
    #[new]
    fn open(py: Python<'_>, path: std::path::PathBuf) -> PyResult<Self> {
        if !path.is_file() {
            return Err(PyFileNotFoundError::new_err(format!("no bag at '{}'", path.display())));
        }
        let file = py.detach(|| guarded(|| File::open(&path)))?.map_err(|error| failed(&error))?;
        let pool = DescriptorPool::decode(DESCRIPTORS).map_err(|error| failed(&error))?;
        Ok(Self { file, pool })
    }

    /// Settings of the episode, as nested dictionaries.
    fn header<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        dictionary(py, &dynamic(&self.pool, self.file.header())?)
    }

    /// End of the episode; `None` in a bag that was cut.
    fn result<'py>(&self, py: Python<'py>) -> PyResult<Option<Bound<'py, PyDict>>> {
        self.file.result().map(|result| dictionary(py, &dynamic(&self.pool, result)?)).transpose()
    }

    /// True if the bag holds the whole episode.
    #[getter]
    fn is_whole(&self) -> bool {
        matches!(self.file.completeness(), Completeness::Whole)
    }

    /// True if its rows are simulated when they are read.
    #[getter]
    fn is_thin(&self) -> bool {
        self.file.is_thin()
    }

    /// Names of the topics that can be read as columns.
    #[staticmethod]
    fn topics() -> Vec<&'static str> {
        TOPICS.into()
    }

    /// The fields of what a policy with these sensors saw, and their numbers: a row for each observation, flat.
    fn observations<'py>(&self, py: Python<'py>, sensors: Vec<String>) -> PyResult<Observed<'py>> {
        let header = self.file.header();
        let chosen = sensors.iter().try_fold(Sensors::NONE, |set, name| {
            let sensor = Sensor::by_name(name);
            let sensor = sensor.ok_or_else(|| {
                PyValueError::new_err(format!("sensors: '{name}' is not a sensor; known ones are {}", Sensor::names()))
            })?;
            Ok::<_, PyErr>(set.with(sensor))
        })?;
        let setup = Setup {
            task: build::task(&header.task)?,
            protocol: header.episode_protocol.parse().map_err(|error: UnknownProtocol| refused(&error))?,
            layout: RobotLayout {
                joints: header.joint_names.len(),
                hand_bodies_per_side: header.hand_bodies.len() / 2,
            },
            image_size: [header.image_width as usize, header.image_height as usize],
        };
        let terms = term_messages(chosen, &setup);
        let mut numbers = Numbers::new(&terms, &header.sensors);
        let fields = numbers.fields().to_vec();
        let read = move || {
            let mut rows = Vec::new();
            for observation in self.file.observations() {
                numbers.take(&observation?);
                rows.extend_from_slice(numbers.latest());
            }
            Ok::<_, BagError>(rows)
        };
        let rows = py.detach(|| guarded(read))?.map_err(|error| failed(&error))?;
        py.check_signals()?;
        Ok((fields, rows.into_pyarray(py)))
    }

    /// Pictures of rows, whose numbers rise, RGB, as of `Episode.render`.
    #[pyo3(signature = (rows, width, height, camera=None))]
    fn render<'py>(
        &self,
        py: Python<'py>,
        rows: Vec<usize>,
        width: usize,
        height: usize,
        camera: Option<&str>,
    ) -> PyResult<Vec<Bound<'py, PyBytes>>> {
        let header = self.file.header();
        let rebuild = || robot_of(header).and_then(|robot| scene_of(header, Arc::new(robot)));
        let scene = Arc::new(guarded(rebuild)?.map_err(|error| failed(&error))?);
        let (light, mut painter) = (Lighting::of(&light_of(header)), Painter::default());
        let (mut wanted, mut pictures) = (rows.into_iter().peekable(), Vec::new());
        for (number, state) in self.file.states().enumerate() {
            let Some(next) = wanted.peek() else { break };
            if number == *next {
                let state = state.map_err(|error| failed(&error))?;
                let row = read_row(&state, scene.robot_layout()).map_err(|error| failed(&error))?;
                pictures.push(painter.paint(py, &scene, &row, &light, [width, height], camera)?);
                wanted.next();
            }
        }
        match wanted.next() {
            Some(row) => Err(PyValueError::new_err(format!("rows: the bag has no row {row}"))),
            None => Ok(pictures),
        }
    }

    /// All messages of a topic as columns.
    fn columns<'py>(&self, py: Python<'py>, topic: &str) -> PyResult<Bound<'py, PyDict>> {
        let read = || match topic {
            "/state" => self.read(self.file.states()).map(|table| Some(table.with_parts_named(self.file.header()))),
            "/action" => self.read(self.file.actions()).map(Some),
            "/observation" => self.read(self.file.observations()).map(Some),
            "/reward" => self.read(self.file.rewards()).map(Some),
            "/event" => self.read(self.file.events()).map(Some),
            "/camera" => self.read(self.file.images()).map(Some),
            "/lidar" => self.read(self.file.point_clouds()).map(Some),
            _ => Ok(None),
        };
        let table = py.detach(|| guarded(read))?.map_err(|error| failed(&error))?;
        py.check_signals()?;
        let known = TOPICS.join(", ");
        table.ok_or_else(|| PyKeyError::new_err(format!("no topic '{topic}'; known ones are {known}")))?.arrays(py)
    }
}

impl Bag {
    fn read<M: Message + Name + Default>(&self, messages: Messages<'_, M>) -> Result<Table, BagError> {
        let mut table = Table::default();
        for message in messages {
            if let Ok(message) = dynamic(&self.pool, &message?) {
                table.add(&message, "");
            }
            table.rows += 1;
        }
        Ok(table)
    }
}

/// A message of this project as nested dictionaries.
pub(crate) fn described<'py, M: Message + Name>(py: Python<'py>, message: &M) -> PyResult<Bound<'py, PyDict>> {
    let pool = DescriptorPool::decode(DESCRIPTORS).map_err(|error| failed(&error))?;
    dictionary(py, &dynamic(&pool, message)?)
}

/// A message of this project, with the names of its fields.
fn dynamic<M: Message + Name>(pool: &DescriptorPool, message: &M) -> PyResult<DynamicMessage> {
    let name = M::full_name();
    let descriptor = pool.get_message_by_name(&name);
    let descriptor = descriptor.ok_or_else(|| PyKeyError::new_err(format!("no message '{name}'")))?;
    DynamicMessage::decode(descriptor, message.encode_to_vec().as_slice()).map_err(|error| failed(&error))
}

/// Messages as columns: one for each number, list of numbers or text in them, by its path.
#[derive(Default)]
struct Table {
    columns: BTreeMap<String, Column>,
    rows: usize,
}

#[derive(Default)]
struct Column {
    /// Indices of the messages that have the field.
    rows: Vec<usize>,
    /// Number of values in each message; `None` for a single value.
    lengths: Vec<Option<usize>>,
    values: Values,
}

/// Values of one kind: numbers take no more than in an array.
enum Values {
    F64(Vec<f64>),
    F32(Vec<f32>),
    Bool(Vec<bool>),
    U64(Vec<u64>),
    I64(Vec<i64>),
    U32(Vec<u32>),
    I32(Vec<i32>),
    Other(Vec<Value>),
}

impl Default for Values {
    fn default() -> Self {
        Self::Other(Vec::new())
    }
}

/// Does the same with the list of each kind.
macro_rules! each_kind {
    ($values:expr, $list:ident => $done:expr) => {
        match $values {
            Values::F64($list) => $done,
            Values::F32($list) => $done,
            Values::Bool($list) => $done,
            Values::U64($list) => $done,
            Values::I64($list) => $done,
            Values::U32($list) => $done,
            Values::I32($list) => $done,
            Values::Other($list) => $done,
        }
    };
}

impl Values {
    fn push(&mut self, value: Value) {
        if let Self::Other(others) = self
            && others.is_empty()
        {
            *self = match value {
                Value::F64(_) => Self::F64(Vec::new()),
                Value::F32(_) => Self::F32(Vec::new()),
                Value::Bool(_) => Self::Bool(Vec::new()),
                Value::U64(_) => Self::U64(Vec::new()),
                Value::I64(_) => Self::I64(Vec::new()),
                Value::U32(_) => Self::U32(Vec::new()),
                Value::I32(_) | Value::EnumNumber(_) => Self::I32(Vec::new()),
                _ => Self::Other(Vec::new()),
            };
        }
        // All values of a field have one kind.
        match (self, value) {
            (Self::F64(list), Value::F64(value)) => list.push(value),
            (Self::F32(list), Value::F32(value)) => list.push(value),
            (Self::Bool(list), Value::Bool(value)) => list.push(value),
            (Self::U64(list), Value::U64(value)) => list.push(value),
            (Self::I64(list), Value::I64(value)) => list.push(value),
            (Self::U32(list), Value::U32(value)) => list.push(value),
            (Self::I32(list), Value::I32(value) | Value::EnumNumber(value)) => list.push(value),
            (Self::Other(list), value) => list.push(value),
            _ => {}
        }
    }

    fn is_empty(&self) -> bool {
        each_kind!(self, list => list.is_empty())
    }

    /// An empty list of the same kind.
    fn alike(&self) -> Self {
        match self {
            Self::F64(_) => Self::F64(Vec::new()),
            Self::F32(_) => Self::F32(Vec::new()),
            Self::Bool(_) => Self::Bool(Vec::new()),
            Self::U64(_) => Self::U64(Vec::new()),
            Self::I64(_) => Self::I64(Vec::new()),
            Self::U32(_) => Self::U32(Vec::new()),
            Self::I32(_) => Self::I32(Vec::new()),
            Self::Other(_) => Self::Other(Vec::new()),
        }
    }

    /// Adds a part of another list of the same kind, as far as it has it; returns how many.
    fn extend_from(&mut self, other: &Self, range: Range<usize>) -> usize {
        fn part<T>(list: &[T], range: Range<usize>) -> &[T] {
            list.get(range).unwrap_or_default()
        }
        match (self, other) {
            (Self::F64(list), Self::F64(from)) => extended(list, part(from, range)),
            (Self::F32(list), Self::F32(from)) => extended(list, part(from, range)),
            (Self::Bool(list), Self::Bool(from)) => extended(list, part(from, range)),
            (Self::U64(list), Self::U64(from)) => extended(list, part(from, range)),
            (Self::I64(list), Self::I64(from)) => extended(list, part(from, range)),
            (Self::U32(list), Self::U32(from)) => extended(list, part(from, range)),
            (Self::I32(list), Self::I32(from)) => extended(list, part(from, range)),
            (Self::Other(list), Self::Other(from)) => extended(list, part(from, range)),
            _ => 0,
        }
    }

    /// All of them as an array; what is no number, as a list.
    fn into_array(self, py: Python<'_>) -> PyResult<Bound<'_, PyAny>> {
        Ok(match self {
            Self::F64(list) => list.into_pyarray(py).into_any(),
            Self::F32(list) => list.into_pyarray(py).into_any(),
            Self::Bool(list) => list.into_pyarray(py).into_any(),
            Self::U64(list) => list.into_pyarray(py).into_any(),
            Self::I64(list) => list.into_pyarray(py).into_any(),
            Self::U32(list) => list.into_pyarray(py).into_any(),
            Self::I32(list) => list.into_pyarray(py).into_any(),
            Self::Other(list) => {
                let list: PyResult<Vec<_>> = list.iter().map(|value| object(py, value)).collect();
                PyList::new(py, list?)?.into_any()
            }
        })
    }
}

fn extended<T: Clone>(list: &mut Vec<T>, from: &[T]) -> usize {
    list.extend_from_slice(from);
    from.len()
}

impl Table {
    fn add(&mut self, message: &DynamicMessage, path: &str) {
        for field in message.descriptor().fields() {
            if field.supports_presence() && !message.has_field(&field) {
                continue;
            }
            self.put(format!("{path}{}", field.name()), message.get_field(&field).into_owned());
        }
    }

    fn put(&mut self, path: String, value: Value) {
        let (length, values) = match value {
            Value::Message(message) => return self.add(&message, &format!("{path}.")),
            Value::List(values) if values.iter().any(|value| value.as_message().is_some()) => {
                for (index, value) in values.into_iter().enumerate() {
                    if let Value::Message(message) = value {
                        // Parts with a name are identified by it.
                        let name = message.get_field_by_name("name").and_then(|name| name.as_str().map(str::to_owned));
                        let name = name.filter(|name| !name.is_empty()).unwrap_or_else(|| index.to_string());
                        self.add(&message, &format!("{path}.{name}."));
                    }
                }
                return;
            }
            Value::Map(_) => return,
            Value::List(values) => (Some(values.len()), values),
            value => (None, vec![value]),
        };
        let column = self.columns.entry(path).or_default();
        column.rows.push(self.rows);
        column.lengths.push(length);
        values.into_iter().for_each(|value| column.values.push(value));
    }

    /// Columns of rows by the names of things and contact measures.
    fn with_parts_named(mut self, header: &EpisodeHeader) -> Self {
        let held = manifest().held_by_socket().filter_map(|thing| header.things.get(thing).cloned()).collect();
        let columns = std::mem::take(&mut self.columns);
        for (path, column) in columns {
            let lists = [("things.", &header.things), ("attachments.", &held)];
            let part = lists.iter().find_map(|(list, names)| {
                let (index, field) = path.strip_prefix(list)?.split_once('.')?;
                Some(format!("{}.{field}", names.get(index.parse::<usize>().ok()?)?))
            });
            if path == "forces" || path == "loads" {
                let measures = header.contacts.iter().filter(|contact| contact.vectors == (path == "forces"));
                self.columns.extend(column.split(measures));
            } else if part.is_none() || !column.values.is_empty() {
                self.columns.insert(part.unwrap_or(path), column);
            }
        }
        self
    }

    fn arrays<'py>(self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let dict = PyDict::new(py);
        for (path, column) in self.columns {
            if column.rows.len() != self.rows {
                let rows: Vec<i64> = column.rows.iter().map(|row| *row as i64).collect();
                dict.set_item(format!("{path}.rows"), rows.into_pyarray(py))?;
            }
            dict.set_item(path, column.array(py)?)?;
        }
        Ok(dict)
    }
}

impl Column {
    /// The columns of measures that follow each other in this one's lists.
    fn split<'a>(&self, measures: impl Iterator<Item = &'a ContactMeasure>) -> impl Iterator<Item = (String, Column)> {
        let mut first = 0;
        measures.map(move |measure| {
            let length = measure.parts as usize * if measure.vectors { 3 } else { 1 };
            let mut part = Column { rows: self.rows.clone(), values: self.values.alike(), ..Column::default() };
            let mut start = 0;
            for row in &self.lengths {
                let row = row.unwrap_or(1);
                let end = (start + row).min(start + first + length);
                let found = part.values.extend_from(&self.values, start + first..end);
                part.lengths.push((length > 1).then_some(found));
                start += row;
            }
            first += length;
            (measure.name.clone(), part)
        })
    }

    /// An array with a row for each message if all have the same number of values; otherwise a list of lists.
    fn array<'py>(self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        let Self { lengths, values, .. } = self;
        let is_even = lengths.windows(2).all(|pair| pair[0] == pair[1]);
        let is_numbers = !matches!(values, Values::Other(_));
        let whole = values.into_array(py)?;
        if is_numbers && is_even {
            return match lengths.first() {
                Some(Some(length)) => whole.call_method1("reshape", ((lengths.len(), *length),)),
                _ => Ok(whole),
            };
        }
        let whole = if is_numbers { whole.call_method0("tolist")? } else { whole };
        let whole = whole.cast_into::<PyList>()?;
        if lengths.iter().all(Option::is_none) {
            return Ok(whole.into_any());
        }
        let (parts, mut start) = (PyList::empty(py), 0);
        for length in lengths {
            match length {
                Some(length) => parts.append(whole.get_slice(start, start + length))?,
                None => parts.append(whole.get_item(start)?)?,
            }
            start += length.unwrap_or(1);
        }
        Ok(parts.into_any())
    }
}

/// Writes a bag as a thin one at `to`; false for one that is thin or cut, which is left alone.
#[pyfunction]
pub(crate) fn write_thin(py: Python<'_>, path: std::path::PathBuf, to: std::path::PathBuf) -> PyResult<bool> {
    let write = || {
        let bag = File::open(&path)?;
        let wanted = !bag.is_thin() && bag.stays_full().is_none();
        if wanted { bag.write_thin(&to).map(|_| true) } else { Ok(false) }
    };
    py.detach(|| guarded(write))?.map_err(|error| failed(&error))
}

/// True for a file or folder that file systems and file managers leave behind.
#[pyfunction]
pub(crate) fn is_leftover(path: std::path::PathBuf) -> bool {
    fiatlux_bag::is_leftover(&path)
}
