"""README.md and docs/ keep their word: commands exist, examples run, tables are what the program prints, .ci/run does what README says."""

import csv
import os
import re
import shlex
import subprocess
import sys
import tomllib
from dataclasses import fields
from importlib import import_module
from pathlib import Path

import numpy as np
import pytest
from twinbench.benchmark import commands
from twinbench.benchmark.cli import GROUPS
from twinbench.benchmark.plan import TASKS
from twinbench.benchmark.results import Results, read_results
from twinbench.benchmark.table import blocks, terminal
from twinbench.methods.registry import methods
from twinbench.metrics.base import metrics

ROOT = Path(__file__).resolve().parents[2]
README = (ROOT / "README.md").read_text(encoding="utf-8")
WRITTEN = {
    file.relative_to(ROOT).as_posix(): file.read_text(encoding="utf-8")
    for file in [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]
}
APART = [f"docs/{name}.md" for name in ("capture", "clusters", "diary", "planning", "playground", "quirks", "submissions")]
OTHERS = {page: text for page, text in WRITTEN.items() if page in APART}  # which have commands with placeholders, and options of modules
PAGES = {page: text for page, text in WRITTEN.items() if page not in APART}
LINKED = WRITTEN | {f.relative_to(ROOT).as_posix(): f.read_text(encoding="utf-8") for f in sorted((ROOT / "results").glob("*.md"))}
TEXT = "\n".join(PAGES.values())


def block(page, language, number=0):
    return re.findall(rf"^```{language}\n(.*?)^```$", PAGES[page], re.M | re.S)[number]


def commands_in(text):
    lines = [
        line.split("  #")[0].strip() for found in re.findall(r"^```bash\n(.*?)^```$", text, re.M | re.S) for line in found.splitlines()
    ]
    return lines + re.findall(r"`((?:pip|twinbench|python3?) [^`]*)`", text)


COMMANDS = list(dict.fromkeys(commands_in(TEXT)))
EXAMPLE = block("docs/howto/python.md", "python")
TABLE = block("docs/tutorials/tables.md", "text")
CLONE, _, INSTALL_AND_RUN, INSTALL_AND_TEST = commands_in(README)[:4]

SUBCOMMANDS = commands.COMMANDS | GROUPS
NESTED = {name: import_module(group.commands, "twinbench.benchmark").COMMANDS for name, group in GROUPS.items()}


def parts(command):
    return [shlex.split(part) for part in re.split(r" && ", " ".join(command.split()))]


def calls(program, listed=COMMANDS):
    return [words for command in listed for words in parts(command) if words[: len(program)] == program]


def test_the_first_screen_has_a_picture_two_commands_and_a_table():
    first = README.split("## Documentation")[0]
    assert first.index("results/sample.png") < first.index("```bash") and first.count("```bash") == 1
    assert CLONE == "git clone URL twinbench && cd twinbench"
    assert INSTALL_AND_RUN == "pip install -e . && twinbench run"
    assert INSTALL_AND_TEST == 'pip install -e ".[test]" && python -m pytest --numprocesses=2 --dist=loadfile'
    assert (ROOT / "results" / "sample.png").stat().st_size < 150_000
    assert (ROOT / "results" / "sample.png").read_bytes().startswith(b"\x89PNG")
    assert len(README.splitlines()) <= 120


def test_readmes_table_is_a_part_of_the_tutorials():
    shown = block("README.md", "text").strip()
    assert shown.startswith("sample, prediction: ") and shown in TABLE


def test_ci_run_installs_and_tests_as_the_readme_says():
    script = ROOT / ".ci" / "run"
    assert os.access(script, os.X_OK)
    lines = [line.strip() for line in script.read_text().splitlines() if line.strip()]
    assert lines[-1] == INSTALL_AND_TEST  # last: its exit status is the script's
    assert "set -euo pipefail" in lines and "python -m pytest --long -m long --numprocesses=2 --dist=loadfile" in lines
    subprocess.run(["bash", "-n", str(script)], check=True)


