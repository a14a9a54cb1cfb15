"""The page of ``panodepth_ros report``: pictures, plots and numbers of one sweep."""

from __future__ import annotations

import base64
import html as markup
import json
import math
from datetime import datetime, timezone
from string import Template
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt
from plotly import graph_objects as plotly
from plotly.offline import get_plotlyjs

from panodepth_ros.camera.simulated import furnished_room
from panodepth_ros.cli.recording import Recording
from panodepth_ros.geometry import SURFACE_DEPTH, Points, locate
from panodepth_ros.matching import window_geometry
from panodepth_ros.pages import page
from panodepth_ros.scan.beams import ScanSettings

#: Points of the cloud that a phone still turns smoothly.
_MOST_POINTS = 40_000
#: Columns beyond which pictures are made smaller.
_MOST_COLUMNS = 3600
_UNKNOWN = (38, 38, 38)
_IN_BAND, _ON_SURFACE = (0x4A, 0xD5, 0xFF, 110), (0xFF, 0xE5, 0x00, 130)  # BGRA
_GREY, _GRID = '#8793a0', 'rgba(128,140,150,0.25)'

Picture = npt.NDArray[np.uint8]


def html(recording: Recording, *, name: str, band: tuple[float, float] | None = None) -> str:
    """
    Make the page.

    Parameters
    ----------
    recording : Recording
        The sweep.
    name : str
        What it is called.
    band : (float, float), optional
        Height band of the scan [m]; by default the recording's own, or that of the depth node.

    Raises
    ------
    ValueError
        If the band is impossible or the pictures are of different sizes.
    """
    settings = ScanSettings()
    low, high = (
        band
        or recording.about.get('height_band')
        or (
            settings.min_height,
            settings.max_height,
        )
    )
    if not low < high:
        raise ValueError(f'band is {low} m to {high} m; allowed: the lower edge first')
    geometry, scan = recording.geometry, recording.scan
    points = locate(recording.depth, window_geometry(geometry))  # as the depth node placed them
    ranges = np.asarray(scan.ranges, np.float64)
    known = np.isfinite(recording.depth)
    farthest = _scale_end(recording.depth)
    stamp = scan.header.stamp
    when = datetime.fromtimestamp(stamp.sec, tz=timezone.utc)
    # Stamps near 0 are simulated time.
    when_text = f'{when:%Y-%m-%d %H:%M:%S} UTC' if when.year > 1971 else f'{stamp.sec} s'
    cloud, shown = _cloud(points, recording.left)
    return Template(page('report.html')).substitute(
        title=markup.escape(f'Panorama of {name}'),
        subtitle=f'{geometry.columns} × {geometry.rows} pixels, arm radius '
        f'{geometry.arm_radius * 100:.1f} cm, frame {markup.escape(scan.header.frame_id)}, '
        f'sweep ended {when_text}',
        plotly=get_plotlyjs(),
        cards=_cards(recording, ranges, known),
        strips=_strips(recording, _fed(points, recording, ranges, (low, high)), farthest),
        plan=_plot(_plan(ranges, recording)),
        plan_note=f'{np.isfinite(ranges).sum()} of {ranges.size} beams; surfaces from '
        f'{low:+.2f} to {high:+.2f} m of the camera’s height',
        film=_film(recording.film),
        cloud=_plot(cloud),
        cloud_note=f'{shown} of {known.sum()} points, without the farthest; drag to turn, '
        'pinch or wheel to zoom',
        accuracy=_accuracy(recording.about.get('accuracy')),
        timings=_timings(recording),
        warnings=_warnings(recording),
        data=_data(recording),
    )


def _scale_end(depth: npt.NDArray[np.float32]) -> float:
    """Upper end of the colour scale [m]: whole, and beyond nearly all distances."""
    known = depth[np.isfinite(depth)]
    return float(math.ceil(np.percentile(known, 98))) if known.size else 1.0


