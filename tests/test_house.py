"""The house keeps its own rules."""

import ast
import os
import re
import subprocess
import sys
import tomllib
from importlib.metadata import entry_points, metadata
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
README = (ROOT / "README.md").read_text(encoding="utf-8")
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
CORE = sorted((ROOT / "plugin" / "equimesh").rglob("*.py"))
ADAPTERS = sorted((ROOT / "adapters" / "equimesh_adapters").rglob("*.py"))


def imports(path):
    """Top-level names of every module that a file imports, wherever in it."""
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            yield from (name.name.split(".")[0] for name in node.names)
        elif isinstance(node, ast.ImportFrom) and node.level == 0:
            yield node.module.split(".")[0]


def command_lines():
    """The lines of the README that a shell is to run, under `Two command lines`."""
    section = README.split("## Two command lines")[1].split("\n## ")[0]
    return re.findall(r"^pip .*$", section, re.MULTILINE)


@pytest.mark.parametrize("path", CORE, ids=lambda path: path.name)
def test_the_core_imports_no_adapter_and_no_mesh_tool(path):
    tools = {"equimesh_adapters", "trimesh", "meshio", "pymeshlab", "gmsh", "pyvista", "rasterio"}
    assert not tools & set(imports(path))


@pytest.mark.parametrize("path", CORE + ADAPTERS, ids=lambda path: path.name)
def test_no_module_is_longer_than_it_should_be(path):
    assert len(path.read_text(encoding="utf-8").splitlines()) <= 420


def test_importing_the_package_loads_no_mesh_tool_no_plotting_and_no_algebra():
    slow = {"trimesh", "meshio", "matplotlib", "rasterio", "gmsh", "sympy", "skfem"}
    code = (
        f"import sys, equimesh, equimesh.cli, equimesh_adapters;print(*{slow} & set(sys.modules))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == ""


def test_what_is_installed_is_what_the_project_declares():
    installed = metadata("equimesh")
    assert installed["Version"] == PROJECT["version"]
    declared = PROJECT["entry-points"]["equimesh.adapters"]
    found = {entry.name: entry.value for entry in entry_points(group="equimesh.adapters")}
    assert declared.items() <= found.items()
    assert set(PROJECT["optional-dependencies"]) >= {
        "pymeshlab", "gmsh", "pyvista", "raster", "plot", "scale", "paper", "all", "test",
    }  # fmt: skip


def test_the_readme_has_two_command_lines_and_ci_runs_the_second():
    first, second = command_lines()
    script = (ROOT / ".ci" / "run").read_text(encoding="utf-8")
    pattern = re.search(r"grep -m 1 -E '(.*)' README\.md", script)[1]
    extracted = re.findall(pattern, README, re.MULTILINE)
    assert extracted == [second]
    assert 'eval "$line"' in script
    assert "equimesh remesh" in first


def test_the_first_command_line_does_what_it_says(tmp_path):
    install, remesh = command_lines()[0].split(" && ")
    assert install == "pip install '.[plot]'"
    environment = os.environ | {"PATH": f"{Path(sys.executable).parent}:{os.environ['PATH']}"}
    done = subprocess.run(
        ["bash", "-c", remesh], cwd=tmp_path, env=environment, capture_output=True, text=True,
        check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    for row in ("input", "triangles", "largest error", "bound on the error", "N*", "efficiency"):
        assert row in done.stdout
    assert {path.name for path in tmp_path.iterdir()} == {"jacksboro.ply", "jacksboro.png"}


def test_the_wheel_brings_the_whole_program_of_the_paper():
    tool = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["tool"]
    packed = tool["hatch"]["build"]["targets"]["wheel"]["force-include"]
    program = ROOT / "examples" / "paper"
    files = {*program.glob("*.py"), program / "page.md"}
    assert {ROOT / source for source in packed} == files
    assert {f"equimesh/{source}" for source in packed} == set(packed.values())


def test_the_changelog_knows_the_version():
    assert f"## {PROJECT['version']}" in (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")


def test_the_measured_tables_meet_what_was_asked():
    page = README.split("<!-- measured -->")[1].split("<!-- end of measured -->")[0]
    verdicts, cases = page.split("| function |")
    rows = [line.split(" | ") for line in verdicts.splitlines() if line.startswith("| ")][2:]
    assert len(rows) > 20
    assert {row[-1] for row in rows} <= {"yes |", "skipped |"}
    assert len(cases.strip().splitlines()) == 1 + 1 + 17


def test_every_format_is_in_the_readme():
    from equimesh.formats import formats

    table = README.split("## Formats")[1].split("\n## ")[0]
    listed = {
        suffix: row.split("|")[3].strip() == "yes"
        for row in table.splitlines()
        if row.startswith("| `")
        for suffix in re.findall(r"`(\.\w+)`", row.split("|")[1])
    }
    assert listed == {suffix: family.write is not None for suffix, family in formats().items()}


@pytest.mark.parametrize("example", ["function", "raster", "surface"])
def test_the_examples_run(example, tmp_path):
    done = subprocess.run(
        [sys.executable, ROOT / "examples" / f"{example}.py"], cwd=tmp_path, capture_output=True,
        text=True, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert done.stdout
