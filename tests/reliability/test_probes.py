"""Row 13: graphs run no code and name no sources; playlists, also remote ones, open nothing else."""

import functools
import http.server
import os
import threading

import numpy as np
import pytest

from bayesnet_track import load_graph
from bayesnet_track.graph.text.messages import GraphError
from bayesnet_track.sources.sources import SourceError, open_source

pytestmark = pytest.mark.reliability

GRAPH = """\
bayesnet: 1
name: probe
{top}
targets:
  thing:
    {plate}
    nodes:
      thing: {{motion: {{random_walk: {{sd_px: {{x: 3, y: 3}}}}}}}}
      eye: {{parent: thing, agent: {agent}}}
"""

IMPORTS = [
    "os.system",
    "os:system",
    "bayesnet_track.cues.motion:CUE",
    "../cues/motion",
    "/etc/passwd",
    "__import__('os').system('touch PWNED')",
    "http://127.0.0.1:1/cue.py",
]
SOURCES = ["source: 0", "video: secret.mp4", "include: other.yaml", "import: os", "plugins: [os]", "path: /"]
PLACES = [
    "/dev/zero",
    "/dev/stdin",
    "/etc/passwd",
    "../../../../../../etc/passwd",
    "http://127.0.0.1:1/m",
    "file:///etc/passwd",
    "pipe",
    ".",
    "pickled.npz",
]


def refused(path, **parts):
    path.write_text(GRAPH.format(**{"top": "", "plate": "", "agent": "intensity", **parts}))
    with pytest.raises(GraphError) as error:
        load_graph(path)
    return str(error.value)


@pytest.fixture
def here(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.mark.parametrize("name", IMPORTS)
def test_a_cue_or_detector_is_a_registered_name(here, name):
    assert "probe.yaml:9:" in refused(here / "probe.yaml", agent=f'"{name}"')
    assert "probe.yaml:6:" in refused(here / "probe.yaml", plate=f'birth: {{detector: "{name}"}}')
    assert [path.name for path in here.iterdir()] == ["probe.yaml"]


@pytest.mark.parametrize("key", SOURCES)
def test_a_graph_names_no_source(here, key):
    assert "probe.yaml:3:" in refused(here / "probe.yaml", top=key)
    assert "probe.yaml:6:" in refused(here / "probe.yaml", plate=key)


class Pwn:
    def __reduce__(self):
        return (os.mkdir, ("PWNED",))


@pytest.mark.parametrize("place", PLACES)
@pytest.mark.parametrize("model", ["embedding", "shape", "onnx", "contour_shape"])
def test_a_model_is_a_plain_file_of_data(here, model, place):
    """A path to a model is data: any plain file may be named, is read, and must be a model."""
    os.mkfifo(here / "pipe")
    np.savez(here / "pickled.npz", mean=np.array([Pwn()], dtype=object))
    chosen = f'{{{model}: {{model: "{place}"}}}}'
    if model in ("embedding", "shape"):
        assert "probe.yaml:9:" in refused(here / "probe.yaml", agent=chosen)
    elif model == "contour_shape":
        assert "probe.yaml:6:" in refused(here / "probe.yaml", plate=f"birth: {{detector: {chosen}}}")
    else:
        from bayesnet_track.observation.detector import DetectorError, installed_detectors

        onnx = installed_detectors()["onnx"]
        with pytest.raises(DetectorError):
            onnx.make(onnx.parameters(model=place))
    assert not (here / "PWNED").exists()


SEGMENTS = [
    "file://{secret}",
    "{secret}",
    "concat:{secret}|{secret}",
    "subfile,,start,0,end,9999,,:{secret}",
    "crypto:file:{secret}",
    "crypto+file:{secret}",
    "data:video/mp4;base64,AAAA",
    "pipe:0",
    "async:file:{secret}",
]
PLAYLISTS = {
    "x.m3u8": "#EXTM3U\n#EXT-X-TARGETDURATION:2\n#EXTINF:2,\n{}\n#EXT-X-ENDLIST\n",
    "key.m3u8": '#EXTM3U\n#EXT-X-TARGETDURATION:2\n#EXT-X-KEY:METHOD=AES-128,URI="{}"\n#EXTINF:2,\n'
    "seg.ts\n#EXT-X-ENDLIST\n",
    "x.ffconcat": "ffconcat version 1.0\nfile '{}'\n",
    "x.sdp": "v=0\no=- 0 0 IN IP4 127.0.0.1\ns=x\nc=IN IP4 127.0.0.1\nt=0 0\nm=video 5004 RTP/AVP 96\n",
    "x.mp4": "#EXTM3U\n#EXT-X-TARGETDURATION:2\n#EXTINF:2,\n{}\n#EXT-X-ENDLIST\n",
}


@pytest.fixture
def served(tmp_path):
    class Quiet(http.server.SimpleHTTPRequestHandler):
        def log_message(self, *_):
            pass

        def do_GET(self):
            if self.path.startswith("/redirect"):
                self.send_response(302)
                self.send_header("Location", (tmp_path / "to").read_text())
                self.end_headers()
            else:
                super().do_GET()

    folder = tmp_path / "served"
    folder.mkdir()
    handler = functools.partial(Quiet, directory=str(folder))
    with http.server.ThreadingHTTPServer(("127.0.0.1", 0), handler) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        yield folder, f"http://127.0.0.1:{server.server_port}"
        server.shutdown()


@pytest.mark.parametrize("segment", SEGMENTS)
@pytest.mark.parametrize("name", ["x.m3u8", "x.ffconcat", "x.mp4"])
def test_a_remote_playlist_opens_no_file_of_this_machine(videos, served, segment, name):
    folder, url = served
    text = PLAYLISTS[name].format(segment.format(secret=videos["start.mp4"]))
    (folder / name).write_text(text)
    with pytest.raises(SourceError):
        open_source(f"{url}/{name}", allow_network=True)


def test_a_redirection_leads_to_no_file_of_this_machine(videos, served, tmp_path):
    _, url = served
    for scheme in ("file://", "concat:", ""):
        (tmp_path / "to").write_text(f"{scheme}{videos['start.mp4']}")
        with pytest.raises(SourceError):
            open_source(f"{url}/redirect.mp4", allow_network=True)


@pytest.mark.parametrize("name", PLAYLISTS)
def test_a_local_playlist_opens_nothing_at_all(videos, tmp_path, name):
    (tmp_path / name).write_text(PLAYLISTS[name].format(videos["start.mp4"]))
    with pytest.raises(SourceError):
        open_source(str(tmp_path / name))


def test_a_packed_model_does_not_unpack_to_any_size(here):
    np.savez_compressed(here / "bomb.npz", kind="shape", mean=np.zeros(1 << 26))
    assert "larger than 256 MB when unpacked" in refused(
        here / "probe.yaml", agent="{shape: {model: bomb.npz}}"
    )
