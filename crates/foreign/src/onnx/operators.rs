//! The operators (onnx.ai/onnx/operators), in all their versions from set 7 on: arguments that older versions have as an
//! newer ones have as an input.

use fiatlux_nets::{Dense, LANES};

use super::Refusal;
use super::file::{Attribute, Node};
use super::load::Loader;
use super::steps::{Kernel, Map, Reduction, Zip};
use super::value::{Data, Value, broadcast, index};

pub(super) struct Call<'c> {
    pub node: &'c Node<'c>,
    pub inputs: &'c [Option<Value>],
}

impl Call<'_> {
    pub fn input(&self, index: usize) -> Result<&Value, Refusal> {
        self.optional(index).ok_or_else(|| format!("it has no input {index}").into())
    }

    pub fn optional(&self, index: usize) -> Option<&Value> {
        self.inputs.get(index)?.as_ref()
    }

    pub fn attribute(&self, name: &str) -> Option<&Attribute<'_>> {
        self.node.attributes.iter().find(|attribute| attribute.name == name)
    }

    pub fn integer(&self, name: &str, default: i64) -> i64 {
        self.attribute(name).map_or(default, |attribute| attribute.integer)
    }

    pub fn float(&self, name: &str, default: f32) -> f32 {
        self.attribute(name).map_or(default, |attribute| attribute.float)
    }

    /// Integers from an attribute, or else from an input, which must be constant.
    pub fn integers(&self, name: &str, index: usize) -> Result<Option<Vec<i64>>, Refusal> {
        if let Some(attribute) = self.attribute(name) {
            return Ok(Some(attribute.integers.clone()));
        }
        let Some(input) = self.optional(index) else { return Ok(None) };
        let numbers = input.integers().ok_or_else(|| format!("its {name} must be constant integers"))?;
        Ok(Some(numbers.to_vec()))
    }
}

/// The attributes of an operator; `None` for an operator that is not supported.
fn attributes(operator: &str) -> Option<&'static [&'static str]> {
    Some(match operator {
        "Abs" | "Add" | "Ceil" | "Div" | "Erf" | "Exp" | "Expand" | "Floor" | "Identity" | "Log" | "MatMul" | "Max"
        | "Min" | "Mul" | "Neg" | "PRelu" | "Pow" | "Reciprocal" | "Relu" | "Round" | "Shape" | "Sigmoid"
        | "Softplus" | "Sqrt" | "Sub" | "Tanh" => &[],
        "Cast" => &["to"],
        "Clip" => &["min", "max"],
        "Concat" | "Flatten" | "Gather" => &["axis"],
        "Constant" => &["value", "value_float", "value_floats", "value_int", "value_ints"],
        "Elu" | "LeakyRelu" => &["alpha"],
        "Gemm" => &["alpha", "beta", "transA", "transB"],
        "LayerNormalization" => &["axis", "epsilon", "stash_type"],
        "ReduceL2" | "ReduceMax" | "ReduceMean" | "ReduceMin" | "ReduceSum" => {
            &["axes", "keepdims", "noop_with_empty_axes"]
        }
        "Reshape" => &["allowzero"],
        "Selu" => &["alpha", "gamma"],
        "Slice" => &["axes", "ends", "starts"],
        "Split" => &["axis", "num_outputs", "split"],
        "Squeeze" | "Unsqueeze" => &["axes"],
        "Transpose" => &["perm"],
        _ => return None,
    })
}