def _cards(recording: Recording, ranges: npt.NDArray[Any], known: npt.NDArray[Any]) -> str:
    finite = ranges[np.isfinite(ranges)]
    cards = [
        (f'{known.mean():.0%}', 'of the pixels hold a distance'),
        (f'{np.isfinite(ranges).mean():.0%}', 'of the beams hold a range'),
        (f'{finite.min():.2f} m' if finite.size else '–', 'nearest beam'),
        (f'{np.median(finite):.2f} m' if finite.size else '–', 'median range'),
        (f'{recording.geometry.sweep_duration:.0f} s', 'for the sweep'),
        (str(len(recording.warnings)), f'warning{"s"[: len(recording.warnings) != 1]}'),
    ]
    return ''.join(f'<div><b>{value}</b><span>{label}</span></div>' for value, label in cards)


def _fed(
    points: Points, recording: Recording, ranges: npt.NDArray[Any], band: tuple[float, float]
) -> Picture:
    """BGRA picture of the pixels in the height band, those on their beam's surface apart."""
    with np.errstate(invalid='ignore'):
        inside = (points.height >= band[0]) & (points.height <= band[1])
    beam = np.zeros(inside.shape, np.int64)
    beam[inside] = np.rint((points.azimuth[inside] + np.pi) / (2 * np.pi) * ranges.size)
    beam_range = ranges[beam % ranges.size]
    with np.errstate(invalid='ignore'):
        surface = inside & (np.abs(recording.depth - beam_range) <= SURFACE_DEPTH * beam_range)
    picture = np.zeros((*inside.shape, 4), np.uint8)
    picture[inside] = _IN_BAND
    picture[surface] = _ON_SURFACE
    return picture


def _coloured(values: npt.NDArray[np.float32], end: float, palette: Picture) -> Picture:
    """Picture of values, those from 0 to ``end`` spread over the 256 colours of a palette."""
    known = np.isfinite(values)
    level = np.where(known, values / end * 255, 0).clip(0, 255).astype(np.uint8)
    picture = palette[level]
    picture[~known] = _UNKNOWN
    return picture


def _embedded(picture: Picture, kind: str = 'png') -> str:
    """Picture as a data URL, of a size that a page can hold."""
    columns = picture.shape[1]
    if columns > _MOST_COLUMNS:
        size = (_MOST_COLUMNS, round(picture.shape[0] * _MOST_COLUMNS / columns))
        how = cv2.INTER_NEAREST if kind == 'png' else cv2.INTER_AREA
        picture = np.asarray(cv2.resize(picture, size, interpolation=how), np.uint8)
    _, encoded = cv2.imencode(f'.{kind}', picture)
    text = base64.b64encode(encoded.tobytes()).decode()
    return f'data:image/{"jpeg" if kind == "jpg" else kind};base64,{text}'


def _palette(colours: int) -> Picture:
    """One of OpenCV's colour maps, shape (256, 3)."""
    ramp = np.arange(256, dtype=np.uint8)[:, np.newaxis]
    return np.asarray(cv2.applyColorMap(ramp, colours)[:, 0], np.uint8)


def _gradient(palette: Picture) -> str:
    stops = ','.join(f'rgb({r},{g},{b})' for b, g, r in palette[::15])
    return f'<span class="bar" style="background:linear-gradient(90deg,{stops})"></span>'


def _film(gif: bytes) -> str:
    if not gif:
        return ''
    url = f'data:image/gif;base64,{base64.b64encode(gif).decode()}'
    return f'<p>As the arm turned:</p><img class="film" src="{url}" alt="ground plan that grows">'


