# ruff: noqa: D103
"""Heads and limbs have Assistive Gym's surfaces, where tools and food get."""

from __future__ import annotations

import functools

import numpy as np
import pytest
from parity_rows import assert_rows_hold_or_name_a_deviation

from agym_jax.human import anthropometry, body
from benchmarks.parity import head
from benchmarks.parity.row import traces


@functools.cache
def person(sex: str) -> head.Person:
    return head.Person(sex)


def test_every_row_holds_or_names_a_deviation():
    assert_rows_hold_or_name_a_deviation(head.rows())


@pytest.mark.parametrize("sex", head.SEXES)
def test_rays_meet_what_shapes_say(sex: str):
    """The lips at the height of the face's capsule, and the tip of the nose."""
    d = person(sex).dims
    (lips,) = person(sex).front(np.zeros(1), np.array([(d.face_low + d.face_high) / 2]))[0]
    (tip,) = person(sex).front(np.zeros(1), np.array([(d.nose_low + d.nose_high) / 2]))[0]
    assert lips == pytest.approx(d.face_y - d.face_r, abs=1e-6)
    assert tip == pytest.approx(d.nose_y - d.nose_r, abs=1e-6)
    assert np.isnan(person(sex).front(np.zeros(1), np.array([0.29]))).all()


@pytest.mark.parametrize("sex", head.SEXES)
def test_the_mouth_is_at_the_lips_and_the_nose_before_them(sex: str):
    t = traces("head")
    x, z = t["mouth_x"], t["mouth_z"]
    front = person(sex).front(x, z)
    lips = front[int(np.argmin(abs(z - 0.03))), len(x) // 2]
    assert abs(lips - t[f"{sex}_mouth"][1]) < 0.003
    assert np.nanmin(front) < lips - 0.008
    assert z[np.unravel_index(np.nanargmin(front), front.shape)[0]] == pytest.approx(0.06, abs=0.01)


def test_people_between_man_and_woman_have_faces_between():
    sexes = [anthropometry.dims(s) for s in (0.0, 0.5, 1.0)]
    for name in body.shapes_of(["head"]):
        low, middle, high = (body.shape(name, d) for d in sexes)
        np.testing.assert_allclose(middle.radius, (low.radius + high.radius) / 2)
        np.testing.assert_allclose(middle.centre, np.add(low.centre, high.centre) / 2)
    wide = anthropometry.dims(0.0, 1.1, 1.2)  # AG's heads are meshes of one size
    assert body.shape("face", wide) == body.shape("face", sexes[0])