impl Loader {
    pub fn operator(&mut self, node: &Node<'_>, inputs: &[Option<Value>]) -> Result<Vec<Value>, Refusal> {
        let attributes = attributes(node.operator).ok_or("it is not supported")?;
        if let Some(other) = node.attributes.iter().find(|attribute| !attributes.contains(&attribute.name)) {
            return Err(format!("its attribute {} is not supported", other.name).into());
        }
        let call = Call { node, inputs };
        let value = match node.operator {
            "Add" => self.pair(Zip::Add, &call),
            "Clip" => self.clip(&call),
            "Div" => self.pair(Zip::Div, &call),
            "Gemm" => self.gemm(&call),
            "LayerNormalization" => self.layer_normalization(&call),
            "MatMul" => self.dense(call.input(0)?, call.input(1)?, false, 1.0),
            "Max" => self.fold(Zip::Max, &call),
            "Min" => self.fold(Zip::Min, &call),
            "Mul" => self.pair(Zip::Mul, &call),
            "PRelu" => self.pair(Zip::PRelu, &call),
            "Pow" => self.pair(Zip::Pow, &call),
            "ReduceL2" => self.reduce(Reduction::L2, &call),
            "ReduceMax" => self.reduce(Reduction::Max, &call),
            "ReduceMean" => self.reduce(Reduction::Mean, &call),
            "ReduceMin" => self.reduce(Reduction::Min, &call),
            "ReduceSum" => self.reduce(Reduction::Sum, &call),
            "Split" => return self.split(&call),
            "Sub" => self.pair(Zip::Sub, &call),
            _ => match map(&call) {
                Some(map) => self.map(map, call.input(0)?),
                None => self.arranged(&call),
            },
        };
        Ok(vec![value?])
    }

    fn map(&mut self, map: Map, input: &Value) -> Result<Value, Refusal> {
        self.computed(Kernel::Map(map), &[input], input.shape.clone())
    }

    fn clip(&mut self, call: &Call<'_>) -> Result<Value, Refusal> {
        let bound = |name: &str, index: usize, default: f32| match call.optional(index) {
            None => Ok(call.float(name, default)),
            Some(value) => match value.floats() {
                Some([bound]) => Ok(*bound),
                _ => Err(format!("its {name} must be one constant number")),
            },
        };
        let (least, most) = (bound("min", 1, f32::NEG_INFINITY)?, bound("max", 2, f32::INFINITY)?);
        self.map(Map::Clip { least, most }, call.input(0)?)
    }

    fn pair(&mut self, zip: Zip, call: &Call<'_>) -> Result<Value, Refusal> {
        self.zip(zip, call.input(0)?, call.input(1)?)
    }

    /// An operator with any number of inputs.
    fn fold(&mut self, zip: Zip, call: &Call<'_>) -> Result<Value, Refusal> {
        let mut value = call.input(0)?.clone();
        for index in 1..call.inputs.len() {
            value = self.zip(zip, &value, call.input(index)?)?;
        }
        Ok(value)
    }

    fn zip(&mut self, zip: Zip, left: &Value, right: &Value) -> Result<Value, Refusal> {
        let shape = broadcast(&left.shape, &right.shape)?;
        let (left, right) = (self.repeated(left, &shape)?, self.repeated(right, &shape)?);
        let (Some(ones), Some(others)) = (left.integers(), right.integers()) else {
            return self.computed(Kernel::Zip(zip), &[&left, &right], shape);
        };
        // Integer arithmetic on shapes.
        let of = match zip {
            Zip::Add => i64::checked_add,
            Zip::Div => i64::checked_div,
            Zip::Mul => i64::checked_mul,
            Zip::Sub => i64::checked_sub,
            _ => return Err("it is not supported for integers".into()),
        };
        let numbers: Option<_> = ones.iter().zip(others).map(|(one, other)| of(*one, *other)).collect();
        Ok(Value { shape, data: Data::Integers(numbers.ok_or("its integers overflow")?) })
    }

    fn reduce(&mut self, reduction: Reduction, call: &Call<'_>) -> Result<Value, Refusal> {
        let input = call.input(0)?;
        let rank = input.shape.len();
        let axes = call.integers("axes", 1)?.unwrap_or_default();
        if axes.is_empty() && call.integer("noop_with_empty_axes", 0) != 0 {
            return Ok(input.clone());
        }
        let axes = axes.into_iter().map(|number| index(number, rank)).collect::<Result<Vec<_>, _>>()?;
        let is_reduced = |axis: &usize| axes.is_empty() || axes.contains(axis);
        // The reduced axes come last, so that each result is made of neighbours.
        let (last, first): (Vec<usize>, Vec<usize>) = (0..rank).partition(is_reduced);
        let width = last.iter().map(|&axis| input.shape[axis]).product();
        let kept = first.iter().map(|&axis| input.shape[axis]).collect();
        let rows = self.transposed(input, &[first, last].concat())?;
        let reduced = self.computed(Kernel::Reduce { reduction, width }, &[&rows], kept)?;
        if call.integer("keepdims", 1) == 0 {
            return Ok(reduced);
        }
        let size = |axis| if is_reduced(&axis) { 1 } else { input.shape[axis] };
        Ok(Value { shape: (0..rank).map(size).collect(), ..reduced })
    }

