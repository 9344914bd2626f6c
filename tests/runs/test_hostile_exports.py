"""Exported files that someone else wrote: any of them loads, or is refused in one line, fast and in little memory."""

from __future__ import annotations

import hashlib
import json
import random
import resource
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from ear_jax.errors import RunError, UsageError
from ear_jax.runs import safetensors
from ear_jax.runs.trained import describe, load, save

MEMORY = 200_000  # KiB that a refusal may take
NASTY = (
    None,
    True,
    -1,
    0,
    1.5,
    10**9,
    10**30,
    float("nan"),
    float("inf"),
    "",
    "x\n\x1b[31m",
    "\ud800",
    [],
    [[]],
    {},
    {"x": 1},
)


@pytest.fixture(scope="module")
def original(finished_once, tmp_path_factory) -> bytes:
    file = tmp_path_factory.mktemp("export") / "policy.safetensors"
    save(file, load(finished_once), [])
    return file.read_bytes()


def parts(content: bytes) -> tuple[dict[str, Any], bytes]:
    """Splits a file into its header and its arrays."""
    size = int.from_bytes(content[:8], "little")
    return json.loads(content[8 : 8 + size]), content[8 + size :]


def joined(header: Any, arrays: bytes) -> bytes:
    text = header if isinstance(header, bytes) else json.dumps(header).encode()
    return len(text).to_bytes(8, "little") + text + arrays


def described(content: bytes, about: Any) -> bytes:
    """Returns the file with another description of its policy and valid checksums."""
    header, arrays = parts(content)
    metadata = {name: value for name, value in header.pop("__metadata__").items() if not name.startswith("sha256")}
    metadata["about"] = about if isinstance(about, str) else json.dumps(about)
    metadata["sha256_metadata"] = digest(metadata, {}, b"")
    return joined({"__metadata__": {**metadata, "sha256": digest(metadata, header, arrays)}, **header}, arrays)


def digest(metadata: dict[str, str], entries: dict[str, Any], arrays: bytes) -> str:
    found = hashlib.sha256(json.dumps(metadata, sort_keys=True).encode())
    for name, entry in sorted(entries.items()):
        kind, shape = safetensors.DTYPES[entry["dtype"]], tuple(entry["shape"])
        found.update(f"{name} {kind} {shape} ".encode())
        found.update(arrays[slice(*entry["data_offsets"])])
    return found.hexdigest()


def about_of(content: bytes) -> dict[str, Any]:
    return json.loads(parts(content)[0]["__metadata__"]["about"])


def changed(content: bytes, **settings: Any) -> bytes:
    """Returns the file with other settings, named as in `network__width`, and valid checksums."""
    about = about_of(content)
    for name, value in settings.items():
        *groups, last = name.split("__")
        holder = about["config"]
        for group in groups:
            holder = holder[group]
        holder[last] = value
    return described(content, about)


def refusal(file: Path) -> str | None:
    """Loads a file as commands do, and returns the line that refuses it; checks its form."""
    try:
        describe(load(file), [])
        return None
    except (UsageError, RunError) as error:
        line = str(error)
    assert line.isprintable(), repr(line)[:500]
    return line


def huge(content: bytes) -> bytes:
    """Returns a header that claims an array of 20 GB."""
    header, _ = parts(content)
    header["codes"] = {"dtype": "F32", "shape": [5 * 10**9], "data_offsets": [0, 2 * 10**10]}
    return joined({"__metadata__": header["__metadata__"], "codes": header["codes"]}, b"")


def with_metadata(value: Any) -> Callable[[bytes], bytes]:
    return lambda content: joined({**parts(content)[0], "__metadata__": value}, parts(content)[1])


def with_entry(**fields: Any) -> Callable[[bytes], bytes]:
    def written(content: bytes) -> bytes:
        header, arrays = parts(content)
        header["codes"] = {**header["codes"], **fields}
        return joined(header, arrays)

    return written


HOSTILE = {
    "metadata null": (with_metadata(None), "its metadata are not texts by name"),
    "metadata list": (with_metadata([1]), "its metadata are not texts by name"),
    "metadata number": (with_metadata({"format": 1}), "its metadata are not texts by name"),
    "header list": (lambda content: joined([], b""), "is not a complete safetensors file"),
    "nested header": (lambda content: joined(b"[" * 100_000, b""), "is not a complete safetensors file"),
    "nested metadata": (lambda content: joined(b'{"a":' * 100_000, b""), "is not a complete safetensors file"),
    "nested about": (lambda content: described(content, "[" * 100_000), "does not describe its policy"),
    "about a list": (lambda content: described(content, []), "does not describe its policy"),
    "long header": (lambda content: joined(b" " * 2_000_000, b""), "its header is longer than the file, or than 1 MB"),
    "negative shape": (with_entry(shape=[-2, -3]), "is not a whole number of at least 0"),
    "shape of booleans": (with_entry(shape=[True] * 3), "is not a whole number of at least 0"),
    "shape of texts": (with_entry(shape=["2", 2, 3]), "is not a whole number of at least 0"),
    "unknown dtype": (with_entry(dtype="O"), "is not a complete safetensors file"),
    "shared bytes": (with_entry(data_offsets=[4, 52]), "an array's offsets are out of range"),
    "layers": (lambda content: changed(content, network__encoder_layers=100_000), "must be at most 100"),
    "seeds": (lambda content: changed(content, seeds=10**9), "does not fit its configuration"),
    "width": (lambda content: changed(content, network__width=2**31 - 1), "does not fit its configuration"),
    "maml's width": (
        lambda content: changed(content, agent="maml", network__width=2**15),
        "--sac.updates 4 is too many",
    ),
    "tasks": (lambda content: changed(content, tasks=[str(n) for n in range(20_000)]), "at most 1000"),
    "width a text": (lambda content: changed(content, network__width="16"), "it must be of type int"),
    "network a list": (lambda content: changed(content, network=[]), "network must be a table of settings"),
    "infinite minutes": (lambda content: changed(content, minutes=float("inf")), "it must be finite"),
    "no family": (lambda content: described(content, {**about_of(content), "config": {}}), "'family' is missing"),
    "escapes": (lambda content: changed(content, preset="\x1b]0;x\x07"), "which is not plain text"),
    "epoch": (lambda content: described(content, {**about_of(content), "epoch": 10**40}), "epochs are out of range"),
}


