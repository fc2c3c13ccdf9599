"""Objects that the models of one run share: each is made once a run, and not shared with other runs."""

from dataclasses import dataclass, field

from toys import Growth, Nudge

from dafw.core.sharing import Shared
from dafw.core.study import Study


def test_a_thing_is_made_once_for_a_name():
    place, made = Shared(), []
    for name in ("solver", "solver", ("solver", 2)):
        place.once(name, lambda name=name: made.append(name) or object())
    assert made == ["solver", ("solver", 2)]
    assert place.once("solver", object) is place.once("solver", object)
    assert Shared().once("solver", object) is not place.once("solver", object)


@dataclass
class Asked(Growth):
    """Keeps every ``Shared`` that it is given."""

    handed: list[Shared] = field(default_factory=list)

    def share_with(self, shared):
        self.handed.append(shared)


def test_the_models_of_a_run_are_handed_one_place_and_those_of_another_run_another():
    places = []
    for _ in range(2):
        study = Study(model=Asked(), truth=Asked(rate=2.0), free=Asked(), filter=Nudge())
        assert not study.model.handed
        study.prepare()
        (place,) = study.model.handed
        assert study.truth.handed == study.free.handed == [place]
        places.append(place)
    assert places[0] is not places[1]
