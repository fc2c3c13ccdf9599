"""What models made together share: once for them, never for others."""

from dafw.core.sharing import shared, together


def test_what_is_made_together_has_one_place_and_what_is_made_alone_its_own():
    with together():
        first, second = shared(), shared()
        with together():
            inner = shared()
        assert first is second is shared() and inner is not first
    with together():
        assert shared() is not first
    assert shared() is not shared()


def test_a_thing_is_made_once_for_a_name():
    place, made = shared(), []
    for name in ("solver", "solver", ("solver", 2)):
        place.once(name, lambda name=name: made.append(name) or object())
    assert made == ["solver", ("solver", 2)]
    assert place.once("solver", object) is place.once("solver", object)
