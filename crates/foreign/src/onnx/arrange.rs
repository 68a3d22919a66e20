//! Operators without arithmetic: they cut, join, repeat and rename.

use super::Refusal;
use super::load::Loader;
use super::operators::Call;
use super::value::{Data, F32, I32, I64, Value, broadcast, count, index, kind, strides};

impl Loader {
    /// The value of an operator that rearranges numbers of its inputs.
    pub fn arranged(&mut self, call: &Call<'_>) -> Result<Value, Refusal> {
        match call.node.operator {
            "Cast" => cast(call),
            "Concat" => self.concat(call),
            "Constant" => constant(call),
            "Expand" => self.expand(call),
            "Flatten" => flatten(call),
            "Gather" => self.gather(call),
            "Identity" => call.input(0).cloned(),
            "Reshape" => reshape(call),
            "Shape" => Ok(Value::list(call.input(0)?.shape.iter().map(|&size| size as i64))),
            "Slice" => self.slice(call),
            "Squeeze" => squeeze(call),
            "Transpose" => self.transpose(call),
            "Unsqueeze" => unsqueeze(call),
            _ => Err("it is not supported".into()),
        }
    }

    fn concat(&mut self, call: &Call<'_>) -> Result<Value, Refusal> {
        let sources = (0..call.inputs.len()).map(|index| call.input(index)).collect::<Result<Vec<_>, _>>()?;
        let mut shape = call.input(0)?.shape.clone();
        let axis = index(call.integer("axis", 0), shape.len())?;
        shape[axis] = 0;
        for source in &sources {
            let mut other = source.shape.clone();
            if other.len() == shape.len() {
                shape[axis] = shape[axis].saturating_add(other[axis]);
                other[axis] = shape[axis];
            }
            if other != shape {
                return Err(format!("the shape {:?} does not fit {:?}", source.shape, sources[0].shape).into());
            }
        }
        let outer: usize = shape[..axis].iter().product();
        let lengths: Vec<usize> = sources.iter().map(|source| source.shape[axis..].iter().product()).collect();
        let places = (0..outer).flat_map(|row| {
            let lengths = lengths.iter().enumerate();
            lengths.flat_map(move |(source, length)| (row * length..(row + 1) * length).map(move |at| (source, at)))
        });
        self.moved(&sources, shape, places)
    }

    fn expand(&mut self, call: &Call<'_>) -> Result<Value, Refusal> {
        let input = call.input(0)?;
        let shape = sizes(&call.integers("shape", 1)?.unwrap_or_default())?;
        let shape = broadcast(&input.shape, &shape)?;
        self.repeated(input, &shape)
    }

    fn gather(&mut self, call: &Call<'_>) -> Result<Value, Refusal> {
        let (input, indices) = (call.input(0)?, call.input(1)?);
        let axis = index(call.integer("axis", 0), input.shape.len())?;
        let (outer, rest) = input.shape.split_at(axis);
        let (&size, inner) = rest.split_first().ok_or("it gathers from one number")?;
        let numbers = indices.integers().ok_or("its indices must be constant integers")?;
        let chosen = numbers.iter().map(|number| index(*number, size)).collect::<Result<Vec<_>, _>>()?;
        let shape = [outer, &indices.shape, inner].concat();
        let (rows, run): (usize, usize) = (outer.iter().product(), inner.iter().product());
        let places = (0..rows).flat_map(|row| {
            let starts = chosen.iter().map(move |at| (row * size + at) * run);
            starts.flat_map(move |start| (start..start + run).map(|place| (0, place)))
        });
        self.moved(&[input], shape, places)
    }

