"""`glrender campaign`: resumed, reproduced, reported; with a full disk, by a Dask cluster, in a browser."""

from __future__ import annotations

import json
import re
import resource
import shutil
from dataclasses import replace
from html.parser import HTMLParser

import pytest
from browser import browser
from glrender import GlrenderError
from glrender.sequences.dask_processes import dask_processes
from glrender_campaign import running
from glrender_campaign.campaign_file import load_campaign
from glrender_campaign.flight import Flight
from glrender_campaign.onboard import OF_FRAMES
from glrender_campaign.running import fly_all, missing, result_of
from glrender_cli.__main__ import main
from missing import needed_module

TIMES = ("processor_s", "frame_ms", "on_board_ms")


@pytest.fixture
def matplotlib():
    return needed_module("matplotlib", "pip install -e '.[test]'")


def results(campaign, folder):
    """Results of all cases, but for how long they took."""
    found = [result_of(folder, case) for case in campaign.cases]
    return [{name: value for name, value in result.items() if name not in TIMES} for result in found]


def test_a_campaign_is_flown_resumed_and_reproduced(campaign_file, tmp_path, capsys, matplotlib):
    file, out = campaign_file(), tmp_path / "out"
    campaign = load_campaign(file)
    first = next(fly_all(campaign, out, 1))
    kept = (out / "cases" / f"{first.id}.json").stat().st_mtime_ns
    assert main(["campaign", str(file), "--out", str(out), "--processes", "2"]) == 0
    said = capsys.readouterr().out
    assert "4 cases, 3 flown now; 4 of 4 cases kept the body" in said
    assert (out / "cases" / f"{first.id}.json").stat().st_mtime_ns == kept
    whole = results(campaign, out)
    assert [result["values"]["belief.cameras.navcam.focal_length_factor"] for result in whole] == [1.0, 1.0, 1.05, 1.05]
    # The worst case's own command, as the report prints it, flies it again: the same errors, to all printed digits.
    line = re.findall(r"<code>glrender (campaign .*?)</code>", (out / "report.html").read_text())[0].split()
    command = line[-1]
    worst = max(whole, key=lambda result: result["error_over_range"]["rms_settled"])
    assert command == worst["id"]
    assert main(line) == 0
    said = capsys.readouterr().out
    assert [float(share) for share in re.findall(r"([\d.]+)% of the range", said)] == \
        [pytest.approx(100.0 * share, abs=6e-4) for share in worst["track"]]
    assert len(list((out / command).glob("frame_*.png"))) == 6
    # More seeds: what is there stays.
    file.write_text(file.read_text().replace("seed = [1, 2]", "seed = [1, 2, 3]"))
    assert len(missing(load_campaign(file), out)) == 2


class Links(HTMLParser):
    """All that a page would load or lead to."""

    def __init__(self):
        super().__init__()
        self.found, self.tags = [], []

    def handle_starttag(self, tag, attributes):
        self.tags.append(tag)
        self.found += [value for name, value in attributes if name in ("src", "href", "srcset", "data", "action")]


def test_the_report_needs_no_other_file_and_fits_a_phone(campaign_file, tmp_path, matplotlib, monkeypatch):
    class Broken(OF_FRAMES["model"]):
        name = "broken <i>"

        def measure(self, frame, believed, render):
            raise ValueError("<script>alert(1)</script>")

    monkeypatch.setitem(OF_FRAMES, Broken.name, Broken)
    file = campaign_file("scenario = 'approach.toml'\nhandover = 0.03\n[axes]\nseed = [1, 2]\nmax_error = [0.3]\n"
                         "estimator = ['model', 'broken <i>']\nfaults = [[], [{ kind = 'dust', probability = 0.5 }]]\n")
    assert main(["campaign", str(file), "--out", str(tmp_path / "out"), "--processes", "1"]) == 0
    page = tmp_path / "out" / "report.html"
    links = Links()
    links.feed(page.read_text())
    assert links.found and all(link.startswith("data:image/") for link in links.found)
    assert not {"script", "i", "link", "iframe"} & set(links.tags)
    text = page.read_text()
    assert "4 of 8 cases kept the body, 4 lost it" in text
    assert "lost: frame 0: ValueError: &lt;script&gt;" in text and "dust in 0.5 of the frames" in text
    with browser(tmp_path / "profile") as chromium:
        for width_px in (380, 1000):
            chromium.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", {
                "width": width_px, "height": 800, "deviceScaleFactor": 1, "mobile": width_px < 500})
            chromium.get(page.as_uri())
            assert chromium.execute_script("return document.documentElement.scrollWidth") <= width_px
            sizes = chromium.execute_script("return [...document.images].map(i => i.complete && i.naturalWidth)")
            # Two axes but the estimator's and seed's, these two, the tracks, and the worst cases.
            assert len(sizes) == 4 + 6 and min(sizes) > 200
        assert chromium.get_log("browser") == []


