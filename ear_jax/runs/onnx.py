"""Policies as ONNX, for robots and programs without JAX: LTEs and observations in, actions out.

The graph is written from a program of `rendering.live.programs`, the same from which the live page's policy is made.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ear_jax.errors import RunError
from ear_jax.files.replacing import replace_file

SUFFIX = ".onnx"
INPUTS, OUTPUTS = ("lte", "obs"), ("action", "mean", "log_std")
OPSET, IR_VERSION = 17, 8  # of 2022, which the runtimes in use read
TOLERANCE = 1e-4  # of actions, which lie in [−1, 1]

BINARY = {"add": "Add", "sub": "Sub", "mul": "Mul", "div": "Div", "max": "Max", "min": "Min", "pow": "Pow"}
UNARY = {
    **{name: name.capitalize() for name in ("abs", "exp", "log", "neg", "sqrt", "tanh", "sin", "cos", "sign", "floor")},
    "logistic": "Sigmoid",
}
COMPARISONS = {"eq": "Equal", "gt": "Greater", "ge": "GreaterOrEqual", "lt": "Less", "le": "LessOrEqual"}
REDUCTIONS = {"reduce_sum": "ReduceSum", "reduce_max": "ReduceMax", "reduce_min": "ReduceMin"}


def import_onnx() -> tuple[Any, Any]:
    """Returns the packages onnx and onnxruntime; raises RunError if one is missing."""
    try:
        import onnx
        import onnxruntime
    except ImportError:
        raise RunError("ONNX needs packages that are not installed: pip install 'ear-jax[onnx]'") from None
    return onnx, onnxruntime


def write_onnx(path: Path, model: Any) -> None:
    """Writes a model to a file; raises RunError if it cannot be written."""
    with replace_file(path) as scratch:
        scratch.write_bytes(model.SerializeToString())


def to_onnx(program: dict[str, Any], constants: np.ndarray, metadata: dict[str, Any]) -> Any:
    """Builds the model of a policy for any number of items.

    Args:
      program: maps an LTE [code] and an observation [obs] to the `OUTPUTS`, each [act].
      constants: the program's constants, one after the other.
      metadata: JSON documents by name, kept in the model.

    Raises:
      RunError: ONNX is not installed, or the policy has an operation that the graph cannot hold.
    """
    onnx, _ = import_onnx()
    graph = _Graph(onnx, program["sizes"])
    for slot, position in program["constants"]:
        graph.constants[slot] = np.asarray(constants[position : position + program["sizes"][slot]], np.float32)
    for slot, name in zip(program["inputs"], INPUTS, strict=True):
        graph.names[slot] = name
    for operation, slot, *operands in program["steps"]:
        graph.names[slot] = graph.step(operation, slot, operands)
    for slot, name in zip(program["outputs"], OUTPUTS, strict=True):
        graph.node("Identity", [graph.value(slot)], name)

    def described(slots: Sequence[int], names: Sequence[str]) -> list[Any]:
        return [
            onnx.helper.make_tensor_value_info(name, onnx.TensorProto.FLOAT, ["items", program["sizes"][slot]])
            for slot, name in zip(slots, names, strict=True)
        ]

    model = onnx.helper.make_model(
        onnx.helper.make_graph(
            graph.nodes,
            "policy",
            described(program["inputs"], INPUTS),
            described(program["outputs"], OUTPUTS),
            graph.initialisers,
        ),
        opset_imports=[onnx.helper.make_opsetid("", OPSET)],
        ir_version=IR_VERSION,
        producer_name="ear_jax",
    )
    onnx.helper.set_model_props(model, {name: json.dumps(value) for name, value in metadata.items()})
    onnx.checker.check_model(model, full_check=True)
    return model


def run_onnx(model: Any, lte: np.ndarray, obs: np.ndarray) -> list[np.ndarray]:
    """Runs a model with onnxruntime on items, lte [items, code] and obs [items, obs]; returns its `OUTPUTS`."""
    _, onnxruntime = import_onnx()
    session = onnxruntime.InferenceSession(model.SerializeToString(), providers=["CPUExecutionProvider"])
    return session.run(list(OUTPUTS), dict(zip(INPUTS, (lte, obs), strict=True)))


class _Graph:
    """A graph under construction; the value of each slot is [items, size], or [size] if it is constant."""

    def __init__(self, onnx: Any, sizes: Sequence[int]):
        self._onnx, self._sizes = onnx, sizes
        self.nodes: list[Any] = []
        self.initialisers: list[Any] = []
        self.names: dict[int, str] = {}  # of the slots' values
        self.constants: dict[int, np.ndarray] = {}

    def value(self, slot: int) -> str:
        """Returns the name of a slot's value."""
        if slot not in self.names:
            self.names[slot] = self.initialiser(self.constants[slot])
        return self.names[slot]

    def initialiser(self, values: np.ndarray) -> str:
        name = f"constant_{len(self.initialisers)}"
        self.initialisers.append(self._onnx.numpy_helper.from_array(np.ascontiguousarray(values), name))
        return name

    def node(self, kind: str, inputs: Sequence[str], output: str = "", **attributes: Any) -> str:
        """Appends a node and returns the name of its output."""
        output = output or f"{kind.lower()}_{len(self.nodes)}"
        self.nodes.append(self._onnx.helper.make_node(kind, list(inputs), [output], **attributes))
        return output

    def step(self, operation: str, slot: int, operands: list[Any]) -> str:
        """Appends a step of a program and returns the name of its result."""
        if operation == "take":
            return self._take(*operands)
        if operation == "multiply":
            return self._multiply(slot, *operands)
        if operation in REDUCTIONS:
            return self._reduce(REDUCTIONS[operation], slot, *operands)
        values = [self.value(operand) for operand in operands]
        if operation in BINARY or operation in UNARY:
            return self.node({**BINARY, **UNARY}[operation], values)
        if operation in COMPARISONS:
            return self._number(self.node(COMPARISONS[operation], values))
        if operation == "ne":
            return self._number(self.node("Not", [self.node("Equal", values)]))
        if operation == "square":
            return self.node("Mul", values * 2)
        if operation == "rsqrt":
            return self.node("Reciprocal", [self.node("Sqrt", values)])
        if operation == "clamp":
            low, value, high = values
            return self.node("Min", [self.node("Max", [low, value]), high])
        if operation == "select_n" and len(values) == 3:
            which, no, yes = values
            return self.node("Where", [self.node("Cast", [which], to=self._onnx.TensorProto.BOOL), yes, no])
        raise RunError(f"this policy cannot be written as ONNX: it uses JAX's operation {operation!r}")

    def _number(self, truth: str) -> str:
        return self.node("Cast", [truth], to=self._onnx.TensorProto.FLOAT)

    def _shaped(self, value: str, *shape: int) -> str:
        return self.node("Reshape", [value, self.initialiser(np.array(shape, np.int64))])

    def _take(self, slots: list[int], positions: list[int] | None) -> str:
        values = [self._for_items(slot) for slot in slots]
        value = self.node("Concat", values, axis=1) if len(values) > 1 else values[0]
        if positions is None or positions == list(range(sum(self._sizes[slot] for slot in slots))):
            return value
        return self.node("Gather", [value, self.initialiser(np.array(positions, np.int64))], axis=1)

    def _for_items(self, slot: int) -> str:
        """Returns a slot's value with an axis of items."""
        if slot not in self.constants:
            return self.names[slot]
        first = self.node("Shape", [INPUTS[0]], start=0, end=1)
        shape = self.node("Concat", [first, self.initialiser(np.array([self._sizes[slot]], np.int64))], axis=0)
        return self.node("Expand", [self.value(slot), shape])

    def _multiply(self, slot: int, rows: int, columns: int, inner: int) -> str:
        """Multiplies [down, inner] by [inner, across] for each item."""
        down, across = self._sizes[rows] // inner, self._sizes[columns] // inner
        if down == 1 and rows not in self.constants and columns in self.constants:
            return self.node("MatMul", [self.names[rows], self._matrix(columns, inner, across)])
        product = self.node("MatMul", [self._matrix(rows, down, inner), self._matrix(columns, inner, across)])
        return self._shaped(product, -1, self._sizes[slot])

    def _matrix(self, slot: int, down: int, across: int) -> str:
        """Returns a slot's value as [down, across], with an axis of items before these unless it is constant."""
        if slot in self.constants:
            return self.initialiser(self.constants[slot].reshape(down, across))
        return self._shaped(self.names[slot], -1, down, across)

    def _reduce(self, kind: str, slot: int, rows: int) -> str:
        size = self._sizes[slot]
        value = self._shaped(self._for_items(rows), -1, size, self._sizes[rows] // size)
        if kind == "ReduceSum":  # which takes its axes as an input, unlike the others
            return self.node(kind, [value, self.initialiser(np.array([2], np.int64))], keepdims=0)
        return self.node(kind, [value], axes=[2], keepdims=0)
