"""A diagnosis with a continuum twin: what suits it, what it says of what was found, and what is written."""

import json
from dataclasses import replace
from functools import partial
from types import SimpleNamespace

import numpy as np
import pytest
from blocks import block
from twinbench.benchmark.challenge.schema import Answer
from twinbench.datasets.scenario import Plane, Scenario, Split
from twinbench.diagnosis import asking, diagnosed
from twinbench.diagnosis.asking import ask, informed, sound_twin
from twinbench.diagnosis.config import DiagnosisConfig
from twinbench.diagnosis.diagnose import diagnose
from twinbench.diagnosis.diagnosed import UNHELD, extend
from twinbench.diagnosis.inference import phases
from twinbench.diagnosis.inference.evidence import gathered
from twinbench.diagnosis.inference.refit import Gain
from twinbench.diagnosis.inference.settling import left
from twinbench.diagnosis.inference.wander import Wander
from twinbench.diagnosis.outcome import _probabilities, _why_open, chance_of_listed, chance_of_sound, verdict_of
from twinbench.diagnosis.page.budget import LAYERS, budget, shares
from twinbench.diagnosis.suitable import has_continuum, suitable, unseen_below
from twinbench.methods.continuum import Continuum
from twinbench.methods.continuum.body import body_of
from twinbench.methods.continuum.config import Config
from twinbench.methods.continuum.kinds import SLENDER
from twinbench.physics.terms import Wind

CONFIG = DiagnosisConfig(regions=4, times=3, held_out=1, members=8, cells=1.0, refitted=2)


def test_what_does_not_suit_is_refused_by_name():
    one = block("first")
    larger = replace(block("larger", seed=1), points=2 * one.points, surface=2 * one.surface, interior=2 * one.interior)
    cases = [
        ([], (), "at least one recording"),
        ([one], [replace(one, name="again")], r"another interaction, got the same as first \(scenario again\)"),
        ([one, replace(one, name="again")], (), r"got first twice \(scenario again\)"),
        ([replace(one, split=Split(5, one.frame_count))], (), r"at least 12 train frames, got 5 \(scenario first\)"),
        ([one], [larger], "one object"),
        ([replace(one, points=1000 * one.points)], (), "look like millimetres"),
        ([replace(one, correspond=False, motion_valid=np.zeros_like(one.visible))], (), "must correspond"),
    ]
    for recordings, transfer, said in cases:
        with pytest.raises(ValueError, match=said):
            suitable(recordings, transfer)
    suitable([one, block("second", seed=1)])
    suitable([one, replace(one, name="tilted", gravity=one.gravity + [1.0, 0, 0])])  # under another gravity it is another recording


def stretched(times, name, seed=0):
    """The block, so many times as long."""
    one, wide = block(name, seed=seed), [times, 1.0, 1.0]
    return replace(one, **{part: getattr(one, part) * wide for part in ("points", "surface", "interior", "controllers")})


def test_a_body_between_two_kinds_is_one_object_in_both():
    # what is ten times as long as wide is a rope: one that is seen as 9 and as 12 times as long may be one object, 9 and 17 is another
    ratio = {t: body_of(stretched(t, "one").observed()).evidence["length_over_width"] for t in (2.4, 2.6, 4.0)}
    assert ratio[2.4] < SLENDER < ratio[2.6] < 1.6 * ratio[2.4] < ratio[4.0]
    suitable([stretched(2.4, "short")], [stretched(2.6, "long", seed=1)])
    with pytest.raises(ValueError, match=r"got a solid in short and a rope \(scenario long\)"):
        suitable([stretched(2.4, "short")], [stretched(4.0, "long", seed=1)])


