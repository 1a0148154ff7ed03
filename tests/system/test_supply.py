"""How the service is shipped: a lock with hashes, a bill of materials, a unit and an image that keep to limits."""

from __future__ import annotations

import configparser
import json
import re
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest
from missing import missing
from packaging.requirements import Requirement

REPOSITORY = Path(__file__).parents[2]
SERVICE = REPOSITORY / "examples" / "service"
sys.path.insert(0, str(REPOSITORY / "tools"))
import lock_service  # noqa: E402 (a tool, not a package)
import release  # noqa: E402

LOCKS = ("requirements.lock", "build.lock")


@pytest.mark.parametrize("name", LOCKS)
def test_every_locked_package_has_hashes_and_no_registry_is_named(name):
    text = (SERVICE / name).read_text(encoding="utf-8")
    entries = [line for line in text.splitlines() if line and not line.startswith((" ", "#"))]
    assert entries and all(re.match(r"[a-z0-9._-]+==\S+ .*\\$", entry) for entry in entries), entries
    assert "://" not in text and "--index" not in text and "--find-links" not in text
    assert all(sums for _, sums in lock_service.locked(text).values())


def test_what_the_project_asks_for_is_locked_within_its_bounds():
    """A floor that was raised, or a dependency that was added, asks for: python tools/lock_service.py"""
    project = tomllib.loads((REPOSITORY / "pyproject.toml").read_text(encoding="utf-8"))
    for name, wanted in (("requirements.lock", [*project["project"]["dependencies"], *(
            text for extra in lock_service.EXTRAS for text in project["project"]["optional-dependencies"][extra])]),
            ("build.lock", project["build-system"]["requires"])):
        found = lock_service.locked((SERVICE / name).read_text(encoding="utf-8"))
        for text in wanted:
            requirement = Requirement(text)
            version, _ = found[requirement.name.lower()]
            assert requirement.specifier.contains(version), (text, version)


def test_the_bill_of_materials_is_the_locks():
    run = subprocess.run([sys.executable, str(REPOSITORY / "tools" / "lock_service.py"), "--check"],
                         capture_output=True, text=True)
    assert run.returncode == 0, f"{run.stdout}{run.stderr}; python tools/lock_service.py writes it anew"
    bill = json.loads((SERVICE / "sbom.cdx.json").read_text(encoding="utf-8"))
    assert bill["bomFormat"] == "CycloneDX" and bill["specVersion"] == "1.6"
    references = [part["bom-ref"] for part in bill["components"]]
    assert len(references) == len(set(references)) >= 10 and bill["dependencies"][0]["dependsOn"] == references
    assert not {"cffi", "pycparser"} & {part["name"] for part in bill["components"]}, "of another Python"


def test_the_image_installs_the_lock_and_nothing_else():
    text = (SERVICE / "Dockerfile").read_text(encoding="utf-8").replace("\\\n", " ")
    installs = re.findall(r"pip (?:install|wheel)[^&\n]*", text)
    assert len(installs) == 4
    for line in installs:
        is_ours = "--no-deps" in line and ("--no-index" in line or "--no-build-isolation" in line)
        assert "--require-hashes -r" in line or is_ours, line
    assert re.search(r"^USER 10001$", text, re.M) and "--uid 10001" in text
    assert "GLRENDER_CACHE=/var/cache/glrender" in text


def test_the_image_has_egl_for_the_cpu_and_for_nvidias_runtime():
    """Mesa's EGL from Debian; of the runtime the driver's EGL, which it mounts for `graphics` alone."""
    text = (SERVICE / "Dockerfile").read_text(encoding="utf-8")
    assert {"libegl1", "libegl-mesa0", "libgl1-mesa-dri"} <= set(text.split())
    assert re.search(r"^ENV NVIDIA_DRIVER_CAPABILITIES=graphics\b", text, re.M)