    fn layer_normalization(&mut self, call: &Call<'_>) -> Result<Value, Refusal> {
        let input = call.input(0)?;
        let axis = index(call.integer("axis", -1), input.shape.len())?;
        let kernel =
            Kernel::Standardize { width: input.shape[axis..].iter().product(), epsilon: call.float("epsilon", 1e-5) };
        let standard = self.computed(kernel, &[input], input.shape.clone())?;
        let scaled = self.zip(Zip::Mul, &standard, call.input(1)?)?;
        match call.optional(2) {
            Some(bias) => self.zip(Zip::Add, &scaled, bias),
            None => Ok(scaled),
        }
    }

    fn gemm(&mut self, call: &Call<'_>) -> Result<Value, Refusal> {
        let mut input = call.input(0)?.clone();
        if input.shape.len() != 2 {
            return Err(format!("its input has the shape {:?} instead of two axes", input.shape).into());
        }
        if call.integer("transA", 0) != 0 {
            input = self.transposed(&input, &[1, 0])?;
        }
        let product = self.dense(&input, call.input(1)?, call.integer("transB", 0) != 0, call.float("alpha", 1.0))?;
        let Some(bias) = call.optional(2) else { return Ok(product) };
        let beta = call.float("beta", 1.0);
        let bias = if beta == 1.0 { bias.clone() } else { self.zip(Zip::Mul, bias, &Value::scalar(beta))? };
        self.zip(Zip::Add, &product, &bias)
    }

    /// The rows of a value times constant weights and a factor.
    fn dense(&mut self, input: &Value, weights: &Value, is_transposed: bool, factor: f32) -> Result<Value, Refusal> {
        let numbers = weights.floats().ok_or("its second input must be constant weights")?;
        let wrong = || format!("it multiplies the shapes {:?} and {:?}", input.shape, weights.shape);
        let &[first, second] = weights.shape.as_slice() else { return Err(wrong().into()) };
        let (inputs, outputs) = if is_transposed { (second, first) } else { (first, second) };
        let rows = input.shape.split_last().filter(|(width, _)| **width == inputs).ok_or_else(wrong)?.1;
        let shape = [rows, &[outputs]].concat();
        let products = [inputs, outputs.next_multiple_of(LANES)].into_iter().chain(rows.iter().copied());
        self.spend(products.fold(1, usize::saturating_mul))?;
        let weight = |input: usize, output: usize| {
            factor * numbers[if is_transposed { output * inputs + input } else { input * outputs + output }]
        };
        self.computed(Kernel::Dense(Dense::new(inputs, outputs, weight, |_| 0.0)), &[input], shape)
    }
}

/// The function of an elementwise operator.
fn map(call: &Call<'_>) -> Option<Map> {
    Some(match call.node.operator {
        "Abs" => Map::Abs,
        "Ceil" => Map::Ceil,
        "Elu" => Map::Elu { alpha: call.float("alpha", 1.0) },
        "Erf" => Map::Erf,
        "Exp" => Map::Exp,
        "Floor" => Map::Floor,
        "LeakyRelu" => Map::LeakyRelu { alpha: call.float("alpha", 0.01) },
        "Log" => Map::Log,
        "Neg" => Map::Neg,
        "Reciprocal" => Map::Reciprocal,
        "Relu" => Map::Relu,
        "Round" => Map::Round,
        "Selu" => Map::Selu { alpha: call.float("alpha", 1.673_263_2), gamma: call.float("gamma", 1.050_701) },
        "Sigmoid" => Map::Sigmoid,
        "Softplus" => Map::Softplus,
        "Sqrt" => Map::Sqrt,
        "Tanh" => Map::Tanh,
        _ => return None,
    })
}
