//! Random networks as ONNX files, for tests and timings.

use prost::Message;
use rand_pcg::Pcg64Mcg;
use rand_pcg::rand_core::Rng as _;

/// The messages of ONNX that a network needs; the numbers are those of `onnx/onnx.proto` in github.com/onnx/onnx.
pub mod pb {
    use prost::Message;

    /// The code of f32 in `TensorProto.DataType`.
    pub const FLOAT: i32 = 1;

    #[derive(Clone, PartialEq, Message)]
    pub struct ModelProto {
        #[prost(int64, tag = "1")]
        pub ir_version: i64,
        #[prost(message, optional, tag = "7")]
        pub graph: Option<GraphProto>,
        #[prost(message, repeated, tag = "8")]
        pub opset_import: Vec<OperatorSetIdProto>,
    }

    #[derive(Clone, PartialEq, Message)]
    pub struct OperatorSetIdProto {
        #[prost(string, tag = "1")]
        pub domain: String,
        #[prost(int64, tag = "2")]
        pub version: i64,
    }

    #[derive(Clone, PartialEq, Message)]
    pub struct GraphProto {
        #[prost(message, repeated, tag = "1")]
        pub node: Vec<NodeProto>,
        #[prost(string, tag = "2")]
        pub name: String,
        #[prost(message, repeated, tag = "5")]
        pub initializer: Vec<TensorProto>,
        #[prost(message, repeated, tag = "11")]
        pub input: Vec<ValueInfoProto>,
        #[prost(message, repeated, tag = "12")]
        pub output: Vec<ValueInfoProto>,
    }

    #[derive(Clone, PartialEq, Message)]
    pub struct NodeProto {
        #[prost(string, repeated, tag = "1")]
        pub input: Vec<String>,
        #[prost(string, repeated, tag = "2")]
        pub output: Vec<String>,
        #[prost(string, tag = "4")]
        pub op_type: String,
        #[prost(message, repeated, tag = "5")]
        pub attribute: Vec<AttributeProto>,
        #[prost(string, tag = "7")]
        pub domain: String,
    }

    #[derive(Clone, PartialEq, Message)]
    pub struct AttributeProto {
        #[prost(string, tag = "1")]
        pub name: String,
        #[prost(int64, tag = "3")]
        pub i: i64,
        #[prost(message, optional, tag = "5")]
        pub t: Option<TensorProto>,
    }

    #[derive(Clone, PartialEq, Message)]
    pub struct TensorProto {
        #[prost(int64, repeated, tag = "1")]
        pub dims: Vec<i64>,
        #[prost(int32, tag = "2")]
        pub data_type: i32,
        #[prost(float, repeated, tag = "4")]
        pub float_data: Vec<f32>,
        #[prost(int64, repeated, tag = "7")]
        pub int64_data: Vec<i64>,
        #[prost(string, tag = "8")]
        pub name: String,
        #[prost(bytes, tag = "9")]
        pub raw_data: Vec<u8>,
        #[prost(message, repeated, tag = "13")]
        pub external_data: Vec<StringStringEntryProto>,
    }

    #[derive(Clone, PartialEq, Message)]
    pub struct StringStringEntryProto {
        #[prost(string, tag = "1")]
        pub key: String,
        #[prost(string, tag = "2")]
        pub value: String,
    }

    #[derive(Clone, PartialEq, Message)]
    pub struct ValueInfoProto {
        #[prost(string, tag = "1")]
        pub name: String,
        #[prost(message, optional, tag = "2")]
        pub r#type: Option<TypeProto>,
    }

    #[derive(Clone, PartialEq, Message)]
    pub struct TypeProto {
        #[prost(message, optional, tag = "1")]
        pub tensor_type: Option<TensorType>,
    }

    #[derive(Clone, PartialEq, Message)]
    pub struct TensorType {
        #[prost(int32, tag = "1")]
        pub elem_type: i32,
        #[prost(message, optional, tag = "2")]
        pub shape: Option<TensorShapeProto>,
    }

    #[derive(Clone, PartialEq, Message)]
    pub struct TensorShapeProto {
        #[prost(message, repeated, tag = "1")]
        pub dim: Vec<Dimension>,
    }

    #[derive(Clone, PartialEq, Message)]
    pub struct Dimension {
        #[prost(int64, optional, tag = "1")]
        pub dim_value: Option<i64>,
    }
}

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
        let transposed = pb::AttributeProto { name: "transB".into(), i: 1, ..Default::default() };
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
    };
    pb::ModelProto {
        ir_version: 8,
        opset_import: vec![pb::OperatorSetIdProto { version: 17, ..Default::default() }],
        graph: Some(graph),
    }
}

/// The bytes of an ONNX file.
pub fn bytes(model: &pb::ModelProto) -> Vec<u8> {
    model.encode_to_vec()
}

pub fn operator(kind: &str, inputs: &[&str], output: &str) -> pb::NodeProto {
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
        data_type: pb::FLOAT,
        raw_data: (0..count).flat_map(|_: usize| draw().to_le_bytes()).collect(),
        ..Default::default()
    }
}

fn value(name: &str, width: usize) -> pb::ValueInfoProto {
    let side = |side| pb::Dimension { dim_value: Some(side) };
    let shape = pb::TensorShapeProto { dim: vec![side(1), side(width as i64)] };
    let tensor_type = pb::TensorType { elem_type: pb::FLOAT, shape: Some(shape) };
    let kind = pb::TypeProto { tensor_type: Some(tensor_type) };
    pb::ValueInfoProto { name: name.into(), r#type: Some(kind) }
}
