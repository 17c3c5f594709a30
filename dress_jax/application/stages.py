"""Stages of a long workflow: each in a folder of its own, kept and skipped while its inputs fit.

    DIR/NAME              a complete stage; `stage.json` says what it was made from and how it ended
    DIR/NAME.unfinished   a stage on its way, or one that failed: what it had written so far

A stage writes into its unfinished folder, which takes the place of the complete one at the end.
What it depends on is kept as digests by name: its own options and files, the version of this
package, and the files of the earlier stages that it reads, as they are on disk. So a result that
was edited by hand is used, and what came after it is made again.
"""

import dataclasses
import enum
import hashlib
import shutil
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from dress_jax import __version__
from dress_jax.core.errors import InputError
from dress_jax.io.documents import read_json, to_plain, write_json
from dress_jax.io.results import prepare_folder

REPORT = "stage.json"
_UNFINISHED, _OLD = ".unfinished", ".old"
_BLOCK = 1 << 20


class Ending(enum.Enum):
    """How it went with a stage."""

    DONE = "done"
    KEPT = "kept"
    SKIPPED = "skipped"


@dataclasses.dataclass(frozen=True)
class StageResult:
    """What a stage says about its work.

    Attributes:
        good: whether the result is sound: converged, free of intersections, whatever the stage
            has to hold; the workflow goes on all the same.
        notes: what a reader of the report should know, a sentence each.
        skipped: why there was nothing to do; empty where there was.
    """

    good: bool = True
    notes: tuple[str, ...] = ()
    skipped: str = ""


@dataclasses.dataclass(frozen=True)
class Stage:
    """One stage.

    Attributes:
        name: of the stage and its folder.
        inputs: everything that the result depends on, apart from earlier stages: plain values by
            name; files and folders as `Path`, whose contents count.
        needs: names of the earlier stages that it reads.
        work: writes into the folder that it is given; earlier stages are its neighbours there.
        resumes: whether `work` goes on from what an interrupted run of it has left in its folder.
    """

    name: str
    inputs: Mapping[str, Any]
    needs: tuple[str, ...]
    work: Callable[[Path], StageResult]
    resumes: bool = False


@dataclasses.dataclass(frozen=True)
class StageOutcome:
    """A stage that is complete.

    Attributes:
        name: of the stage.
        folder: with its result.
        ending: how it went this time.
        result: what it said, now or when it was made.
        seconds: that it took when it was made.
        because: the inputs that had changed, where it was made again.
    """

    name: str
    folder: Path
    ending: Ending
    result: StageResult
    seconds: float
    because: tuple[str, ...] = ()


class Stopped(Exception):
    """The user stopped a stage; what is complete stays, and the same call goes on from there.

    Args:
        stage: its name.
    """

    def __init__(self, stage: str):
        super().__init__(f"stopped in stage '{stage}'")
        self.stage = stage


def run_stages(
    folder: str | Path,
    stages: Sequence[Stage],
    *,
    first: str | None = None,
    last: str | None = None,
    tell: Callable[[StageOutcome], None] | None = None,
) -> tuple[StageOutcome, ...]:
    """Run the stages that are not complete, or whose inputs have changed.

    Args:
        folder: of the workflow.
        stages: in their order.
        first: made again from this stage on, even where its inputs fit.
        last: the stage to end with.
        tell: called after every stage.

    Raises:
        InputError: an unknown name, a folder that cannot be written to, or what a stage raises;
            its name comes first.
        Stopped: on Ctrl-C.
    """
    folder, names = Path(folder), [stage.name for stage in stages]
    for option, name in (("--from", first), ("--until", last)):
        if name is not None and name not in names:
            raise InputError(
                f"there is no stage '{name}'", where=option, mend=f"stages are {', '.join(names)}"
            )
    end = len(stages) if last is None else names.index(last) + 1
    forced = len(stages) if first is None else names.index(first)
    if forced >= end and first is not None:
        raise InputError(
            f"comes after stage '{last}'", where=f"--from {first}", mend="turn the two around"
        )
    prepare_folder(folder)
    outcomes = []
    for number, stage in enumerate(stages[:end]):
        outcomes.append(_run(folder, stage, forced=number >= forced))
        if tell is not None:
            tell(outcomes[-1])
    return tuple(outcomes)


