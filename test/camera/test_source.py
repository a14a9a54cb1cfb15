"""Sources of frames: files written by OpenCV, a stream over the loopback, devices that fail."""

from __future__ import annotations

import os
import threading
import time
from collections import deque
from itertools import pairwise
from pathlib import Path

import cv2
import numpy as np
import pytest
from fixtures.mjpeg import HEIGHT, WIDTH, network_camera

from panodepth_ros.camera.automatics import Automatics, Wishes
from panodepth_ros.camera.capture import StreamSource, V4l2Source, VideoFileSource
from panodepth_ros.camera.images import ImageSequenceSource, image_files
from panodepth_ros.camera.source import (
    Schedule,
    SourceClosedError,
    SourceError,
    SourceLostError,
    check_size,
    to_grey,
)
from panodepth_ros.camera.v4l2 import check_device, device_path

ANY = (0, 0)


@pytest.fixture
def stop() -> threading.Event:
    return threading.Event()


def picture(brightness: int, width: int = 64, height: int = 48) -> np.ndarray:
    image = np.full((height, width, 3), brightness, np.uint8)
    image[: height // 2, : width // 2, 2] = 255  # upper left is red
    return image


@pytest.fixture
def video(tmp_path: Path) -> str:
    """Twelve frames of 64 by 48 pixels at 200 Hz, brighter by 20 each."""
    path = tmp_path / 'sweep.avi'
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*'MJPG'), 200.0, (64, 48))
    assert writer.isOpened()
    for k in range(12):
        writer.write(picture(20 * k))
    writer.release()
    return str(path)


# --- schedule ---------------------------------------------------------------------------------


def test_a_camera_keeps_to_its_times(stop: threading.Event) -> None:
    schedule = Schedule(200.0, stop, skips=True)
    moments = []
    for _ in range(20):
        moments.append(schedule.wait())
        assert moments[-1] <= time.monotonic()
    periods = (np.array(moments) - moments[0]) * 200.0
    np.testing.assert_allclose(periods, np.round(periods), atol=1e-6)
    assert len(set(np.round(periods))) == 20
    assert schedule.skipped == round(periods[-1]) - 19


def test_a_camera_skips_exposures_that_have_passed(stop: threading.Event) -> None:
    schedule = Schedule(500.0, stop, skips=True)
    first = schedule.wait()
    stop.wait(0.05)
    second = schedule.wait()
    periods = (second - first) * 500.0
    assert periods == pytest.approx(round(periods), abs=1e-6)
    assert schedule.skipped == round(periods) - 1
    assert schedule.skipped >= 20


def test_a_file_loses_no_frame_when_late(stop: threading.Event) -> None:
    schedule = Schedule(500.0, stop, skips=False)
    schedule.wait()
    stop.wait(0.05)
    asked = time.monotonic()
    assert schedule.wait() >= asked
    assert schedule.skipped == 0


def test_waiting_ends_when_the_source_is_closed(stop: threading.Event) -> None:
    schedule = Schedule(0.001, stop, skips=True)
    schedule.wait()
    threading.Timer(0.05, stop.set).start()
    with pytest.raises(SourceClosedError):
        schedule.wait()


# --- frames -----------------------------------------------------------------------------------


def test_sizes_are_checked() -> None:
    image = picture(0)
    check_size(image, (64, 48), 'it')
    check_size(image[..., 0], (64, 0), 'it')
    with pytest.raises(SourceError, match=r'it gives frames of 64 by 48 pixels; .* 48 by 64'):
        check_size(image, (48, 64), 'it')


def test_grey() -> None:
    assert to_grey(picture(100)).shape == (48, 64)
    assert to_grey(picture(100)[..., 0])[-1, -1] == 100


# --- video file -------------------------------------------------------------------------------


