//! An ONNX network with one input and one output, loaded and checked.

use std::fmt::Display;
use std::io::Read;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::Path;
use std::sync::Arc;

use sha2::{Digest, Sha256};
use tract_onnx::pb;
use tract_onnx::prelude::{
    Datum, DatumExt, Framework, InferenceFact, InferenceModelExt, IntoRunnable, IntoTValue, Tensor, TypedRunnableModel,
    TypedSimpleState, tvec,
};
use tract_onnx::tract_hir::infer::Factoid;
use tract_onnx::tract_hir::internal::DimLike;

use crate::{ForeignError, ModelFile};

/// Largest file that is read: six times the size of GEAR-SONIC's decoder in f32.
const FILE_LIMIT: u64 = 256 << 20;
/// First bytes of a file that Git LFS did not fetch.
const LFS_POINTER: &[u8] = b"version https://git-lfs";

/// A network that was run once on zeros and gave finite numbers. Any number of runners can share it.
#[derive(Debug, Clone)]
pub struct Model {
    plan: Arc<TypedRunnableModel>,
    file: ModelFile,
    digest: String,
}

impl Model {
    /// Reads a network; if `digest` (64 lower-case hexadecimal digits) is given, the file's SHA-256 must equal it.
    ///
    /// # Errors
    /// [`ForeignError`], with the path: missing (the message says where to get it), too large, another digest, not
    /// ONNX, weights in another file, another shape, or numbers that are not finite.
    pub fn read(path: &Path, file: &ModelFile, digest: Option<&str>) -> Result<Self, ForeignError> {
        let unreadable = |source: std::io::Error| match source.kind() {
            std::io::ErrorKind::NotFound => ForeignError::Missing { path: path.into(), source_of: file.source },
            _ => ForeignError::Read { path: path.into(), source },
        };
        let opened = std::fs::File::open(path).map_err(unreadable)?;
        let mut bytes = Vec::new();
        opened.take(FILE_LIMIT + 1).read_to_end(&mut bytes).map_err(unreadable)?;
        if bytes.len() as u64 > FILE_LIMIT {
            return Err(ForeignError::FileSize { path: path.into(), most: FILE_LIMIT });
        }
        if bytes.starts_with(LFS_POINTER) {
            return Err(ForeignError::Pointer { path: path.into() });
        }
        let model = Self::from_bytes(&bytes, path, file)?;
        match digest.filter(|expected| *expected != model.digest) {
            None => Ok(model),
            Some(expected) => {
                Err(ForeignError::Digest { path: path.into(), found: model.digest, expected: expected.into() })
            }
        }
    }

    /// Loads a network from memory; errors call it `path`.
    ///
    /// # Errors
    /// As for [`Model::read`], except those of reading the file.
    pub fn from_bytes(bytes: &[u8], path: &Path, file: &ModelFile) -> Result<Self, ForeignError> {
        let onnx = |problem: String| ForeignError::Onnx { path: path.into(), problem };
        // The loader indexes by the file's own names and shapes, and panics when a damaged file makes them
        // inconsistent.
        let caught = catch_unwind(AssertUnwindSafe(|| load(bytes, path, file)));
        let plan = caught.unwrap_or_else(|_| Err(onnx("its graph is inconsistent".into())))?;
        let digest = Sha256::digest(bytes).iter().map(|byte| format!("{byte:02x}")).collect();
        let model = Self { plan, file: *file, digest };
        let mut output = vec![0.0; file.outputs];
        let run = || model.runner().and_then(|mut runner| runner.run(&vec![0.0; file.inputs], &mut output));
        let ran = catch_unwind(AssertUnwindSafe(run)).unwrap_or_else(|_| Err("it cannot be run".into()));
        ran.map_err(onnx)?;
        Ok(model)
    }

    /// SHA-256 of the file, hexadecimal.
    pub fn digest(&self) -> &str {
        &self.digest
    }

    /// Size of the network's input.
    pub fn inputs(&self) -> usize {
        self.file.inputs
    }

    /// Size of the network's output.
    pub fn outputs(&self) -> usize {
        self.file.outputs
    }

    pub(crate) fn runner(&self) -> Result<Runner, String> {
        let state = self.plan.spawn().map_err(said)?;
        Ok(Runner { state })
    }
}

/// Runs a network, with the buffers for it.
#[derive(Debug)]
pub(crate) struct Runner {
    state: TypedSimpleState,
}

