"""The table of an evaluation."""

import json
import math

import numpy as np
import pytest
from PIL import Image

from dwgs.evaluation import COLUMNS, Measured, tabulate
from dwgs.evaluation.plot import plot
from dwgs.metrics import frechet_distance

REASONS = {"fvd": "--fvd FILE", "joint_psnr": "joint reconstruction"}


def sequence(seed, psnr=20.0):
    rng = np.random.default_rng(seed)
    features = {"fid": tuple(rng.normal(size=(9, 3)).astype(np.float32) for _ in range(2))}
    return Measured({"oracle_psnr": psnr + seed, "flicker": 3.0 + 0.1 * seed}, features)


@pytest.fixture
def table():
    systems = {
        "ours": [sequence(i) for i in range(3)],
        "exact": [Measured({"oracle_psnr": math.inf})] * 3,
        "big": "no weights",
    }
    return tabulate(systems, REASONS)


def test_a_mean_is_that_of_the_sequences_and_its_interval_holds_it(table):
    cell = table.rows["ours"]["oracle_psnr"]
    assert (cell.value, cell.sequences) == (21.0, 3)
    assert cell.interval[0] <= cell.value <= cell.interval[1]


def test_a_frechet_distance_is_of_all_sequences_together(table):
    pooled = [np.concatenate([sequence(i).features["fid"][k] for i in range(3)]) for k in (0, 1)]
    assert table.rows["ours"]["fid"].value == pytest.approx(frechet_distance(*pooled))


def test_what_is_unavailable_has_its_reason_and_never_a_number(table):
    for key, reason in REASONS.items():
        cell = table.rows["ours"][key]
        assert (cell.value, cell.reason) == (None, reason)
    assert "unavailable: --fvd FILE" in table.markdown()


def test_a_system_that_did_not_run_says_why_once(table):
    text = table.markdown()
    assert text.count("no weights") == 1
    rows = [line for line in text.splitlines() if line.startswith("| big")]
    assert len(rows) == 2
    assert not any(character.isdigit() for row in rows for character in row)


def test_every_column_is_in_the_markdown_and_explained(table):
    text = table.markdown()
    for column in COLUMNS:
        assert f"| {column.heading} " in text
        assert column.meaning in text


def test_the_document_is_json_of_any_parser(table):
    document = json.loads(json.dumps(table.document(), allow_nan=False))
    assert document["systems"]["exact"]["oracle_psnr"]["value"] == "inf"
    assert document["systems"]["ours"]["fvd"] == {"value": None, "reason": "--fvd FILE"}
    assert document["absent"] == {"big": "no weights"}


def test_one_sequence_has_no_interval():
    table = tabulate({"ours": [sequence(0)]}, {})
    assert table.rows["ours"]["oracle_psnr"].interval is None
    assert "20.00 |" in table.markdown()


def test_the_plot_is_a_picture_that_the_same_table_gives_again(table, tmp_path):
    plot(table, tmp_path / "a.png")
    plot(table, tmp_path / "b.png")
    image = Image.open(tmp_path / "a.png")
    assert image.width > 400
    assert len(image.convert("RGB").getcolors(1 << 24)) > 10
    assert (tmp_path / "a.png").read_bytes() == (tmp_path / "b.png").read_bytes()


def test_a_table_without_any_number_is_plotted_empty(tmp_path):
    plot(tabulate({"big": "no weights"}, {}), tmp_path / "a.png")
    assert (tmp_path / "a.png").stat().st_size > 0
