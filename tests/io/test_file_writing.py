"""Atomic files, JSON, patterns, reports and progress."""

import io
import json
import os

import numpy as np
import pytest

from dress_jax.core.errors import InputError
from dress_jax.io.atomic import atomic_open, atomic_path, write_text
from dress_jax.io.documents import read_json, to_plain, write_json
from dress_jax.io.patterns import load_pattern, save_pattern
from dress_jax.io.progress import progress
from dress_jax.io.report import peak_memory_mb, write_report
from dress_jax.pattern.specification_writer import to_specification

SQUARE = {
    "pattern": {
        "panels": {
            "front": {
                "vertices": [[0, 0], [20, 0], [20, 30], [0, 30]],
                "edges": [{"endpoints": [k, (k + 1) % 4]} for k in range(4)],
                "translation": [0, 100, 20],
                "rotation": [0, 0, 0],
            }
        },
        "stitches": [],
    },
    "properties": {"curvature_coords": "relative", "units_in_meter": 100},
}


def test_a_failed_write_leaves_the_old_file_and_no_litter(tmp_path):
    path = tmp_path / "deep" / "file.txt"
    write_text(path, "old")
    with pytest.raises(RuntimeError), atomic_open(path) as handle:
        handle.write("half of the new")
        raise RuntimeError
    assert path.read_text() == "old"
    with pytest.raises(RuntimeError), atomic_path(path) as temporary:
        temporary.write_text("half")
        assert temporary.parent == path.parent
        assert temporary.suffix == path.suffix
        raise RuntimeError
    assert path.read_text() == "old"
    with atomic_open(path, binary=True) as handle:
        handle.write(b"new")
    assert path.read_bytes() == b"new"
    assert os.listdir(path.parent) == ["file.txt"]


def test_a_place_that_cannot_be_written_is_named(tmp_path):
    write_text(tmp_path / "file", "")
    for bad in (tmp_path / "file" / "inside.txt", tmp_path):
        with pytest.raises(InputError, match="cannot be written") as caught:
            write_text(bad, "x")
        assert str(bad) in str(caught.value)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b'{"a": 1,\n  "b": }', "line 2, column 8.*no valid JSON"),
        (b"[1, 2]", "holds a list instead of an object"),
        (b"\xff\xfe\x00", "not a UTF-8"),
    ],
)
def test_bad_json_is_named(tmp_path, content, message):
    (tmp_path / "spec.json").write_bytes(content)
    with pytest.raises(InputError, match=message) as caught:
        load_pattern(tmp_path / "spec.json")
    assert "spec.json" in str(caught.value)


def test_missing_json_is_named(tmp_path):
    with pytest.raises(InputError, match=r"none\.json: cannot be read"):
        load_pattern(tmp_path / "none.json")


def test_a_bad_pattern_names_its_file(tmp_path):
    write_json(tmp_path / "spec.json", {"pattern": {"panels": {}}})
    with pytest.raises(InputError, match=r"spec\.json"):
        load_pattern(tmp_path / "spec.json")


def test_patterns_round_trip(tmp_path):
    write_json(tmp_path / "a.json", SQUARE)
    pattern = load_pattern(tmp_path / "a.json")
    save_pattern(pattern, tmp_path / "b.json")
    again = load_pattern(tmp_path / "b.json")
    assert to_specification(again) == to_specification(pattern)
    np.testing.assert_allclose(again.panels[0].vertices, pattern.panels[0].vertices, atol=1e-15)


def test_real_patterns_round_trip(tmp_path, shared_data):
    files = sorted((shared_data / "patterns" / "garmentcode").rglob("*specification.json"))[:2]
    assert files
    for file in files:
        pattern = load_pattern(file)
        save_pattern(pattern, tmp_path / "again.json")
        again = load_pattern(tmp_path / "again.json")
        for panel, other in zip(pattern.panels, again.panels, strict=True):
            # Centimetres and degrees in the file cost a few roundings.
            np.testing.assert_allclose(other.vertices, panel.vertices, atol=1e-12)
            np.testing.assert_allclose(other.translation, panel.translation, atol=1e-12)
            np.testing.assert_allclose(other.rotation, panel.rotation, atol=1e-12)
        assert again.stitches == pattern.stitches


def test_reports_hold_plain_sorted_values(tmp_path):
    content = {"z": np.float32(0.5), "a": {"n": np.int64(3), "rows": np.eye(2)}, "ok": np.True_}
    write_report(tmp_path / "report.json", content)
    report = read_json(tmp_path / "report.json", what="a report")
    assert report["z"] == 0.5
    assert report["a"] == {"n": 3, "rows": [[1.0, 0.0], [0.0, 1.0]]}
    assert report["ok"] is True
    assert list(report) == sorted(report)
    assert report["environment"]["packages"]["jax"]
    assert 10.0 < report["peak_memory_mb"] <= peak_memory_mb()


def test_numbers_that_are_not_finite_are_refused_or_null(tmp_path):
    content = {"loss": [1.0, float("nan")], "worst": np.inf}
    with pytest.raises(ValueError, match="/loss/1 is nan"):
        write_report(tmp_path / "report.json", content)
    assert not (tmp_path / "report.json").exists()
    write_report(tmp_path / "report.json", content, nonfinite_to_null=True)
    report = json.loads((tmp_path / "report.json").read_text())
    assert report["loss"] == [1.0, None]
    assert report["worst"] is None
    with pytest.raises(ValueError, match="/a is a set"):
        to_plain({"a": {1}})


def test_progress_without_a_terminal_prints_sparse_lines():
    stream, now = io.StringIO(), [0.0]
    with progress("drape", total=100, stream=stream, clock=lambda: now[0]) as report:
        for iteration in range(1, 101):
            now[0] += 0.5
            report(iteration, loss=1.0 / iteration)
    lines = stream.getvalue().splitlines()
    assert lines[0] == "drape: 20/100  loss 0.05  40 s left"
    assert lines[-1] == "drape: 100/100  loss 0.01  0 s left"
    assert len(lines) == 5


def test_progress_on_a_terminal_shows_stage_and_loss():
    class Terminal(io.StringIO):
        def isatty(self):
            return True

    stream = Terminal()
    with progress("sew", total=3, stream=stream) as report:
        for iteration in range(1, 4):
            report(iteration, 0.25)
    assert "sew" in stream.getvalue()
    assert "0.25" in stream.getvalue()
