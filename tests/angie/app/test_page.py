"""The web page in headless Chromium: the whole path by clicks, and what may go wrong."""

import shutil
import socket
import threading
import time
from urllib.parse import urlsplit

import numpy as np
import pytest
from PIL import Image

from angie.bundle import PHOTO
from data_prep.media.audio import write_wav

pytest.importorskip("gradio")
uvicorn = pytest.importorskip("uvicorn")
playwright = pytest.importorskip("playwright.sync_api")

from angie.app.queue import Limits, Queue  # noqa: E402
from angie.app.server import application  # noqa: E402
from angie.request import Pipelines  # noqa: E402

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser")
WIDE, NARROW = {"width": 1280, "height": 1500}, {"width": 390, "height": 3600}

pytestmark = [pytest.mark.slow, pytest.mark.skipif(CHROMIUM is None, reason="needs Chromium")]


@pytest.fixture(scope="module")
def queue():
    with Queue(Pipelines(), Limits(seconds=30)) as made:
        yield made


@pytest.fixture(scope="module")
def address(queue):
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    made = application(queue, None, token=None, local=True, page=True)
    config = {"host": "127.0.0.1", "port": port, "log_level": "warning"}
    server = uvicorn.Server(uvicorn.Config(made, timeout_graceful_shutdown=2, **config))
    thread = threading.Thread(target=server.run, daemon=True)
    thread.start()
    while not server.started:
        time.sleep(0.05)
    yield f"http://127.0.0.1:{port}/"
    server.should_exit = True
    thread.join(20)


@pytest.fixture(scope="module")
def browser():
    with playwright.sync_playwright() as started:
        chromium = started.chromium.launch(executable_path=CHROMIUM, args=["--no-sandbox"])
        yield chromium
        chromium.close()


@pytest.fixture
def page(browser, address):
    """A tab of its own; `page.asked` are the hosts that it asked for anything."""
    context = browser.new_context(viewport=WIDE)
    tab = context.new_page()
    tab.asked = set()
    tab.on("request", lambda asked: tab.asked.add(urlsplit(asked.url).netloc))
    tab.set_default_timeout(40_000)
    tab.goto(address)
    tab.wait_for_selector("#animate")
    yield tab
    context.close()


@pytest.fixture(scope="module")
def voice(tmp_path_factory):
    """Sounds of two, twelve and forty seconds."""
    folder = tmp_path_factory.mktemp("voice")
    for seconds in (2, 12, 40):
        time = np.arange(16_000 * seconds) / 16_000
        sound = 0.3 * np.sin(900 * time) * np.sin(8 * time)
        write_wav(folder / f"{seconds}.wav", sound, 16_000)
    return folder


def give(page, photo=None, sound=None, agreed=True):
    if photo is not None:
        page.locator("#photo input[type=file]").first.set_input_files(str(photo))
        page.wait_for_selector("#photo img")
    if sound is not None:
        page.locator("#voice input[type=file]").first.set_input_files(str(sound))
        page.wait_for_selector("#voice audio", state="attached")
    if agreed:
        page.locator("#consent input[type=checkbox]").check()


def says(page, words, seconds=240):
    page.wait_for_function(
        "words => document.querySelector('#status').innerText.includes(words)",
        arg=words, timeout=1000 * seconds,
    )  # fmt: skip


def calm(queue, seconds=60):
    """Wait until nothing runs."""
    end = time.monotonic() + seconds
    while queue.counts()["running"] + queue.counts()["waiting"]:
        assert time.monotonic() < end, queue.counts()
        time.sleep(0.1)


def test_the_whole_path_by_clicks(page, address, voice, tmp_path_factory):
    give(page, PHOTO, voice / "2.wav")
    page.wait_for_selector("#square img")
    page.locator("#square img").click(position={"x": 120, "y": 120})
    page.click("#animate")
    says(page, "Drawing")
    says(page, "Done: 50 frames")
    page.wait_for_selector("#video video")
    page.wait_for_selector("#plot img")
    page.click("#again")
    says(page, "Drawing")
    says(page, "Done: 50 frames")
    page.wait_for_selector("#other video")
    for name, size in (("wide", WIDE), ("narrow", NARROW)):
        page.set_viewport_size(size)
        time.sleep(1)
        page.screenshot(path=str(tmp_path_factory.getbasetemp() / f"{name}.png"), full_page=True)
        width = page.evaluate("document.documentElement.scrollWidth")
        assert width <= size["width"]
    assert {host for host in page.asked if host} == {urlsplit(address).netloc}


def test_what_is_missing_or_wrong_is_told(page, voice, tmp_path):
    page.click("#animate")
    says(page, "Give a photo first")
    Image.fromarray(np.full((300, 300, 3), 90, np.uint8)).save(tmp_path / "nobody.png")
    give(page, tmp_path / "nobody.png", voice / "2.wav", agreed=False)
    page.wait_for_function("document.querySelector('#square-note').innerText.includes('No face')")
    page.click("#animate")
    says(page, "Tick the box")
    page.locator("#consent input[type=checkbox]").check()
    page.reload()
    (tmp_path / "text.wav").write_text("no sound at all")
    give(page, PHOTO)
    page.locator("#voice input[type=file]").first.set_input_files(str(tmp_path / "text.wav"))
    time.sleep(2)
    page.click("#animate")
    says(page, "audio.wav")
    assert page.locator("#status [role=alert]").count() == 1


def test_a_long_recording_is_refused(page, voice):
    give(page, PHOTO, voice / "40.wav")
    page.click("#animate")
    says(page, "lasts more than 30 s")


def test_the_button_stops_and_a_closed_tab_frees_its_work(page, queue, voice):
    give(page, PHOTO, voice / "12.wav")
    page.click("#animate")
    says(page, "Drawing")
    page.click("#stop")
    says(page, "Stopped")
    calm(queue)
    page.click("#animate")
    says(page, "Drawing")
    page.close()
    calm(queue)


def test_two_people_at_once_do_not_mix(page, browser, address, queue, voice):
    other = browser.new_context(viewport=WIDE).new_page()
    other.goto(address)
    other.wait_for_selector("#animate")
    give(page, PHOTO, voice / "2.wav")
    give(other, PHOTO, voice / "12.wav")
    page.click("#animate")
    other.click("#animate")
    says(page, "Done: 50 frames")
    assert "50 frames" not in other.inner_text("#status")
    says(other, "Drawing")
    other.click("#stop")
    says(other, "Stopped")
    other.context.close()
    calm(queue)


def test_it_can_be_used_by_keyboard(page):
    reached = set()
    for _ in range(60):
        page.keyboard.press("Tab")
        reached.add(page.evaluate("document.activeElement.closest('[id]')?.id || ''"))
    assert {"animate", "stop"} <= reached


def test_no_file_of_the_machine_is_served(page, address):
    for path in ("gradio_api/file=/etc/passwd", "file=/etc/passwd", "gradio_api/file=README.md"):
        answer = page.request.get(address + path)
        assert answer.status in (403, 404, 405), path
