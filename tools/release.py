"""Build and check a release, offline: python tools/release.py [FOLDER]

The folder has wheel and sdist, the bill of materials of the service's image, metadata for Zenodo out of CITATION.cff,
and SHA256SUMS. Checked are: metadata by `packaging`, each file of the wheel by its hash in RECORD, the wheel that the
sdist makes by being the same, one version in all. `twine` and `check-wheel-contents` are run where they are installed.
"""

from __future__ import annotations

import base64
import hashlib
import json
import re
import shutil
import subprocess
import sys
import tarfile
import tempfile
import zipfile
from pathlib import Path

from packaging.metadata import Metadata

ROOT = Path(__file__).resolve().parents[1]
TOOLS = {"twine": ["check", "--strict"], "check-wheel-contents": []}
"""Programs of others that check files, and their arguments."""


def build(source: Path, folder: Path, *targets: str) -> list[Path]:
    """Build targets of hatchling's out of a source tree; the files."""
    options = [word for target in targets for word in ("-t", target)]
    command = [sys.executable, "-m", "hatchling", "build", *options, "-d", str(folder)]
    subprocess.run(command, cwd=source, check=True, stdout=subprocess.DEVNULL)  # noqa: S603 (no word is another's)
    return sorted(path for path in folder.iterdir() if path.name.endswith((".whl", ".tar.gz")))


def wheel_files(wheel: Path) -> dict[str, bytes]:
    """Names and contents of a wheel's files."""
    with zipfile.ZipFile(wheel) as packed:
        return {name: packed.read(name) for name in packed.namelist()}


def wrong_hashes(files: dict[str, bytes]) -> list[str]:
    """Names of files that RECORD lacks, or has by another hash, and of those that only RECORD has."""
    record, = (name for name in files if name.endswith(".dist-info/RECORD"))
    rows = [line.rsplit(",", 2) for line in files[record].decode().splitlines()]
    listed = {name.strip('"'): digest for name, digest, _ in rows if name.strip('"') != record}
    made = {name: "sha256=" + base64.urlsafe_b64encode(hashlib.sha256(content).digest()).decode().rstrip("=")
            for name, content in files.items() if name != record}
    return sorted(name for name in listed.keys() | made.keys() if listed.get(name) != made.get(name))


def zenodo(citation: str, description: str) -> dict[str, object]:
    """Zenodo's metadata of a CITATION.cff."""
    def field(name: str) -> str:
        return re.search(rf'^{name}: "?([^"\n]+)"?$', citation, re.M)[1]

    return {"title": field("title"), "version": field("version"), "license": field("license").lower(),
            "upload_type": "software", "description": description,
            "creators": [{"name": name} for name in re.findall(r'^ +- name: "?([^"\n]+)"?$', citation, re.M)]}


def main() -> None:
    folder = Path(sys.argv[1] if len(sys.argv) > 1 else ROOT / "out" / "release").resolve()
    if folder.exists() and not folder.is_dir() or any(folder.glob("*")) and not (folder / "SHA256SUMS").is_file():
        sys.exit(f"FOLDER: must be new, empty, or of an earlier release, got {folder}; name another")
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    wheel, sdist = sorted(build(ROOT, folder, "wheel", "sdist"), key=lambda path: path.suffix != ".whl")
    files = wheel_files(wheel)
    text, = (content for name, content in files.items() if name.endswith(".dist-info/METADATA"))
    metadata, bill = Metadata.from_email(text), json.loads((ROOT / "examples/service/sbom.cdx.json").read_text())
    citation = zenodo((ROOT / "CITATION.cff").read_text(encoding="utf-8"), metadata.summary or "")
    versions = {str(metadata.version), bill["metadata"]["component"]["version"], citation["version"]}
    problems = [f"{wheel.name}: {name}: is not what RECORD says" for name in wrong_hashes(files)]
    if len(versions) > 1:
        problems.append(f"versions differ: {', '.join(sorted(map(str, versions)))}")
    with tempfile.TemporaryDirectory() as place, tarfile.open(sdist) as packed:
        packed.extractall(place, filter="data")
        source, = Path(place).iterdir()
        again = wheel_files(build(source, Path(place, "wheel"), "wheel")[0])
    problems += [f"the wheel of {sdist.name}: {name}: differs" for name in sorted(files.keys() | again.keys())
                 if files.get(name) != again.get(name)]
    for tool, options in TOOLS.items():
        if program := shutil.which(tool):
            command = [program, *options, str(wheel), *([str(sdist)] if tool == "twine" else [])]
            run = subprocess.run(command)  # noqa: S603 (no word is another's)
            problems += [f"{tool} ends with {run.returncode}"] * (run.returncode != 0)
        else:
            sys.stdout.write(f"{tool} is not here: not run\n")
    (folder / "sbom.cdx.json").write_text(json.dumps(bill, indent=1) + "\n")
    (folder / "zenodo.json").write_text(json.dumps(citation, indent=1) + "\n")
    sums = [f"{hashlib.sha256(path.read_bytes()).hexdigest()}  {path.name}\n" for path in sorted(folder.iterdir())]
    (folder / "SHA256SUMS").write_text("".join(sums))
    sys.stdout.writelines(f"{path}\n" for path in sorted(folder.iterdir()))
    sys.exit("\n".join(problems) or 0)


if __name__ == "__main__":
    main()
