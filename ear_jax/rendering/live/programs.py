"""JAX functions as lists of instructions, which `page/program.js` runs without JAX."""

from __future__ import annotations

import base64
import gzip
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.extend.core import ClosedJaxpr, Jaxpr, JaxprEqn, Literal, Var

from ear_jax.errors import UsageError

# Number by number, with operands of one size or of size 1; `page/program.js` holds the same names.
# fmt: off
ELEMENTWISE = frozenset((
    "abs", "acos", "acosh", "add", "and", "asin", "asinh", "atan", "atan2", "atanh", "cbrt", "ceil", "clamp",
    "cos", "cosh", "div", "eq", "exp", "exp2", "expm1", "floor", "ge", "gt", "is_finite", "le", "log", "log1p",
    "logistic", "lt", "max", "min", "mul", "ne", "neg", "not", "or", "pow", "rem", "round_away", "round_even",
    "rsqrt", "select_n", "sign", "sin", "sinh", "sqrt", "square", "sub", "tan", "tanh", "xor",
))
# fmt: on
TRUTHS = ("and", "not", "or", "xor")  # of truth values alone
ROUNDINGS = {jax.lax.RoundingMethod.AWAY_FROM_ZERO: "round_away", jax.lax.RoundingMethod.TO_NEAREST_EVEN: "round_even"}
REDUCTIONS = frozenset(("reduce_sum", "reduce_prod", "reduce_max", "reduce_min", "reduce_and", "reduce_or"))
# Each number of the result is a number of an operand. Further operands are indices, which must be constant.
# fmt: off
MOVES = frozenset((
    "broadcast_in_dim", "concatenate", "copy", "copy_p", "dynamic_slice", "expand_dims", "gather", "pad",
    "reshape", "rev", "slice", "split", "squeeze", "stack", "stop_gradient", "transpose",
))
# fmt: on
INDEXED = frozenset(("dynamic_slice", "gather"))
CALLS = ("jaxpr", "call_jaxpr", "fun_jaxpr", "call")  # parameters that hold the function an equation calls

Value = np.ndarray | int  # a constant, or the number of the slot that holds it at run time


@dataclass
class Constants:
    """The constants of all programs of a page, as one array of float32."""

    arrays: list[np.ndarray] = field(default_factory=list)
    size: int = 0

    def add(self, array: np.ndarray) -> int:
        """Appends an array and returns the position of its first number."""
        self.arrays.append(np.asarray(array, np.float32).reshape(-1))
        self.size += self.arrays[-1].size
        return self.size - self.arrays[-1].size

    def packed(self) -> str:
        """Returns all of them compressed, in base 64."""
        return pack(np.concatenate([*self.arrays, np.zeros(0, np.float32)]).astype("<f4").tobytes())


def pack(content: bytes) -> str:
    """Returns bytes compressed by gzip, in base 64; equal bytes give equal text."""
    return base64.b64encode(gzip.compress(content, 9, mtime=0)).decode()


def translate(function: Callable[..., Any], constants: Constants, *arguments: Any) -> dict[str, Any]:
    """Translates a JAX function into a program that computes the same numbers.

    Args:
      function: the function, traced once.
      constants: receives the function's constants, such as a policy's weights.
      *arguments: pytrees of arrays, whose shapes are those of the arguments.

    Returns:
      The program, as JSON: `sizes` of the slots that hold numbers, `constants` as pairs of a slot and a position,
      `steps` as lists of operation, slot of the result and operands, and the slots of `inputs` and `outputs`, in the
      order of their leaves.

    Raises:
      UsageError: the function has an operation that cannot be translated.
    """
    closed = jax.make_jaxpr(function)(*arguments)
    program = _Program(constants)
    inputs: list[Value] = [program.slot(_array(var).size) for var in closed.jaxpr.invars]
    outputs = program.run(closed.jaxpr, closed.consts, inputs)
    slots = [program.held(output) for output in outputs]
    return {
        "sizes": program.sizes,
        "constants": program.constants,
        "steps": program.steps,
        "inputs": inputs,
        "outputs": slots,
    }