def cloth(name, wide=0.3, gap=None):
    """Tracks of a sheet ``wide`` x 40 cm that is moved along itself: flat, or hung over a bar, so that its halves are ``gap`` m apart."""
    across, along = np.meshgrid(np.linspace(-wide / 2, wide / 2, 16), np.linspace(0, 0.4, 21), indexing="ij")
    arc = np.pi / 4 * (gap or 2 * wide)
    turn, down = np.clip(across / arc, -1, 1) * np.pi / 2, np.clip(np.abs(across) - arc, 0, None)
    bent = np.stack([gap / 2 * np.sin(turn), along, gap / 2 * np.cos(turn) - down], -1) if gap else np.stack([across, along, 0 * along], -1)
    moved = np.arange(30)[:, None, None] * [0.0, 0.01, 0.0]
    points = bent.reshape(-1, 3) + moved + 5e-4 * np.random.default_rng(0).normal(size=(30, bent[..., 0].size, 3))
    seen, one = np.ones(points.shape[:2], bool), block(name)
    nothing = dict(surface=np.zeros((0, 3)), interior=np.zeros((0, 3)), controllers=one.controllers[:1].repeat(30, 0))
    return replace(one, points=points, visible=seen, motion_valid=seen, split=Split(21, 30), **nothing)


def test_a_sheet_that_begins_folded_is_the_one_that_lies_open():
    flat, folded = cloth("flat"), cloth("folded", gap=0.04)
    assert [body_of(one.observed()).kind for one in (flat, folded)] == ["sheet", "solid"]
    suitable([flat], [folded])
    with pytest.raises(ValueError, match=r"a solid in folded and a sheet \(scenario flat\); a sheet that begins folded looks like a solid"):
        suitable([folded], [flat])
    with pytest.raises(ValueError, match=r"a sheet in flat and a solid \(scenario small\)$"):
        suitable([flat], [replace(folded, name="small", points=0.4 * folded.points)])


def test_as_many_recordings_are_fitted_as_are_asked(monkeypatch):
    # a fit of a solid takes three at most unless it is told otherwise, of which the numbers of hands would be taken for those of others
    told, settling, ended = [], [], SimpleNamespace(values={}, ended={})

    def fitted(self, observed, config, **_):
        told.append((len(observed), config.recordings))
        return ended

    monkeypatch.setattr(Continuum, "fitted", fitted)
    solid = SimpleNamespace(scene=SimpleNamespace(body=SimpleNamespace(settling=0)))  # which settles nothing, and is searched once
    monkeypatch.setattr(asking, "settled", lambda twin, recordings, config: settling.append(len(recordings)) or solid)
    assert sound_twin([block(f"take {k}", seed=k) for k in range(5)], CONFIG) is solid
    assert told == [(asking.FEW, 5), (5, 5)] and settling == [5]  # led by a fit of a few


def test_few_points_or_frames_are_refused():
    one = block("first")
    hidden = one.visible.copy()
    hidden[:, 15:] = False
    with pytest.raises(ValueError, match="at least 20 points seen in frame 0, got 15"):
        suitable([replace(one, visible=hidden, motion_valid=hidden)])
    hidden = one.visible.copy()
    hidden[1:] = False
    seldom = replace(one, name="seldom", points=one.points + 0.01, visible=hidden, motion_valid=hidden)
    with pytest.raises(ValueError, match=r"in at least 20% of train frames, got 8\.3%"):
        suitable([seldom])
    suitable([one], [seldom])  # nothing is fitted to a transfer recording: what is seen of it is compared


def test_what_lies_below_the_ground_and_shows_no_body_says_so(monkeypatch):
    def no_body(recordings):
        raise ValueError("no line")

    monkeypatch.setattr("twinbench.diagnosis.suitable.bodies_of", no_body)
    one = block("first")
    up = -one.gravity / np.linalg.norm(one.gravity)
    below = replace(one, name="second", ground=Plane(up, float((one.points[0] @ up).max() + 0.02)))
    with pytest.raises(ValueError, match=r"^no line$"):
        suitable([one])
    with pytest.raises(ValueError, match="no line; second lies below the told ground in frame 0: ask it alone"):
        suitable([below])


def test_of_several_the_one_that_lies_below_the_ground_and_shows_no_body_is_asked_alone(monkeypatch):
    from twinbench.methods.continuum.bodies import bodies_of

    one = block("first")
    up = -one.gravity / np.linalg.norm(one.gravity)
    below = replace(one, name="second", points=one.points + 0.001, ground=Plane(up, float((one.points[0] @ up).max() + 0.02)))
    said, asked = [], []

    def seen(recordings):
        if recordings[0].name == "second":
            raise ValueError("no line")
        return bodies_of(recordings)

    monkeypatch.setattr("twinbench.diagnosis.suitable.bodies_of", seen)
    monkeypatch.setattr("twinbench.diagnosis.diagnose.ask_springs", lambda case, **options: asked.append((case.name, options["transfer"])))
    moved = replace(one, name="third", points=one.points + 0.002)
    diagnose([one, below], transfer=[moved], progress=said.append)
    assert asked == [("second", [moved])] and "second lies below the told ground" in said[0]
    with pytest.raises(ValueError, match="no line; second lies below"):
        diagnose([one, below], twin="continuum")
    assert unseen_below([below]) is None and unseen_below([one, moved]) is None  # one alone is asked by springs anyway


