"""Documents and rows have checksums: a flipped bit is found, or has changed nothing."""

from __future__ import annotations

import contextlib
import json
from pathlib import Path

import pytest

from ear_jax.errors import RunError
from ear_jax.files.documents import read_json, write_json
from ear_jax.files.rows import append_rows, read_rows
from tests.helpers.faults import flips

FLIPS = 400
CARD = {"name": "trot", "returns": [1.5, -2.25e-7, 12345678], "config": {"lr": 3e-4, "tasks": ["1", "ä"]}, "met": True}


def test_a_document_comes_back_and_has_a_checksum(tmp_path):
    write_json(tmp_path / "a.json", CARD)
    assert read_json(tmp_path / "a.json") == CARD
    assert set(json.loads((tmp_path / "a.json").read_text())) == {*CARD, "checksum"}
    write_json(tmp_path / "a.json", json.loads((tmp_path / "a.json").read_text()) | {"met": False})
    assert read_json(tmp_path / "a.json")["met"] is False, "it is made anew"


def test_a_number_that_is_not_finite_is_not_written(tmp_path):
    write_json(tmp_path / "a.json", CARD)
    with pytest.raises(RunError, match=r"cannot write .*a\.json: Out of range float values"):
        write_json(tmp_path / "a.json", {"mean_return": float("nan")})
    assert read_json(tmp_path / "a.json") == CARD


def test_one_of_an_earlier_version_is_read_and_layout_does_not_count(tmp_path):
    (tmp_path / "a.json").write_text(json.dumps(CARD))
    assert read_json(tmp_path / "a.json") == CARD
    write_json(tmp_path / "a.json", CARD)
    (tmp_path / "a.json").write_text(json.dumps(json.loads((tmp_path / "a.json").read_text()), sort_keys=True))
    assert read_json(tmp_path / "a.json") == CARD


def assert_flips_are_found(path: Path) -> None:
    """Asserts that a document with a flipped bit is refused, or says the same."""
    good, content = read_json(path), path.read_bytes()
    for flipped in flips(content, FLIPS):
        path.write_bytes(flipped)
        with contextlib.suppress(RunError):
            read = read_json(path)
            assert {name: value for name, value in read.items() if name in good} == good
            assert len(read) <= len(good) + 1, "the checksum's own name may be another"
    path.write_bytes(content)


def test_each_flipped_bit_of_a_document_is_found(tmp_path):
    write_json(tmp_path / "a.json", CARD)
    assert_flips_are_found(tmp_path / "a.json")


@pytest.mark.parametrize(
    ("content", "complaint"),
    [
        ("[1]", "it is no table of names and values"),
        ("[" * 100_000, "it is nested too deeply"),
        ('{"a": ' * 100_000, "it is nested too deeply"),
        ('{"a": Infinity}', "Infinity is no number of JSON"),
        ("", "Expecting value"),
        ('{"a": 1, "checksum": 7}', "it differs from its checksum"),
        (b"\xff", "can't decode"),
    ],
)
def test_a_malformed_document_is_one_line(content, complaint, tmp_path):
    (tmp_path / "a.json").write_bytes(content if isinstance(content, bytes) else content.encode())
    with pytest.raises(RunError, match=complaint) as raised:
        read_json(tmp_path / "a.json")
    assert "\n" not in str(raised.value)


@pytest.fixture
def rows(tmp_path) -> list[dict]:
    rows = [{"seed": 0, "epoch": epoch, "mean_return": -epoch / 7, "returns": {"a": epoch / 3}} for epoch in range(6)]
    append_rows(tmp_path / "a.jsonl", rows[:4])
    append_rows(tmp_path / "a.jsonl", rows[4:])
    return rows


def test_a_row_that_is_cut_off_is_skipped_and_a_damaged_one_named(rows, tmp_path):
    path = tmp_path / "a.jsonl"
    assert read_rows(path) == rows
    text = path.read_text()
    for end in range(1, len(text.splitlines()[-1])):
        path.write_text(text[: -1 - end])
        assert read_rows(path) == rows[:-1]
    path.write_text(text[:-1])
    assert read_rows(path) == rows
    path.write_text(text.replace("-0.4285", "-0.4286"))
    with pytest.raises(RunError, match=r"a\.jsonl is damaged: line 4: it differs from its checksum"):
        read_rows(path)
    warnings: list[str] = []
    assert read_rows(path, warnings.append) == rows[:3] + rows[4:]
    assert warnings == [f"warning: {path} is damaged: line 4: it differs from its checksum; it is skipped"]


def test_each_flipped_bit_of_a_row_is_found(rows, tmp_path):
    path = tmp_path / "a.jsonl"
    content = path.read_bytes()
    for flipped in flips(content, FLIPS):
        path.write_bytes(flipped)
        warnings: list[str] = []
        read = read_rows(path, warnings.append)
        if not warnings:
            assert [{name: row[name] for name in rows[0]} for row in read] == rows


@pytest.mark.parametrize("line", ["7", "[]", "[" * 100_000, '{"a": NaN}', "x" * 10, '{"seed": 0}'])
def test_a_line_that_is_no_row_is_named(line, rows, tmp_path):
    path = tmp_path / "a.jsonl"
    lines = path.read_text().splitlines()
    path.write_text("\n".join([*lines[:2], line, *lines[2:], ""]))
    with pytest.raises(RunError, match=r"a\.jsonl is damaged: line 3: "):
        read_rows(path)


def test_rows_of_an_earlier_version_are_read_before_those_of_this_one(rows, tmp_path):
    path = tmp_path / "b.jsonl"
    path.write_text("".join(json.dumps(row) + "\n" for row in rows[:3]))
    append_rows(path, rows[3:])
    assert read_rows(path) == rows


def test_what_cannot_be_read_or_lacks_a_key_is_named(rows, tmp_path):
    (tmp_path / "folder").mkdir()
    for read in (read_json, read_rows):
        with pytest.raises(RunError, match=r"folder cannot be read: Is a directory"):
            read(tmp_path / "folder")
    for required in ({"seed": str}, {"loss": float}):
        with pytest.raises(RunError, match=rf"line 1: its '{next(iter(required))}' is missing, or of another type"):
            read_rows(tmp_path / "a.jsonl", required=required)
