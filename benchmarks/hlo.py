"""Kernels of a program compiled for a GPU, read from the text of its scheduled HLO. Imports no JAX."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator
from dataclasses import dataclass, field

SIZES = {"pred": 1, "s8": 1, "u8": 1, "bf16": 2, "f16": 2, "s32": 4, "u32": 4, "f32": 4, "s64": 8, "u64": 8, "f64": 8}
NO_KERNEL = {"parameter", "constant", "tuple", "get-tuple-element", "bitcast", "after-all", "partition-id"}
SPARSE = {
    "gather",
    "scatter",
    "dynamic-slice",
    "dynamic-update-slice",
}  # read as much as they write

_COMPUTATION = re.compile(r"^(ENTRY )?%?([\w.\-]+) \(.*\) -> .*\{$")
_INSTRUCTION = re.compile(r"^\s+(?:ROOT )?%?([\w.\-]+) = (\(.*?\)|\S+) ([\w\-]+)\((.*)$")
_SHAPE = re.compile(r"(\w+)\[([\d,]*)\]")
_CALLED = re.compile(r"(?:calls|to_apply)=%?([\w.\-]+)")


@dataclass(frozen=True)
class Instruction:
    """One instruction of a computation."""

    name: str
    shape: str
    op: str
    line: str  # from its operands on
    operands: tuple[str, ...]

    def called(self, attribute: str = "") -> str | None:
        """Returns the name of the computation it calls, or of a loop's `body` or `condition`."""
        pattern = re.compile(rf"{attribute}=%?([\w.\-]+)") if attribute else _CALLED
        found = pattern.search(self.line)
        return found.group(1) if found else None

    @property
    def trips(self) -> int | None:
        """The number of iterations of a loop, None if it depends on what the loop computes."""
        found = re.search(r'known_trip_count":\{"n":"(\d+)"', self.line)
        return int(found.group(1)) if found else None


@dataclass(frozen=True)
class Kernel:
    """One launch: a fusion or a single instruction."""

    name: str
    ops: frozenset[str]  # operations in it
    source: str  # the target of a custom call, and the JAX operation that it writes last
    traffic: int  # bytes read and written, without reuse in caches

    @property
    def is_matmul(self) -> bool:
        return "dot" in self.ops or "cublas" in self.source


@dataclass
class Module:
    """A compiled program: instructions of each computation, in the order of the text."""

    entry: str = ""
    computations: dict[str, list[Instruction]] = field(default_factory=dict)

    def loops(self, computation: str | None = None) -> list[Instruction]:
        """Returns the loops of a computation, by default of all."""
        chosen = self.computations.values() if computation is None else [self.computations[computation]]
        return [found for instructions in chosen for found in instructions if found.op == "while"]

    def kernels(self, computation: str, rounds: int = 1) -> Iterator[Kernel]:
        """Yields the kernels of one run of a computation.

        Args:
          computation: its name.
          rounds: iterations of an inner loop whose number is not known; kernels of inner loops count once for each.
        """
        shapes = {found.name: found.shape for found in self.computations[computation]}
        for found in self.computations[computation]:
            if found.op == "while":
                body = found.called("body")
                inner = list(self.kernels(body, rounds)) if body else []
                yield from inner * (found.trips or rounds)
            elif found.op == "call" and (called := found.called()):
                yield from self.kernels(called, rounds)
            elif found.op not in NO_KERNEL and not found.op.endswith("-done"):
                yield self._kernel(found, shapes)

    def _kernel(self, found: Instruction, shapes: dict[str, str]) -> Kernel:
        inner = list(self._inside(found))
        ops = frozenset(one.op for one in (found, *inner))
        named = (re.search(r'op_name="([^"]*)"', one.line) for one in (found, *reversed(inner)))
        last = next((name.group(1) for name in named if name), "")  # of what the kernel writes last
        target = re.search(r'custom_call_target="([^"]*)"', found.line)
        written = size(found.shape)
        read = written if ops & SPARSE else sum(size(shapes.get(name, "")) for name in found.operands)
        return Kernel(found.name, ops, f"{target.group(1) if target else ''} {last}".strip(), read + written)

    def _inside(self, found: Instruction) -> Iterator[Instruction]:
        """Yields the instructions of the computations that an instruction calls."""
        called = found.called()
        for one in self.computations.get(called or "", ()):
            yield one
            if one.op in ("fusion", "call"):
                yield from self._inside(one)


def parse(text: str) -> Module:
    """Reads the text of a module."""
    module, current = Module(), None
    for line in text.splitlines():
        if heading := _COMPUTATION.match(line):
            current = module.computations.setdefault(heading.group(2), [])
            module.entry = heading.group(2) if heading.group(1) else module.entry
        elif line.startswith("}"):
            current = None
        elif current is not None and (found := _INSTRUCTION.match(line)):
            name, shape, op, rest = found.groups()
            operands = tuple(re.findall(r"%([\w.\-]+)", rest.split("), ")[0]))
            current.append(Instruction(name, shape, op, rest, operands))
    return module


def size(shape: str) -> int:
    """Returns the bytes of a shape's text, such as `(f32[2,3]{1,0}, s32[])`."""
    arrays = ((kind, dims) for kind, dims in _SHAPE.findall(shape) if kind in SIZES)
    return sum(SIZES[kind] * math.prod(int(dim) for dim in dims.split(",") if dim) for kind, dims in arrays)
