"""The table against numbers worked out by hand, and the file against a reader of its own."""

from __future__ import annotations

import json
import os
import statistics
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from clfcbf import report
from clfcbf.errors import ConfigurationError
from clfcbf.simulation.campaign import summarise


def run(index: int = 0, **changes: Any) -> dict[str, Any]:
    return {
        "region": "R1", "seed": 0, "index": index, "outcome": "ok", "success": True,
        "strict": True, "e_lon_mm": 1.0, "e_lat_mm": -2.0, "e_theta_deg": 0.5, "time_s": 10.0,
        "path_m": 2.0, "min_fov_margin_deg": 3.0, "fov_lost": False, "ticks": 300,
        "limit_violations": 0, "infeasible_ticks": 0, "unguarded_ticks": 0, "guarded_ticks": 0,
        "step_us_p50": 100.0, "step_us_p99": 200.0, "reason": "", **changes,
    }  # fmt: skip


def row(text: str, label: str) -> str:
    (line,) = [line for line in text.splitlines() if line.startswith(label)]
    return line


errors = st.floats(-5000.0, 5000.0, allow_nan=False)


@given(st.lists(st.tuples(errors, errors, errors), min_size=2, max_size=8))
def test_errors_are_those_of_every_run(values: list[tuple[float, float, float]]) -> None:
    records = [
        run(k, e_lon_mm=x, e_lat_mm=y, e_theta_deg=w, success=k % 2 == 0)
        for k, (x, y, w) in enumerate(values)
    ]
    text = report.table(records, summarise(records), "heading")
    for column, label in enumerate(("e_lon [mm]", "e_lat [mm]", "e_theta [deg]")):
        words = row(text, label).split()[2:]
        numbers = [float(word) for word in words if word != "±"]
        column_values = [value[column] for value in values]
        expected = (
            statistics.fmean(column_values),
            statistics.stdev(column_values),
            statistics.fmean(map(abs, column_values)),
            max(map(abs, column_values)),
        )
        assert numbers[:4] == pytest.approx(expected, abs=0.0051)


def test_table_names_failures_and_counts() -> None:
    records = [
        run(0),
        run(1, outcome="lost", success=False, strict=False, reason="target lost", e_lon_mm=-800.0),
        run(2, strict=False, guarded_ticks=4, infeasible_ticks=2, unguarded_ticks=1, time_s=13.0),
        run(3, limit_violations=5, fov_lost=True, min_fov_margin_deg=-1.25),
    ]
    text = report.table(records, summarise(records), "heading")
    assert text.startswith("heading\n")
    assert "3/4" in row(text, "success")
    assert "2/4" in row(text, "strict")
    assert row(text, "outcomes") == "outcomes lost 1, ok 3"
    assert "target lost" in row(text, "  run 1")
    assert "e_lon -800.0 mm" in row(text, "  run 1")
    assert "mean 10.75, max 13.00" in row(text, "time")
    assert "smallest -1.25 deg, lost in 1 of 4 runs" in row(text, "view margin")
    assert "violated by 5 of 1200 commands" in row(text, "limits")
    assert "2 infeasible, 4 guarded, 1 without a certified brake" in row(text, "ticks")


def test_paper_stands_beside_and_is_cited() -> None:
    text = report.table([run()], summarise([run()]), "heading")
    assert row(text, "e_lon [mm]").endswith("2.08 ±  0.96")
    assert row(text, "e_lat [mm]").endswith("9.33 ± 10.51")
    assert row(text, "e_theta [deg]").endswith("2.12 ±  1.55")
    assert "21.35 and 23.83" in row(text, "time")
    assert "30/30" in row(text, "success")
    assert "Xie et al. (2024)" in text
    assert "outcomes" not in text


def test_many_failures_do_not_flood_the_screen() -> None:
    records = [run(k, outcome="timeout", success=False, strict=False) for k in range(200)]
    text = report.table(records, summarise(records), "heading")
    assert text.count("  run ") == report.SHOWN_FAILURES
    assert f"and {200 - report.SHOWN_FAILURES} more" in text


json_values = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(),
    lambda inner: st.lists(inner) | st.dictionaries(st.text(), inner),
    max_leaves=20,
)


@settings(max_examples=50)
@given(content=st.dictionaries(st.text(), json_values))
def test_json_is_strict_and_whole(tmp_path_factory: Any, content: dict[str, Any]) -> None:
    path = tmp_path_factory.getbasetemp() / "strict.json"  # written over, example by example
    report.write_json(path, content)

    def strict(value: Any) -> Any:
        if isinstance(value, dict):
            return {key: strict(item) for key, item in value.items()}
        if isinstance(value, list):
            return [strict(item) for item in value]
        return None if value in (float("inf"), float("-inf")) or value != value else value

    def refuse(constant: str) -> float:
        raise AssertionError(f"{constant} is not JSON")

    assert json.loads(path.read_text("utf-8"), parse_constant=refuse) == strict(content)


def test_failed_write_leaves_the_old_file(tmp_path: Path) -> None:
    path = tmp_path / "out.json"
    path.write_text("old")
    with pytest.raises(TypeError):
        report.write_json(path, {"set": {1, 2}})
    assert path.read_text() == "old"
    assert list(tmp_path.iterdir()) == [path]


def test_checking_leaves_no_trace(tmp_path: Path) -> None:
    path = tmp_path / "out.json"
    report.check_writable(path)
    assert list(tmp_path.iterdir()) == []
    path.write_text("old")
    report.check_writable(path)
    assert path.read_text() == "old"


def test_link_stays_a_link(tmp_path: Path) -> None:
    target, link = tmp_path / "target.json", tmp_path / "link.json"
    link.symlink_to(target)
    report.check_writable(link)
    report.write_json(link, {"a": 1})
    assert link.is_symlink()
    assert json.loads(target.read_text()) == {"a": 1}


def test_device_stays_a_device() -> None:
    device = Path(os.devnull)
    report.check_writable(device)
    report.write_json(device, {"a": 1})
    assert not device.is_file()


def test_unwritable_places(tmp_path: Path) -> None:
    for path in (tmp_path, tmp_path / "no" / "out.json", Path("/proc/out.json")):
        with pytest.raises(ConfigurationError, match="cannot write"):
            report.check_writable(path)
        with pytest.raises(ConfigurationError, match="cannot write"):
            report.write_json(path, {})
