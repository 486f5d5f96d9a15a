"""The figure: what is in it, against the runs it was given; files of each format."""

from __future__ import annotations

import math
import subprocess
import sys
import xml.etree.ElementTree as ET
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("matplotlib", reason="figures need the extra viz")

from matplotlib.patches import Circle, Wedge

from clfcbf import plots
from clfcbf.errors import ConfigurationError, MissingExtraError
from clfcbf.plot_panels import bearings, span_of
from clfcbf.se2 import Pose2
from clfcbf.simulation.campaign import EpisodeSpec, Track, record_and_track, simulate
from clfcbf.simulation.scenarios import World

WORLD = World()


@pytest.fixture(scope="module")
def runs() -> tuple[list[dict[str, Any]], list[Track]]:
    records = [record_and_track(EpisodeSpec(index=index)) for index in range(4)]
    return records, [record.pop("track") for record in records]


def test_track_is_a_sample_of_the_trace() -> None:
    spec = EpisodeSpec(ideal=True)
    _, trace = simulate(spec)
    track = Track.of(trace)
    assert track.times[0] == trace.times[0]
    assert track.times[-1] == trace.times[-1]
    assert tuple(track.poses[-1]) == trace.poses[-1]
    assert track.poses.shape == (len(track.times), 3)
    assert track.commands.shape == (len(track.times), 2)
    assert 3 * (len(track.times) - 2) < len(trace.times) <= 3 * (len(track.times) - 1) + 1
    for time, pose, command in zip(*track, strict=True):
        tick = trace.times.index(time)
        assert tuple(pose) == trace.poses[tick]
        assert tuple(command) == trace.decisions[tick].twist


def test_bearings_against_complex_numbers(runs: tuple[list[dict[str, Any]], list[Track]]) -> None:
    track = runs[1][0]
    x, y, theta = track.poses.T
    rotation = np.exp(1j * theta)
    camera = x + 1j * y + rotation * WORLD.camera.camera.x
    expected = np.angle((WORLD.standoff - camera) / rotation)
    assert np.allclose(bearings(track, WORLD), expected, rtol=0.0, atol=1e-12)


def test_figure_shows_what_was_driven(runs: tuple[list[dict[str, Any]], list[Track]]) -> None:
    records, tracks = runs
    figure = plots.approach_figure(records, tracks)
    paths, speed, turn_rate, bearing, near, fitted = figure.axes
    drawn = [line.get_xydata() for line in paths.lines]
    for track in tracks:
        assert any(np.array_equal(line, track.poses[:, :2]) for line in drawn)
    for axes, column in ((speed, 0), (turn_rate, 1)):
        drawn = [line.get_xydata() for line in axes.lines]
        for track in tracks:
            history = np.column_stack((track.times, track.commands[:, column]))
            assert any(np.array_equal(line, history) for line in drawn)
    levels = [line.get_ydata()[0] for line in bearing.lines if len(line.get_xdata()) == 2]
    assert sorted(levels) == pytest.approx([-35.0, 35.0])
    assert 0.22 in [line.get_ydata()[0] for line in speed.lines if len(line.get_xdata()) == 2]
    radii = {patch.radius for patch in near.patches if isinstance(patch, Circle)}
    assert radii == {10.0, 30.0}
    points = {(line.get_xdata()[0], line.get_ydata()[0]) for line in fitted.lines}
    assert points == {(record["e_lon_mm"], record["e_lat_mm"]) for record in records}
    assert paths.get_aspect() == near.get_aspect() == 1.0
    assert "4 of 4 docked" in figure.texts[0].get_text()