def _strips(recording: Recording, fed: Picture, farthest: float) -> str:
    depth_map, confidence_map = _palette(cv2.COLORMAP_TURBO)[::-1], _palette(cv2.COLORMAP_VIRIDIS)
    strips = [
        ('left eye', _embedded(recording.left, 'jpg'), _embedded(fed)),
        ('right eye', _embedded(recording.right, 'jpg'), ''),
        (
            f'distance from the axis: 0 m {_gradient(depth_map)} {farthest:g}&nbsp;m',
            _embedded(_coloured(recording.depth, farthest, depth_map)),
            '',
        ),
        (
            f'confidence: 0 {_gradient(confidence_map)} 1',
            _embedded(_coloured(recording.confidence, 1.0, confidence_map)),
            '',
        ),
    ]
    return '\n'.join(
        f'<span class="name">{label}</span><div class="strip"><img src="{url}" alt="">'
        + (f'<img class="over" src="{over}" alt="">' if over else '')
        + '<i></i></div>'
        for label, url, over in strips
    )


def _plot(figure: plotly.Figure) -> str:
    """Figure as a part of the page, without the library."""
    figure.update_layout(
        margin={'l': 0, 'r': 0, 't': 8, 'b': 0},
        paper_bgcolor='rgba(0,0,0,0)',
        plot_bgcolor='rgba(0,0,0,0)',
        font={'color': _GREY, 'size': 12},
        legend={'orientation': 'h', 'y': -0.15},
        modebar={'bgcolor': 'rgba(0,0,0,0)', 'color': _GREY, 'remove': ['lasso2d', 'select2d']},
    )
    part: str = figure.to_html(
        full_html=False,
        include_plotlyjs=False,
        default_height='100%',
        config={'responsive': True, 'displaylogo': False, 'scrollZoom': True},
    )
    return f'<div class="plot">{part}</div>'


def _plan(ranges: npt.NDArray[np.float64], recording: Recording) -> plotly.Figure:
    """Scan from above, x (forward) up and y to the left."""
    azimuth = -np.pi + np.arange(ranges.size) * (2 * np.pi / ranges.size)
    known = np.isfinite(ranges)
    x, y = ranges[known] * np.cos(azimuth[known]), ranges[known] * np.sin(azimuth[known])
    figure = plotly.Figure()
    if (seed := recording.about.get('room_seed')) is not None:
        lines = [np.array([*line, (np.nan, np.nan)]) for line in furnished_room(seed).outline(0.0)]
        outline = np.concatenate(lines)
        figure.add_scatter(
            **{'x': outline[:, 1], 'y': outline[:, 0], 'mode': 'lines', 'name': 'true room'},
            **{'line': {'color': '#9aa5b1', 'width': 2}, 'hoverinfo': 'skip'},
        )
    figure.add_scatter(
        x=y,
        y=x,
        mode='markers',
        name='scan',
        marker={'size': 5, 'color': '#e4572e'},
        customdata=np.stack([np.degrees(azimuth[known]), ranges[known]], axis=-1),
        hovertemplate='%{customdata[1]:.2f} m at %{customdata[0]:.1f}°<extra></extra>',
    )
    radius = recording.geometry.arm_radius
    figure.add_shape(
        **{'type': 'circle', 'x0': -radius, 'x1': radius, 'y0': -radius, 'y1': radius},
        line={'color': '#0b7a75'},
    )
    axis = {'gridcolor': _GRID, 'zerolinecolor': _GRID, 'ticksuffix': ' m'}
    figure.update_xaxes(autorange='reversed', title='y, left', **axis)
    figure.update_yaxes(scaleanchor='x', title='x, forward', **axis)
    figure.update_layout(dragmode='pan')
    return figure


