"""The safetensors format: a JSON header and raw arrays, which most libraries of this field read, and no code in it.

8 bytes, little endian: the header's length. The header: name → dtype, shape and offsets, and `__metadata__`, strings by
name. The arrays, one after the other (https://github.com/huggingface/safetensors#format).
"""

from __future__ import annotations

import json
import math
import os
from pathlib import Path

import numpy as np

from ear_jax.errors import RunError

DTYPES = {"F32": np.dtype("<f4"), "I32": np.dtype("<i4"), "U32": np.dtype("<u4")}
NAMES = {dtype: name for name, dtype in DTYPES.items()}
HEADER_LIMIT = 100_000_000  # bytes, as the reference implementation has it


def write(path: Path, arrays: dict[str, np.ndarray], metadata: dict[str, str]) -> None:
    """Writes a file, whole or not at all; raises RunError where it cannot be written."""
    header: dict[str, object] = {"__metadata__": metadata}
    end = 0
    for name, array in arrays.items():
        begin, end = end, end + array.nbytes
        header[name] = {"dtype": NAMES[array.dtype], "shape": list(array.shape), "data_offsets": [begin, end]}
    text = json.dumps(header).encode()
    text += b" " * (-len(text) % 8)  # so that the arrays are aligned
    scratch = path.with_name(path.name + ".part")
    try:
        scratch.unlink(missing_ok=True)
        with scratch.open("xb") as file:
            file.write(len(text).to_bytes(8, "little") + text)
            for array in arrays.values():
                file.write(np.ascontiguousarray(array).tobytes())
        os.replace(scratch, path)
    except OSError as error:
        raise RunError(f"cannot write {path}: {error.strerror}") from None


def read(path: Path) -> tuple[dict[str, np.ndarray], dict[str, str]]:
    """A file's arrays and metadata; raises RunError where it is no such file, or a damaged one."""
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
        raise RunError(f"{path} is no whole safetensors file: {error}".splitlines()[0]) from None


def _array(content: memoryview, dtype: str, shape: list[int], data_offsets: list[int]) -> np.ndarray:
    begin, end = data_offsets
    kind = DTYPES[dtype]
    if not 0 <= begin <= end <= len(content) or end - begin != math.prod(shape) * kind.itemsize:
        raise ValueError("an array lies outside of it")
    return np.frombuffer(content[begin:end], kind).reshape(shape)
