//! The messages of an ONNX file that are used here (github.com/onnx/onnx, `onnx/onnx.proto`). The numbers in the
//! matches are the fields' numbers there.

use std::collections::BTreeMap;

use super::wire::{Field, Fields, varint};

/// Supported versions of the operator set. Before 7, shapes were matched by other rules.
const VERSIONS: std::ops::RangeInclusive<i64> = 7..=28;
/// Maximum number of nodes, and of tensors, of a graph; a controller has some twenty.
const MAX_NODES: usize = 4096;
/// Maximum number of inputs, outputs, attributes or dimensions.
const MAX_PARTS: usize = 256;
/// Maximum number of integers in a tensor, which are only shapes, axes and indices.
const MAX_INTEGERS: usize = 1 << 12;

#[derive(Debug, Default)]
pub(super) struct Graph<'a> {
    pub nodes: Vec<Node<'a>>,
    pub tensors: BTreeMap<&'a str, Tensor<'a>>,
    pub inputs: Vec<Port<'a>>,
    pub outputs: Vec<Port<'a>>,
}

#[derive(Debug, Default)]
pub(super) struct Node<'a> {
    pub name: &'a str,
    pub operator: &'a str,
    pub domain: &'a str,
    pub inputs: Vec<&'a str>,
    pub outputs: Vec<&'a str>,
    pub attributes: Vec<Attribute<'a>>,
}

#[derive(Debug, Default)]
pub(super) struct Attribute<'a> {
    pub name: &'a str,
    pub float: f32,
    pub integer: i64,
    pub floats: Vec<f32>,
    pub integers: Vec<i64>,
    pub tensor: Option<Tensor<'a>>,
}

#[derive(Debug, Default, Clone)]
pub(super) struct Tensor<'a> {
    pub name: &'a str,
    pub shape: Vec<i64>,
    pub kind: i64,
    /// Little-endian numbers, or one of the two lists below.
    pub raw: &'a [u8],
    pub floats: Vec<f32>,
    pub integers: Vec<i64>,
    pub is_external: bool,
}

/// An input or output of the graph.
#[derive(Debug, Default)]
pub(super) struct Port<'a> {
    pub name: &'a str,
    pub kind: i64,
    /// `None` for a size that is not fixed.
    pub shape: Vec<Option<i64>>,
}

pub(super) fn parse(bytes: &[u8]) -> Result<Graph<'_>, String> {
    let (mut graph, mut version) = (None, None);
    for field in Fields(bytes) {
        match field? {
            (7, Field::Bytes(bytes)) => graph = Some(bytes),
            (8, Field::Bytes(bytes)) => {
                let (domain, number) = operator_set(bytes)?;
                if is_standard(domain) {
                    version = Some(number);
                }
            }
            _ => {}
        }
    }
    let graph = graph.ok_or("it has no graph")?;
    let version = version.ok_or("it names no version of the operators")?;
    if !VERSIONS.contains(&version) {
        let (first, last) = VERSIONS.into_inner();
        return Err(format!("its operators are of set {version}; sets {first} to {last} are supported"));
    }
    Graph::parse(graph)
}

/// True for ONNX's own domain of operators.
pub(super) fn is_standard(domain: &str) -> bool {
    matches!(domain, "" | "ai.onnx")
}

fn operator_set(bytes: &[u8]) -> Result<(&str, i64), String> {
    let (mut domain, mut version) = ("", 0);
    for field in Fields(bytes) {
        match field? {
            (1, Field::Bytes(bytes)) => domain = text(bytes)?,
            (2, Field::Varint(number)) => version = number as i64,
            _ => {}
        }
    }
    Ok((domain, version))
}

impl<'a> Graph<'a> {
    fn parse(bytes: &'a [u8]) -> Result<Self, String> {
        let mut graph = Self::default();
        for field in Fields(bytes) {
            match field? {
                (1, Field::Bytes(bytes)) => push(&mut graph.nodes, Node::parse(bytes)?, MAX_NODES, "nodes")?,
                (5, Field::Bytes(bytes)) => {
                    let tensor = Tensor::parse(bytes)?;
                    if graph.tensors.len() >= MAX_NODES {
                        return Err(too_many("tensors", MAX_NODES));
                    }
                    if let Some(first) = graph.tensors.insert(tensor.name, tensor) {
                        return Err(format!("it has two tensors '{}'", first.name));
                    }
                }
                (11, Field::Bytes(bytes)) => push(&mut graph.inputs, Port::parse(bytes)?, MAX_NODES, "inputs")?,
                (12, Field::Bytes(bytes)) => push(&mut graph.outputs, Port::parse(bytes)?, MAX_NODES, "outputs")?,
                (15, _) => return Err("it has sparse tensors".into()),
                _ => {}
            }
        }
        Ok(graph)
    }
}