def test_extras_are_there():
    extras = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["optional-dependencies"]
    named = set(re.findall(r"\.\[(\w+)\]", TEXT))
    assert {"test", "plots", "synthetic", "docs", "capture"} <= named <= set(extras)
    # the default tests skip nothing for want of a package
    assert {one for name in named for one in extras[name]} <= set(extras["test"])


EVERYWHERE = [command for text in (TEXT, *OTHERS.values()) for command in commands_in(text)]


@pytest.mark.parametrize("command", dict.fromkeys(shlex.join(words) for words in calls(["twinbench"], EVERYWHERE)))
def test_twinbench_commands_exist(command):
    name, *arguments = shlex.split(command)[1:]
    if name == "COMMAND":  # of any
        return
    options = {field.name.replace("_", "-") for field in fields(NESTED[name][arguments[0]] if name in NESTED else SUBCOMMANDS[name])}
    assert {word[2:] for word in arguments if word.startswith("--")} <= options | {"help"}


def test_every_subcommand_is_mentioned():
    said = [words for words in calls(["twinbench"], EVERYWHERE) if words[1] != "COMMAND"]
    assert {words[1] for words in said} == set(SUBCOMMANDS)
    for name, nested in NESTED.items():
        assert {words[2] for words in said if words[1] == name and words[2:]} == set(nested)


def test_options_in_the_prose_exist():
    every = [*SUBCOMMANDS.values(), *(command for nested in NESTED.values() for command in nested.values())]
    options = {field.name.replace("_", "-") for command in every for field in fields(command)}
    assert set(re.findall(r"`--([\w-]+)", TEXT)) - {"cuda", "small"} <= options  # those are of modules that are run with python -m


@pytest.mark.parametrize("command", dict.fromkeys(shlex.join(words) for words in calls(["python"]) + calls(["python3"])))
def test_python_commands_exist(command):
    words = shlex.split(command)[1:]
    if words[0] != "-m":  # a file that the page shows
        assert f"`{words[0]}`" in TEXT
        return
    module, *arguments = words[1:]
    for word in arguments:
        assert word.startswith((".", "--")) or (ROOT / word).exists()
    if module.startswith("twinbench."):
        printed = subprocess.run([sys.executable, "-m", module, "--help"], capture_output=True, text=True, check=True).stdout
        assert {word for word in arguments if word.startswith("--")} <= set(re.findall(r"--\w+", printed))
    else:
        assert module in ("pytest", "venv")


@pytest.mark.parametrize("page", LINKED)
def test_links_lead_somewhere(page):
    prose, there = re.sub(r"^```.*?^```$", "", LINKED[page], flags=re.M | re.S), []
    for target in re.findall(r"\]\((?!https?:)([^)]+)\)", prose):
        file, _, anchor = target.partition("#")
        to = (ROOT / page).parent / file if file else ROOT / page
        if to.resolve().relative_to(ROOT).as_posix().startswith("docs/reference/") and not to.exists():
            assert to.name in ("python.md", "commands.md", "found.md")  # made with the site, which checks its links
            continue
        assert to.exists(), target
        there.append(to.resolve())
        if anchor:
            headings = re.findall(r"^#+ (.*)$", to.read_text(encoding="utf-8"), re.M)
            assert anchor in {re.sub(r"[^\w -]", "", heading).lower().replace(" ", "-") for heading in headings}, target
    hidden = subprocess.run(["git", "check-ignore", "--", *there], capture_output=True, text=True, cwd=ROOT).stdout if there else ""
    assert not hidden, hidden  # from a clone it would be missing


def test_the_example_runs(tmp_path):
    printed = subprocess.run([sys.executable, "-c", EXAMPLE], capture_output=True, text=True, cwd=tmp_path, check=True).stdout
    found = float(re.match(r"Score\(mean=([\d.]+), frames=15, unscorable=0\)", printed)[1])
    assert 0 < found < 0.1  # m: the sample's body is 0.3 m long


