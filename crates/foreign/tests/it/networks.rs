//! Random networks as ONNX files, for tests and timings.

use prost::Message;
use rand_pcg::Pcg64Mcg;
use rand_pcg::rand_core::Rng as _;
use tract_onnx::pb;
use tract_onnx::pb::tensor_shape_proto::{Dimension, dimension};
use tract_onnx::pb::{attribute_proto, tensor_proto, type_proto};

/// A multilayer perceptron with ELU between these sizes, as PyTorch exports it.
pub fn perceptron(sizes: &[usize], seed: u128) -> pb::ModelProto {
    let mut random = Pcg64Mcg::new(seed | 1);
    let mut draw = |bound: f32| ((random.next_u64() >> 40) as f32 / (1_u64 << 23) as f32 - 1.0) * bound;
    let last = sizes.len() - 2;
    let (mut node, mut initializer) = (Vec::new(), Vec::new());
    for (layer, pair) in sizes.windows(2).enumerate() {
        let (inputs, outputs) = (pair[0], pair[1]);
        let bound = (3.0 / inputs as f32).sqrt();
        let from = if layer == 0 { "obs".into() } else { format!("hidden{}", layer - 1) };
        let to = if layer == last { "actions".into() } else { format!("sum{layer}") };
        initializer.push(tensor(&format!("w{layer}"), &[outputs, inputs], || draw(bound)));
        initializer.push(tensor(&format!("b{layer}"), &[outputs], || draw(0.1)));
        let transposed = pb::AttributeProto {
            name: "transB".into(),
            i: 1,
            r#type: attribute_proto::AttributeType::Int as i32,
            ..Default::default()
        };
        let gemm = operator("Gemm", &[&from, &format!("w{layer}"), &format!("b{layer}")], &to);
        node.push(pb::NodeProto { attribute: vec![transposed], ..gemm });
        if layer < last {
            node.push(operator("Elu", &[&to], &format!("hidden{layer}")));
        }
    }
    let graph = pb::GraphProto {
        name: "policy".into(),
        node,
        initializer,
        input: vec![value("obs", sizes[0])],
        output: vec![value("actions", sizes[sizes.len() - 1])],
        ..Default::default()
    };
    pb::ModelProto {
        ir_version: 8,
        opset_import: vec![pb::OperatorSetIdProto { version: 17, ..Default::default() }],
        graph: Some(graph),
        ..Default::default()
    }
}

/// The bytes of an ONNX file.
pub fn bytes(model: &pb::ModelProto) -> Vec<u8> {
    model.encode_to_vec()
}

fn operator(kind: &str, inputs: &[&str], output: &str) -> pb::NodeProto {
    pb::NodeProto {
        op_type: kind.into(),
        input: inputs.iter().map(|&name| name.into()).collect(),
        output: vec![output.into()],
        ..Default::default()
    }
}

fn tensor(name: &str, shape: &[usize], mut draw: impl FnMut() -> f32) -> pb::TensorProto {
    let count = shape.iter().product();
    pb::TensorProto {
        name: name.into(),
        dims: shape.iter().map(|&side| side as i64).collect(),
        data_type: tensor_proto::DataType::Float as i32,
        raw_data: (0..count).flat_map(|_: usize| draw().to_le_bytes()).collect(),
        ..Default::default()
    }
}

fn value(name: &str, width: usize) -> pb::ValueInfoProto {
    let side = |side| Dimension { value: Some(dimension::Value::DimValue(side)), ..Default::default() };
    let shape = pb::TensorShapeProto { dim: vec![side(1), side(width as i64)] };
    let kind = type_proto::Tensor { elem_type: tensor_proto::DataType::Float as i32, shape: Some(shape) };
    let kind = pb::TypeProto { value: Some(type_proto::Value::TensorType(kind)), ..Default::default() };
    pb::ValueInfoProto { name: name.into(), r#type: Some(kind), ..Default::default() }
}