def complete_stage(folder: str | Path, name: str) -> StageOutcome | None:
    """A stage that is complete in a folder, whatever it was made from; None where it is not.

    Raises:
        InputError: its report is damaged.
    """
    place = Path(folder) / name
    if not (place / REPORT).is_file():
        return None
    return _kept(place, name)


def digest_of(value: Any) -> str:
    """A short digest of plain values; of a `Path`, of the contents of the file or folder.

    Raises:
        InputError: a path that leads nowhere.
    """
    digest = hashlib.sha256()
    _feed(digest, value)
    return digest.hexdigest()[:16]


def _run(folder: Path, stage: Stage, *, forced: bool) -> StageOutcome:
    place, work = folder / stage.name, folder / f"{stage.name}{_UNFINISHED}"
    digests = {"version": __version__}
    digests |= {name: digest_of(value) for name, value in stage.inputs.items()}
    digests |= {f"stage {name}": digest_of(folder / name) for name in stage.needs}
    kept = _digests(place)
    because = tuple(sorted(name for name in digests if kept.get(name) != digests[name]))
    if kept == digests and not forced:
        return _kept(place, stage.name)
    begun = _digests(work) == digests
    if not (stage.resumes and begun) and work.exists():
        shutil.rmtree(work)
    write_json(work / REPORT, {"stage": stage.name, "inputs": digests})
    started = time.perf_counter()
    try:
        result = stage.work(work)
    except InputError as error:
        where = f"stage '{stage.name}'" + (f", {error.where}" if error.where else "")
        raise InputError(error.problem, where=where, mend=error.mend) from error
    except KeyboardInterrupt as error:
        raise Stopped(stage.name) from error
    seconds = time.perf_counter() - started
    document = {"stage": stage.name, "inputs": digests, "seconds": seconds}
    write_json(work / REPORT, document | to_plain(dataclasses.asdict(result)))
    _replace(place, work)
    ending = Ending.SKIPPED if result.skipped else Ending.DONE
    return StageOutcome(stage.name, place, ending, result, seconds, because if kept else ())


def _replace(place: Path, work: Path) -> None:
    """Put a finished folder in its place; a folder cannot be replaced by another one at once."""
    old = place.with_name(place.name + _OLD)
    if old.exists():
        shutil.rmtree(old)
    if place.exists():
        place.rename(old)
    work.rename(place)
    if old.exists():
        shutil.rmtree(old)


def _digests(place: Path) -> dict[str, str]:
    """What a folder was made from; nothing where it has no report."""
    if not (place / REPORT).is_file():
        return {}
    inputs = read_json(place / REPORT, what="the report of a stage").get("inputs")
    return inputs if isinstance(inputs, dict) else {}


def _kept(place: Path, name: str) -> StageOutcome:
    document = read_json(place / REPORT, what="the report of a stage")
    try:
        result = StageResult(
            good=bool(document["good"]),
            notes=tuple(document["notes"]),
            skipped=str(document["skipped"]),
        )
        seconds = float(document["seconds"])
    except (KeyError, TypeError, ValueError) as error:
        raise InputError(
            "is damaged", where=str(place / REPORT), mend=f"begin again with --from {name}"
        ) from error
    ending = Ending.SKIPPED if result.skipped else Ending.KEPT
    return StageOutcome(name, place, ending, result, seconds)


def _feed(digest: Any, value: Any) -> None:
    if isinstance(value, Path):
        _feed_path(digest, value)
    elif isinstance(value, Mapping):
        for key in sorted(value):
            digest.update(f"{key}=".encode())
            _feed(digest, value[key])
    elif isinstance(value, (list, tuple)):
        digest.update(f"[{len(value)}]".encode())
        for item in value:
            _feed(digest, item)
    else:
        digest.update(f"{value!r};".encode())


def _feed_path(digest: Any, path: Path) -> None:
    if path.is_dir():
        files = sorted(p for p in path.rglob("*") if p.is_file() and p.name != REPORT)
    elif path.is_file():
        files = [path]
    else:
        raise InputError("there is no such file or folder", where=str(path), mend="check the path")
    for file in files:
        inner = file.relative_to(path).as_posix() if path.is_dir() else ""
        digest.update(f"<{inner}>{file.stat().st_size};".encode())
        with file.open("rb") as handle:
            while block := handle.read(_BLOCK):
                digest.update(block)