def test_options_that_the_twin_has_no_use_for_are_refused():
    one = block()
    with pytest.raises(ValueError, match="unknown twin 'cloud'"):
        diagnose(one, twin="cloud")
    with pytest.raises(ValueError, match="'springs' is asked about one recording, got 2"):
        diagnose([one, one], twin="springs")
    with pytest.raises(ValueError, match="got block twice"):
        diagnose(one, twin="continuum", fitted_on=[one])


def test_a_continuum_is_asked_of_what_is_tracked_all_over(monkeypatch):
    one = block()
    markers = replace(one, grips=np.arange(one.controllers.shape[1]))
    hidden = one.visible.copy()
    hidden[0, 15:] = False
    few, cloud = replace(one, visible=hidden, motion_valid=hidden), replace(one, correspond=False, motion_valid=np.zeros_like(one.visible))
    places = one.points.shape[1]
    sparse = one.visible & np.isin(np.arange(places), np.linspace(0, places - 1, 20).astype(int))  # in ten regions, none of which has six
    assert not has_continuum(replace(one, visible=sparse, motion_valid=sparse))
    up = -one.gravity / np.linalg.norm(one.gravity)
    level = (one.points[0] @ up).max() + np.array([-0.2, 0.02])
    above, below = (replace(one, ground=Plane(up, float(offset))) for offset in level)  # whose ground is higher than all of the body
    assert has_continuum(above) and not has_continuum(below)
    assert has_continuum(one) and not any(map(has_continuum, (markers, few, cloud)))
    monkeypatch.setattr("twinbench.diagnosis.diagnose.ask", lambda recordings, **options: ("continuum", len(recordings)))
    monkeypatch.setattr("twinbench.diagnosis.springs.inquire", lambda *given, **options: 1 / 0)
    assert diagnose(one) == ("continuum", 1)
    assert diagnose([markers, one]) == diagnose([one, markers]) == ("continuum", 2)  # springs are asked about one recording
    for other in (markers, few, cloud):
        with pytest.raises(ZeroDivisionError):
            diagnose(other)


def test_a_p_value_leaves_a_sound_twin_its_least_probability():
    # Sellke, Bayarri and Berger (2001), table 1: p = 0.05 is at least 0.289, 0.01 at least 0.111, 0.001 at least 0.0184
    assert [chance_of_sound(p) for p in (0.05, 0.01, 0.001)] == pytest.approx([0.289, 0.111, 0.0184], abs=5e-4)
    assert chance_of_sound(0.9) == chance_of_sound(0.4) == 0.5


def test_what_is_missing_is_listed_as_far_as_its_likeliest_name_explains_it():
    # 0.8 before: 4 to 1. A refit that leaves what sound twins do in one of 100 keeps -e p ln p = 0.125 of that, 0.5 to 1; one whose gain is
    # a standard error above nothing 0.841 of it, below nothing 0.159; one that leaves what is usual and gains for sure, all
    config = DiagnosisConfig()

    def listed(left, share, error):
        return chance_of_listed(config, left, Gain(share, error))

    assert chance_of_listed(config) == config.listed == pytest.approx(0.8)
    assert listed(0.5, 0.9, 0.01) == pytest.approx(0.8) == pytest.approx(listed(0.4, np.nan, np.nan))
    assert listed(0.01, 0.9, 0.01) == pytest.approx(0.5007 / 1.5007, abs=1e-3)
    for sign, share in ((1, 0.8413), (-1, 0.1587)):
        assert listed(0.5, 0.2 * sign, 0.2) == pytest.approx(4 * share / (1 + 4 * share), abs=1e-3)
    assert listed(0.5, 0.3, 0.0) == pytest.approx(0.8) and listed(0.0, 0.3, 0.0) < 1e-6
    with pytest.raises(ValueError, match=r"listed must lie in \(0, 1\), got 1"):
        DiagnosisConfig(listed=1.0)


