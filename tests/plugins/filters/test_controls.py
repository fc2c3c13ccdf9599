"""Control variables: to coordinates and back."""

from dataclasses import dataclass, field

import numpy as np
import pytest

from dafw import ANGLE, NONNEGATIVE, POSITIVE, ConfigurationError, Model, StateSpace, Variable
from dafw.core.executors.serial import Serial
from dafw.core.rerun import Rerun
from dafw.core.rng import Streams
from dafw.plugins.filters.controls import SMALLEST, Controls

SPACE = StateSpace(
    [
        Variable("gas", 3, NONNEGATIVE),
        Variable("speed", 1, NONNEGATIVE),
        Variable("direction", 1, ANGLE),
        Variable("diffusion", 1, POSITIVE),
        Variable("place", 1),
    ]
)
MEMBERS = np.array([[1.0, 0.0, 2.0, 5.0, 6.2, 0.4, -30.0], [0.0, 0.5, 0.0, 0.2, 0.0, 3.0, 12.5]])


@dataclass
class Filling(Model):
    """The gas at the start is as much as the place says."""

    dt: float = 1.0
    space: StateSpace = field(default_factory=lambda: SPACE)

    def settled(self, members):
        settled = members.copy()
        settled[:, :3] = np.abs(members[:, 6:])
        return settled


RERUN = Rerun(Filling(), Serial(), Streams(0))


def test_they_are_all_single_numbers_unless_named():
    assert Controls(SPACE).names == ("speed", "direction", "diffusion", "place")
    assert Controls(SPACE, ["place", "gas"]).entries.tolist() == [6, 0, 1, 2]
    assert Controls(SPACE, ["gas"]).has_fields and not Controls(SPACE).has_fields
    fields = StateSpace([Variable("x", 4), Variable("y", 2)])
    assert len(Controls(fields)) == 6


def test_names_that_are_unknown_or_twice_are_refused():
    for names, message in ((["speed", "colour"], "colour"), (["speed", "speed"], "twice")):
        with pytest.raises(ConfigurationError, match=message):
            Controls(SPACE, names)


def test_coordinates_are_logarithms_of_numbers_that_must_not_be_negative():
    expected = [[np.log(5.0), 6.2, np.log(0.4), -30.0], [np.log(0.2), 0.0, np.log(3.0), 12.5]]
    np.testing.assert_array_equal(Controls(SPACE).coordinates(MEMBERS), expected)
    calm = MEMBERS.copy()
    calm[:, 3] = 0.0
    assert (Controls(SPACE).coordinates(calm)[:, 0] == np.log(SMALLEST)).all()
    # A field may be zero: its coordinates are its numbers.
    np.testing.assert_array_equal(Controls(SPACE, ["gas"]).coordinates(MEMBERS), MEMBERS[:, :3])


@pytest.mark.parametrize("names", [[], ["diffusion", "direction"], ["gas", "speed"]], ids=str)
def test_there_and_back(names):
    controls = Controls(SPACE, names)
    coordinates = controls.coordinates(MEMBERS)
    found = controls.at(RERUN, MEMBERS[::-1], coordinates, settle=False)
    np.testing.assert_allclose(controls.coordinates(found), coordinates, rtol=1e-14)
    np.testing.assert_allclose(found[:, controls.entries], MEMBERS[:, controls.entries], rtol=1e-14)
    others = np.delete(np.arange(7), controls.entries)
    np.testing.assert_array_equal(found[:, others], MEMBERS[::-1, others])


def test_fields_follow_and_angles_wrap():
    controls = Controls(SPACE)
    coordinates = controls.coordinates(MEMBERS)
    coordinates[:, 1] += [1.0, -0.5]
    found = controls.at(RERUN, MEMBERS, coordinates)
    np.testing.assert_allclose(found[:, 4], [7.2 - 2.0 * np.pi, 2.0 * np.pi - 0.5])
    np.testing.assert_array_equal(found[:, :3], np.abs(found[:, [6, 6, 6]]))
    offset = controls.offset(controls.coordinates(found), controls.coordinates(MEMBERS))
    np.testing.assert_allclose(offset, [[0.0, 1.0, 0.0, 0.0], [0.0, -0.5, 0.0, 0.0]], atol=1e-14)


def test_the_volume_is_the_derivative_of_the_numbers():
    controls = Controls(SPACE)
    coordinates = controls.coordinates(MEMBERS)
    np.testing.assert_allclose(controls.log_volume(coordinates), np.log(MEMBERS[:, 3] * MEMBERS[:, 5]))


def test_what_the_first_guess_knows_is_no_control():
    first = np.repeat(MEMBERS[:1], 4, axis=0)
    first[:, 3] = [1.0, 2.0, 3.0, 4.0]
    open_ones = Controls(SPACE).left_open(first)
    assert open_ones.names == ("speed",) and open_ones.entries.tolist() == [3]
    assert Controls(SPACE, ["speed"]).left_open(first).names == ("speed",)


def test_unknown_numbers_that_do_not_follow_from_the_controls_are_missing():
    assert Controls(SPACE, ["speed", "diffusion"]).missing(RERUN, MEMBERS) == ["direction", "place"]
    assert Controls(SPACE).missing(RERUN, MEMBERS) == []