def test_hadolint_takes_the_image(tmp_path):
    """And would not take a broken one."""
    program = shutil.which("hadolint", path=Path(sys.executable).parent)
    if program is None:
        missing("HADOLINT", "pip install -e '.[test]'")
    run = subprocess.run([program, str(SERVICE / "Dockerfile")], capture_output=True, text=True)
    assert run.returncode == 0, run.stdout
    (tmp_path / "Dockerfile").write_text("FROM debian\nRUN cd /src && sudo apt install python3\n")
    assert subprocess.run([program, str(tmp_path / "Dockerfile")], capture_output=True).returncode != 0


def unit():
    parser = configparser.ConfigParser(strict=False, interpolation=None, comment_prefixes=("#",))
    parser.optionxform = str
    parser.read(SERVICE / "glrender.service", encoding="utf-8")
    return parser["Service"]


def test_the_unit_keeps_to_its_cache_and_limits():
    service = unit()
    assert service["Type"] == "notify" and service["WatchdogSec"] == "30" and service["CapabilityBoundingSet"] == ""
    assert {"MemoryMax", "TasksMax", "LimitNOFILE", "CacheDirectory", "StateDirectory"} <= set(service)
    assert service["SystemCallFilter"] == "@system-service"
    assert "GLRENDER_CACHE=%C/glrender" in service["Environment"]
    assert "glrender/shapes" in service["StateDirectory"]
    assert "--shape-dir /var/lib/glrender/shapes" in service["ExecStart"]


def test_systemd_takes_the_unit(tmp_path):
    analyze = shutil.which("systemd-analyze")
    if analyze is None:
        missing("SYSTEMD-ANALYZE", "make systemd")
    (tmp_path / "glrender.service").write_text(re.sub(
        r"ExecStart=\S+", "ExecStart=/bin/true", (SERVICE / "glrender.service").read_text(encoding="utf-8")))
    run = subprocess.run([analyze, "verify", str(tmp_path / "glrender.service")], capture_output=True, text=True)
    said = run.stdout + run.stderr
    assert run.returncode == 0 and "glrender.service" not in said, said


def test_a_release_finds_a_file_that_record_does_not_have():
    """RECORD as wheels have it: SHA-256 in URL-safe base64 without padding."""
    record = ("a/b.py,sha256=ypeBEsobvcr6wjGzmiPcTaeG7_gUfE5yuYB3ha_uSLs,1\n"
              "gone.py,sha256=ypeBEsobvcr6wjGzmiPcTaeG7_gUfE5yuYB3ha_uSLs,1\nx.dist-info/RECORD,,\n")
    files = {"a/b.py": b"a", "more.py": b"a", "x.dist-info/RECORD": record.encode()}
    assert release.wrong_hashes(files) == ["gone.py", "more.py"]
    assert release.wrong_hashes(files | {"a/b.py": b"b"}) == ["a/b.py", "gone.py", "more.py"]


def test_a_release_deletes_no_folder_of_another(tmp_path, monkeypatch):
    (tmp_path / "thesis.tex").write_text("years of work")
    monkeypatch.setattr(sys, "argv", ["release.py", str(tmp_path)])
    with pytest.raises(SystemExit, match="FOLDER: must be new, empty, or of an earlier release"):
        release.main()
    assert (tmp_path / "thesis.tex").read_text() == "years of work"


@pytest.mark.slow
def test_a_release_is_built_and_checked_offline(tmp_path):
    run = subprocess.run([sys.executable, str(REPOSITORY / "tools" / "release.py"), str(tmp_path / "out")],
                         capture_output=True, text=True)
    assert run.returncode == 0, f"{run.stdout}{run.stderr}"
    names = {path.name for path in (tmp_path / "out").iterdir()}
    assert {"SHA256SUMS", "sbom.cdx.json", "zenodo.json"} < names and len(names) == 5
    zenodo = json.loads((tmp_path / "out" / "zenodo.json").read_text())
    assert zenodo["license"] == "mit" and zenodo["creators"] and zenodo["version"] in "".join(names)