def test_the_same_campaign_gives_the_same_report(campaign_file, tmp_path, matplotlib):
    file = campaign_file("scenario = 'approach.toml'\n[axes]\nseed = [1, 2]\nmax_error = [0.3]\n")
    pages = []
    for _ in range(2):
        assert main(["campaign", str(file), "--out", str(tmp_path / "out"), "--processes", "1"]) == 0
        pages.append(re.sub(r"[\d.]+ ms", "", (tmp_path / "out" / "report.html").read_text()))
        shutil.rmtree(tmp_path / "out")
    assert pages[0] == pages[1]


def test_a_full_disk_midway_leaves_what_is_done(campaign_file, tmp_path):
    """The system refuses to write as much, as a full disk does; with room again the rest is flown."""
    campaign, out = load_campaign(campaign_file()), tmp_path / "out"
    flying = fly_all(campaign, out, 1)
    done = next(flying)
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (300, hard))
    try:
        with pytest.raises(GlrenderError, match="cannot be written: File too large; 1 of 4 cases are there and stay: "
                                                "make room, and start again"):
            list(flying)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    assert [path.stem for path in (out / "cases").glob("*.json")] == [done.id] and not list(out.rglob(".*"))
    assert len(list(fly_all(campaign, out, 1))) == 3 and not missing(campaign, out)


@pytest.mark.parametrize("content", ["", '{"id": ', "[]", "3", '{"id": 1}', "whole without its track", "no picture"])
def test_a_result_that_is_cut_or_odd_is_flown_again(campaign_file, tmp_path, monkeypatch, content):
    campaign, out = load_campaign(campaign_file()), tmp_path / "out"
    flight = Flight(picture=b"png", result={
        "error_m": {}, "error_over_range": {"rms_settled": 0.1, "last": 0.1}, "frames": 1, "track": [0.1],
        **dict.fromkeys(("values", "status", "reason", "accepted", "worst_frame", *TIMES))})
    monkeypatch.setattr(running, "fly_here", lambda case: replace(flight, result={**flight.result, "id": case.id}))
    assert len(list(fly_all(campaign, out, 1))) == 4 and not missing(campaign, out)
    case = campaign.cases[1]
    path = out / "cases" / f"{case.id}.json"
    if content == "no picture":
        path.with_suffix(".png").unlink()
    else:
        whole = json.loads(path.read_text())
        path.write_text(json.dumps(whole | {"track": []}) if "whole" in content else content)
    assert missing(campaign, out) == [case] == list(fly_all(campaign, out, 1))
    assert not missing(campaign, out) and result_of(out, case)["id"] == case.id


def test_a_dask_cluster_flies_the_same(campaign_file, tmp_path):
    distributed = needed_module("distributed", "pip install distributed")
    campaign = load_campaign(campaign_file())
    list(fly_all(campaign, tmp_path / "here", 1))
    with distributed.LocalCluster(n_workers=1, threads_per_worker=1, processes=True, dashboard_address=None) as cluster:
        list(fly_all(campaign, tmp_path / "there", pool=dask_processes(cluster.scheduler_address)))
    assert results(campaign, tmp_path / "there") == results(campaign, tmp_path / "here")


def test_mistakes_are_told_in_a_line(campaign_file, tmp_path, capsys):
    file = campaign_file()
    (tmp_path / "taken").write_text("")
    for arguments, told in ((["--case", "12345678"], "--case: must be the id of one of 4 cases, got '12345678'; ids "),
                            (["--out", str(tmp_path / "taken")], "--out: must be a folder, or not be there yet"),
                            (["--out", "/proc/foo"], "--out: must be a folder that can be written to (No such file or "
                                                     "directory), got '/proc/foo'; name another"),
                            (["--out", str(tmp_path / "taken"), "--case", load_campaign(file).cases[0].id],
                             "--out: must be a folder, or not be there yet"),
                            (["--processes", "-1"], "--processes: must be an integer between 0 and 256, got -1"),
                            (["--processes", "-3", "--case", "1"], "--processes: must be an integer between 0 and"),
                            (["--dask", "tcp://127.0.0.1:1"], "--dask: no scheduler answers")):
        assert main(["campaign", str(file), "--out", str(tmp_path / "out"), *arguments]) == 1
        error = capsys.readouterr().err
        assert told in error and error.count("\n") == 1, error