@pytest.mark.parametrize("verdict", ["adequate", "named", "unknown"])
def test_probabilities_say_how_likely_each_effect_is_whatever_the_verdict(verdict):
    # p = 0.01 leaves a sound twin 0.111; what is missing is listed with a third where the likeliest leaves as little as one in 100
    one = SimpleNamespace(left=0.01, gain=Gain(0.9, 0.01))
    found = answer(verdict, chances={"wind": 0.9, "creep": 0.1})
    found.test.p, found.named = 0.01, [] if verdict == "adequate" else [one]
    chances = _probabilities(found, None, DiagnosisConfig())
    missing, listed = 1 - chance_of_sound(0.01), 0.8 if verdict == "adequate" else 0.5007 / 1.5007
    wanted = dict(adequate=1 - missing, wind=0.9 * missing * listed, creep=0.1 * missing * listed, unknown=missing * (1 - listed))
    assert (
        list(chances) == list(wanted)
        and chances == pytest.approx(wanted, abs=1e-3)
        and sum(chances.values()) == pytest.approx(1.0, abs=1e-3)
    )


def answer(verdict="adequate", *, held_out=1.0, sizes=(3.0, 5.0), chances=None, parallel=(), kinds=("wind",), sunk=(), rather=0.0):
    found = [SimpleNamespace(name=f"effect {k}", size=s) for k, s in enumerate(sizes)]
    named = [SimpleNamespace(name=name) for name in kinds]
    chances = {name: 1.0 for name in kinds[:1]} if chances is None else chances
    test = SimpleNamespace(p=0.5, p_held_out=held_out)
    return SimpleNamespace(
        verdict=verdict,
        test=test,
        detectable=found,
        named=named,
        probabilities=chances,
        parallel=parallel,
        wandering=(),
        sunk=sunk,
        cameras_rather=rather,
    )


@pytest.mark.parametrize(
    ("found", "verdict", "names"),
    [
        (answer(), "adequate", ()),
        (answer(sizes=(30.0, 40.0, 2.0)), "cannot_tell", ()),  # half of the effects could be 20 mm large
        (answer("unfounded"), "cannot_tell", ()),  # nothing says how far a sound twin is off
        (answer(held_out=0.001), "cannot_tell", ()),  # fitted frames say sound, those held out do not
        (answer("unknown"), "unknown", ()),
        (answer("named"), "missing", ("wind",)),
        (answer("named", kinds=("controller_delay",)), "measurement", ("controller_delay",)),
        (answer("named", parallel=("gravity_tilt",)), "ambiguous", ("wind", "gravity_tilt")),
        (answer("named", chances={"wind": 0.6, "creep": 0.39, "pressure": 0.01}), "ambiguous", ("wind", "creep")),
        (answer(sunk=(0.0, 0.0)), "adequate", ()),
        (answer("unknown", sunk=(0.0, 0.3)), "ambiguous", ("ground_pose", "camera_pose")),  # below the ground in one of two
        (answer("unknown", sunk=(0.3,), rather=4.0), "measurement", ("camera_pose",)),  # 0.23 e^4 / 0.77: 0.94 of the two
        (answer("unknown", sunk=(0.3,), rather=2.0), "ambiguous", ("camera_pose", "ground_pose")),
        (answer("unknown", sunk=(0.3,), rather=-2.0), "missing", ("ground_pose",)),
        (answer("unknown", rather=9.0), "unknown", ()),  # where it lies is as told
        (answer("named", sunk=(0.3,), rather=-2.0), "ambiguous", ("wind", "ground_pose")),
        (answer("named", sunk=(0.3,)), "ambiguous", ("wind", "ground_pose", "camera_pose")),
        (answer("named", kinds=("ground_pose",), sunk=(0.3,)), "ambiguous", ("ground_pose", "camera_pose")),
    ],
)
def test_the_verdict_follows_from_what_was_found(found, verdict, names):
    assert verdict_of(found, CONFIG) == (verdict, names)


