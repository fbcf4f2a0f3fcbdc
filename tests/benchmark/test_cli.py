"""The command line: what it prints, what it writes, and one clear line for wrong input."""

import json
import os
import re
import subprocess
import sys
from dataclasses import replace
from itertools import product
from pathlib import Path

import pytest
from things import write_things
from twinbench.benchmark.cli import main
from twinbench.benchmark.options import writable_file
from twinbench.benchmark.provenance import device_name


@pytest.fixture(scope="module")
def cases(tmp_path_factory):
    return write_things(tmp_path_factory.mktemp("cases") / "thing")


@pytest.fixture(autouse=True)
def elsewhere(tmp_path, monkeypatch):
    """Each test in its own working directory with its own cache."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("TWINBENCH_CACHE", str(tmp_path / "cache"))


def run(*options):
    return main(["run", "--methods", "static", "rigid", *map(str, options)])


def test_run_prints_and_writes_the_table(cases, capsys):
    assert run("--data", cases) == 0
    out, err = capsys.readouterr()
    for text in ("thing, resimulation", "thing, prediction", "thing, transfer", "static", "rigid", "chamfer_", "[mm]"):
        assert text in out
    # a line a step where there is no terminal
    assert [re.sub(r"after .*", "after", line) for line in err.splitlines()] == [
        f"thing: {n} of 4: {method} on {name}: scored after"
        for n, (name, method) in enumerate(product(("lift_once", "lift_twice"), ("static", "rigid")), 1)
    ]
    folder = Path("results/thing/latest")
    tables = [f"{name}.{kind}" for name, kinds in {"leaderboard": ("csv", "md", "tex"), "table": ("md", "tex")}.items() for kind in kinds]
    assert sorted(file.name for file in folder.iterdir()) == sorted(["about.json", "config.toml", "rows.csv", "rows.parquet", *tables])
    # resimulation: frames 1..6 at 10 mm a frame along z, where the static twin's matched particles stay behind: mean 35 mm
    line = next(line for line in (folder / "table.md").read_text().splitlines() if line.startswith("| static"))
    assert "| 35.00 |" in line


def test_table_prints_again_what_run_printed(cases, capsys):
    run("--data", cases, "--out", "here")
    printed = capsys.readouterr().out
    assert main(["table", "here"]) == 0
    assert capsys.readouterr().out.strip() in printed
    main(["table", "here", "--format", "markdown"])
    assert capsys.readouterr().out.strip() == Path("here/latest/table.md").read_text().strip()


def test_scenarios_tasks_and_seeds_are_chosen(cases, capsys):
    assert run("--data", cases, "--scenarios", "lift_twice", "--tasks", "prediction", "--seeds", 0, 1, "--out", "o") == 0
    lines = Path("o/latest/rows.csv").read_text().splitlines()
    assert len(lines) == 1 + 2 * 2 and all("lift_twice" in line and ",prediction," in line for line in lines[1:])


def test_the_leaderboard_goes_where_it_is_asked(cases):
    assert run("--data", cases, "--out", "o", "--leaderboard", "board", "--seeds", 0, 1) == 0
    assert sorted(file.name for file in Path("board").iterdir()) == ["leaderboard.csv", "leaderboard.md", "leaderboard.tex"]
    assert not list(Path("o/latest").glob("leaderboard*"))
    # two recordings and two seeds of a method without randomness: over seeds, and nothing varies
    assert "| 35.00 ± 0.00 |" in Path("board/leaderboard.md").read_text()


def test_all_stands_for_every_method(cases, monkeypatch):
    from twinbench.methods import registry

    few = {name: found for name, found in registry.methods().items() if name in ("static", "rigid")}
    monkeypatch.setattr(registry, "methods", lambda: few)
    assert main(["run", "--methods", "all", "--data", str(cases), "--out", "o"]) == 0
    assert {row.split(",")[3] for row in Path("o/latest/rows.csv").read_text().splitlines()[1:]} == set(few)


@pytest.fixture
def ablations(monkeypatch):
    from twinbench.benchmark.ablations import ABLATIONS, Ablation

    made = {"bodies": Ablation("whether bodies move", ("static", "rigid"), metrics=("track_error",)), "tracker": ABLATIONS["tracks"]}
    made["tracker"] = replace(made["tracker"], compared=("static",))
    for module in ("api", "experiment"):
        monkeypatch.setattr(f"twinbench.benchmark.{module}.ABLATIONS", made)
    return made


def test_an_ablation_prints_and_writes_its_own_table(cases, ablations, capsys):
    assert main(["run", "--ablation", "bodies", "--data", str(cases)]) == 0
    out = capsys.readouterr().out
    assert out.startswith("bodies: whether bodies move\n\nthing, resimulation") and "transfer" not in out
    header = Path("results/thing-bodies/latest/table.md").read_text().splitlines()[2]
    assert header == "| method | track_error [mm] | n | fit [s] |"
    assert "bodies: whether bodies move" in Path("results/thing-bodies/latest/leaderboard.md").read_text()
    assert main(["run", "--ablation", "bodies", "--methods", "rigid", "--tasks", "transfer", "--data", str(cases), "--out", "o"]) == 0
    assert {tuple(row.split(",")[3:5]) for row in Path("o/latest/rows.csv").read_text().splitlines()[1:]} == {("rigid", "transfer")}


def test_the_trackers_own_tracks_are_scored_beside_a_twin(cases, ablations, capsys):
    # tracks are three of the tracked points, which are seen in every frame: the tracker is exact, and the static twin is 35 mm off
    assert main(["run", "--ablation", "tracker", "--data", str(cases)]) == 0
    rows = [line.split() for line in capsys.readouterr().out.splitlines() if line.startswith(("tracker  ", "static  "))]
    assert [row[:2] for row in rows[:2]] == [["static", "35.00"], ["tracker", "0.00*"]]


def test_a_preset_may_hold_several_tables(cases, ablations, monkeypatch, capsys):
    from twinbench.benchmark.presets import PRESETS, Preset

    monkeypatch.setitem(PRESETS, "paper", Preset("quick", (str(cases),), ("static",), ("bodies",)))
    assert main(["run", "--preset", "paper", "--out", "o", "--report", "r/all.html"]) == 0
    assert sorted(file.name for file in Path("r").iterdir()) == ["all-bodies.html", "all.html"]
    out = capsys.readouterr().out
    assert out.index("thing, transfer") < out.index("bodies: whether bodies move")
    assert Path("o/latest/table.md").exists() and Path("o/bodies/latest/table.md").exists()
    assert main(["run", "--preset", "paper", "--methods", "rigid"]) == 0  # who says what to compare is given that alone
    assert "bodies:" not in capsys.readouterr().out


def test_metrics_are_chosen_and_an_appearance_is_fitted_for_images_only(capsys):
    # the sample has images, and the baselines need no time
    assert run("--metrics", "chamfer,track_error", "--out", "o") == 0
    header = Path("o/latest/table.md").read_text().splitlines()[2]
    assert header == "| method | chamfer [mm] | track_error [mm] | n | fit [s] |"
    assert not list(Path("cache").glob("appearances*"))


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["runn"], "unknown command 'runn'; did you mean 'run'? known: run, table, compare, picture, curve, check, download, list"),
        (["run", "--methods", "ridgid"], "unknown method 'ridgid'; did you mean 'rigid'?"),
        (["run", "--metrics", "chamfre"], "unknown metric 'chamfre'; did you mean 'chamfer'?"),
        (["run", "--tasks", "predictoin"], "unknown task 'predictoin'; did you mean 'prediction'?"),
        (["run", "--preset", "ful"], "unknown preset 'ful'; did you mean 'full'? known: quick, full, paper"),
        (["run", "--ablation", "stage"], "unknown ablation 'stage'; did you mean 'stages'?"),
        (["run", "--ablation", "stages", "--methods", "phystwin-zer"], "unknown variant 'phystwin-zer'; did you mean 'phystwin-zero'?"),
        (["run", "--preset", "paper"], "--preset paper is for the recordings in data: twinbench download data brings them"),
        (["run", "--methods", "static", "--leaderboard", __file__], "choose another with --leaderboard"),
        (["run", "--device", "cuda:0"], "unknown device 'cuda:0'; did you mean 'cuda'? known: cpu, cuda"),
        (["run", "--split", "claen"], "unknown split 'claen'; did you mean 'clean'?"),
        (["run", "--methods", "static", "--data", "nowhere"], "no recordings at nowhere: no such file or folder"),
        (["run", "--methods"], "--methods needs at least one value"),
        (["run", "--methods", ""], "at least one method must be named, got ''"),
        (["run", "--methods", "static", "--metrics", ","], "at least one metric must be named, got ','"),
        (["run", "--methods", "static", "--report", f"{__file__}/r.html"], "choose another with --report"),
        (
            ["run", "--methods", "static", "--report", "."],
            ".: not a file that can be written (a folder is there); choose another with --report",
        ),
        (["video", "sample/plush_lift", "--methods", "static", "--out", f"{__file__}/r.html"], "choose another with --out"),
        (["play", "sample/plush_lift", "--host", "no.such.host.invalid", "--out", f"{__file__}/played"], "choose another with --out"),
        (["conform", "static", "--data", "nowhere"], "--data nowhere is for a layout to open, and static is a method"),
        (["run", "--seeds"], "--seeds needs at least one value"),
        (["run", "--methods", "static", "--seeds", "4294967296"], "seeds must lie in [0, 4294967295], got 4294967296"),
        (["run", "--methods", "static", "--seeds=-1"], "seeds must lie in [0, 4294967295], got -1"),
        (["real", "hand", "--data", "nowhere"], "nowhere: no cables are there; it must hold data_set (DEFORM) or dataset (DEFT)"),
        (["run", "--methods", "static", "--out", __file__], "test_cli.py: not a folder that results can be written to (File exists)"),
        (["table", "nowhere"], "no results in nowhere: rows.parquet is missing"),
        (["table", "nowhere", "--format", "html"], "unknown format 'html'"),
        (["check", "nowhere"], "no recording at nowhere"),
        (["download", "dota"], "unknown archive 'dota'; did you mean 'data'?"),
        (["list", "--data", "nowhere"], "no recordings at nowhere"),
    ],
)
def test_wrong_input_is_one_line_and_code_2(arguments, message, capsys):
    assert main(arguments) == 2
    out, err = capsys.readouterr()
    assert err.startswith("twinbench: ") and message in err and err.count("\n") == 1
    assert "Traceback" not in out + err


COMPUTING = [["diagnose", "sample/plush_lift"], ["plan", "sample/plush_lift"], ["real", "hand"], ["challenge", "answer", "."]]


@pytest.mark.parametrize("command", COMPUTING)
def test_a_device_that_is_not_there_is_said_before_any_work(command, capsys, monkeypatch):
    monkeypatch.setattr("torch.cuda.is_available", lambda: False)
    device_name.cache_clear()
    assert main([*command, "--device", "cuda"]) == 2
    assert re.fullmatch(
        r"twinbench: device 'cuda' is not there: torch .* finds no CUDA device; use --device cpu\n", capsys.readouterr().err
    )


def test_a_cache_that_cannot_be_written_is_named(cases, capsys, monkeypatch):
    monkeypatch.setenv("TWINBENCH_CACHE", os.devnull)
    assert run("--data", cases) == 2
    assert capsys.readouterr().err.startswith(f"twinbench: {os.devnull}: the cache must be a folder, got a file; TWINBENCH_CACHE names")
    assert main(["cache", "list"]) == 2


def test_where_results_go_is_tried_whoever_asks(tmp_path, monkeypatch):
    # root may write everywhere by its permissions, and still cannot where the disk refuses
    def refused(**_):
        raise OSError(30, "Read-only file system")

    monkeypatch.setattr("twinbench.benchmark.options.TemporaryFile", refused)
    with pytest.raises(ValueError, match=r"not a folder that results can be written to \(Read-only file system\)"):
        writable_file(tmp_path / "page.html")


def test_version(capsys):
    assert main(["--version"]) == 0
    assert re.fullmatch(r"twinbench \d+\.\d+\.\d+\n", capsys.readouterr().out)


def test_unknown_scenario_suggests_the_nearest(cases, capsys):
    assert run("--data", cases, "--scenarios", "lift_one") == 2
    assert "unknown scenario 'lift_one'; did you mean 'lift_once'?" in capsys.readouterr().err


def test_unknown_option_suggests_the_nearest(capsys):
    with pytest.raises(SystemExit) as stopped:
        main(["run", "--presets", "quick"])
    assert stopped.value.code == 2
    assert "--preset" in capsys.readouterr().err.split("Perhaps", 1)[1]


def test_nothing_to_do_is_said(cases, capsys):
    assert run("--data", cases / "lift_once", "--tasks", "transfer") == 2
    assert "nothing to do" in capsys.readouterr().err


def test_a_recording_that_cannot_be_read_is_one_line(cases, tmp_path, capsys):
    (tmp_path / "bad").mkdir()
    (tmp_path / "bad" / "final_data.pkl").write_bytes(b"not a pickle")
    assert run("--data", tmp_path / "bad") == 2
    err = capsys.readouterr().err
    assert "final_data.pkl" in err and err.count("\n") == 1


def test_a_package_that_is_not_there_is_one_line_and_a_fault_of_ours_is_not(tmp_path, capsys, monkeypatch):
    (tmp_path / "beam_a.c3d").write_bytes(b"")

    def read(file):
        raise ImportError("reading this needs a package: pip install one")

    monkeypatch.setattr("twinbench.datasets.softbeam.read_c3d", read)
    assert run("--data", tmp_path) == 2
    err = capsys.readouterr().err
    assert "pip install one" in err and err.count("\n") == 1
    monkeypatch.setitem(sys.modules, "twinbench.benchmark.api", None)
    with pytest.raises(ImportError, match=r"twinbench\.benchmark\.api"):
        run("--data", tmp_path)


def test_a_device_that_is_not_there_is_one_line(cases, capsys):
    torch = pytest.importorskip("torch")
    if torch.cuda.is_available():
        pytest.skip("there is a CUDA device")
    assert run("--data", cases, "--device", "cuda") == 2
    err = capsys.readouterr().err
    assert "device 'cuda' is not there" in err and "--device cpu" in err and err.count("\n") == 1


def test_check_tells_by_its_exit_code(cases, tmp_path, capsys):
    main(["check", str(cases / "lift_once")])
    assert " error" not in capsys.readouterr().out
    (tmp_path / "bad").mkdir()
    (tmp_path / "bad" / "final_data.pkl").write_bytes(b"not a pickle")
    assert main(["check", str(tmp_path / "bad")]) == 1
    assert "final_data.pkl" in capsys.readouterr().out


def test_the_recordings_that_ship_are_known_by_name(capsys):
    assert main(["check", "sample"]) == 0
    assert "error" not in capsys.readouterr().out


def test_list_names_everything(cases, capsys):
    assert main(["list", "--data", str(cases)]) == 0
    out = capsys.readouterr().out
    for text in (
        "static",
        "rigid",
        "chamfer",
        "coordinate_error",
        "prediction",
        "phystwin",
        "lift_once",
        "transfer from lift_once",
        "stages",
    ):
        assert text in out


FRESH = """
import json, sys
from twinbench.benchmark.cli import main
code = main({arguments!r})
print("\\n" + json.dumps([code, sorted({{"torch", "warp", "cv2", "scipy.spatial"}} & set(sys.modules))]))
"""


def fresh(arguments):
    """Exit code and heavy modules imported by the command line in a new process."""
    done = subprocess.run([sys.executable, "-c", FRESH.format(arguments=arguments)], capture_output=True, text=True, check=True)
    assert done.stderr == ""
    return json.loads(done.stdout.splitlines()[-1])


@pytest.mark.long
def test_a_repeated_run_imports_no_engine_and_does_not_read_the_recordings(cases):
    arguments = ["run", "--quiet", "--methods", "static", "rigid", "--data", str(cases)]
    assert fresh(arguments)[0] == 0
    assert fresh(arguments) == [0, []]


def test_help_is_light(tmp_path):
    source = "import sys\nimport twinbench.benchmark.cli\nprint({'torch', 'warp', 'pandas', 'scipy'} & set(sys.modules))"
    assert subprocess.run([sys.executable, "-c", source], capture_output=True, text=True, check=True).stdout == "set()\n"


def test_a_reader_who_has_seen_enough_is_no_error(cases):
    source = "import sys\nfrom twinbench.benchmark.cli import main\nsys.exit(main(['list', '--data', sys.argv[1]]))"
    command = f'{sys.executable} -u -c "$SOURCE" {cases} | head -n 1; exit ${{PIPESTATUS[0]}}'
    done = subprocess.run(["bash", "-c", command], env={**os.environ, "SOURCE": source}, capture_output=True, text=True)
    assert (done.stdout, done.stderr, done.returncode) == ("methods:\n", "", 0)