    fn slice(&mut self, call: &Call<'_>) -> Result<Value, Refusal> {
        let input = call.input(0)?;
        let rank = input.shape.len();
        let (starts, ends) =
            (call.integers("starts", 1)?.unwrap_or_default(), call.integers("ends", 2)?.unwrap_or_default());
        let axes = call.integers("axes", 3)?.unwrap_or_else(|| (0..starts.len() as i64).collect());
        let steps = call.integers("steps", 4)?.unwrap_or_else(|| vec![1; starts.len()]);
        if [ends.len(), axes.len(), steps.len()] != [starts.len(); 3] {
            return Err("its starts, ends, axes and steps differ in number".into());
        }
        let (mut shape, mut along, mut first) = (input.shape.clone(), strides(&input.shape), 0);
        for (((start, end), number), step) in starts.into_iter().zip(ends).zip(axes).zip(steps) {
            let axis = index(number, rank)?;
            let size = input.shape[axis] as i64;
            if step == 0 {
                return Err("it has a step of 0".into());
            }
            // Indices beyond the ends are clamped; backwards, the end may be before the first.
            let (low, high) = if step > 0 { (0, size) } else { (-1, size - 1) };
            let bound = |at: i64| (if at < 0 { at.saturating_add(size) } else { at }).clamp(low, high);
            let (start, end) = (bound(start), bound(end));
            let length = if step > 0 { end - start } else { start - end };
            shape[axis] = length.max(0).unsigned_abs().div_ceil(step.unsigned_abs()) as usize;
            first += start as isize * along[axis];
            along[axis] = along[axis].saturating_mul(step as isize);
        }
        self.view(input, shape, &along, first)
    }

    /// The values of `Split`, the one operator with several.
    pub fn split(&mut self, call: &Call<'_>) -> Result<Vec<Value>, Refusal> {
        let input = call.input(0)?;
        let axis = index(call.integer("axis", 0), input.shape.len())?;
        let (size, parts) = (input.shape[axis], call.node.outputs.len());
        let lengths = match call.integers("split", 1)? {
            Some(lengths) => sizes(&lengths)?,
            None => {
                let length = size.div_ceil(parts);
                (0..parts).map(|part| length.min(size.saturating_sub(part * length))).collect()
            }
        };
        if lengths.iter().fold(0, |sum: usize, length| sum.saturating_add(*length)) != size || lengths.len() != parts {
            return Err(format!("it splits {size} into {lengths:?}").into());
        }
        let along = strides(&input.shape);
        let mut first = 0;
        let mut part = |length: usize| {
            let mut shape = input.shape.clone();
            shape[axis] = length;
            let value = self.view(input, shape, &along, first);
            first += length as isize * along[axis];
            value
        };
        lengths.into_iter().map(&mut part).collect()
    }

    fn transpose(&mut self, call: &Call<'_>) -> Result<Value, Refusal> {
        let input = call.input(0)?;
        let rank = input.shape.len();
        let order = match call.attribute("perm") {
            None => (0..rank).rev().collect(),
            Some(order) => sizes(&order.integers)?,
        };
        let mut sorted = order.clone();
        sorted.sort_unstable();
        if !sorted.into_iter().eq(0..rank) {
            return Err(format!("{order:?} is not an order of {rank} axes").into());
        }
        self.transposed(input, &order)
    }

    /// A value with its axes in another order.
    pub fn transposed(&mut self, input: &Value, order: &[usize]) -> Result<Value, Refusal> {
        let along = strides(&input.shape);
        let shape = order.iter().map(|&axis| input.shape[axis]).collect();
        self.view(input, shape, &order.iter().map(|&axis| along[axis]).collect::<Vec<_>>(), 0)
    }
}

fn cast(call: &Call<'_>) -> Result<Value, Refusal> {
    let input = call.input(0)?;
    match (call.integer("to", 0), &input.data) {
        (F32, Data::Floats(_) | Data::Computed(_)) | (I32 | I64, Data::Integers(_)) => Ok(input.clone()),
        (F32, Data::Integers(numbers)) => {
            let data = Data::Floats(numbers.iter().map(|&number| number as f32).collect());
            Ok(Value { shape: input.shape.clone(), data })
        }
        (to, _) => Err(format!("a cast to {} is not supported", kind(to)).into()),
    }
}