class _Program:
    """A program under construction."""

    def __init__(self, constants: Constants):
        self.sizes: list[int] = []
        self.constants: list[tuple[int, int]] = []
        self.steps: list[list[Any]] = []
        self._all = constants

    def slot(self, size: int) -> int:
        self.sizes.append(size)
        return len(self.sizes) - 1

    def held(self, value: Value) -> int:
        """Returns the slot that holds a value at run time."""
        if isinstance(value, int):
            return value
        slot = self.slot(value.size)
        self.constants.append((slot, self._all.add(value)))
        return slot

    def step(self, operation: str, size: int, *operands: Any) -> int:
        """Appends a step and returns the slot of its result."""
        slot = self.slot(size)
        self.steps.append([operation, slot, *operands])
        return slot

    def run(self, jaxpr: Jaxpr, consts: Sequence[Any], inputs: Sequence[Value]) -> list[Value]:
        """Appends the steps of a function and returns its results; what depends on constants only is computed here."""
        values: dict[Var, Value] = dict(zip(jaxpr.invars, inputs, strict=True))
        values.update(zip(jaxpr.constvars, map(np.asarray, consts), strict=True))

        def read(atom: Var | Literal) -> Value:
            return np.asarray(atom.val) if isinstance(atom, Literal) else values[atom]

        for equation in _needed(jaxpr):
            operands = [read(atom) for atom in equation.invars]
            called = _called(equation)
            if called is not None:
                results = self.run(called.jaxpr, called.consts, operands)
            elif all(isinstance(operand, np.ndarray) for operand in operands):
                results = list(_computed(equation, operands))
            else:
                results = self._translated(equation, operands)
            values.update(zip(equation.outvars, results, strict=True))
        return [read(atom) for atom in jaxpr.outvars]

    def _translated(self, equation: JaxprEqn, operands: list[Value]) -> list[Value]:
        name, params = equation.primitive.name, equation.params
        size = _array(equation.outvars[0]).size
        if name == "scan":
            return self._unrolled(equation, operands)
        if name in MOVES:
            return self._moved(equation, operands)
        if name in REDUCTIONS:
            return [self._reduced(name, equation, operands[0])]
        if name == "dot_general":
            return [self._multiplied(equation, operands)]
        if name == "convert_element_type":
            return [self._converted(equation, operands[0])]
        if name == "integer_pow":
            name, operands = "pow", [*operands, np.full((), params["y"], np.float32)]
        if name == "round":
            name = ROUNDINGS[params["rounding_method"]]
        integers = jnp.issubdtype(_array(equation.outvars[0]).dtype, jnp.integer)
        if name not in ELEMENTWISE or (integers and name in TRUTHS):
            raise UsageError(f"JAX's operation {name!r}{' of integers' * integers} cannot be translated")
        shapes = [_array(atom).shape for atom in equation.invars] + [()] * (len(operands) - len(equation.invars))
        spread = [
            self._broadcast(*pair, _array(equation.outvars[0]).shape) for pair in zip(operands, shapes, strict=True)
        ]
        result = self.step(name, size, *map(self.held, spread))
        return [self.step("trunc", size, result) if integers and name == "div" else result]

    def _broadcast(self, value: Value, shape: tuple[int, ...], wanted: tuple[int, ...]) -> Value:
        """Repeats a value along axes of length 1; a single number stays one, as each step takes it as it is."""
        if shape == wanted or math.prod(shape) == 1:
            return value
        if isinstance(value, np.ndarray):
            return np.broadcast_to(value.reshape(shape), wanted)
        return self._taken([value], np.broadcast_to(np.arange(math.prod(shape)).reshape(shape), wanted))

    def _moved(self, equation: JaxprEqn, operands: list[Value]) -> list[Value]:
        """Finds where each number comes from by moving the operands' indices instead of their numbers."""
        indexed = equation.primitive.name in INDEXED
        data = operands[:1] if indexed else operands
        if indexed and any(isinstance(operand, int) for operand in operands[1:]):
            raise UsageError(f"JAX's operation {equation.primitive.name!r} cannot be translated at a place that varies")
        first, indices = 0, []
        for atom in equation.invars[: len(data)]:
            indices.append(np.arange(first, first + _array(atom).size, dtype=np.int32).reshape(_array(atom).shape))
            first += _array(atom).size
        slots = [self.held(value) for value in data]
        if equation.params.get("fill_value") is not None:  # of numbers from outside; no position stands for one
            equation = equation.replace(params={**equation.params, "fill_value": -1})
        moved = _computed(equation, [*indices, *operands[len(data) :]])
        return [self._taken(slots, index) for index in moved]

    def _taken(self, slots: list[int], index: np.ndarray) -> int:
        """Takes numbers at given positions of some slots, which are counted as one after the other."""
        index = np.asarray(index).reshape(-1)
        total = sum(self.sizes[slot] for slot in slots)
        if index.min(initial=0) < 0 or index.max(initial=0) >= total:
            raise UsageError("numbers from outside an array cannot be translated")
        if len(slots) == 1 and np.array_equal(index, np.arange(total)):
            return slots[0]
        return self.step("take", index.size, slots, index.tolist())

    def _rows(self, value: Value, shape: tuple[int, ...], order: Sequence[int]) -> Value:
        """Transposes a value of a shape."""
        if isinstance(value, np.ndarray):
            return np.transpose(value.reshape(shape), order)
        return self._taken([value], np.transpose(np.arange(math.prod(shape)).reshape(shape), order))

    def _reduced(self, name: str, equation: JaxprEqn, operand: Value) -> int:
        shape, axes = _array(equation.invars[0]).shape, equation.params["axes"]
        kept = [axis for axis in range(len(shape)) if axis not in axes]
        rows = self.held(self._rows(operand, shape, [*kept, *axes]))
        return self.step(name, _array(equation.outvars[0]).size, rows)

    def _multiplied(self, equation: JaxprEqn, operands: list[Value]) -> int:
        ((left_axes, right_axes), (batch, _)) = equation.params["dimension_numbers"]
        if batch:
            raise UsageError("products of batches of matrices cannot be translated")
        (left, right), (left_atom, right_atom) = operands, equation.invars
        left_kept = [axis for axis in range(_array(left_atom).ndim) if axis not in left_axes]
        right_kept = [axis for axis in range(_array(right_atom).ndim) if axis not in right_axes]
        rows = self.held(self._rows(left, _array(left_atom).shape, [*left_kept, *left_axes]))
        columns = self.held(self._rows(right, _array(right_atom).shape, [*right_axes, *right_kept]))
        inner = math.prod(_array(left_atom).shape[axis] for axis in left_axes)
        return self.step("multiply", _array(equation.outvars[0]).size, rows, columns, inner)

    def _converted(self, equation: JaxprEqn, operand: Value) -> Value:
        before, after = _array(equation.invars[0]).dtype, _array(equation.outvars[0]).dtype
        size = _array(equation.outvars[0]).size
        if after == jnp.bfloat16:
            return self.step("bfloat16", size, self.held(operand))
        if jnp.issubdtype(after, jnp.integer) and jnp.issubdtype(before, jnp.floating):
            return self.step("trunc", size, self.held(operand))
        if after == jnp.bool_ and before != jnp.bool_:
            return self.step("ne", size, self.held(operand), self.held(np.zeros(1)))
        return operand

    def _unrolled(self, equation: JaxprEqn, operands: list[Value]) -> list[Value]:
        """Repeats the steps of a loop of known length, as in a recurrent policy."""
        params, inner = equation.params, equation.params["jaxpr"]
        consts, carry = params["num_consts"], params["num_carry"]
        fixed, state, sequences = operands[:consts], operands[consts:][:carry], operands[consts + carry :]
        atoms = equation.invars[consts + carry :]
        rows: list[list[Value]] = []
        moments = range(params["length"])
        for moment in reversed(moments) if params["reverse"] else moments:
            items = [
                self._item(value, _array(atom).shape, moment) for value, atom in zip(sequences, atoms, strict=True)
            ]
            results = self.run(inner.jaxpr, inner.consts, [*fixed, *state, *items])
            state = results[:carry]
            rows.append(results[carry:])
        rows = rows[::-1] if params["reverse"] else rows
        stacked = [self._stacked([row[index] for row in rows]) for index in range(len(equation.outvars) - carry)]
        return [*state, *stacked]

    def _item(self, value: Value, shape: tuple[int, ...], moment: int) -> Value:
        if isinstance(value, np.ndarray):
            return value[moment]
        return self._taken([value], np.arange(math.prod(shape)).reshape(shape)[moment])

    def _stacked(self, values: list[Value]) -> Value:
        slots = [self.held(value) for value in values]
        return self.step("take", sum(self.sizes[slot] for slot in slots), slots, None)


