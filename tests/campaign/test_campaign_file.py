"""Campaign files: the cases that they give, and what is refused with field, rule, value and a way out."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from glrender import ConfigError
from glrender_campaign.campaign_file import load_campaign


def with_axes(*lines):
    return "scenario = 'approach.toml'\n[axes]\n" + "\n".join(lines)


def test_cases_are_all_combinations_seeds_fastest(campaign_file):
    campaign = load_campaign(campaign_file(with_axes(
        "seed = [7, 8]", "estimator = ['sphere', 'model']", "faults = [[], [{ kind = 'dust' }]]",
        "belief.bodies.rock.facets = [1.0, 0.5, 0.1]")))
    cases = campaign.cases
    assert len(cases) == 2 * 2 * 2 * 3 == len({case.id for case in cases})
    # A hundred thousand cases of 32 bits would meet.
    assert all(re.fullmatch("[0-9a-f]{16}", case.id) for case in cases)
    assert [case.values["seed"] for case in cases[:4]] == [7, 8, 7, 8]
    assert [case.belief.bodies["rock"].facets for case in cases[::8]] == [1.0, 0.5, 0.1]
    assert campaign.varied == ["belief.bodies.rock.facets", "estimator", "faults", "seed"]


def test_ids_stay_while_what_they_depend_on_does(campaign_file):
    """Another seed adds cases and leaves the others' ids; another scene, handover or shape file changes them all."""
    def ids(*lines, more="", first=""):
        return {case.id for case in load_campaign(campaign_file(first + with_axes(*lines), more)).cases}

    one, two = ids("seed = [1]"), ids("seed = [1, 2]")
    assert one < two and len(two) == 2
    assert not ids("seed = [1, 2]", first="handover = 0.04\n") & two
    assert not ids("seed = [1, 2]", more="[belief.bodies.rock]\nfacets = 0.5\n") & two


def test_a_shape_file_that_changes_is_another_case(campaign_file, tmp_path):
    from glrender import generate

    lines = ["belief.bodies.rock.shape = ['other.obj']", "belief.bodies.rock.length_unit = ['m']"]
    found = []
    for radius_m in (90.0, 95.0):
        generate.icosphere(radius_m=radius_m, subdivisions=2).to_file(tmp_path / "other.obj")
        found += [case.id for case in load_campaign(campaign_file(with_axes(*lines))).cases]
    assert len(set(found)) == 2


@pytest.mark.parametrize("campaign, told", [
    ("[axes]", "campaign.toml.scenario: missing"),
    ("scenario = 'approach.toml'", "campaign.toml.axes: missing"),
    ("scenario = 'aproach.toml'\n[axes]", "aproach.toml"),
    ("scenario = 'approach.toml'\nseeds = 3\n[axes]", "campaign.toml.seeds: unknown key"),
    ("scenario = 'approach.toml'\nhandover = -0.1\n[axes]", "handover: must be a share >= 0 and < 1, got -0.1"),
    ("scenario = 'approach.toml'\npointing = 'truth'\n[axes]", "pointing: must be one of 'estimate', 'scenario'"),
    ("scenario = 'approach.toml'\nbody = 'rok'\n[axes]", "did you mean 'rock'?"),
    ("scenario = 'approach.toml'\ncamera = 'nav'\n[axes]", "did you mean 'navcam'?"),
    (with_axes("seed = []"), "axes.seed: must have a value at least: without, the campaign has no case, got []"),
    (with_axes("seed = 5"), "axes.seed: must be a list of values, got 5; [5] is one"),
    (with_axes("seed = [-1]"), "axes.seed[0]: must be an integer between 0 and"),
    (with_axes("seed = [1, 1]"), "axes.seed[1]: is given twice, got 1; leave one out"),
    (with_axes("seeds = [1]"), "axes.seeds: unknown key; did you mean 'seed'?"),
    (with_axes("estimator = ['modell']"), "axes.estimator[0]: must be one of"),
    (with_axes("estimator = ['altimeter']"), "axes.estimator[0]: must be one of"),
    (with_axes("max_error = [0.1, -0.1]"), "axes.max_error[1]: must be > 0 and <= 1, got -0.1"),
    (with_axes("onboard_max_error = [2.0]"), "axes.onboard_max_error[0]: must be > 0 and <= 1, got 2.0"),
    (with_axes("faults = [[{ kind = 'dusk' }]]"), "axes.faults[0][0].kind: must be one of"),
    (with_axes("faults = [[{ kind = 'dust', depth = -1 }]]"), "axes.faults[0][0].depth: must be between"),
    (with_axes("belief.bodies.rok.facets = [0.1]"), "belief.bodies.rok: unknown key; did you mean 'rock'?"),
    (with_axes("belief.bodies.rock.facet = [0.1]"), "belief.bodies.rock.facet[0]: unknown key; did you mean 'facets'?"),
    (with_axes("belief.bodies.rock.facets.share = [0.1]"), "axes.belief.bodies.rock.facets.share[0]: must be a field"),
    (with_axes("belief.bodies.rock.facets = [0.1, 0.0]"), "axes.belief.bodies.rock.facets[1]: must be a share > 0"),
    (with_axes("belief.bodies.rock.albedo_factor = [9.0]"), "must be between 0 and 1, got 1.8"),
    (with_axes("belief.bodies.rock = [0.1]"), "axes.belief.bodies.rock[0]: must be a table, got 0.1"),
    (with_axes("belief = [0.1]"), "axes.belief: must be a table of beliefs, got [0.1]"),
    (with_axes(f"seed = {list(range(1001))}", f"max_error = {[0.001 * k for k in range(1, 102)]}"),
     "axes: must give 100000 cases at most, got 101101; give fewer values"),
])
def test_what_is_no_campaign_is_refused(campaign_file, campaign, told):
    with pytest.raises(ConfigError) as error:
        load_campaign(campaign_file(campaign, "[belief.bodies.rock]\nfacets = 0.5\n"))
    assert told in str(error.value)


