"""The safetensors format: a JSON header and raw arrays. It holds no code, and most libraries of the field read it.

A file is the header's length (8 bytes, little endian), the header (name → dtype, shape and offsets; `__metadata__`:
strings by name) and the arrays one after the other (https://github.com/huggingface/safetensors#format).
"""

from __future__ import annotations

import hashlib
import json
import math
import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ear_jax.errors import RunError
from ear_jax.files.replacing import replace_file

DTYPES = {"F32": np.dtype("<f4"), "I32": np.dtype("<i4"), "U32": np.dtype("<u4")}
NAMES = {dtype: name for name, dtype in DTYPES.items()}
HEADER_LIMIT = 1_000_000  # bytes; a parsed header takes up to thirty times as much memory


def write(path: Path, arrays: dict[str, np.ndarray], metadata: dict[str, str]) -> None:
    """Writes a file atomically; raises RunError if it cannot be written, or not be read because of its metadata."""
    header: dict[str, object] = {"__metadata__": metadata}
    end = 0
    for name, array in arrays.items():
        begin, end = end, end + array.nbytes
        header[name] = {"dtype": NAMES[array.dtype], "shape": list(array.shape), "data_offsets": [begin, end]}
    text = json.dumps(header).encode()
    text += b" " * (-len(text) % 8)  # aligns the arrays
    if len(text) > HEADER_LIMIT:
        raise RunError(f"{path} would have metadata of {len(text):,} bytes; at most {HEADER_LIMIT:,} can be read")
    with replace_file(path) as scratch, scratch.open("wb") as file:
        file.write(len(text).to_bytes(8, "little") + text)
        for array in arrays.values():
            file.write(np.ascontiguousarray(array).tobytes())


@dataclass(frozen=True)
class Entry:
    """One array's place in a file."""

    dtype: np.dtype
    shape: tuple[int, ...]
    begin: int  # bytes after the header
    end: int


@dataclass(frozen=True)
class Header:
    """A file's metadata and the places of its arrays."""

    metadata: dict[str, str]
    entries: dict[str, Entry]
    size: int  # bytes before the arrays


def read_header(path: Path) -> Header:
    """Reads a file's header, whose arrays fill the rest of the file; memory and time do not grow with the file's size.

    Raises:
      RunError: the file is damaged, of another format, or cannot be read.
    """
    try:
        with path.open("rb") as file:
            total = os.fstat(file.fileno()).st_size
            size = int.from_bytes(file.read(8), "little")
            if size > min(HEADER_LIMIT, total - 8):
                raise ValueError("its header is longer than the file, or than 1 MB")
            header = json.loads(file.read(size))
        metadata, entries = header.pop("__metadata__", {}), {name: _entry(entry) for name, entry in header.items()}
        if not (isinstance(metadata, dict) and all(isinstance(value, str) for value in metadata.values())):
            raise ValueError("its metadata are not texts by name")
        end = 0
        for entry in sorted(entries.values(), key=lambda entry: (entry.begin, entry.end)):
            if entry.begin != end:
                raise ValueError("an array's offsets are out of range")
            end = entry.end
        if 8 + size + end != total:
            raise ValueError(f"its arrays have {end:,} bytes, but {total - 8 - size:,} bytes follow its header")
        return Header(metadata, entries, 8 + size)
    except OSError as error:
        raise RunError(f"cannot read {path}: {error.strerror}") from None
    except (ValueError, TypeError, KeyError, AttributeError, RecursionError) as error:
        raise RunError(f"{path} is not a complete safetensors file: {error}".splitlines()[0]) from None


def read_arrays(path: Path, header: Header) -> dict[str, np.ndarray]:
    """Returns the arrays of a file by name; raises RunError if it cannot be read."""
    try:
        with path.open("rb") as file:
            file.seek(header.size)
            content = memoryview(file.read())
        return {
            name: np.frombuffer(content[entry.begin : entry.end], entry.dtype).reshape(entry.shape)
            for name, entry in header.entries.items()
        }
    except (OSError, ValueError) as error:
        raise RunError(f"cannot read {path}: {getattr(error, 'strerror', None) or error}") from None


def read(path: Path) -> tuple[dict[str, np.ndarray], dict[str, str]]:
    """Returns a file's arrays and metadata; raises RunError if it is damaged or of another format."""
    header = read_header(path)
    return read_arrays(path, header), header.metadata


def digest(arrays: dict[str, np.ndarray], metadata: dict[str, str]) -> str:
    """Returns SHA-256 over arrays and metadata, for a writer to store among the metadata."""
    digest = hashlib.sha256(json.dumps(metadata, sort_keys=True).encode())
    for name, array in sorted(arrays.items()):
        digest.update(f"{name} {array.dtype} {array.shape} ".encode())
        digest.update(np.ascontiguousarray(array))
    return digest.hexdigest()


def _entry(entry: Any) -> Entry:
    """Checks an array's part of a header; raises ValueError, TypeError or KeyError."""
    (begin, end), shape, dtype = entry["data_offsets"], entry["shape"], DTYPES[entry["dtype"]]
    if not all(type(number) is int and number >= 0 for number in (*shape, begin, end)):
        raise ValueError("a size in its header is not a whole number of at least 0")
    if end - begin != math.prod(shape) * dtype.itemsize:
        raise ValueError("an array's offsets are out of range")
    return Entry(dtype, tuple(shape), begin, end)