@pytest.mark.slow
def test_the_example_runs_with_phystwin(tmp_path):
    source = EXAMPLE.replace('get_method("rigid")', 'get_method("phystwin")')
    assert source != EXAMPLE
    subprocess.run([sys.executable, "-c", source], capture_output=True, cwd=tmp_path, check=True)


def run_again(folder, scored):
    """What the first command prints, with the baselines only: their figures take little time and hardly depend on the machine."""
    environment = os.environ | {"TWINBENCH_CACHE": str(folder / "cache")}
    script = "import sys; from twinbench.benchmark.cli import main; sys.exit(main())"
    options = ["run", "--methods", "static", "rigid", "--metrics", *scored]
    return subprocess.run([sys.executable, "-c", script, *options], capture_output=True, text=True, cwd=folder, env=environment, check=True)


LENGTHS = [name for name, metric in metrics().items() if metric.unit == "m"]


@pytest.fixture(scope="module")
def printed_again(tmp_path_factory):
    """The lengths alone, which need no appearance of the body: a minute and a half of a core less."""
    folder = tmp_path_factory.mktemp("run")
    return run_again(folder, LENGTHS).stdout, folder


def figures(text):
    """{(task, method): the figures of its rows, without their time}."""
    found, task = {}, ""
    for line in text.splitlines():
        if heading := re.match(r"sample, (\w+): ", line):
            task = heading[1]
        elif task and (row := re.match(r"(\S+) +((?:[-\d.*]+ +)+)\d+\.\d$", line)):
            found.setdefault((task, row[1]), []).extend(row[2].replace("*", "").split())
    return found


def test_the_lengths_in_the_table_are_what_the_command_prints(printed_again):
    here, there = figures(TABLE), figures(printed_again[0])
    assert set(here) == {(task, method) for task in TASKS for method in ("static", "rigid", "phystwin")}
    assert set(there) == {(task, method) for task in TASKS for method in ("static", "rigid")}
    for key, printed in there.items():
        assert here[key][: len(LENGTHS)] == printed[: len(LENGTHS)]


def spaced(line):
    named = line.replace(" config.toml,", "")  # docs/clusters.md has it
    return re.sub(r"\d{4}-\d\d-\d\d_\d\d-\d\d-\d\d", "WHEN", " ".join(named.split()))


def test_the_table_is_in_the_format_that_is_printed(printed_again):
    # its own figures, as rows of two recordings each, printed anew: the same text to the last character, but for where it was written
    rows, names = [], [name for name in metrics() if not name.startswith("lpips")]
    shown = [name for name in names if name not in ("iou_corrected", "psnr_corrected")]
    for (task, method), values in figures(TABLE).items():
        *values, _count = values
        seconds = float(re.search(rf"^{method} .* (\S+)$", TABLE, re.M)[1])
        assert len(values) == len(shown)
        row = dict(zip(shown, [float(v.replace("-", "nan")) for v in values], strict=True))
        row = {name: v / 1e3 if metrics()[name].unit == "m" else v for name, v in row.items()}
        row |= {f"{name}_corrected": row[name] for name in ("iou", "psnr")} | {f"{name}_unscorable": 0 for name in names}
        row |= {f"{name}_reason": "the twin's particles are not the recording's points" for name in names if np.isnan(row[name])}
        about = {"collection": "sample", "task": task, "method": method, "status": "ok", "seed": 0, "fit_seconds": seconds, "frames": 9}
        rows += [row | about | {"scenario": scenario, "sources": scenario} for scenario in ("plush_drag", "plush_lift")]
    again = terminal(Results.of(rows, {name: metrics()[name] for name in names}, []))
    assert TABLE.splitlines()[:-1] == [*again.splitlines(), ""]
    assert spaced(TABLE.splitlines()[-1]) == spaced(printed_again[0].splitlines()[-1])


