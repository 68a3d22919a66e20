//! Bags as NumPy arrays, topic by topic.

use std::collections::BTreeMap;

use fiatlux_bag::{Bag as File, BagError, Completeness, Messages};
use fiatlux_proto::v3::{ContactMeasure, EpisodeHeader};
use fiatlux_proto::{DESCRIPTORS, Message};
use fiatlux_rules::manifest;
use numpy::IntoPyArray;
use prost::Name;
use prost_reflect::{DescriptorPool, DynamicMessage, MapKey, ReflectMessage, Value};
use pyo3::exceptions::{PyFileNotFoundError, PyKeyError};
use pyo3::prelude::*;
use pyo3::types::{PyBytes, PyDict, PyList};

use crate::fault::{failed, guarded};

/// Names of the topics that can be read as columns.
const TOPICS: [&str; 6] = ["/state", "/action", "/observation", "/reward", "/event", "/camera"];

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

    /// Names of the topics that can be read as columns.
    #[staticmethod]
    fn topics() -> Vec<&'static str> {
        TOPICS.into()
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
    values: Vec<Value>,
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
        column.values.extend(values);
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
            let mut values = self.values.as_slice();
            let mut part = Column { rows: self.rows.clone(), ..Column::default() };
            for row in &self.lengths {
                let (list, rest) = values.split_at(row.unwrap_or(1));
                let list = list.get(first..first + length).unwrap_or_default();
                part.values.extend_from_slice(list);
                part.lengths.push((length > 1).then_some(list.len()));
                values = rest;
            }
            first += length;
            (measure.name.clone(), part)
        })
    }

    /// An array with a row for each message if all have the same number of values; otherwise a list of lists.
    fn array<'py>(self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        let Self { lengths, values, .. } = self;
        let is_even = lengths.windows(2).all(|pair| pair[0] == pair[1]);
        let numbers = match values.first() {
            Some(Value::F64(_)) => Some(column(py, &values, Value::as_f64)),
            Some(Value::F32(_)) => Some(column(py, &values, Value::as_f32)),
            Some(Value::Bool(_)) => Some(column(py, &values, Value::as_bool)),
            Some(Value::U64(_)) => Some(column(py, &values, Value::as_u64)),
            Some(Value::I64(_)) => Some(column(py, &values, Value::as_i64)),
            Some(Value::U32(_)) => Some(column(py, &values, Value::as_u32)),
            Some(Value::I32(_)) => Some(column(py, &values, Value::as_i32)),
            Some(Value::EnumNumber(_)) => Some(column(py, &values, Value::as_enum_number)),
            _ => None,
        };
        match numbers {
            Some(numbers) if is_even => match lengths[0] {
                Some(length) => numbers?.call_method1("reshape", ((lengths.len(), length),)),
                None => numbers,
            },
            _ => {
                let list = PyList::empty(py);
                let mut values = values.iter();
                for length in lengths {
                    match length {
                        Some(length) => {
                            let part = values.by_ref().take(length).map(|value| object(py, value));
                            list.append(part.collect::<PyResult<Vec<_>>>()?)?;
                        }
                        None => values.next().map_or(Ok(()), |value| list.append(object(py, value)?))?,
                    }
                }
                Ok(list.into_any())
            }
        }
    }
}

fn column<'py, T: numpy::Element>(
    py: Python<'py>,
    values: &[Value],
    number: fn(&Value) -> Option<T>,
) -> PyResult<Bound<'py, PyAny>> {
    Ok(values.iter().filter_map(number).collect::<Vec<T>>().into_pyarray(py).into_any())
}

fn dictionary<'py>(py: Python<'py>, message: &DynamicMessage) -> PyResult<Bound<'py, PyDict>> {
    let dict = PyDict::new(py);
    for field in message.descriptor().fields() {
        if !field.supports_presence() || message.has_field(&field) {
            dict.set_item(field.name(), object(py, &message.get_field(&field))?)?;
        }
    }
    Ok(dict)
}

fn object<'py>(py: Python<'py>, value: &Value) -> PyResult<Bound<'py, PyAny>> {
    Ok(match value {
        Value::Bool(value) => value.into_pyobject(py)?.to_owned().into_any(),
        Value::I32(value) | Value::EnumNumber(value) => value.into_pyobject(py)?.into_any(),
        Value::I64(value) => value.into_pyobject(py)?.into_any(),
        Value::U32(value) => value.into_pyobject(py)?.into_any(),
        Value::U64(value) => value.into_pyobject(py)?.into_any(),
        Value::F32(value) => value.into_pyobject(py)?.into_any(),
        Value::F64(value) => value.into_pyobject(py)?.into_any(),
        Value::String(value) => value.into_pyobject(py)?.into_any(),
        Value::Bytes(value) => PyBytes::new(py, value).into_any(),
        Value::Message(message) => dictionary(py, message)?.into_any(),
        Value::List(values) => {
            let values = values.iter().map(|value| object(py, value));
            PyList::new(py, values.collect::<PyResult<Vec<_>>>()?)?.into_any()
        }
        Value::Map(map) => {
            let dict = PyDict::new(py);
            for (key, value) in map {
                let key = match key {
                    MapKey::String(key) => key.clone(),
                    MapKey::Bool(key) => key.to_string(),
                    MapKey::I32(key) => key.to_string(),
                    MapKey::I64(key) => key.to_string(),
                    MapKey::U32(key) => key.to_string(),
                    MapKey::U64(key) => key.to_string(),
                };
                dict.set_item(key, object(py, value)?)?;
            }
            dict.into_any()
        }
    })
}
