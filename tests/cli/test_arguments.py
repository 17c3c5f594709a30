"""What the commands say about bad input: exit code 2 and one line with the mend."""

import json
import subprocess
import sys
import time

import pytest

# Help must come at once; importing jax alone takes longer on a slow machine.
HELP_SECONDS = 5.0


def error_line(result):
    lines = [line for line in result.stderr.splitlines() if line.startswith("error: ")]
    assert len(lines) == 1, result.output
    assert "Traceback" not in result.output
    return lines[0]


def test_a_missing_pattern_is_named(run, tmp_path):
    result = run("drape", tmp_path / "none.json", "--out", tmp_path / "out")
    assert result.exit_code == 2
    assert "none.json" in error_line(result)
    assert "check the path" in error_line(result)


def test_a_broken_pattern_is_named_with_its_line(run, tmp_path):
    (tmp_path / "broken.json").write_text('{"pattern":\n oops}')
    result = run("drape", tmp_path / "broken.json", "--out", tmp_path / "out")
    assert result.exit_code == 2
    assert "line 2" in error_line(result)


@pytest.mark.parametrize(
    ("options", "parts"),
    [
        (("--fabric", "lead"), ("lead", "cotton")),
        (("--fabric-of", "skirt_front=lead"), ("lead", "cotton")),
        (("--fabric-of", "silk"), ("silk", "PANEL=FABRIC")),
        (("--fabric-of", "sleeve=silk"), ("sleeve", "panels are")),
        (("--edge-length", "15"), ("edge length", "metres")),
        (("--pose", "handstand"), ("handstand", "relaxed")),
        (("--shape", "giant"), ("giant", "average")),
        (("--dressing-pose", "handstand"), ("handstand", "relaxed")),
        (("--body", "nobody.obj"), ("nobody.obj", "check the path")),
    ],
)
def test_a_bad_option_is_named_with_its_mend(run, inputs, tmp_path, options, parts):
    result = run("drape", inputs / "skirt.json", "--out", tmp_path / "out", *options)
    assert result.exit_code == 2
    for part in parts:
        assert part in error_line(result)


def test_a_static_mesh_cannot_be_posed(run, inputs, tmp_path):
    result = run(
        *("drape", inputs / "skirt.json", "--out", tmp_path / "out"),
        *("--body", inputs / "body.obj", "--pose", "a"),
    )
    assert result.exit_code == 2
    assert "static mesh" in error_line(result)


def test_an_output_that_cannot_be_written_is_found_before_the_work(run, inputs, tmp_path):
    (tmp_path / "file").write_text("in the way")
    result = run("drape", inputs / "skirt.json", "--out", tmp_path / "file")
    assert result.exit_code == 2
    assert str(tmp_path / "file") in error_line(result)


@pytest.mark.parametrize("command", ["render", "check"])
def test_a_folder_without_a_result_is_refused(run, tmp_path, command):
    options = ("--out", tmp_path / "targets") if command == "render" else ()
    result = run(command, tmp_path, *options)
    assert result.exit_code == 2
    assert "drape.h5" in error_line(result)


def test_nothing_to_resume_is_said(run, inputs, draped, tmp_path):
    folder, _ = draped
    targets = tmp_path / "targets"
    assert run("render", folder, "--views", 2, "--size", 32, "--out", targets).exit_code == 0
    result = run(
        *("fit", inputs / "skirt.json", "--targets", targets, "--body", inputs / "body.obj"),
        *("--edge-length", 0.06, "--resume", "--out", tmp_path / "fit"),
    )
    assert result.exit_code == 2
    assert "--resume" in error_line(result)


@pytest.mark.parametrize("arguments", [("drape",), ("drape", "--nonsense"), ("nonsense",)])
def test_usage_errors_have_the_code_of_bad_input(run, arguments):
    assert run(*arguments).exit_code == 2


def test_every_command_has_help(run):
    names = ("drape", "render", "bundle", "fit", "fit-body", "texture", "animate", "demo", "check")
    overview = run("--help")
    assert overview.exit_code == 0
    for name in names:
        assert name in overview.output
        assert run(name, "--help").exit_code == 0


def test_the_program_starts_without_jax():
    code = (
        "import sys, json\n"
        "from dress_jax.cli.main import app\n"
        "print(json.dumps([name in sys.modules for name in ('jax', 'numpy', 'scipy')]))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert json.loads(done.stdout) == [False, False, False]


def test_the_installed_program_shows_its_version():
    code = "import sys; sys.argv[0] = 'dress-jax'; from dress_jax.cli.main import main; main()"
    begin = time.monotonic()
    done = subprocess.run(
        [sys.executable, "-c", code, "--version"], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0
    assert done.stdout.startswith("dress-jax ")
    assert time.monotonic() - begin < HELP_SECONDS


def test_a_cache_folder_that_cannot_be_made_is_only_a_warning(run, inputs, tmp_path):
    (tmp_path / "file").write_text("in the way")
    result = run("--cache-dir", tmp_path / "file" / "cache", "check", tmp_path)
    assert result.exit_code == 2  # of the missing result, after the warning
    assert "warning: " in result.stderr
    assert "--cache-dir" in result.stderr
