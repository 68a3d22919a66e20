"""Results of onnxruntime for every operator that crates/foreign reads: networks whose output is that of all cases.

    FIATLUX_PYTHON tests/oracle/operators.py crates/foreign/tests/fixtures

Writes operators9.onnx, operators17.onnx and operators21.onnx, one for each of three versions of the operator set, and
operators.safetensors: the inputs, the outputs, and in its metadata the name of each case and how many numbers it has.

Needs numpy, onnx and onnxruntime (foreign.requirements.txt).
"""

import sys
from pathlib import Path

import numpy as np
import onnx
import onnxruntime
from foreign import write_safetensors
from onnx import TensorProto, helper, numpy_helper

ROWS, INPUTS = 4, 24
RANDOM = np.random.default_rng(5)
INT_MAX = 2**63 - 1


class Graph:
    """A network under construction: `x` is its input [1, 24]; `grid` is the same numbers as [2, 3, 4]."""

    def __init__(self, version):
        self.version, self.nodes, self.tensors, self.cases = version, [], [], []
        self.grid = self.node("Reshape", ["x", ints(2, 3, 4)])
        self.positive = self.node("Add", [self.node("Abs", ["x"]), floats(0.1)])

    def name(self):
        return f"v{len(self.nodes) + len(self.tensors)}"

    def node(self, operator, inputs, outputs=1, **attributes):
        """Adds a node; inputs are names, arrays that become tensors, or None."""
        names = []
        for given in inputs:
            if isinstance(given, np.ndarray):
                self.tensors.append(numpy_helper.from_array(given, self.name()))
                given = self.tensors[-1].name
            names.append(given or "")
        made = [f"{self.name()}_{index}" for index in range(outputs)]
        self.nodes.append(helper.make_node(operator, names, made, **attributes))
        return made[0] if outputs == 1 else made

    def case(self, operator, inputs, label="", outputs=1, **attributes):
        """A node whose output the test compares."""
        made = self.node(operator, inputs, outputs, **attributes)
        for value in [made] if outputs == 1 else made:
            self.show(operator + label, value)

    def show(self, label, value):
        self.cases.append((label, self.node("Reshape", [value, ints(1, -1)])))

    def model(self):
        self.nodes.append(helper.make_node("Concat", [value for _, value in self.cases], ["all"], axis=1))
        ports = [
            helper.make_tensor_value_info(name, TensorProto.FLOAT, [1, width])
            for name, width in [("x", INPUTS), ("all", None)]
        ]
        graph = helper.make_graph(self.nodes, "operators", ports[:1], ports[1:], self.tensors)
        sets = [helper.make_opsetid("", self.version)]
        model = helper.make_model(graph, opset_imports=sets, ir_version=8)
        onnx.checker.check_model(model)
        return model


def ints(*numbers):
    return np.array(numbers, np.int64)


def floats(*numbers):
    return np.array(numbers if len(numbers) > 1 else numbers[0], np.float32)


def random(*shape):
    return RANDOM.standard_normal(shape).astype(np.float32)


def arithmetic(graph):
    x, grid, positive = "x", graph.grid, graph.positive
    for operator in "Abs Ceil Erf Exp Floor Identity Neg Relu Selu Sigmoid Softplus Tanh Elu LeakyRelu".split():
        graph.case(operator, [x])
    for operator in "Log Reciprocal Sqrt".split():
        graph.case(operator, [positive])
    graph.case("Elu", [x], ".alpha", alpha=0.7)
    graph.case("LeakyRelu", [x], ".alpha", alpha=0.2)
    graph.case("Selu", [x], ".alpha", alpha=1.5, gamma=1.1)
    for operator in "Add Sub Mul Div Max Min".split():
        graph.case(operator, [x, positive])
        graph.case(operator, [grid, random(3, 1)], ".broadcast")
        graph.case(operator, [random(5, 1, 1, 1), grid], ".left")
    graph.case("Max", [grid, random(4), random(2, 1, 1)], ".three")
    graph.case("Pow", [positive, floats(1.7)])
    graph.case("PRelu", [grid, random(3, 1)])
    for operator in "ReduceL2 ReduceMax ReduceMean ReduceMin ReduceSum".split():
        graph.case(operator, [grid], ".all")
    graph.case("MatMul", [grid, random(4, 19)])
    graph.case("MatMul", [graph.node("Reshape", [x, ints(24)]), random(24, 5)], ".vector")
    graph.case("Gemm", [x, random(24, 7), random(7)])
    graph.case("Gemm", [x, random(70, 24), random(1, 70)], ".transposed", transB=1, alpha=0.5, beta=0.25)
    columns = graph.node("Reshape", [x, ints(6, 4)])
    graph.case("Gemm", [columns, random(6, 3), floats(0.5)], ".rows", transA=1)
    constant = graph.node("Mul", [random(4, 3), floats(2.0)])
    graph.case("MatMul", [grid, graph.node("Transpose", [graph.node("Transpose", [constant])])], ".folded")


