from __future__ import annotations

import json

import pytest

from api.lights_file import read_lights
from stage.errors import InputError
from stage.lights import Light


def written(tmp_path, text):
    path = tmp_path / "lights.json"
    path.write_text(text if isinstance(text, str) else json.dumps(text))
    return path


def test_single_lights_and_groups(tmp_path):
    entries = [
        {"direction": [0, 0, 2]},
        {"position": [1, 2, 3], "intensity": [2, 0, 1], "scale": 0.5},
        [{"direction": [0, 1, 0], "scale": 2}, {"direction": [1, 0, 0]}],
    ]
    assert read_lights(written(tmp_path, entries)) == [
        [(Light(direction=(0, 0, 1)), 1.0)],
        [(Light(position=(1, 2, 3), intensity=(2, 0, 1)), 0.5)],
        [(Light(direction=(0, 1, 0)), 2.0), (Light(direction=(1, 0, 0)), 1.0)],
    ]


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("", "is not JSON"),
        ("[1,", "is not JSON"),
        ('{"direction": [0,0,1]}', "expected a list of lights, got an object"),
        ("[]", "the list of lights is empty"),
        ("[[]]", r"lights\[0\]: a group"),
        ("[3]", r"lights\[0\]: expected an object"),
        ('[{"direction": [0,0,1], "colour": 1}]', r"lights\[0\]: unknown key 'colour'"),
        ('[{"direction": [0,0,0]}]', r"lights\[0\].direction: must not be zero"),
        ('[{"direction": [0,0,1], "position": [0,0,1]}]', r"lights\[0\]: give exactly one"),
        ("[{}]", r"lights\[0\]: give exactly one"),
        ('[{"direction": [0,0,NaN]}]', "holds NaN"),
        ('[{"direction": [0,0,-Infinity]}]', "holds -Infinity"),
        ('[{"direction": [0,0,1e999]}]', "holds 1e999"),
        ('[{"direction": [0,1]}]', r"lights\[0\].direction: expected three numbers"),
        ('[{"direction": [0,1,true]}]', r"lights\[0\].direction: expected three numbers"),
        ('[{"direction": [0,0,1], "intensity": [1,-1,1]}]', r"lights\[0\].intensity: must not be negative"),
        ('[[{"direction": [0,0,1]}, {"position": "x"}]]', r"lights\[0\]\[1\].position: expected three numbers"),
        ('[{"direction": [0,0,1], "scale": -1}]', r"lights\[0\].scale"),
        ('[{"direction": [0,0,1], "scale": null}]', r"lights\[0\].scale"),
    ],
)
def test_whatever_is_wrong_is_named_with_its_place(tmp_path, text, says):
    path = written(tmp_path, text)
    with pytest.raises(InputError, match=says) as refused:
        read_lights(path)
    assert str(path) in str(refused.value)


def test_a_missing_file_is_named(tmp_path):
    with pytest.raises(InputError, match="no such file"):
        read_lights(tmp_path / "none.json")