@pytest.mark.slow
def test_the_table_is_what_the_command_prints(tmp_path):
    scored = [name for name in metrics() if not name.startswith("lpips")]  # which need a download, and are not in the table that is shown
    again = run_again(tmp_path, scored).stdout
    here, there = figures(TABLE), figures(again)
    for key, printed in there.items():
        assert here[key][: len(LENGTHS)] == printed[: len(LENGTHS)]
        # the appearance comes from some hundred steps in single precision, which machines round in their own way
        assert list(map(float, here[key][len(LENGTHS) :])) == pytest.approx(list(map(float, printed[len(LENGTHS) :])), rel=0.03)
    assert there

    words = {spaced(line) for line in again.splitlines()}
    for line in TABLE.splitlines():
        if not re.match(r"(phystwin|rigid|static) |-{9}|sample: no ", line):  # captions, names of columns, legend
            assert spaced(line) in words


def board(folder):
    """{(task, method, metric): (mean as printed in millimetres, half of the interval, over what)} of lengths in a committed leaderboard."""
    with (ROOT / "results" / folder / "leaderboard.csv").open(newline="") as file:
        rows = [row for row in csv.DictReader(file) if row["unit"] == "m"]
    return {(r["task"], r["method"], r["metric"]): (f"{1e3 * float(r['mean']):.2f}", r["interval95"], r["interval_over"]) for r in rows}


def test_the_leaderboard_that_is_shown_is_what_the_command_gives(printed_again):
    # the baselines hardly depend on the machine; the others took minutes, and stand beside them in the same file
    shown = board(".")
    results = read_results(printed_again[1] / "results" / "sample" / "latest")
    for found in blocks(results):
        for line in found.lines:
            for metric in (name for name in found.metrics if results.units[name] == "m"):
                assert shown[found.task, line.method, metric][0] == f"{1e3 * line.means[metric]:.2f}"
    assert {method for _, method, _ in shown} == {name for name, found in methods().items() if found.room == "methods"}
    for kind in ("md", "tex"):
        text = (ROOT / "results" / f"leaderboard.{kind}").read_text(encoding="utf-8")
        assert all(value[0] in text for value in shown.values())


def test_the_methods_that_are_shown_beside_the_paper_are_the_leaderboards():
    shown, page = board("."), PAGES["docs/howto/paper.md"]
    columns = (("resimulation", "chamfer"), ("prediction", "chamfer"), ("prediction", "track_error"), ("transfer", "chamfer"))
    for method in {method for _, method, _ in shown}:
        line = next(line for line in page.splitlines() if line.startswith(f"| `{method}` |"))
        for task, metric in columns:
            assert (task, method, metric) not in shown or shown[task, method, metric][0] in line, (method, task, metric)


def test_the_ablation_that_is_shown_is_the_leaderboards():
    shown, lines = board("stages"), [line for line in PAGES["docs/howto/ablations.md"].splitlines() if line.startswith("| `phystwin")]
    for task in ("resimulation", "prediction"):
        for method in ("phystwin", "phystwin-zero", "phystwin-first"):
            mean, half, over = shown[task, method, "chamfer"]
            cell = f"{mean} ± {1e3 * float(half):.2f}"
            assert over == "3 seeds" and any(line.startswith(f"| `{method}` |") and cell in line for line in lines), (task, method, cell)


def test_the_table_shows_a_twin_that_predicts():
    # what the project asks of itself on the sample: at most half of static's Chamfer distance on frames never seen
    shown = figures(TABLE)
    assert float(shown["prediction", "phystwin"][0]) <= 0.5 * float(shown["prediction", "static"][0])


def test_what_gets_written_is_named(printed_again):
    folder = printed_again[1] / "results" / "sample" / "latest"
    named = PAGES["docs/howto/runs.md"] + OTHERS.get("docs/clusters.md", "")
    for file in folder.iterdir():
        assert f"`{file.name}`" in named
    assert len(read_results(folder).rows) == 12


def test_columns_tasks_and_methods_are_explained():
    for name in [*metrics(), *TASKS, *methods()]:
        assert f"`{name}`" in PAGES["docs/concepts/tasks.md"], name


def test_quirks_are_where_it_says():
    from twinbench.methods.phystwin.config import Quirks

    assert "`Quirks`" in PAGES["docs/concepts/published.md"] and Quirks.__module__ == "twinbench.methods.phystwin.config"