def _cloud(points: Points, image: Picture) -> tuple[plotly.Figure, int]:
    """Point cloud in the panorama's colours, and how many points it shows."""
    distance = points.radial_distance
    with np.errstate(invalid='ignore'):
        known = np.flatnonzero(distance <= 1.5 * np.nanpercentile(distance, 98))
    # A regular choice would show the panorama's rows as lines.
    if known.size > _MOST_POINTS:
        known = np.random.default_rng(0).choice(known, _MOST_POINTS, replace=False)
    xyz = points.xyz().reshape(-1, 3)[known].astype(np.float32)
    bgr = np.broadcast_to(image.reshape(points.height.size, -1), (points.height.size, 3))[known]
    figure = plotly.Figure()
    figure.add_scatter3d(
        **dict(zip('xyz', xyz.T, strict=True)),
        mode='markers',
        marker={'size': 1.6, 'color': [f'rgb({r},{g},{b})' for b, g, r in bgr.tolist()]},
        hovertemplate='%{x:.2f}, %{y:.2f}, %{z:.2f} m<extra></extra>',
    )
    axis = {'gridcolor': _GRID, 'showbackground': False, 'zerolinecolor': _GRID, 'title': ''}
    figure.update_layout(
        scene={
            **{f'{name}axis': axis for name in 'xyz'},
            'aspectmode': 'data',
            'camera': {'eye': {'x': -1.1, 'y': -0.6, 'z': 1.1}, 'center': {'z': -0.1}},
        }
    )
    return figure, known.size


def _table(rows: list[tuple[str, str]]) -> str:
    cells = ''.join(f'<tr><td>{name}</td><td>{value}</td></tr>' for name, value in rows)
    return f'<table>{cells}</table>'


def _accuracy(accuracy: dict[str, dict[str, float]] | None) -> str:
    if accuracy is None:
        return '<p>The true room is not known.</p>'
    scan, depth = accuracy['scan'], accuracy['depth']
    return '<p>Against the true room.</p>' + _table(
        [
            ('beams that hold a range', f'{scan["coverage"]:.1%}'),
            ('median error of a beam', f'{scan["median_error"]:.2%}'),
            ('beams within 5 %', f'{scan["within_5_percent"]:.1%}'),
            ('beams more than 10 % too far', f'{scan["too_far"]:.1%}'),
            ('beams more than 10 % too near', f'{scan["too_near"]:.1%}'),
            ('pixels both eyes see that hold a distance', f'{depth["kept"]:.1%}'),
            ('median error of a pixel’s distance', f'{depth["median_error"]:.2%}'),
            ('pixels off by more than one column', f'{depth["wrong"]:.1%}'),
        ]
    )


def _timings(recording: Recording) -> str:
    geometry, counts = recording.geometry, recording.counts
    seen = int(geometry.seen.sum())
    column_time = geometry.sweep_duration / seen * 1000 if seen else math.nan
    rows = [
        ('sweep, first to last column', f'{geometry.sweep_duration:.1f} s'),
        ('a column', f'{column_time:.0f} ms'),
        ('panoramas received to scan received', f'{recording.matching_time:.2f} s'),
        ('columns seen', f'{seen} of {geometry.columns}'),
    ]
    messages = _table(
        [(markup.escape(topic), str(count)) for topic, count in sorted(counts.items())]
    )
    return f'{_table(rows)}<details><summary>messages of each topic</summary>{messages}</details>'


def _warnings(recording: Recording) -> str:
    if recording.warnings:
        lines = ''.join(
            f'<li class="bad">{markup.escape(line)}</li>' for line in recording.warnings
        )
        text = f'<ul>{lines}</ul>'
    elif recording.log:
        text = '<p>None in the logs.</p>'
    else:
        text = '<p>The recording holds no log.</p>'
    if recording.log:
        log = markup.escape('\n'.join(recording.log))
        text += f'<details><summary>whole log</summary><pre>{log}</pre></details>'
    return text


def _data(recording: Recording) -> str:
    """What the page reads out under the pointer: millimetres and 255ths, 0 unknown."""
    depth = np.nan_to_num(recording.depth * 1000, nan=0, posinf=0).clip(0, 65535).astype('<u2')
    confidence = (np.nan_to_num(recording.confidence) * 255).astype(np.uint8)
    geometry = recording.geometry
    return json.dumps(
        {
            'columns': geometry.columns,
            'rows': geometry.rows,
            'azimuth_column': geometry.azimuth_column,
            'depth': base64.b64encode(depth.tobytes()).decode(),
            'confidence': base64.b64encode(confidence.tobytes()).decode(),
        }
    )
