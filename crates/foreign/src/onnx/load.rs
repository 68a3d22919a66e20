//! Turns a graph into steps: the nodes in their order, each with known shapes.

use std::collections::{BTreeMap, BTreeSet};
use std::ops::Range;

use super::file::{Graph, Node, Port, is_standard, parse};
use super::steps::{Kernel, Step};
use super::value::{Data, F32, MAX_NUMBERS, Value, broadcast, count, kind, places, strides};
use super::{Network, Refusal};

/// A network under construction.
#[derive(Debug, Default)]
pub(super) struct Loader {
    steps: Vec<Step>,
    arena: Vec<f32>,
    /// Numbers that operators have made so far.
    made: usize,
}

impl Network {
    /// Loads a network with one input f32 [1, `inputs`] and one output f32 [1, `outputs`].
    pub fn load(bytes: &[u8], inputs: usize, outputs: usize) -> Result<Self, Refusal> {
        let graph = parse(bytes)?;
        // Older files list the tensors among the inputs.
        let open: Vec<&Port<'_>> =
            graph.inputs.iter().filter(|input| !graph.tensors.contains_key(input.name)).collect();
        let (&[input], [output]) = (open.as_slice(), graph.outputs.as_slice()) else {
            let (inputs, outputs) = (open.len(), graph.outputs.len());
            return Err(format!("it has {inputs} inputs and {outputs} outputs instead of one each").into());
        };
        let fits = matches!(input.shape.as_slice(), [None | Some(1), Some(width)] if *width == inputs as i64);
        if input.kind != F32 || !fits {
            let sizes: Vec<String> =
                input.shape.iter().map(|size| size.map_or("?".into(), |size| size.to_string())).collect();
            let found = format!("{} [{}]", kind(input.kind), sizes.join(", "));
            return Err(Refusal::Shape { side: "input", found });
        }
        let mut loader = Loader { arena: vec![0.0; inputs], ..Loader::default() };
        let mut values = BTreeMap::from([(input.name, Value { shape: vec![1, inputs], data: Data::Computed(0) })]);
        for node in needed(&graph, output.name) {
            loader.node(node, &graph, &mut values)?;
        }
        let value = find(output.name, &graph, &mut values)?;
        if value.shape != [1, outputs] || matches!(value.data, Data::Integers(_)) {
            return Err(Refusal::Shape { side: "output", found: format!("{:?}", value.shape) });
        }
        let output = loader.place(&value)?;
        Ok(Self { steps: loader.steps, arena: loader.arena, output })
    }
}

/// The nodes that the output depends on, in the file's order.
fn needed<'g, 'a>(graph: &'g Graph<'a>, output: &'a str) -> Vec<&'g Node<'a>> {
    let mut wanted = BTreeSet::from([output]);
    let mut nodes: Vec<_> = (graph.nodes.iter().rev())
        .filter(|node| {
            let is_needed = node.outputs.iter().any(|output| !output.is_empty() && wanted.contains(output));
            if is_needed {
                wanted.extend(&node.inputs);
            }
            is_needed
        })
        .collect();
    nodes.reverse();
    nodes
}

/// The value of a name, from an earlier node or from the file.
fn find<'a>(name: &'a str, graph: &Graph<'a>, values: &mut BTreeMap<&'a str, Value>) -> Result<Value, Refusal> {
    if let Some(value) = values.get(name) {
        return Ok(value.clone());
    }
    let missing = || format!("no earlier node makes '{name}'; its nodes are damaged, or form a cycle");
    let value = Value::of_tensor(graph.tensors.get(name).ok_or_else(missing)?, name)?;
    values.insert(name, value.clone());
    Ok(value)
}