def test_a_video_file_is_played_once_frame_by_frame(video: str, stop: threading.Event) -> None:
    source = VideoFileSource(video, size=(64, 48), framerate=0.0, grey=False, stop=stop)
    assert source.size == (64, 48)
    frames = []
    while (frame := source.read()) is not None:
        frames.append(frame)
    assert source.read() is None
    source.close()
    assert len(frames) == 12
    for k, frame in enumerate(frames):
        assert frame.image.shape == (48, 64, 3)
        assert frame.image[40:, 40:].mean() == pytest.approx(20 * k, abs=6.0)
        assert frame.image[:10, :10, 2].mean() > 220
    stamps = np.array([frame.stamp for frame in frames])
    assert (np.diff(stamps) > 0.0049).all()
    assert stamps[-1] <= time.monotonic()


def test_a_video_file_is_played_at_the_rate_asked_for(video: str, stop: threading.Event) -> None:
    source = VideoFileSource(video, size=ANY, framerate=50.0, grey=True, stop=stop)
    first, second = source.read(), source.read()
    source.close()
    assert first is not None
    assert second is not None
    assert second.stamp - first.stamp >= 0.0199
    assert first.image.shape == (48, 64)


def test_what_is_no_video_is_refused(tmp_path: Path, video: str, stop: threading.Event) -> None:
    text = tmp_path / 'notes.avi'
    text.write_text('this is no video')
    for path, reason in (
        (str(tmp_path / 'none.avi'), r'none.avi does not exist'),
        (str(tmp_path), 'is not a file'),
        (str(text), 'notes.avi holds no frame that can be decoded'),
    ):
        with pytest.raises(SourceError, match=reason) as refused:
            VideoFileSource(path, size=ANY, framerate=0.0, grey=False, stop=stop)
        assert not isinstance(refused.value, SourceLostError)
    with pytest.raises(SourceError, match=r'64 by 48 pixels; .* ask for 640 by 480'):
        VideoFileSource(video, size=(640, 480), framerate=0.0, grey=False, stop=stop)


# --- image sequence ---------------------------------------------------------------------------


@pytest.fixture
def images(tmp_path: Path) -> Path:
    """Pictures 8 to 11, brighter by 10 per number, and a file that is none."""
    folder = tmp_path / 'frames'
    folder.mkdir()
    for k in range(8, 12):
        cv2.imwrite(str(folder / f'frame_{k}.png'), picture(10 * k))
    (folder / 'notes.txt').write_text('not a picture')
    return folder


@pytest.mark.parametrize('last', ['', '/frame_*.png', '/frame_%d.png', '/frame_%02d.png'])
def test_images_come_in_the_order_of_their_numbers(
    images: Path, last: str, stop: threading.Event
) -> None:
    source = ImageSequenceSource(
        f'{images}{last}', size=(64, 48), framerate=500.0, grey=False, stop=stop
    )
    assert source.size == (64, 48)
    shades = []
    while (frame := source.read()) is not None:
        shades.append(int(frame.image[-1, -1, 0]))
    source.close()
    assert shades == [80, 90, 100, 110]


def test_grey_images(images: Path, stop: threading.Event) -> None:
    source = ImageSequenceSource(str(images), size=ANY, framerate=500.0, grey=True, stop=stop)
    frame = source.read()
    assert frame is not None
    assert frame.image.shape == (48, 64)


def test_bad_image_sequences_are_refused(images: Path, stop: threading.Event) -> None:
    def opened(pattern: Path | str, framerate: float = 500.0) -> ImageSequenceSource:
        return ImageSequenceSource(
            str(pattern), size=ANY, framerate=framerate, grey=False, stop=stop
        )

    for pattern in (images / 'other_*.png', images.parent / 'none' / '%04d.png', images / 'x'):
        with pytest.raises(SourceError, match=r'no images at .* allowed: a folder with'):
            image_files(str(pattern))
    with pytest.raises(SourceError, match='framerate is 0; images need one above 0'):
        opened(images, framerate=0.0)
    cv2.imwrite(str(images / 'frame_9.png'), picture(0, width=32))
    source = opened(images)
    source.read()
    with pytest.raises(SourceError, match=r'frame_9.png gives frames of 32 by 48 pixels'):
        source.read()
    (images / 'frame_7.png').write_bytes(b'none')
    with pytest.raises(SourceError, match=r'frame_7.png cannot be decoded'):
        opened(images)