def arrangement(graph):
    x, grid = "x", graph.grid
    graph.case("Concat", [grid, random(2, 1, 4), grid], axis=1)
    graph.case("Concat", [x, random(1, 3)], ".last", axis=-1)
    graph.case("Flatten", [grid], axis=2)
    graph.case("Flatten", [grid], ".default")
    graph.case("Gather", [grid, ints(2, 0, -1)], axis=1)
    graph.case("Gather", [grid, np.array(1, np.int64)], ".one", axis=-1)
    graph.case("Reshape", [grid, ints(0, -1)])
    graph.case("Transpose", [grid])
    graph.case("Transpose", [grid], ".perm", perm=[1, 0, 2])
    graph.case("Expand", [graph.node("Reshape", [x, ints(24, 1)]), ints(2, 1, 3)])
    # A shape that follows from the input, as PyTorch writes it for an open batch.
    batch = graph.node("Gather", [graph.node("Shape", [x]), ints(0)], axis=0)
    quarter = graph.node("Div", [graph.node("Mul", [ints(24), batch]), graph.node("Add", [ints(3), batch])])
    shape = graph.node("Concat", [quarter, graph.node("Sub", [ints(5), ints(1)])], axis=0)
    graph.case("Reshape", [x, shape], ".computed")
    pairs = graph.node("Reshape", [x, ints(12, 2)])
    graph.case("Mul", [pairs, graph.node("Cast", [shape], to=TensorProto.FLOAT)], ".cast")
    value = graph.node("Constant", [], value=numpy_helper.from_array(np.array([1.5, -2.0]), "c"))
    graph.case("Mul", [pairs, graph.node("Cast", [value], to=TensorProto.FLOAT)], ".constant")


def by_attribute(graph):
    """Arguments as attributes, as up to set 9 or 12."""
    x, grid = "x", graph.grid
    graph.case("Clip", [x], min=-0.4, max=0.9)
    graph.case("Clip", [x], ".max", max=0.1)
    graph.case("Slice", [grid], axes=[1, 2], starts=[1, -3], ends=[INT_MAX, 4])
    graph.case("Slice", [grid], ".default", starts=[1], ends=[2])
    graph.case("Squeeze", [x], axes=[0])
    graph.case("Unsqueeze", [x], axes=[0, 3])
    graph.case("Split", [grid], outputs=2, axis=2, split=[1, 3])
    graph.case("Split", [grid], ".equal", outputs=3, axis=1)


def by_input(graph):
    """Arguments as inputs, as from set 10, 11 or 13 on."""
    x, grid = "x", graph.grid
    graph.case("Round", [graph.node("Mul", [graph.node("Round", [graph.node("Mul", [x, floats(4.0)])]), floats(0.5)])])
    graph.case("Clip", [x, floats(-0.4), floats(0.9)])
    graph.case("Clip", [x, None, floats(0.1)], ".max")
    graph.case("Slice", [grid, ints(1, -3), ints(INT_MAX, 4), ints(1, 2)])
    graph.case("Slice", [grid, ints(-1, 3), ints(-INT_MAX, 0), ints(0, -1), ints(-1, -2)], ".backwards")
    graph.case("Slice", [x, ints(0), ints(24), ints(1), ints(5)], ".steps")
    graph.case("Squeeze", [x, ints(0)])
    graph.case("Squeeze", [x], ".all")
    graph.case("Unsqueeze", [x, ints(0, -1)])
    graph.case("Split", [grid, ints(1, 3)], outputs=2, axis=2)
    graph.case("Split", [grid], ".equal", outputs=3, axis=1, **({"num_outputs": 3} if graph.version >= 18 else {}))
    graph.case("LayerNormalization", [grid, random(4), random(4)])
    graph.case("LayerNormalization", [grid, random(3, 4)], ".axis", axis=1, epsilon=0.1)


def reductions(graph):
    for operator in "ReduceL2 ReduceMax ReduceMean ReduceMin ReduceSum".split():
        is_input = graph.version >= 18 or graph.version >= 13 and operator == "ReduceSum"
        for label, axes, more in [(".middle", [1], {}), (".outer", [0, -1], {"keepdims": 0})]:
            if is_input:
                graph.case(operator, [graph.grid, ints(*axes)], label, **more)
            else:
                graph.case(operator, [graph.grid], label, axes=axes, **more)


def main():
    folder = Path(sys.argv[1])
    inputs = 2.0 * random(ROWS, INPUTS)
    tensors, names = {"input": inputs}, {}
    for version in [9, 17, 21]:
        graph = Graph(version)
        arithmetic(graph)
        arrangement(graph)
        reductions(graph)
        by_attribute(graph) if version == 9 else by_input(graph)
        path, model = folder / f"operators{version}.onnx", graph.model()
        onnx.save(model, path)
        counts = [made.size for made in results(model, [value for _, value in graph.cases], inputs[:1])]
        names[str(version)] = " ".join(f"{label}:{count}" for (label, _), count in zip(graph.cases, counts))
        tensors[f"output{version}"] = np.concatenate([results(model, ["all"], row[None])[0] for row in inputs])
        print(f"set {version}: {len(counts)} cases, {path.stat().st_size} bytes")
    write_safetensors(folder / "operators.safetensors", tensors, names)


def results(model, names, x):
    """Values of a network, for one input."""
    del model.graph.output[:]
    model.graph.output.extend(helper.make_tensor_value_info(name, TensorProto.FLOAT, [1, None]) for name in names)
    return onnxruntime.InferenceSession(model.SerializeToString(), providers=["CPUExecutionProvider"]).run(
        None, {"x": x}
    )


if __name__ == "__main__":
    main()
