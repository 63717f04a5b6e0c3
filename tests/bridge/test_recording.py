"""What goes into a capture comes out of it, in order, whole."""

import contextlib
import json
import math
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.reader import make_reader

from bridge.errors import CaptureError
from bridge.frame import RawFrame
from bridge.outputs import Checkpoint, SolutionOut
from bridge.recording import Capture, Recorder
from bridge.recording_format import pack_frames, unpack_frames
from bridge.recording_viewer import east_north_up, forward_left_up, on_the_map
from nav.types import Mode, S, Solution, SolutionFlag

UTC = 1_700_000_000_000_000_000

frames_strategy = st.lists(
    st.builds(
        RawFrame,
        seq=st.integers(0, 2**64 - 1),
        rx_ns=st.integers(-(2**63), 2**63 - 1),
        source=st.integers(0, 2**16 - 1),
        key=st.integers(0, 2**32 - 1),
        data=st.binary(max_size=300),
    ),
    max_size=40,
)


def recorder(path: Path, **options: object) -> Recorder:
    return Recorder(path, sources={0: "bridge", 1: "can0"}, utc_offset_ns=UTC, **options)  # type: ignore[arg-type]


def numbered(count: int, step_ns: int = 1_000_000) -> list[RawFrame]:
    return [RawFrame(i, i * step_ns, 1, 0x100 + i % 3, i.to_bytes(8, "little")) for i in range(count)]


@settings(deadline=None)
@given(frames_strategy)
def test_batches_round_trip(frames: list[RawFrame]) -> None:
    assert unpack_frames(pack_frames(frames)) == frames


@settings(deadline=None)
@given(frames_strategy.filter(bool), st.data())
def test_a_cut_batch_is_refused_or_whole(frames: list[RawFrame], data: st.DataObject) -> None:
    packed = pack_frames(frames)
    cut = data.draw(st.integers(1, len(packed) - 1))
    with contextlib.suppress(CaptureError):
        got = unpack_frames(packed[:cut])
        assert got == frames[: len(got)]


@settings(max_examples=20, deadline=None)
@given(frames_strategy)
def test_any_frames_come_back_in_the_order_given(
    tmp_path_factory: pytest.TempPathFactory, frames: list[RawFrame]
) -> None:
    path = tmp_path_factory.mktemp("capture") / "a.mcap"
    rec = recorder(path)
    for frame in frames:
        assert rec.record(frame)
    rec.close()
    capture = Capture(path)
    assert list(capture.frames()) == frames
    assert capture.damage is None


def test_frames_are_never_sorted_by_time(tmp_path: Path) -> None:
    frames = [RawFrame(i, ns, 1, 1, b"") for i, ns in enumerate([500_000_000, 100, 900_000_000, 7, 6])]
    rec = recorder(tmp_path / "a.mcap")
    for frame in frames:
        rec.record(frame)
    rec.close()
    assert list(Capture(tmp_path / "a.mcap").frames()) == frames


def test_many_frames_through_many_chunks(tmp_path: Path) -> None:
    frames = numbered(50_000, 100_000)
    rec = recorder(tmp_path / "a.mcap", lossless=True)
    for frame in frames:
        rec.record(frame)
    rec.close()
    assert rec.unrecorded == 0
    assert list(Capture(tmp_path / "a.mcap").frames()) == frames


def test_a_capture_describes_itself(tmp_path: Path) -> None:
    files = {"config.toml": b"[source.can0]\n", "navbridge.dbc": bytes(range(256))}
    rec = recorder(tmp_path / "a.mcap", attachments=files, metadata={"seed": "7"})
    rec.record(numbered(1)[0])
    rec.finish({"solution_sha256": "ab"})
    rec.close()
    capture = Capture(tmp_path / "a.mcap")
    assert capture.attachments == files
    assert capture.sources == {0: "bridge", 1: "can0"}
    assert capture.utc_offset_ns == UTC
    assert capture.metadata["seed"] == "7"
    assert "numpy" in json.loads(capture.metadata["packages"])
    for name in ("navbridge", "python", "cpu", "cpu_flags", "libc", "libm", "sources_sha256"):
        assert capture.metadata[name], name
    assert capture.result() == {"solution_sha256": "ab", "unrecorded": "0"}


def test_checkpoints_truth_and_documents(tmp_path: Path) -> None:
    rec = recorder(tmp_path / "a.mcap")
    links = [Checkpoint(i * 10**9, "main", i, f"{i:064x}") for i in range(1, 4)]
    for i, link in enumerate(links):
        rec.record(numbered(3)[i])
        rec.checkpoint(link)
        rec.truth(link.t_ns, {"lat_deg": 0.1 + i})
        rec.document("/navbridge/health", link.t_ns, {"unknown_frames": i})
    rec.close()
    capture = Capture(tmp_path / "a.mcap")
    assert capture.checkpoints() == links
    assert [item["seq"] for item in capture.documents("/navbridge/digest")] == [0, 1, 2]
    assert [item["lat_deg"] for item in capture.truth()] == [0.1, 1.1, 2.1]
    assert [item["unknown_frames"] for item in capture.documents("/navbridge/health")] == [0, 1, 2]
    assert list(capture.documents("/nothing")) == []