@pytest.mark.parametrize("name", HOSTILE)
def test_a_hostile_file_is_refused_in_one_line_before_its_arrays_are_read(name, original, tmp_path, monkeypatch):
    file, (hostile, complaint) = tmp_path / "policy.safetensors", HOSTILE[name]
    file.write_bytes(hostile(original))
    monkeypatch.setattr(safetensors, "read_arrays", lambda *_: pytest.fail("the arrays were read"))
    before, began = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss, time.process_time()
    assert complaint in (refusal(file) or "")
    assert time.process_time() - began < 3, "seconds of the processor; below one where nothing else runs"
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < MEMORY


@pytest.mark.parametrize("make", [huge, lambda content: content], ids=["arrays of 20 GB", "a policy and then 20 GB"])
def test_a_sparse_file_of_20_gigabytes_is_not_read(make, original, tmp_path, monkeypatch):
    file, content = tmp_path / "policy.safetensors", make(original)
    file.write_bytes(content)
    header = 8 + int.from_bytes(content[:8], "little")
    with file.open("r+b") as stream:
        stream.truncate(header + 2 * 10**10)
    monkeypatch.setattr(safetensors, "read_arrays", lambda *_: pytest.fail("the arrays were read"))
    complaint = refusal(file) or ""
    assert any(part in complaint for part in ("is damaged", "does not fit", "bytes follow its header")), complaint


def places(tree: Any, path: tuple[Any, ...] = ()) -> list[tuple[Any, ...]]:
    """Lists the paths of everything in a JSON document."""
    children = tree.items() if isinstance(tree, dict) else enumerate(tree) if isinstance(tree, list) else ()
    return [path, *(place for name, child in children for place in places(child, (*path, name)))]


def mangled(tree: Any, dice: random.Random) -> Any:
    """Returns a JSON document with one value replaced, removed or renamed."""
    *path, last = dice.choice(places(tree)[1:])
    copy = json.loads(json.dumps(tree))
    holder = copy
    for name in path:
        holder = holder[name]
    action = dice.randrange(4)
    if action == 0:
        del holder[last]
    elif action == 1 and isinstance(holder, dict):
        holder[str(last) + dice.choice("sx \n")] = holder.pop(last)
    else:
        holder[last] = dice.choice(NASTY)
    return copy


def mutant(content: bytes, dice: random.Random) -> bytes:
    """Returns a file with some bytes, its header or its description changed; the last has valid checksums."""
    kind = dice.randrange(6)
    place = dice.randrange(len(content))
    if kind == 0:
        flipped = bytearray(content)
        for byte in (place, *dice.choices(range(8 + len(content) // 4), k=dice.randrange(8))):
            flipped[byte] = dice.randrange(256)
        return bytes(flipped)
    if kind == 1:
        return content[:place]
    if kind == 2:
        return content[:place] + dice.randbytes(dice.randrange(1, 200)) + content[place:]
    header, arrays = parts(content)
    if kind == 3:
        return joined(mangled(header, dice), arrays)
    about = about_of(content)
    if kind == 4:
        return described(content, mangled(about, dice))
    return described(content, {**about, "config": mangled(about["config"], dice)})


def fuzz(original: bytes, file: Path, seeds: range) -> int:
    """Loads mutants, and returns the number of those that were refused."""
    refused, before = 0, resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    for seed in seeds:
        dice = random.Random(seed)
        file.write_bytes(mutant(original, dice))
        began = time.monotonic()
        try:
            refused += refusal(file) is not None
        except Exception as error:
            raise AssertionError(f"mutant {seed}: {type(error).__name__}: {error}") from error
        assert time.monotonic() - began < 10, f"mutant {seed}"
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < MEMORY
    return refused


def test_mutants_load_or_are_refused(original, tmp_path):
    assert fuzz(original, tmp_path / "policy.safetensors", range(100)) > 50


@pytest.mark.slow
def test_five_hundred_mutants_load_or_are_refused(original, tmp_path):
    assert fuzz(original, tmp_path / "policy.safetensors", range(1000, 1500)) > 300


def test_a_file_of_an_earlier_version_has_one_checksum_and_loads(original, tmp_path):
    header, arrays = parts(original)
    metadata = {name: value for name, value in header.pop("__metadata__").items() if not name.startswith("sha256")}
    file = tmp_path / "policy.safetensors"
    file.write_bytes(
        joined({"__metadata__": {**metadata, "sha256": digest(metadata, header, arrays)}, **header}, arrays)
    )
    assert np.isfinite(load(file).policies["networks"]["decoder"]["params"]["Dense_0"]["kernel"]).all()


def test_metadata_that_could_not_be_read_are_not_written(tmp_path):
    with pytest.raises(RunError, match="at most 1,000,000 can be read"):
        safetensors.write(tmp_path / "long.safetensors", {}, {"long": "x" * 1_000_000})
    assert list(tmp_path.iterdir()) == []