def test_layers_of_the_budget_add_up_to_the_error():
    part = dict(
        record=0, begin=0.0, end=0.5, fitted=True, error=5.0, noise=1.0, representation=3.0, parameters=0.0, named=1.0, unexplained=0.0
    )
    assert sum(shares(part).values()) == pytest.approx(1.0)
    assert shares(part)["representation"] == pytest.approx(9 / 25)
    assert shares(part)["unexplained"] == pytest.approx(14 / 25)
    assert shares(part | {"representation": 9.0})["unexplained"] == 0  # sound twins are off by more than this one
    page = budget({"budget": [part, part | {"begin": 0.5, "end": 1.0, "fitted": False}]})
    assert page.count("<svg") == 1 and page.count('class="held"') == 1 and all(words in page for words in LAYERS.values())
    assert budget({}) == ""


def test_too_few_frames_add_nothing_and_say_so():
    made = Config(starts=1, iterations=1, refinement=0, members=0)
    observed = block().observed()
    start = Continuum().fitted([observed], made)
    twin = extend([observed], start, made, members=4)
    assert twin.note.startswith("not diagnosed: a diagnosis needs at least 12 train frames, got 9")
    assert twin.values == start.values


@pytest.mark.slow
def test_wind_is_found_in_two_recordings_and_a_sound_block_is_none(tmp_path):
    blown = [block(name, seed=k, extra=(Wind(),), wind_y=20.0, wind_speed=3.0) for k, name in enumerate(("first", "second"))]
    found = ask(blown[:1], transfer=blown[1:], config=CONFIG)
    assert found.result["test"]["p"] < 0.03
    assert "wind" in (found.result["effect"], *found.result["alternatives"])
    assert found.result["fit"]["transfer"]["extended"] < 0.7 * found.result["fit"]["transfer"]["baseline"]
    found.write(tmp_path)
    result = json.loads((tmp_path / "diagnosis.json").read_text())
    assert result["schema"] == 2 and result["verdict"] == found.result["verdict"]
    assert Answer.from_dict(result).plain() == result | {"error": None}  # it can be an answer in a challenge
    assert sum(result["probabilities"].values()) == pytest.approx(1.0, abs=1e-3)
    assert {"error", "noise", "representation", "parameters", "named", "unexplained"} <= set(result["budget"][0])
    assert (tmp_path / "report.html").read_text().count('<figure class="budget"') == 1
    assert (tmp_path / "tracks.npz").is_file() and (tmp_path / "twins" / "baseline" / "twin.json").is_file()
    known = ask(blown[:1], fitted_on=[block("known", seed=7)], config=CONFIG)
    assert known.result["test"]["p"] < 0.03 and [r["role"] for r in known.result["evidence"]["recordings"]] == ["case", "fitted_on"]
    sound = ask([block("sound", seed=5), block("other", seed=6)], config=CONFIG)
    assert sound.result["test"]["p"] > 0.03 and sound.result["effect"] is None
    assert {part["record"] for part in sound.result["budget"]} == {0, 1}


def test_a_diagnosed_twin_keeps_no_name_that_makes_it_miss_more(monkeypatch):
    observed, made = block("one").observed(), Config(starts=1, iterations=3, refinement=0, members=0)
    rough, fitted = (Continuum().fitted([observed], one) for one in (replace(made, iterations=0), made))
    found = SimpleNamespace(named=[SimpleNamespace(amounts={"wind_x": 96.0})], test=SimpleNamespace(p=1e-4))
    monkeypatch.setattr(diagnosed, "suitable", lambda recordings: None)  # of so few frames nothing is asked
    monkeypatch.setattr(diagnosed, "infer", lambda *given, **more: found)
    monkeypatch.setattr(diagnosed, "verdict_of", lambda *given: ("missing", ("wind",)))
    asked = [Scenario.of(observed, UNHELD)], DiagnosisConfig(members=4)
    assert left(fitted, *asked) < left(rough, *asked)
    monkeypatch.setattr(diagnosed, "told_twin", lambda *given, **more: rough)
    kept = extend([observed], fitted, made, members=4)
    assert kept.values == fitted.values and kept.note.startswith("nothing added: the twin with wind (wind_x 96) misses more")
    monkeypatch.setattr(diagnosed, "told_twin", lambda *given, **more: fitted)
    taken = extend([observed], rough, made, members=4)
    assert taken.values == fitted.values and taken.note.startswith("with wind (wind_x 96)")


