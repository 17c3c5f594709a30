"""The layer order of docs/design.md, held by walking the imports of every module."""

import ast
import re
from pathlib import Path

import pytest

import dress_jax

PACKAGE = Path(dress_jax.__file__).parent
DESIGN = PACKAGE.parent / "docs" / "design.md"

# What each package may import besides itself. Dictionary order is the layer order: a package may
# only name packages above it.
_BELOW_SIM = {"core", "geometry", "pattern", "body", "render", "energy", "contact", "solver"}
_BELOW_IO = {
    *("capture", "vision", "sim", "loss", "optimisation"),
    *("reconstruction", "texture", "motion"),
}
ALLOWED: dict[str, set[str]] = {
    "core": set(),
    "geometry": {"core"},
    "pattern": {"core", "geometry"},
    "body": {"core", "geometry"},
    "render": {"core", "geometry"},
    "energy": {"core", "geometry"},
    "contact": {"core", "geometry"},
    "solver": {"core"},
    "capture": {"core", "geometry", "pattern", "body", "render"},
    "vision": {"core", "capture"},
    "sim": {"core", "geometry", "pattern", "energy", "contact", "solver"},
    "loss": _BELOW_SIM | {"sim"},
    "optimisation": _BELOW_SIM | {"sim", "loss"},
    "reconstruction": {"core", "geometry", "body", "render", "loss"},
    "texture": {"core", "geometry", "pattern", "render"},
    "motion": {"core", "geometry", "body"},
    "io": _BELOW_SIM | _BELOW_IO,
    "application": _BELOW_SIM | _BELOW_IO | {"io"},
    "cli": _BELOW_SIM | _BELOW_IO | {"io", "application"},
}
# Layers that may touch files, clocks and the environment.
EFFECTS = {"io", "application", "cli"}
# Tools that make the embedded data once; no simulation runs through them.
EFFECT_MODULES = {"body/bake.py", "body/anny_source.py", "vision/bake.py"}

_EFFECT_IMPORTS = {
    "os",
    "pathlib",
    "time",
    "datetime",
    "tempfile",
    "shutil",
    "glob",
    "subprocess",
    "socket",
    "logging",
}
_EFFECT_CALLS = {"open", "input", "print", "exec", "eval"}
_EFFECT_ATTRIBUTES = {
    ("np", "load"),
    ("np", "save"),
    ("np", "savez"),
    ("np", "savez_compressed"),
    ("np", "loadtxt"),
    ("np", "savetxt"),
    ("np", "genfromtxt"),
    ("np", "fromfile"),
}


def _modules():
    return sorted(PACKAGE.rglob("*.py"))


def _name(path: Path) -> str:
    return path.relative_to(PACKAGE).as_posix()


def _imports(tree: ast.AST):
    """Absolute dotted names imported anywhere in a module, with their lines."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from ((alias.name, node.lineno) for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            if node.level:
                yield "<relative>", node.lineno
            elif node.module == "dress_jax":
                yield from ((f"dress_jax.{alias.name}", node.lineno) for alias in node.names)
            else:
                yield from ((f"{node.module}.{alias.name}", node.lineno) for alias in node.names)


def layer_violations(package: str, source: str) -> list[str]:
    """Imports of a module that its package may not have."""
    faults = []
    for name, line in _imports(ast.parse(source)):
        if name == "<relative>":
            faults.append(f"{line}: relative import")
        elif name.startswith("dress_jax."):
            target = name.split(".")[1]
            known = target in ALLOWED  # else a name such as __version__
            if known and target != package and target not in ALLOWED[package]:
                faults.append(f"{line}: {package} imports {target}")
    return faults


def effect_violations(source: str) -> list[str]:
    """Touches of files, clocks, the environment or global configuration."""
    tree = ast.parse(source)
    faults = [
        f"{line}: imports {name}"
        for name, line in _imports(tree)
        if name.split(".")[0] in _EFFECT_IMPORTS
    ]
    for node in ast.walk(tree):
        if not isinstance(node, ast.Call):
            continue
        called = node.func
        if isinstance(called, ast.Name) and called.id in _EFFECT_CALLS:
            faults.append(f"{node.lineno}: calls {called.id}")
        elif isinstance(called, ast.Attribute):
            owner = ast.unparse(called.value)
            if (owner, called.attr) in _EFFECT_ATTRIBUTES:
                faults.append(f"{node.lineno}: calls {owner}.{called.attr}")
            if (owner, called.attr) == ("jax.config", "update"):
                faults.append(f"{node.lineno}: changes the global configuration")
    return faults


def test_every_package_has_a_layer():
    folders = {path.parent.name for path in PACKAGE.glob("*/__init__.py")}
    assert folders <= set(ALLOWED)


def test_table_is_the_order_of_the_design_note():
    """The packages of docs/design.md are those of the table; its arrows agree with it."""
    text = DESIGN.read_text(encoding="utf-8")
    assert set(re.findall(r"^\| `(\w+)` \|", text, re.MULTILINE)) == set(ALLOWED)
    order = list(ALLOWED)
    for package, allowed in ALLOWED.items():
        assert all(order.index(other) < order.index(package) for other in allowed)
    chain = re.search(r"-> (loss -> [\w >-]+)\n", text)
    assert chain is not None
    names = chain.group(1).split(" -> ")
    assert names == order[order.index("loss") :]
    assert "energy -> contact -> solver" in text


def test_imports_go_one_way():
    faults = []
    for path in _modules():
        name = _name(path)
        if "/" in name:
            source = path.read_text(encoding="utf-8")
            faults += [f"{name}:{fault}" for fault in layer_violations(name.split("/")[0], source)]
    assert not faults, "\n".join(faults)


def test_numeric_layers_have_no_effects():
    faults = []
    for path in _modules():
        name = _name(path)
        if name.split("/")[0] not in EFFECTS and name not in EFFECT_MODULES:
            source = path.read_text(encoding="utf-8")
            faults += [f"{name}:{fault}" for fault in effect_violations(source)]
    assert not faults, "\n".join(faults)


def test_only_outer_layers_use_the_data_tools():
    """The exempt modules must not leak into the numeric layers through an import."""
    tools = {"dress_jax." + name[:-3].replace("/", ".") for name in EFFECT_MODULES}
    for path in _modules():
        name = _name(path)
        if name.split("/")[0] in EFFECTS or name in EFFECT_MODULES:
            continue
        found = {
            imported
            for imported, _ in _imports(ast.parse(path.read_text(encoding="utf-8")))
            if any(imported == tool or imported.startswith(tool + ".") for tool in tools)
        }
        assert not found, f"{name} imports {found}"


@pytest.mark.parametrize(
    ("package", "source"),
    [
        ("energy", "from dress_jax.contact.barrier import barrier"),
        ("contact", "import dress_jax.sim.kernels"),
        ("solver", "from dress_jax import energy"),
        ("sim", "def f():\n    from dress_jax.optimisation import fit"),
        ("core", "from . import results"),
    ],
)
def test_a_wrong_import_is_found(package, source):
    assert layer_violations(package, source)


@pytest.mark.parametrize(
    "source",
    [
        "import os",
        "from pathlib import Path",
        "import time as t",
        "with open('a') as f: pass",
        "import numpy as np\nnp.load('a')",
        "import jax\njax.config.update('jax_enable_x64', True)",
    ],
)
def test_an_effect_is_found(source):
    assert effect_violations(source)
