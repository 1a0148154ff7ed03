"""Write the service image's lock and its bill of materials: python tools/lock_service.py

`examples/service/requirements.lock` and `build.lock` have the exact version of each package and the SHA-256 of each of
its files, for Linux and Python 3.12; `sbom.cdx.json` lists the same in CycloneDX. uv resolves (it is installed for the
while if it is not here); where from is not written down. `--check` only compares the bill with the locks, offline.
"""

from __future__ import annotations

import argparse
import json
import re
import shutil
import subprocess
import sys
import tempfile
import tomllib
import venv
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
SERVICE = ROOT / "examples" / "service"
LOCK, BUILD_LOCK, BILL = (SERVICE / name for name in ("requirements.lock", "build.lock", "sbom.cdx.json"))
PYTHON = "3.12"
EXTRAS = ("stars", "exr")


def locked(text: str) -> dict[str, tuple[str, list[str]]]:
    """Name to version and SHA-256 sums of a lock, without what only another Python than the image's needs."""
    found = {}
    for entry in re.split(r"\n(?=\S)", text.replace("\\\n", " ").strip()):
        match = re.match(r"([A-Za-z0-9._-]+)==([^\s;]+)", entry)
        if match and "'pypy'" not in entry:
            found[match[1]] = (match[2], re.findall(r"--hash=sha256:([0-9a-f]{64})", entry))
    return found


def bill_of(lock: str) -> str:
    """The CycloneDX document of a lock, as JSON."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    own = f"pkg:pypi/{project['name']}@{project['version']}"
    components = [{"type": "library", "bom-ref": f"pkg:pypi/{name}@{version}", "name": name, "version": version,
                   "purl": f"pkg:pypi/{name}@{version}",
                   "hashes": [{"alg": "SHA-256", "content": each} for each in sums]}
                  for name, (version, sums) in sorted(locked(lock).items())]
    document = {"bomFormat": "CycloneDX", "specVersion": "1.6", "version": 1,
                "metadata": {"component": {"type": "application", "bom-ref": own, "name": project["name"],
                                           "version": project["version"], "purl": own,
                                           "licenses": [{"license": {"id": project["license"]}}]}},
                "components": components,
                "dependencies": [{"ref": own, "dependsOn": [part["bom-ref"] for part in components]}]}
    return json.dumps(document, indent=1) + "\n"


def _uv(folder: str) -> str:
    """uv, found or installed into a folder for the while."""
    found = shutil.which("uv")
    if found:
        return found
    venv.create(folder, with_pip=True)
    subprocess.run([f"{folder}/bin/pip", "install", "--quiet", "uv"], check=True)  # noqa: S603 (our own environment's)
    return f"{folder}/bin/uv"


def resolve() -> None:
    """Write both locks."""
    with tempfile.TemporaryDirectory() as folder:
        build = Path(folder) / "build.in"
        build.write_text("\n".join(tomllib.loads((ROOT / "pyproject.toml").read_text())["build-system"]["requires"]))
        uv = _uv(f"{folder}/env")
        for source, target in ((ROOT / "pyproject.toml", LOCK), (build, BUILD_LOCK)):
            extras = [word for name in EXTRAS for word in ("--extra", name)] if target is LOCK else []
            made = Path(folder) / target.name
            subprocess.run([  # noqa: S603 (no word of it comes from elsewhere)
                uv, "pip", "compile", str(source), *extras, "--universal", "--python-version", PYTHON,
                "--generate-hashes", "--no-annotate", "--no-header", "--no-emit-index-url", "--no-emit-find-links",
                "--quiet", "--output-file", str(made)], check=True, stdout=subprocess.DEVNULL)
            target.write_text("# Written by tools/lock_service.py.\n" + made.read_text(encoding="utf-8"))


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--check", action="store_true", help="whether the bill is the lock's; writes nothing")
    check = parser.parse_args().check
    if not check:
        resolve()
    bill = bill_of(LOCK.read_text(encoding="utf-8"))
    if check:
        is_same = BILL.read_text(encoding="utf-8") == bill
        sys.stdout.write("the bill is the lock's\n" if is_same else f"{BILL.name} is not that of {LOCK.name}\n")
        return int(not is_same)
    BILL.write_text(bill, encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