fn constant(call: &Call<'_>) -> Result<Value, Refusal> {
    let [attribute] = call.node.attributes.as_slice() else { return Err("it needs one value".into()) };
    let name = call.node.outputs.first().copied().unwrap_or_default();
    match (attribute.name, &attribute.tensor) {
        ("value", Some(tensor)) => Value::of_tensor(tensor, name),
        ("value_float", _) => Ok(Value::scalar(attribute.float)),
        ("value_floats", _) => {
            Ok(Value { shape: vec![attribute.floats.len()], data: Data::Floats(attribute.floats.as_slice().into()) })
        }
        ("value_int", _) => Ok(Value { shape: vec![], data: Data::Integers([attribute.integer].into()) }),
        ("value_ints", _) => Ok(Value::list(attribute.integers.iter().copied())),
        _ => Err("it has no value".into()),
    }
}

fn flatten(call: &Call<'_>) -> Result<Value, Refusal> {
    let input = call.input(0)?;
    let rank = input.shape.len();
    let number = call.integer("axis", 1);
    let at = if number == rank as i64 { rank } else { index(number, rank)? };
    let (rows, columns) = input.shape.split_at(at);
    Ok(Value { shape: vec![rows.iter().product(), columns.iter().product()], data: input.data.clone() })
}

fn reshape(call: &Call<'_>) -> Result<Value, Refusal> {
    let input = call.input(0)?;
    let spec = call.integers("shape", 1)?.unwrap_or_default();
    let total = count(&input.shape)?;
    let wrong = || format!("the shape {:?} cannot become {spec:?}", input.shape);
    let is_copied = |size: i64| size == 0 && call.integer("allowzero", 0) == 0;
    let mut shape = Vec::new();
    for (axis, &size) in spec.iter().enumerate() {
        shape.push(match size {
            -1 => 1,
            size if is_copied(size) => *input.shape.get(axis).ok_or_else(wrong)?,
            size => usize::try_from(size).map_err(|_| wrong())?,
        });
    }
    if let Some(open) = spec.iter().position(|&size| size == -1) {
        shape[open] = total / count(&shape)?;
    }
    if count(&shape)? != total || spec.iter().filter(|&&size| size == -1).count() > 1 {
        return Err(wrong().into());
    }
    Ok(Value { shape, data: input.data.clone() })
}

fn squeeze(call: &Call<'_>) -> Result<Value, Refusal> {
    let input = call.input(0)?;
    let rank = input.shape.len();
    let removed = match call.integers("axes", 1)? {
        Some(axes) => axes.into_iter().map(|number| index(number, rank)).collect::<Result<Vec<_>, _>>()?,
        None => (0..rank).filter(|&axis| input.shape[axis] == 1).collect(),
    };
    if let Some(axis) = removed.iter().find(|&&axis| input.shape[axis] != 1) {
        return Err(format!("axis {axis} of the shape {:?} is not 1", input.shape).into());
    }
    let kept = (0..rank).filter(|axis| !removed.contains(axis)).map(|axis| input.shape[axis]);
    Ok(Value { shape: kept.collect(), data: input.data.clone() })
}

fn unsqueeze(call: &Call<'_>) -> Result<Value, Refusal> {
    let input = call.input(0)?;
    let axes = call.integers("axes", 1)?.unwrap_or_default();
    let rank = input.shape.len() + axes.len();
    let added = axes.into_iter().map(|number| index(number, rank)).collect::<Result<Vec<_>, _>>()?;
    let mut sizes = input.shape.iter().copied();
    let shape: Vec<usize> =
        (0..rank).map(|axis| if added.contains(&axis) { 1 } else { sizes.next().unwrap_or(1) }).collect();
    match sizes.next() {
        None => Ok(Value { shape, data: input.data.clone() }),
        Some(_) => Err(format!("it names an axis twice: {added:?}").into()),
    }
}

fn sizes(numbers: &[i64]) -> Result<Vec<usize>, String> {
    let sizes: Result<Vec<usize>, _> = numbers.iter().map(|number| usize::try_from(*number)).collect();
    sizes.map_err(|_| format!("{numbers:?} are not sizes"))
}