def _array(atom: Any) -> jax.core.ShapedArray:
    """Returns the shape and type of an operand or a result."""
    return atom.aval


def _called(equation: JaxprEqn) -> ClosedJaxpr | None:
    """Returns the function that an equation calls once, if it is such a call."""
    if equation.primitive.name in ("scan", "while", "cond"):
        return None
    called = next((equation.params[key] for key in CALLS if key in equation.params), None)
    return ClosedJaxpr(called, ()) if isinstance(called, Jaxpr) else called


def _needed(jaxpr: Jaxpr) -> list[JaxprEqn]:
    """Returns the equations on which the results depend; Flax makes random keys that no policy uses."""
    found: list[JaxprEqn] = []
    wanted = {atom for atom in jaxpr.outvars if not isinstance(atom, Literal)}  # a literal has no hash
    for equation in reversed(jaxpr.eqns):
        if wanted & set(equation.outvars):
            found.append(equation)
            wanted |= {atom for atom in equation.invars if not isinstance(atom, Literal)}
    return found[::-1]


def _computed(equation: JaxprEqn, operands: Sequence[Any]) -> list[np.ndarray]:
    with jax.ensure_compile_time_eval():
        results = equation.primitive.bind(*map(jnp.asarray, operands), **equation.params)
    return [np.asarray(result) for result in (results if equation.primitive.multiple_results else [results])]