impl Runner {
    /// Runs the network once. It allocates the input, the output and the values between layers.
    pub fn run(&mut self, input: &[f32], output: &mut [f32]) -> Result<(), String> {
        let tensor = Tensor::from_shape(&[1, input.len()], input).map_err(said)?;
        let outputs = self.state.run(tvec![tensor.into_tvalue()]).map_err(said)?;
        let first = outputs.first().ok_or("it has no output")?;
        let view = first.try_as_plain_ram().map_err(said)?;
        let numbers = view.as_slice::<f32>().map_err(said)?;
        if numbers.len() != output.len() {
            return Err(format!("its output has {} numbers instead of {}", numbers.len(), output.len()));
        }
        if let Some(index) = numbers.iter().position(|number| !number.is_finite()) {
            return Err(format!("number {index} of its output is {}", numbers[index]));
        }
        output.copy_from_slice(numbers);
        Ok(())
    }
}

fn load(bytes: &[u8], path: &Path, file: &ModelFile) -> Result<Arc<TypedRunnableModel>, ForeignError> {
    let onnx = |problem: String| ForeignError::Onnx { path: path.into(), problem };
    // Shapes between layers follow from the input; those noted in the file may have a symbol for the batch.
    let framework = tract_onnx::onnx().with_ignore_value_info(true);
    let proto = framework.proto_model_for_read(&mut &*bytes).map_err(|error| onnx(said(error)))?;
    check_weights(&proto, path)?;
    let shape = |side, expected: usize, found: String| ForeignError::Shape {
        path: path.into(),
        side,
        expected: format!("f32 [1, {expected}]"),
        found,
    };
    let mut model = framework.model_for_proto_model(&proto).map_err(|error| onnx(said(error)))?;
    let (inputs, outputs) = (model.inputs.len(), model.outputs.len());
    if (inputs, outputs) != (1, 1) {
        return Err(onnx(format!("it has {inputs} inputs and {outputs} outputs instead of one each")));
    }
    let declared = model.input_fact(0).map_err(|error| onnx(said(error)))?.clone();
    if !takes(&declared, file.inputs) {
        return Err(shape("input", file.inputs, format!("{declared:?}")));
    }
    let fact = f32::fact([1, file.inputs]);
    model.set_input_fact(0, fact.into()).map_err(|error| onnx(said(error)))?;
    let model = model.into_optimized().map_err(|error| onnx(said(error)))?;
    let output = model.output_fact(0).map_err(|error| onnx(said(error)))?;
    let sides = output.shape.as_concrete();
    if output.datum_type != f32::datum_type() || sides != Some(&[1, file.outputs]) {
        return Err(shape("output", file.outputs, format!("{output:?}")));
    }
    model.into_runnable().map_err(|error| onnx(said(error)))
}

/// Whether the input declared in the file accepts f32 [1, inputs]: the batch may be open, the width may not.
fn takes(declared: &InferenceFact, inputs: usize) -> bool {
    let dims: Vec<_> = declared.shape.dims().map(|dim| dim.concretize().and_then(|dim| dim.to_usize().ok())).collect();
    let is_f32 = declared.datum_type.concretize() == Some(f32::datum_type());
    is_f32 && matches!(dims.as_slice(), [None | Some(1), Some(width)] if *width == inputs)
}

/// Refuses weights in another file, and weights that are not finite.
fn check_weights(proto: &pb::ModelProto, path: &Path) -> Result<(), ForeignError> {
    let Some(graph) = &proto.graph else { return Ok(()) };
    let constants = graph.node.iter().flat_map(|node| &node.attribute).filter_map(|attribute| attribute.t.as_ref());
    for tensor in graph.initializer.iter().chain(constants) {
        if !tensor.external_data.is_empty() {
            let problem = format!("its tensor '{}' is stored in another file", tensor.name);
            return Err(ForeignError::Onnx { path: path.into(), problem });
        }
        let raw = tensor.raw_data.as_chunks().0.iter().map(|number| f32::from_le_bytes(*number));
        let is_f32 = tensor.data_type == pb::tensor_proto::DataType::Float as i32;
        let mut numbers = tensor.float_data.iter().copied().chain(raw.filter(|_| is_f32));
        if let Some(index) = numbers.position(|number| !number.is_finite()) {
            return Err(ForeignError::Weights { path: path.into(), tensor: tensor.name.clone(), index });
        }
    }
    Ok(())
}

/// An error with its causes, on one line.
fn said(error: impl Display) -> String {
    format!("{error:#}")
}
