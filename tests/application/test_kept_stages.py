"""The stage runner on light stages: kept, made again, stopped, resumed, and failures by name."""

import dataclasses

import pytest

from dress_jax.application.stages import (
    Ending,
    Stage,
    StageResult,
    Stopped,
    complete_stage,
    digest_of,
    run_stages,
)
from dress_jax.core.errors import InputError


class Workshop:
    """Three stages that copy texts; counts how often each has worked."""

    def __init__(self, folder, source):
        self.folder, self.source = folder, source
        self.worked = []
        self.trouble = {}
        self.option = 1

    def stages(self):
        return [
            Stage("first", {"file": self.source}, (), self.work("first", ())),
            Stage("second", {"option": self.option}, ("first",), self.work("second", ("first",))),
            Stage("third", {}, ("first", "second"), self.work("third", ("second",)), resumes=True),
        ]

    def work(self, name, needs):
        def run(place):
            self.worked.append((name, sorted(p.name for p in place.iterdir())))
            (place / "begun.txt").write_text("begun")
            if name in self.trouble:
                raise self.trouble[name]
            before = [(self.folder / need / "text.txt").read_text() for need in needs]
            own = self.source.read_text() if name == "first" else f"{name} {self.option}"
            (place / "text.txt").write_text(" ".join([*before, own]))
            return StageResult(good=name != "second", notes=(f"note of {name}",))

        return run

    def run(self, **options):
        self.worked.clear()
        return run_stages(self.folder, self.stages(), **options)

    @property
    def names(self):
        return [name for name, _ in self.worked]


@pytest.fixture
def shop(tmp_path):
    (tmp_path / "input.txt").write_text("one")
    return Workshop(tmp_path / "out", tmp_path / "input.txt")


def endings(outcomes):
    return [outcome.ending for outcome in outcomes]


def test_complete_stages_are_kept_with_what_they_said(shop):
    told = []
    made = shop.run(tell=told.append)
    assert endings(made) == [Ending.DONE] * 3 and told == list(made)
    assert (shop.folder / "third" / "text.txt").read_text() == "one second 1 third 1"
    kept = shop.run()
    assert endings(kept) == [Ending.KEPT] * 3 and shop.worked == []
    for before, now in zip(made, kept, strict=True):
        assert dataclasses.replace(before, ending=now.ending) == now
    assert [outcome.result.good for outcome in kept] == [True, False, True]
    assert complete_stage(shop.folder, "second") == kept[1]
    assert complete_stage(shop.folder, "fourth") is None


def test_what_has_changed_is_made_again_with_what_follows(shop):
    shop.run()
    shop.option = 2
    outcomes = shop.run()
    assert shop.names == ["second", "third"]
    assert outcomes[1].because == ("option",) and outcomes[2].because == ("stage second",)
    shop.source.write_text("two")
    assert shop.run()[0].because == ("file",) and shop.names == ["first", "second", "third"]
    # A stage that comes out as before leaves those after it alone.
    shop.run(first="first", last="first")
    assert shop.run() and shop.names == []


def test_a_result_that_was_edited_is_used(shop):
    shop.run()
    (shop.folder / "second" / "text.txt").write_text("by hand")
    outcomes = shop.run()
    assert endings(outcomes) == [Ending.KEPT, Ending.KEPT, Ending.DONE]
    assert (shop.folder / "third" / "text.txt").read_text() == "by hand third 1"


def test_another_version_makes_everything_again(shop, monkeypatch):
    shop.run()
    monkeypatch.setattr("dress_jax.application.stages.__version__", "other")
    assert all(outcome.because[-1] == "version" for outcome in shop.run())


def test_from_and_until(shop):
    assert [o.name for o in shop.run(last="second")] == ["first", "second"]
    assert not (shop.folder / "third").exists()
    shop.run()
    assert shop.names == ["third"]
    outcomes = shop.run(first="second")
    assert shop.names == ["second", "third"] and outcomes[1].because == ()
    with pytest.raises(InputError, match=r"--until: there is no stage 'last'.*first, second"):
        shop.run(last="last")
    with pytest.raises(InputError, match=r"--from third: comes after stage 'first'"):
        shop.run(first="third", last="first")


def test_a_failure_names_the_stage_and_leaves_what_was_done(shop):
    shop.trouble["second"] = InputError("is too short", where="hem", mend="lengthen it")
    with pytest.raises(InputError, match=r"^stage 'second', hem: is too short\. lengthen it\.$"):
        shop.run()
    assert (shop.folder / "first" / "text.txt").exists()
    assert (shop.folder / "second.unfinished" / "begun.txt").exists()
    assert not (shop.folder / "second").exists()
    shop.trouble.clear()
    shop.run()
    # Nothing of the failed attempt is left for a stage that does not resume.
    assert shop.worked[0] == ("second", ["stage.json"])
    assert not (shop.folder / "second.unfinished").exists()


def test_an_earlier_result_stays_until_a_new_one_is_complete(shop):
    shop.run()
    shop.option, shop.trouble["second"] = 2, InputError("no")
    with pytest.raises(InputError):
        shop.run()
    assert (shop.folder / "second" / "text.txt").read_text() == "one second 1"
    # But it is not taken for the new one.
    shop.trouble.clear()
    shop.run()
    assert shop.names == ["second", "third"]


def test_a_stopped_stage_goes_on_with_its_own_files(shop):
    shop.trouble["third"] = KeyboardInterrupt()
    with pytest.raises(Stopped, match="stage 'third'") as stop:
        shop.run()
    assert stop.value.stage == "third"
    shop.trouble.clear()
    shop.run()
    assert shop.worked == [("third", ["begun.txt", "stage.json"])]
    shop.trouble["third"], shop.option = KeyboardInterrupt(), 3
    with pytest.raises(Stopped):
        shop.run()
    shop.trouble.clear()
    shop.option = 4  # what was begun belongs to other inputs
    shop.run()
    assert shop.worked[-1] == ("third", ["stage.json"])


def test_a_skipped_stage_says_why(tmp_path):
    stage = Stage("a", {}, (), lambda place: StageResult(skipped="nothing to do"))
    first, second = (run_stages(tmp_path, [stage])[0] for _ in range(2))
    assert first.ending is second.ending is Ending.SKIPPED
    assert second.result.skipped == "nothing to do"


def test_damaged_reports_are_named(shop):
    shop.run()
    path = shop.folder / "second" / "stage.json"
    path.write_text(path.read_text().replace("notes", "remarks"))
    with pytest.raises(InputError, match=r"second.stage\.json: is damaged.*--from second"):
        shop.run()
    shop.run(first="second")
    with pytest.raises(InputError, match="there is no such file or folder"):
        digest_of(shop.folder / "none")


def test_digests_tell_names_orders_and_contents_apart(tmp_path):
    (tmp_path / "a").mkdir()
    (tmp_path / "a" / "x").write_text("1")
    before = digest_of(tmp_path / "a")
    (tmp_path / "a" / "stage.json").write_text("{}")
    assert digest_of(tmp_path / "a") == before
    (tmp_path / "a" / "x").rename(tmp_path / "a" / "y")
    assert digest_of(tmp_path / "a") != before
    values = [{"a": 1}, {"a": 1.0}, {"b": 1}, [1, 2], [2, 1], [[1], 2], "1", None]
    assert len({digest_of(value) for value in values}) == len(values)
