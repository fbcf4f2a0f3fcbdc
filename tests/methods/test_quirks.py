"""docs/quirks.md lists every switch of every method, and of the appearance, with the sentence that stands in the code."""

import re
from importlib import import_module
from pathlib import Path

import pytest
from twinbench.benchmark.ablations import ABLATIONS
from twinbench.benchmark.differences import FILE, switches, up_to_date

ROOT = Path(__file__).parents[2]
TEXT = FILE.read_text(encoding="utf-8")
ROWS = [tuple(cell.strip() for cell in line.strip("|").split("|")) for line in TEXT.splitlines() if line.startswith("| ")][1:]
PARTS = [folder.parent.name for folder in sorted((ROOT / "methods").glob("*/config.py")) if "class Quirks" in folder.read_text()]


@pytest.mark.parametrize("part", PARTS)
def test_every_switch_is_in_the_table_with_its_sentence(part):
    fields = import_module(f"twinbench.methods.{part}.config").Quirks.__dataclass_fields__
    listed = {switch.strip("`"): sentence for name, switch, sentence in ROWS if name == part.replace("_", "-")}
    source = " ".join((ROOT / "methods" / part / "config.py").read_text(encoding="utf-8").split())
    assert list(fields) == [name for name in listed if name in fields] and fields
    for name in fields:
        assert f'{name}: bool = True """{listed[name]}"""' in source


def test_the_table_has_nothing_that_is_not_in_the_code_and_is_up_to_date():
    assert up_to_date(TEXT) == TEXT, "bring it up to date: python -m twinbench.benchmark.differences"
    known = {part.replace("_", "-"): import_module(f"twinbench.methods.{part}.config").Quirks.__dataclass_fields__ for part in PARTS}
    for part, switch, sentence in ROWS:
        assert len(sentence) > 20 and sentence.endswith(".")
        if part in known and switch != "-":
            assert switch.strip("`") in known[part]


def test_what_is_out_of_date_is_replaced_and_the_rest_kept():
    rows = "| phystwin | `gone` | It went. |\n| phystwin | - | No switch. |\n| other | - | Kept. |\n"
    old = f"# Title\n\n| part | switch | x |\n|---|---|---|\n{rows}"
    new = up_to_date(old)
    assert (
        new.startswith("# Title\n\n| part | switch | x |\n|---|---|---|\n| appearance | `incremental` | Each frame") and "`gone`" not in new
    )
    assert new.endswith("| other | - | Kept. |\n") and up_to_date(new) == new
    lines = new.splitlines()
    assert lines[lines.index("| phystwin | - | No switch. |") - 1].startswith("| phystwin | `")


def test_a_switch_without_a_sentence_is_refused():
    assert switches('class Quirks:\n    a: bool = True\n    """It does\n    this."""\n') == {"a": "It does this."}
    with pytest.raises(ValueError, match=r"Quirks.b must have a sentence below it"):
        switches('class Quirks:\n    b: bool = True\n    c: bool = True\n    """It does that."""\n')


def test_the_ablations_that_it_names_are_those_that_switch_quirks():
    of_quirks = {name for name, one in ABLATIONS.items() if one.quirks_of or one.looks_of}
    assert set(re.findall(r"`(?:twinbench run --ablation )?([\w-]*quirks)`", TEXT)) == of_quirks