impl<'a> Node<'a> {
    fn parse(bytes: &'a [u8]) -> Result<Self, String> {
        let mut node = Self::default();
        for field in Fields(bytes) {
            match field? {
                (1, Field::Bytes(bytes)) => push(&mut node.inputs, text(bytes)?, MAX_PARTS, "inputs of a node")?,
                (2, Field::Bytes(bytes)) => push(&mut node.outputs, text(bytes)?, MAX_PARTS, "outputs of a node")?,
                (3, Field::Bytes(bytes)) => node.name = text(bytes)?,
                (4, Field::Bytes(bytes)) => node.operator = text(bytes)?,
                (5, Field::Bytes(bytes)) => {
                    push(&mut node.attributes, Attribute::parse(bytes)?, MAX_PARTS, "attributes of a node")?;
                }
                (7, Field::Bytes(bytes)) => node.domain = text(bytes)?,
                _ => {}
            }
        }
        Ok(node)
    }
}

impl<'a> Attribute<'a> {
    fn parse(bytes: &'a [u8]) -> Result<Self, String> {
        let mut attribute = Self::default();
        for field in Fields(bytes) {
            match field? {
                (1, Field::Bytes(bytes)) => attribute.name = text(bytes)?,
                (2, Field::Fixed32(number)) => attribute.float = f32::from_le_bytes(number),
                (3, Field::Varint(number)) => attribute.integer = number as i64,
                (5, Field::Bytes(bytes)) => attribute.tensor = Some(Tensor::parse(bytes)?),
                (7, field) => floats(field, &mut attribute.floats)?,
                (8, field) => integers(field, &mut attribute.integers)?,
                _ => {}
            }
        }
        Ok(attribute)
    }
}

impl<'a> Tensor<'a> {
    fn parse(bytes: &'a [u8]) -> Result<Self, String> {
        let mut tensor = Self::default();
        for field in Fields(bytes) {
            match field? {
                (1, field) => integers(field, &mut tensor.shape)?,
                (2, Field::Varint(number)) => tensor.kind = number as i64,
                (4, field) => floats(field, &mut tensor.floats)?,
                (5 | 7, field) => integers(field, &mut tensor.integers)?,
                (8, Field::Bytes(bytes)) => tensor.name = text(bytes)?,
                (9, Field::Bytes(bytes)) => tensor.raw = bytes,
                (13, _) | (14, Field::Varint(1)) => tensor.is_external = true,
                _ => {}
            }
        }
        Ok(tensor)
    }
}

impl<'a> Port<'a> {
    fn parse(bytes: &'a [u8]) -> Result<Self, String> {
        let mut port = Self::default();
        for field in Fields(bytes) {
            match field? {
                (1, Field::Bytes(bytes)) => port.name = text(bytes)?,
                (2, Field::Bytes(kind)) => {
                    // A type holds a tensor's type, which holds its numbers' type and its shape, a list of sizes.
                    if let Some(tensor) = part(kind, 1)? {
                        port.kind = size(tensor, 1)?.unwrap_or(0);
                        for field in Fields(part(tensor, 2)?.unwrap_or(&[])) {
                            if let (1, Field::Bytes(bytes)) = field? {
                                push(&mut port.shape, size(bytes, 1)?, MAX_PARTS, "dimensions of an input")?;
                            }
                        }
                    }
                }
                _ => {}
            }
        }
        Ok(port)
    }
}

/// The message in a field of a message.
fn part(bytes: &[u8], number: u64) -> Result<Option<&[u8]>, String> {
    let mut found = None;
    for field in Fields(bytes) {
        match field? {
            (own, Field::Bytes(bytes)) if own == number => found = Some(bytes),
            _ => {}
        }
    }
    Ok(found)
}

/// The integer in a field of a message.
fn size(bytes: &[u8], number: u64) -> Result<Option<i64>, String> {
    let mut found = None;
    for field in Fields(bytes) {
        match field? {
            (own, Field::Varint(value)) if own == number => found = Some(value as i64),
            _ => {}
        }
    }
    Ok(found)
}

fn text(bytes: &[u8]) -> Result<&str, String> {
    std::str::from_utf8(bytes).map_err(|_| "a name in it is not UTF-8".into())
}

fn push<T>(list: &mut Vec<T>, item: T, most: usize, what: &str) -> Result<(), String> {
    if list.len() >= most {
        return Err(too_many(what, most));
    }
    list.push(item);
    Ok(())
}

fn too_many(what: &str, most: usize) -> String {
    format!("it has more than {most} {what}")
}

/// Integers, one field each or packed in one.
fn integers(field: Field<'_>, to: &mut Vec<i64>) -> Result<(), String> {
    let mut one = |number: u64| push(to, number as i64, MAX_INTEGERS, "integers in a tensor");
    match field {
        Field::Varint(number) => one(number),
        Field::Bytes(mut bytes) => {
            while !bytes.is_empty() {
                one(varint(&mut bytes).ok_or("the file is damaged")?)?;
            }
            Ok(())
        }
        _ => Err("the file is damaged".into()),
    }
}

/// Numbers, one field each or packed in one.
fn floats(field: Field<'_>, to: &mut Vec<f32>) -> Result<(), String> {
    match field {
        Field::Fixed32(number) => to.push(f32::from_le_bytes(number)),
        Field::Bytes(bytes) => to.extend(bytes.as_chunks().0.iter().map(|number| f32::from_le_bytes(*number))),
        _ => return Err("the file is damaged".into()),
    }
    Ok(())
}
