"""Suggestions for mistyped names: only when near, numbers by value, case ignored, in natural order."""

from __future__ import annotations

import pytest

import ear_jax
from ear_jax.errors import UsageError, in_order, known_name, nearest, plain, unknown

SPEEDS = [f"vel-{speed}" for speed in range(1, 11)]
FAMILIES = ["ant-dir", "halfcheetah-run-jump", "halfcheetah-vel", "hopper-vel", "walker-vel", "reach"]


@pytest.mark.parametrize(
    ("word", "known", "names"),
    [
        ("vel-1.5", SPEEDS, ["vel-1", "vel-2"]),
        ("vel-12", SPEEDS, ["vel-10"]),
        ("vel-0.2", SPEEDS, ["vel-1"]),
        ("vl-2", SPEEDS, ["vel-2"]),
        ("hopper", FAMILIES, ["hopper-vel"]),
        ("cheetah", FAMILIES, ["halfcheetah-run-jump", "halfcheetah-vel"]),
        ("Hoper-Vel", FAMILIES, ["hopper-vel"]),
        ("humanoid", FAMILIES, []),
        ("my_robot.xml", ["ant.xml", "point.xml", "pusher.xml"], []),
        ("", FAMILIES, []),
    ],
)
def test_only_near_names_are_suggested(word, known, names):
    assert nearest(word, known) == names


def test_names_are_listed_in_natural_order():
    assert in_order(reversed(SPEEDS)) == SPEEDS
    assert in_order(["dir-1.5", "b", "dir-0.25", "a10", "a9", "dir-10"]) == [
        "a9",
        "a10",
        "b",
        "dir-0.25",
        "dir-1.5",
        "dir-10",
    ]
    message = str(unknown("task", "vel-1.5", SPEEDS))
    assert message == f"unknown task 'vel-1.5'; did you mean 'vel-1' or 'vel-2'? (there are: {', '.join(SPEEDS)})"


def test_case_is_ignored_unless_it_tells_two_names_apart():
    assert known_name("family", "HalfCheetah-Vel", FAMILIES) == "halfcheetah-vel"
    assert known_name("name", "A", ["a", "A"]) == "A"
    with pytest.raises(UsageError, match="unknown family 'x'"):
        known_name("family", "x", FAMILIES)


def test_control_characters_are_spelt_out():
    assert plain("β [/x] \x1b[31m\n\udcff") == "β [/x] \\x1b[31m\\n\\udcff"


def test_an_unknown_name_of_the_package_is_an_attribute_error():
    with pytest.raises(AttributeError, match="module 'ear_jax' has no attribute 'trian_run'"):
        ear_jax.trian_run  # noqa: B018