def test_cones_stand_at_the_camera(runs: tuple[list[dict[str, Any]], list[Track]]) -> None:
    records, tracks = runs
    cones = [
        patch
        for patch in plots.approach_figure(records, tracks).axes[0].patches
        if isinstance(patch, Wedge)
    ]
    assert 9 <= len(cones) <= 12  # four along each of three paths
    poses = np.concatenate([track.poses for track in tracks])
    for cone in cones:
        theta = math.radians(0.5 * (cone.theta1 + cone.theta2))
        back = Pose2(*cone.center, theta).compose(WORLD.camera.camera.inverse())
        assert np.abs(poses[:, :2] - (back.x, back.y)).max(axis=1).min() < 1e-9
        assert cone.theta2 - cone.theta1 == pytest.approx(70.0)


def test_span_shows_every_error() -> None:
    for size in np.geomspace(1e-3, 1e5, 200).tolist():
        span = span_of([{"e_lon_mm": -size, "e_lat_mm": 0.0}, {"e_lon_mm": 0.0, "e_lat_mm": 0.1}])
        assert size < span
        assert span < 4.0 * max(size, 0.5)


def test_failed_and_cut_short_runs_are_drawn() -> None:
    records = [
        record_and_track(EpisodeSpec(index=index), World(patience=0.3)) for index in range(5)
    ]
    tracks = [record.pop("track") for record in records]
    figure = plots.approach_figure(records, tracks)
    figure.canvas.draw()
    legend = figure.axes[0].get_legend()
    assert legend is not None
    assert "not within 30 mm and 5°" in [text.get_text() for text in legend.get_texts()]
    assert {line.get_marker() for line in figure.axes[5].lines} == {"X"}


def test_single_tick() -> None:
    record = record_and_track(EpisodeSpec())
    track = Track(*(values[:1] for values in record.pop("track")))
    plots.approach_figure([record], [track]).canvas.draw()


@pytest.mark.parametrize("suffix", [".png", ".svg", ".PDF"])
def test_formats(
    suffix: str, tmp_path: Path, runs: tuple[list[dict[str, Any]], list[Track]]
) -> None:
    path = tmp_path / f"runs{suffix}"
    plots.save_figure(plots.approach_figure(*runs), path)
    content = path.read_bytes()
    assert len(content) > 20_000
    if suffix == ".svg":
        assert ET.fromstring(content).tag == "{http://www.w3.org/2000/svg}svg"
    else:
        assert content.startswith(b"%PDF" if suffix == ".PDF" else b"\x89PNG")


def test_no_global_state(runs: tuple[list[dict[str, Any]], list[Track]]) -> None:
    import matplotlib

    before = dict(matplotlib.rcParams)
    plots.approach_figure(*runs).canvas.draw()
    assert dict(matplotlib.rcParams) == before
    script = (
        "import sys\n"
        "import clfcbf.cli\n"
        "print('matplotlib' in sys.modules)\n"
        "from clfcbf.plots import approach_figure\n"
        "from clfcbf.simulation.campaign import EpisodeSpec, record_and_track\n"
        "record = record_and_track(EpisodeSpec())\n"
        "approach_figure([record], [record['track']]).canvas.draw()\n"
        "print('matplotlib.pyplot' in sys.modules)\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True, check=True
    )
    assert done.stdout.split() == ["False", "False"]


def test_refusals(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
    runs: tuple[list[dict[str, Any]], list[Track]],
) -> None:  # fmt: skip
    records, tracks = runs
    for name in ("runs.gif", "runs"):
        with pytest.raises(ConfigurationError, match=r"\.png, \.svg, \.pdf"):
            plots.check_format(tmp_path / name)
    with pytest.raises(ConfigurationError, match="0 runs and 0 tracks"):
        plots.approach_figure([], [])
    with pytest.raises(ConfigurationError, match="4 runs and 3 tracks"):
        plots.approach_figure(records, tracks[:3])
    figure = plots.approach_figure(records, tracks)
    with pytest.raises(ConfigurationError, match="cannot write"):
        plots.save_figure(figure, tmp_path / "no" / "runs.png")
    monkeypatch.setitem(sys.modules, "matplotlib.figure", None)
    with pytest.raises(MissingExtraError, match=r"clfcbf\[viz\]"):
        plots.approach_figure(records, tracks)