def test_a_combination_that_cannot_be_believed_is_refused_before_the_first_flight(campaign_file):
    """Each value is right alone: 4 times the albedo of 0.2, or a law of 0.3 as it is."""
    lines = ["belief.bodies.rock.brdf.normal_albedo = [0.2, 0.3]", "belief.bodies.rock.albedo_factor = [1.0, 4.0]"]
    brdf = "[belief.bodies.rock]\nbrdf = { law = 'lambert', normal_albedo = 0.2 }\n"
    with pytest.raises(ConfigError) as error:
        load_campaign(campaign_file(with_axes(*lines), brdf))
    told = str(error.value)
    assert told.startswith("campaign.toml.axes.belief.bodies.rock.normal_albedo: must be between 0 and 1, got 1.2; ")
    assert "brdf.normal_albedo = 0.3 and belief.bodies.rock.albedo_factor = 4.0: fly them in separate campaigns" in told
    assert len(load_campaign(campaign_file(with_axes(lines[0], lines[1].replace("4.0", "3.0")), brdf)).cases) == 4


def test_facets_that_a_shape_has_not_are_refused_in_any_combination(campaign_file, tmp_path):
    from glrender import generate

    generate.icosphere(radius_m=90.0, subdivisions=3).to_file(tmp_path / "fine.obj")
    generate.icosphere(radius_m=90.0, subdivisions=0).to_file(tmp_path / "coarse.obj")
    lines = ["belief.bodies.rock.shape = ['fine.obj', 'coarse.obj']", "belief.bodies.rock.length_unit = ['m']",
             "belief.bodies.rock.facets = [1.0, 0.1]"]
    with pytest.raises(ConfigError, match="rock.facets: must leave 4 facets of 20, got 0.1; .*shape = 'coarse.obj'"):
        load_campaign(campaign_file(with_axes(*lines)))


def test_a_body_whose_name_has_dots_is_varied(campaign_file, tmp_path):
    file = campaign_file(with_axes("belief.bodies.'a.b'.facets = [1.0, 0.5]"))
    text = (tmp_path / "approach.toml").read_text()
    (tmp_path / "approach.toml").write_text(text.replace('name = "rock"', 'name = "a.b"'))
    campaign = load_campaign(file)
    assert campaign.varied == ['belief.bodies."a.b".facets']
    assert [case.belief.bodies["a.b"].facets for case in campaign.cases] == [1.0, 0.5]


@pytest.mark.parametrize("axes, told", [
    ("belief.bodies.mars.facets = [0.5]", "campaign.toml.axes.belief.bodies.mars: unknown key; "),
    ("belief.bodies.rock.albedo_factor = [9.0]",
     "campaign.toml.axes.belief.bodies.rock.albedo_factor[0]: belief.bodies.rock.normal_albedo: must be between"),
    (None, "nope.toml: cannot be read: No such file or directory")])
def test_errors_say_a_path_once(campaign_file, monkeypatch, tmp_path, axes, told):
    file = campaign_file(with_axes(axes or ""))
    monkeypatch.chdir(tmp_path)
    with pytest.raises(ConfigError) as error:
        load_campaign(file if axes else "nope.toml")
    assert str(error.value).startswith(told)


@pytest.mark.parametrize("old, new, told", [
    ("times_s = [0.0, 60.0, 120.0, 180.0, 240.0, 300.0]", "times_s = [0.0]", "must give two frames or more"),
    ("[cameras.model]", "[cameras.modell]", "cameras[0].modell: unknown key"),
    ("r_m = [900.0, 300.0, 100.0]", "r_m = [9.0, 3.0, 1.0]", "from the centre of 'rock', which is solid to there"),
])
def test_scenarios_that_cannot_be_flown_are_refused(campaign_file, tmp_path, old, new, told):
    file = campaign_file()
    text = (tmp_path / "approach.toml").read_text()
    assert old in text
    (tmp_path / "approach.toml").write_text(text.replace(old, new))
    with pytest.raises(Exception, match="rock|frames|modell") as error:
        load_campaign(file)
    assert told in str(error.value)


def test_the_example_is_a_campaign():
    """The number of its flights is the page's."""
    examples = Path(__file__).parents[2] / "examples"
    campaign = load_campaign(examples / "campaign" / "campaign.toml")
    assert f"{len(campaign.cases)} flights" in (examples.parent / "docs" / "campaign.md").read_text()
    assert f"{len(campaign.cases)} flights" in (examples / "campaign" / "campaign.toml").read_text()
    assert len(campaign.setup.states) == 16


def test_the_pages_campaign_loads(tmp_path):
    """The file that docs/campaign.md prints, beside the example's scenario."""
    root = Path(__file__).parents[2]
    (printed,) = re.findall(r"```toml\n(.*?)```", (root / "docs" / "campaign.md").read_text(), re.S)
    (tmp_path / "campaign.toml").write_text(printed)
    (tmp_path / "approach.toml").write_text((root / "examples" / "campaign" / "approach.toml").read_text())
    assert len(load_campaign(tmp_path / "campaign.toml").cases) == 32
