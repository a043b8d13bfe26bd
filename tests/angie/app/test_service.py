"""The service over HTTP: asked, polled, fetched, stopped; and what it does not let through."""

import time

import pytest

from angie.bundle import PHOTO
from data_prep.errors import BadInput

pytest.importorskip("fastapi")
client = pytest.importorskip("fastapi.testclient")

from angie.app.guard import HEADERS, Guard  # noqa: E402
from angie.app.server import application  # noqa: E402
from angie.commands.serve import check_token, is_local  # noqa: E402

TOKEN = "a-word-that-nobody-guesses"
HOST = "http://localhost"


@pytest.fixture
def http(queue):
    made = application(queue, None, token=None, local=True, page=False)
    with client.TestClient(made, base_url=HOST) as http:
        yield http


@pytest.fixture
def files(blip):
    return {"photo": ("a.png", PHOTO.read_bytes()), "audio": ("b.wav", blip.read_bytes())}


def test_a_video_is_asked_for_and_fetched(http, files):
    given = {"consent": "a drawing", "seed": "4", "format": "webm", "fade": "0.2"}
    asked = http.post("/videos", files=files, data=given)
    assert asked.status_code == 202, asked.text
    place = f"/videos/{asked.json()['id']}"
    assert http.get(f"{place}/file").status_code in (200, 409)
    for _ in range(600):
        told = http.get(place).json()
        if told["state"] not in ("waiting", "running"):
            break
        time.sleep(0.1)
    assert (told["state"], told["share"], told["video"]) == ("done", 1.0, f"{place}/file")
    video = http.get(told["video"])
    assert video.headers["content-type"] == "video/webm" and video.content[:4] == b"\x1aE\xdf\xa3"
    assert http.delete(place).status_code == 204 and http.get(place).status_code == 404


@pytest.mark.parametrize(
    ("change", "data", "status", "words"),
    [
        ({}, {}, 422, "consent"),
        ({}, {"consent": " "}, 422, "consent: say how"),
        ({}, {"consent": "y", "seed": "many"}, 422, "whole number"),
        ({}, {"consent": "y", "format": "frames"}, 422, "choose from mp4"),
        ({}, {"consent": "y", "start": "sofa"}, 422, "--start sofa"),
        ({"audio": ("b.wav", b"no sound")}, {"consent": "y"}, 422, "audio.wav"),
        ({"audio": ("b.wav", b"")}, {"consent": "y"}, 422, "audio: is empty"),
        ({"photo": ("a.png", bytes(3_000_000))}, {"consent": "y"}, 422, "larger than 2 MB"),
        ({"photo": ("a.png", bytes(9_000_000))}, {"consent": "y"}, 413, "at most 7 MB"),
    ],
)
def test_what_cannot_be_used_is_told(http, queue, files, change, data, status, words):
    answer = http.post("/videos", files={**files, **change}, data=data)
    assert answer.status_code == status and words in answer.text
    assert str(queue.root) not in answer.text and list(queue.root.iterdir()) == []


def test_names_of_files_lead_nowhere(http, queue, files):
    files["photo"] = ("../../../etc/cron.d/x.p/ng", files["photo"][1])
    answer = http.post("/videos", files=files, data={"consent": "y"})
    assert answer.status_code == 202
    (folder,) = queue.root.iterdir()
    assert folder.name == answer.json()["id"]
    for path in ("/videos/..%2f..%2fetc%2fpasswd/file", "/videos/none/file", "/etc/passwd"):
        assert http.get(path).status_code == 404


def test_health_and_documentation_need_nothing_from_elsewhere(http):
    assert http.get("/health").json()["status"] == "ok"
    page = http.get("/docs")
    assert "POST /videos" in page.text and "photo*" in page.text and "http" not in page.text
    assert "/videos/{name}" in http.get("/openapi.json").json()["paths"]
    assert page.headers["content-security-policy"] == HEADERS["content-security-policy"]


def test_a_token_is_asked_for(queue):
    made = application(queue, None, token=TOKEN, local=False, page=False)
    with client.TestClient(made, base_url="http://host") as http:
        assert http.get("/health").status_code == 200
        assert http.get("/docs").status_code == 401
        for wrong in (TOKEN[:-1], "", TOKEN + "x"):
            answer = http.get("/docs", headers={"authorization": f"Bearer {wrong}"})
            assert answer.status_code == 401
        assert http.get("/docs", headers={"authorization": f"Bearer {TOKEN}"}).status_code == 200
        first = http.get(f"/docs?token={TOKEN}")
        assert first.status_code == 200 and "HttpOnly" in first.headers["set-cookie"]
        assert http.get("/docs").status_code == 200  # by the cookie


def test_other_sites_are_not_answered(http):
    assert http.get("/health", headers={"host": "evil.example"}).status_code == 403
    assert http.get("/health", headers={"origin": "http://evil.example"}).status_code == 403
    assert http.get("/health", headers={"origin": "http://localhost"}).status_code == 200
    assert Guard(None, token=None, body=1, local=True)._refused(
        {"path": "/"}, {"host": "127.0.0.1:8025", "content-length": "x"}
    ) == (413, "give at most 1e-06 MB in all")


def test_addresses_that_others_reach_need_a_good_token():
    assert is_local("127.0.0.1") and is_local("::1") and is_local("localhost")
    assert not is_local("0.0.0.0") and not is_local("host.example")
    check_token(None, True, "127.0.0.1")
    check_token(TOKEN, False, "0.0.0.0")
    with pytest.raises(BadInput, match="--host 0.0.0.0: others can reach it"):
        check_token(None, False, "0.0.0.0")
    with pytest.raises(BadInput, match="16 to 200 letters"):
        check_token("short", True, "127.0.0.1")