# --- stream -----------------------------------------------------------------------------------


def test_a_stream_delivers_and_its_silence_is_noticed(stop: threading.Event) -> None:
    with network_camera() as camera:
        source = StreamSource(
            camera.url, size=(WIDTH, HEIGHT), grey=False, frame_timeout=1.0, stop=stop
        )
        frames = [source.read() for _ in range(10)]
        assert {frame.image.shape for frame in frames} == {(HEIGHT, WIDTH, 3)}
        assert len({int(frame.image[0, 0, 0]) for frame in frames}) > 5
        assert all(a.stamp <= b.stamp for a, b in pairwise(frames))
        camera.silent.set()
        with pytest.raises(SourceLostError, match='ended or gave no frame for 1 s'):
            deque(iter(source.read, None), maxlen=0)
        source.close()
        with pytest.raises(SourceLostError, match=r'does not deliver within 0.5 s'):
            StreamSource(camera.url, size=ANY, grey=False, frame_timeout=0.5, stop=stop)
        camera.silent.clear()
        with pytest.raises(SourceError, match='ask for 640 by 480'):
            StreamSource(camera.url, size=(640, 480), grey=False, frame_timeout=1.0, stop=stop)
        closed = StreamSource(camera.url, size=ANY, grey=True, frame_timeout=1.0, stop=stop)
        assert closed.read().image.ndim == 2
        stop.set()
        with pytest.raises(SourceClosedError):
            closed.read()
        closed.close()


def test_no_stream_at_all(stop: threading.Event) -> None:
    with pytest.raises(SourceError, match="'camera' is not a URL"):
        StreamSource('camera', size=ANY, grey=False, frame_timeout=0.5, stop=stop)
    with pytest.raises(SourceLostError, match='does not deliver'):
        StreamSource('http://127.0.0.1:9/', size=ANY, grey=False, frame_timeout=0.5, stop=stop)


# --- V4L2: what can go wrong without a camera ---------------------------------------------------


def test_devices_by_number_and_path() -> None:
    assert device_path('3') == '/dev/video3'
    assert device_path('/dev/v4l/by-id/usb-X-index0') == '/dev/v4l/by-id/usb-X-index0'


def opened_device(video_device: str, stop: threading.Event) -> V4l2Source:
    return V4l2Source(
        video_device,
        size=(640, 480),
        framerate=30.0,
        pixel_format='auto',
        automatics=Automatics(Wishes()),
        frame_timeout=1.0,
        stop=stop,
    )


def test_a_missing_device_may_come_back(stop: threading.Event) -> None:
    with pytest.raises(SourceLostError, match=r'video device /dev/video97 does not exist; there'):
        opened_device('97', stop)


def test_what_is_no_video_device_is_refused(tmp_path: Path, stop: threading.Event) -> None:
    file = tmp_path / 'video0'
    file.touch()
    link = tmp_path / 'by-id'
    link.symlink_to('/dev/null')
    controller, terminal = os.openpty()
    try:
        for path, reason in (
            (file, 'is not a video device; for a file set source to video'),
            (tmp_path, 'cannot be opened: Is a directory'),
            (link, 'is not a V4L2 video device: '),
            (os.ttyname(terminal), 'is not a V4L2 video device: '),
        ):
            with pytest.raises(SourceError, match=reason) as refused:
                opened_device(str(path), stop)
            assert not isinstance(refused.value, SourceLostError)
    finally:
        os.close(controller)
        os.close(terminal)


@pytest.mark.skipif(os.geteuid() == 0, reason='root may open everything')
def test_a_device_of_others_is_named(tmp_path: Path) -> None:
    file = tmp_path / 'video0'
    file.touch(mode=0)
    with pytest.raises(SourceError, match='is the user in the group video'):
        check_device(str(file))