impl Loader {
    fn node<'a>(
        &mut self,
        node: &Node<'a>,
        graph: &Graph<'a>,
        values: &mut BTreeMap<&'a str, Value>,
    ) -> Result<(), Refusal> {
        let named = |refusal| match refusal {
            Refusal::Problem(problem) => {
                Refusal::Problem(format!("its operator {} '{}': {problem}", node.operator, node.name))
            }
            other => other,
        };
        if !is_standard(node.domain) {
            return Err(named(format!("the domain '{}' is not supported", node.domain).into()));
        }
        let inputs = node.inputs.iter().map(|name| (!name.is_empty()).then(|| find(name, graph, values)).transpose());
        let inputs: Vec<Option<Value>> = inputs.collect::<Result<_, _>>().map_err(named)?;
        let results = self.operator(node, &inputs).map_err(named)?;
        if let Some(name) = node.outputs.iter().skip(results.len()).find(|name| !name.is_empty()) {
            return Err(named(format!("its output '{name}' is not supported").into()));
        }
        for (name, value) in node.outputs.iter().zip(results).filter(|(name, _)| !name.is_empty()) {
            if graph.tensors.contains_key(name) || values.insert(name, value).is_some() {
                return Err(named(format!("it makes '{name}', which exists already").into()));
            }
        }
        Ok(())
    }

    /// The numbers of `sources` at the given places (index of the source, and index in it), in a new shape.
    pub fn moved(
        &mut self,
        sources: &[&Value],
        shape: Vec<usize>,
        places: impl Iterator<Item = (usize, usize)>,
    ) -> Result<Value, Refusal> {
        let count = self.make(&shape)?;
        let integers: Option<Vec<_>> = sources.iter().map(|source| source.integers()).collect();
        if let Some(sources) = integers {
            let data = Data::Integers(places.map(|(source, place)| sources[source][place]).collect());
            return Ok(Value { shape, data });
        }
        let floats: Option<Vec<_>> = sources.iter().map(|source| source.floats()).collect();
        if let Some(sources) = floats {
            let data = Data::Floats(places.map(|(source, place)| sources[source][place]).collect());
            return Ok(Value { shape, data });
        }
        let starts = sources.iter().map(|source| Ok(self.place(source)?.start)).collect::<Result<Vec<_>, Refusal>>()?;
        let mut runs: Vec<[usize; 2]> = Vec::new();
        for (source, place) in places {
            let from = starts[source] + place;
            match runs.last_mut() {
                Some([start, length]) if *start + *length == from => *length += 1,
                _ => runs.push([from, 1]),
            }
        }
        if let &[[from, _]] = runs.as_slice() {
            return Ok(Value { shape, data: Data::Computed(from) });
        }
        let to = self.reserve(count);
        self.steps.push(Step::Copy { runs, to });
        Ok(Value { shape, data: Data::Computed(to) })
    }

    /// The numbers of one value along `strides` from `start`, in a new shape.
    pub fn view(
        &mut self,
        source: &Value,
        shape: Vec<usize>,
        strides: &[isize],
        start: isize,
    ) -> Result<Value, Refusal> {
        count(&shape)?;
        let places = places(&shape, strides, start);
        self.moved(&[source], shape, places.map(|place| (0, place)))
    }

    /// A value repeated along the axes where it has size 1.
    pub fn repeated(&mut self, value: &Value, shape: &[usize]) -> Result<Value, Refusal> {
        if value.shape == shape {
            return Ok(value.clone());
        }
        if broadcast(&value.shape, shape)? != shape {
            return Err(format!("the shape {:?} does not fit into {shape:?}", value.shape).into());
        }
        let mut along = vec![0; shape.len()];
        let skipped = shape.len() - value.shape.len();
        for (axis, stride) in strides(&value.shape).into_iter().enumerate() {
            along[skipped + axis] = if value.shape[axis] == 1 { 0 } else { stride };
        }
        self.view(value, shape.to_vec(), &along, 0)
    }

    pub fn computed(&mut self, kernel: Kernel, inputs: &[&Value], shape: Vec<usize>) -> Result<Value, Refusal> {
        let count = self.make(&shape)?;
        let known: Option<Vec<_>> = inputs.iter().map(|input| input.floats()).collect();
        if let Some(known) = known {
            let mut numbers = vec![0.0; count];
            kernel.run(known[0], known.get(1).map_or(&[], |right| right), &mut numbers);
            return Ok(Value { shape, data: Data::Floats(numbers.into()) });
        }
        let left = self.place(inputs[0])?;
        let right = inputs.get(1).map_or(Ok(0..0), |right| self.place(right))?;
        let start = self.reserve(count);
        self.steps.push(Step::Compute { kernel, inputs: [left, right], output: start..start + count });
        Ok(Value { shape, data: Data::Computed(start) })
    }

    /// The range of a value's numbers in the arena.
    fn place(&mut self, value: &Value) -> Result<Range<usize>, Refusal> {
        let count = count(&value.shape)?;
        let start = match &value.data {
            Data::Computed(start) => *start,
            Data::Floats(numbers) => {
                let start = self.arena.len();
                self.arena.extend_from_slice(numbers);
                start
            }
            Data::Integers(_) => return Err("it computes with integers; cast them to f32".into()),
        };
        Ok(start..start + count)
    }

    fn reserve(&mut self, count: usize) -> usize {
        let start = self.arena.len();
        self.arena.resize(start + count, 0.0);
        start
    }

    /// Counts the numbers of a new value, and refuses too many.
    fn make(&mut self, shape: &[usize]) -> Result<usize, Refusal> {
        let count = count(shape)?;
        self.spend(count)?;
        Ok(count)
    }

    /// Counts numbers that an operator makes or multiplies.
    pub fn spend(&mut self, count: usize) -> Result<(), Refusal> {
        self.made = self.made.saturating_add(count);
        if self.made > MAX_NUMBERS {
            return Err(format!("the network makes more than {MAX_NUMBERS} numbers").into());
        }
        Ok(())
    }
}