@pytest.mark.long
def test_a_name_whose_twin_misses_more_than_the_sound_one_is_withdrawn(monkeypatch):
    # the twin with the wind that was there misses less; one that misses as much as the sound twin has no use for its name
    made, seen = asking._with, []
    monkeypatch.setattr(asking, "_with", lambda named, twin, *given, **more: seen.append(made(named, twin, *given, **more)) or twin)
    monkeypatch.setattr(asking, "gathered", partial(gathered, missing=dict.fromkeys(("wind", "quadratic_drag"))))  # few effects are asked
    blown = block("blown", extra=(Wind(),), wind_y=20.0, wind_speed=3.0)
    found = asking.asked([blown], CONFIG)
    answer, first = found.answer, found.answer.named[0]
    assert asking.leaves_less(seen[0], found.twin, [blown], CONFIG)
    assert answer.verdict == "unknown" and found.told is None and first.left == 0.0
    assert _why_open(answer, "unknown", CONFIG).endswith("leaves more unexplained than sound twins do.")
    assert all(part.named == 0 for part in answer.budget) and max(part.unexplained for part in answer.budget) > 0
    assert chance_of_listed(CONFIG, first.left, first.gain) < 1e-6


@pytest.mark.slow
def test_tracks_that_wander_are_said_in_the_result(monkeypatch, tmp_path):
    # no effect of the catalogue: nothing that is looked up for effects may be missed for it
    monkeypatch.setattr(phases, "wander", lambda recording, kind: Wander(np.r_[np.full(39, 1e-3), 0.03], 1e-12))
    found = ask([block()], config=replace(CONFIG, members=4, rounds=1))
    assert (found.result["verdict"], found.result["effect"]) == ("measurement", "track_drift")
    assert found.result["experiment"] is None
    found.write(tmp_path)
    assert "drift" in (tmp_path / "report.html").read_text()


@pytest.mark.slow
def test_who_is_told_what_is_missing_sizes_it_and_nothing_else():
    blown = [block(name, seed=k, extra=(Wind(),), wind_y=20.0, wind_speed=3.0) for k, name in enumerate(("first", "second"))]
    told = informed(blown[:1], {"wind": None}, transfer=blown[1:], config=CONFIG).result
    assert told["effect"] == "wind" and {h["effect"] for h in told["evidence"]["hypotheses"]} == {"baseline", "wind"}
    assert told["fit"]["transfer"]["extended"] < 0.7 * told["fit"]["transfer"]["baseline"]
    pull = [told["parameters"][f"wind_{axis}"]["value"] for axis in "xyz"]
    assert pull[1] == pytest.approx(20.0, rel=0.3) and np.hypot(pull[0], pull[2]) < 0.3 * pull[1]
    nothing = informed(blown[:1], {"torsion": None}, config=CONFIG).result  # a block has no twist
    assert nothing["effect"] is None and nothing["parameters"] == {} and nothing["fit"]["train"]["extended"] is None


def test_what_has_no_name_says_what_the_likeliest_lacks():
    def answered(*named):
        return SimpleNamespace(
            named=[
                SimpleNamespace(name="wind", left=left, log_evidence=nats, gain=SimpleNamespace(share=share, error=0.1))
                for left, nats, share in named
            ],
            sunk=(),
            cameras_rather=0.0,
        )

    config = DiagnosisConfig()
    assert _why_open(answered((0.001, 50.0, 0.9)), "unknown", config).endswith("wind, leaves more unexplained than sound twins do.")
    assert _why_open(answered((0.5, 50.0, -0.2)), "unknown", config).endswith("wind, does not hold on the held-out frames.")
    assert _why_open(answered((0.5, 5.0, 0.9)), "unknown", config).endswith("wind, is not much likelier than that nothing is missing.")
    assert _why_open(answered((0.5, 50.0, 0.05)), "unknown", config) is None
    assert _why_open(answered(), "unknown", config) is None and _why_open(answered((0.001, 50.0, 0.9)), "missing", config) is None
