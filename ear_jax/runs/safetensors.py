"""The safetensors format: a JSON header and raw arrays. It holds no code, and most libraries of the field read it.

A file is the header's length (8 bytes, little endian), the header (name → dtype, shape and offsets; `__metadata__`:
strings by name) and the arrays one after the other (https://github.com/huggingface/safetensors#format).
"""

from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np

from ear_jax.errors import RunError
from ear_jax.runs import records

DTYPES = {"F32": np.dtype("<f4"), "I32": np.dtype("<i4"), "U32": np.dtype("<u4")}
NAMES = {dtype: name for name, dtype in DTYPES.items()}
HEADER_LIMIT = 100_000_000  # bytes, as in the reference implementation


def write(path: Path, arrays: dict[str, np.ndarray], metadata: dict[str, str]) -> None:
    """Writes a file atomically; raises RunError if it cannot be written."""
    header: dict[str, object] = {"__metadata__": metadata}
    end = 0
    for name, array in arrays.items():
        begin, end = end, end + array.nbytes
        header[name] = {"dtype": NAMES[array.dtype], "shape": list(array.shape), "data_offsets": [begin, end]}
    text = json.dumps(header).encode()
    text += b" " * (-len(text) % 8)  # aligns the arrays
    with records.replacing(path, "xb") as file:
        file.write(len(text).to_bytes(8, "little") + text)
        for array in arrays.values():
            file.write(np.ascontiguousarray(array).tobytes())


def read(path: Path) -> tuple[dict[str, np.ndarray], dict[str, str]]:
    """Returns a file's arrays and metadata; raises RunError if it is damaged or of another format."""
    try:
        content = path.read_bytes()
    except OSError as error:
        raise RunError(f"cannot read {path}: {error.strerror}") from None
    try:
        size = int.from_bytes(content[:8], "little")
        if size > min(HEADER_LIMIT, len(content) - 8):
            raise ValueError("its header is longer than the file")
        header = json.loads(content[8 : 8 + size])
        metadata, arrays = header.pop("__metadata__", {}), memoryview(content)[8 + size :]
        return {name: _array(arrays, **entry) for name, entry in header.items()}, metadata
    except (ValueError, TypeError, KeyError, AttributeError) as error:
        raise RunError(f"{path} is not a complete safetensors file: {error}".splitlines()[0]) from None


def _array(content: memoryview, dtype: str, shape: list[int], data_offsets: list[int]) -> np.ndarray:
    begin, end = data_offsets
    kind = DTYPES[dtype]
    if not 0 <= begin <= end <= len(content) or end - begin != math.prod(shape) * kind.itemsize:
        raise ValueError("an array's offsets are out of range")
    return np.frombuffer(content[begin:end], kind).reshape(shape)