def test_an_indexed_reader_sees_the_viewer_channels(tmp_path: Path) -> None:
    state = np.zeros(S.SIZE)
    state[S.Q] = [math.sqrt(0.5), 0.0, 0.0, -math.sqrt(0.5)]  # heading east
    state[[S.LAT, S.LON, S.HEIGHT]] = [0.8, 0.2, 100.0]
    flags = SolutionFlag.POSITION | SolutionFlag.LEVEL | SolutionFlag.HEADING
    rec = recorder(tmp_path / "a.mcap")
    for i in range(201):  # one second at 200 Hz
        sol = Solution(i * 5_000_000, Mode.NAVIGATE, flags, state)
        rec.solution(SolutionOut("main", sol, 0))
        rec.solution(SolutionOut("slave", sol, 0))
    rec.close()
    with (tmp_path / "a.mcap").open("rb") as stream:
        reader = make_reader(stream)
        summary = reader.get_summary()
        assert summary is not None
        counts: dict[str, int] = {}
        last: dict[str, dict[str, object]] = {}
        for schema, channel, message in reader.iter_messages():
            assert schema is not None
            shape = json.loads(schema.data)
            assert schema.encoding == "jsonschema"
            assert shape["title"] == schema.name
            body = json.loads(message.data)
            assert set(shape["required"]) == set(body)
            counts[channel.topic] = counts.get(channel.topic, 0) + 1
            last[channel.topic] = body
    assert counts == {
        "/pose": 11,
        "/location": 11,
        "/slave/pose": 11,
        "/slave/location": 11,
        "/tf": 22,
    }
    assert last["/location"]["latitude"] == math.degrees(0.8)
    assert last["/pose"]["timestamp"] == {"sec": UTC // 10**9 + 1, "nsec": 0}
    # a vehicle heading east points its x axis (forward) along x of the map (east): no rotation
    assert last["/tf"]["rotation"] == pytest.approx({"w": 1.0, "x": 0.0, "y": 0.0, "z": 0.0}, abs=1e-15)


def test_nothing_is_shown_before_it_is_valid(tmp_path: Path) -> None:
    rec = recorder(tmp_path / "a.mcap")
    rec.solution(SolutionOut("main", Solution(1, Mode.ALIGN, 0, np.full(S.SIZE, np.nan)), 0))
    rec.close()
    assert list(Capture(tmp_path / "a.mcap").documents("/pose")) == []


def test_forward_left_up_turns_forward_into_the_x_axis() -> None:
    # forward is y of the vehicle; pointing north it must be y of the map, a quarter turn about up
    assert forward_left_up((1.0, 0.0, 0.0, 0.0)) == pytest.approx((math.sqrt(0.5), 0, 0, math.sqrt(0.5)))


def test_on_the_map_a_vehicle_keeps_its_attitude_over_the_pole() -> None:
    # north along Greenwich, over the pole, and on: true heading jumps, the map sees no turn
    ahead, back = (1.0, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0)
    pole = math.pi / 2 - 1e-6
    before = on_the_map((pole, 0.0, 0.0), pole, 0.0, ahead)
    after = on_the_map((pole, 0.0, 0.0), pole, math.pi, back)
    assert before == pytest.approx(ahead, abs=1e-15)
    # level turns by 2e-6 rad on the way
    assert abs(sum(a * b for a, b in zip(before, after, strict=True))) == pytest.approx(1.0, abs=1e-11)


def test_local_coordinates_of_small_steps() -> None:
    # radii of curvature of WGS-84 at 45 degrees: meridian 6367381.8 m, normal 6388838.3 m;
    # second-order terms of a 1e-5 rad step are below 1 mm
    east, north, up = east_north_up((math.pi / 4, 0.3, 0.0), (math.pi / 4 + 1e-5, 0.3 + 1e-5, 2.0))
    assert north == pytest.approx(63.673818, abs=1e-3)
    assert east == pytest.approx(63.88838 * math.cos(math.pi / 4), abs=1e-3)
    assert up == pytest.approx(2.0, abs=1e-3)


def test_a_capture_that_cannot_be_created_says_so(tmp_path: Path) -> None:
    with pytest.raises(CaptureError, match="cannot create"):
        recorder(tmp_path / "no" / "such" / "folder.mcap")


def test_a_full_disk_at_the_start_says_so() -> None:
    with pytest.raises(CaptureError, match="No space left"):
        recorder(Path("/dev/full"))


def test_closing_twice_is_harmless(tmp_path: Path) -> None:
    rec = recorder(tmp_path / "a.mcap")
    rec.close()
    rec.close()
    assert list(Capture(tmp_path / "a.mcap").frames()) == []
