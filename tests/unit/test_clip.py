"""Reading plain video: rates, times, colour, and any start."""

from __future__ import annotations

from contextlib import closing
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest

from exwarp_cli.errors import DamagedFileError, InputError
from exwarp_cli.io import video_reader, video_timing
from exwarp_cli.io.display_colour import MATRICES, to_display
from exwarp_cli.io.ffmpeg import EXACT_SCALING, FfmpegError, FfmpegReader
from exwarp_cli.io.footage import ClipSequence, close_sequences, find_frames
from exwarp_cli.io.video_reader import ClipReader, is_clip, open_clip
from exwarp_cli.io.video_timing import (
    UNKNOWN_TIMES,
    Pacing,
    Packets,
    find_pacing,
    nearest_standard_rate,
    parse_packets,
)
from exwarp_cli.io.video_writer import VideoWriter
from tests.cli.pictures import ffmpeg
from tests.unit.clip_files import H264, PALETTE, SIZE, STEADY, make, shown


def ticks(*times: int, tick: Fraction = Fraction(1, 1000)) -> Packets:
    return Packets(times, tick, (0,), len(times))


class TestPackets:
    LISTED = """#software: Lavf
#tb 0: 1/24000
#dimensions 0: 320x180
0, -2002,    0, 1001, 4470, 0x35533896
0, -1001, 3003, 1001, 1888, 0x0571a3b6, F=0x0
0,     0, 1001, 1001, 1044, 0x36fffc65, F=0x0, S=1, 8, 0x1
0,  1001, 2002, 1001,  801, 0xe4638c72, F=0x0
"""

    def test_they_come_in_the_order_in_which_they_are_shown(self):
        packets = parse_packets(self.LISTED)
        assert packets.times == (0, 1001, 2002, 3003)
        assert packets.tick == Fraction(1, 24000)
        assert packets.keys == (0,) and packets.count == 4
        assert packets.time(3) == Fraction(3003, 24000)
        assert packets.least_step == Fraction(1001, 24000)

    def test_those_that_an_edit_list_hides_are_left_out(self):
        hidden = self.LISTED + "0, 2002, -1001, 1001, 9, 0x0, F=0x5\n"
        assert parse_packets(hidden).times == (0, 1001, 2002, 3003)

    def test_those_shown_before_the_first_key_frame_cannot_be_decoded(self):
        cut = self.LISTED.replace("0, -2002,    0,", "0, -2002, 1500,")
        packets = parse_packets(cut)
        assert packets.times == (1500, 2002, 3003) and packets.keys == (0,)

    @pytest.mark.parametrize("unknown", UNKNOWN_TIMES)
    def test_without_many_times_all_are_dropped(self, unknown):
        packets = parse_packets(self.LISTED.replace("0,  1001, 2002,", f"0,  1001, {unknown},"))
        assert packets.times == () and packets.keys == () and packets.count == 4

    @staticmethod
    def even(*bad: tuple[int, object], count: int = 30, ahead: int = 0) -> Packets:
        """Packets at 0, 40, 80 ... ms, some with another time."""
        times = {k: 40 * k for k in range(count)} | dict(bad)
        lines = [
            f"0, {40 * (k - ahead)}, {times[k]}, 40, 9, 0x0, F=0x{int(k == 0)}"
            for k in range(count)
        ]
        return parse_packets("\n".join(["#tb 0: 1/1000", *lines]))

    @pytest.mark.parametrize("bad", [(7, 240), (7, 320), (29, 1120), (1, 0), (7, "NOPTS")])
    def test_only_a_bad_time_is_mended(self, bad):
        packets = self.even(bad)
        assert packets.times == tuple(range(0, 1200, 40))
        assert find_pacing(packets, Fraction(1000, 41)) == Pacing(Fraction(25), tuple(range(30)))

    def test_a_missing_time_of_reordered_frames_is_the_one_left_free(self):
        listed = self.even(count=30, ahead=2)
        swapped = {4: 240, 5: 160, 6: 200}  # a P-frame, then the two shown before it
        for unknown in swapped:
            packets = self.even(*(swapped | {unknown: "NOPTS"}).items(), ahead=2)
            assert packets.times == listed.times

    def test_frames_before_a_bad_time_are_identified_by_theirs(self):
        packets = self.even((7, 240))
        assert packets.mended == 6 and packets.stamps[6:8] == (240, 240)
        assert self.even().mended is None and self.even((1, 0)).mended == 0

    def test_a_hidden_key_frame_makes_what_follows_decodable(self):
        hidden = ["0, -80, -80, 40, 9, 0x0, F=0x5", "0, -40, -40, 40, 9, 0x0, F=0x4"]
        shown = [f"0, {k}, {k}, 40, 9, 0x0, F=0x0" for k in (0, 40, 80)]
        later = ["0, 120, 120, 40, 9, 0x0, F=0x1"]
        packets = parse_packets("\n".join(["#tb 0: 1/1000", *hidden, *shown, *later]))
        assert packets.times == (0, 40, 80, 120) and packets.keys == (3,)

    def test_no_packets_are_an_error(self):
        with pytest.raises(FfmpegError, match="no frames"):
            parse_packets("#tb 0: 1/25\n")


class TestPace:
    def test_times_in_milliseconds_stand_for_the_exact_rate(self):
        exact = [round(1000 * i * 1001 / 24000) for i in range(200)]
        found = find_pacing(ticks(*exact), Fraction(24000, 1001))
        assert found.rate == Fraction(24000, 1001) and not found.varies
        assert found.shown == tuple(range(200))

    def test_the_header_is_not_believed_against_the_times(self):
        found = find_pacing(ticks(*range(0, 4000, 40)), Fraction(1000))
        assert found.rate == 25 and not found.varies

    def test_an_unusual_constant_rate_is_kept(self):
        found = find_pacing(ticks(0, 700, 1400, 2100, tick=Fraction(1, 10000)), None)
        assert found.rate == Fraction(10000, 700) and not found.varies

    def test_jitter_loses_and_repeats_nothing(self):
        rng = np.random.default_rng(3)
        times = [33 * i + int(rng.integers(-4, 5)) for i in range(60)]
        found = find_pacing(ticks(*times), Fraction(90))
        assert found.varies and found.shown == tuple(range(60))
        assert abs(found.rate - 30) < 0.5

    def test_a_frame_that_was_dropped_is_bridged_by_the_one_before(self):
        times = [i * 40 for i in range(30) if i not in (7, 8)]
        found = find_pacing(ticks(*times), Fraction(25))
        assert found.rate == 25 and found.varies
        assert found.shown[5:11] == (5, 6, 6, 6, 7, 8)
        assert len(found.shown) == 30 and found.repeated == 2 and found.skipped == 0

    def test_jitter_beside_a_gap_does_no_more(self):
        rng = np.random.default_rng(4)
        times = [40 * i + int(rng.integers(-6, 7)) for i in range(60) if i not in (20, 21)]
        found = find_pacing(ticks(*times), Fraction(25))
        bridged = [i if i < 20 else 19 if i < 22 else i - 2 for i in range(60)]
        assert found.rate == 25 and list(found.shown) == bridged

    def test_frames_between_the_instants_are_skipped(self):
        times = [*range(0, 800, 40), 790, *range(800, 1600, 40)]
        found = find_pacing(ticks(*times), Fraction(25))
        assert found.rate == 25 and found.skipped == 1 and found.repeated == 0

    @pytest.mark.parametrize("rate", [Fraction(24), Fraction(24000, 1001), Fraction(60)])
    def test_missing_frames_leave_a_standard_rate(self, rate):
        """In milliseconds, the mean and the median of what is there are neither."""
        exact = [round(1000 * i / rate) for i in range(145) if i not in (40, 90)]
        found = find_pacing(ticks(*exact), Fraction(143, 6))
        assert found.rate == rate and found.repeated == 2 and found.skipped == 0

    @pytest.mark.parametrize("rate", [24, 30, 60, 120])
    @pytest.mark.parametrize("missing", [0.01, 0.1, 0.6])
    @pytest.mark.parametrize("said", ["mean", "rate", "none"])
    def test_no_frame_is_left_out_where_others_are_missing(self, rate, missing, said):
        """Of times in milliseconds, as Matroska and WebM have them."""
        gone = set(np.random.default_rng(6).choice(np.arange(1, 299), int(300 * missing), False))
        kept = [i for i in range(300) if i not in gone]
        times = [round(1000 * i / rate) for i in kept]
        mean = Fraction(1000 * (len(times) - 1), times[-1])
        found = find_pacing(
            ticks(*times), {"mean": mean, "rate": Fraction(rate), "none": None}[said]
        )
        assert found.rate == rate and found.skipped == 0
        assert [found.shown[i] for i in kept] == list(range(len(kept)))

    def test_coarse_ticks_with_jitter_are_no_high_rate(self):
        """At 240 fps, every time in ticks of 1/600 s lies near an instant."""
        rng = np.random.default_rng(3)
        times = {round(600 * (i / 60 + rng.uniform(-0.03, 0.03))) for i in range(200)}
        found = find_pacing(ticks(*sorted(times), tick=Fraction(1, 600)), None)
        assert found.rate <= 80

    def test_a_header_s_mean_is_the_standard_rate_it_is_near_to(self):
        times = [round(1000 * i / 24) for i in range(300)]
        assert find_pacing(ticks(*times), Fraction(299_000, times[-1])).rate == 24

    def test_equal_times_without_room_between_lose_no_frame(self):
        packets = parse_packets(
            "\n".join(["#tb 0: 1/25", *(f"0, {k}, {k // 2}, 1, 9, 0x0" for k in range(12))])
        )
        assert packets.count == 12 and find_pacing(packets, None).shown == tuple(range(12))

    def test_a_header_s_mean_is_no_rate_where_frames_vary(self):
        rng = np.random.default_rng(5)
        times = [round(100 / 3 * i) + int(rng.integers(-4, 5)) for i in range(60)]
        found = find_pacing(ticks(*times), Fraction(2983, 100))
        assert found.rate == 30 and found.shown == tuple(range(60))

    def test_one_frame_and_unknown_times_take_the_header(self):
        assert find_pacing(ticks(0), Fraction(24)).shown == (0,)
        assert find_pacing(ticks(0), None).rate == 30
        untimed = find_pacing(Packets((), Fraction(1), (), 5), Fraction(25))
        assert untimed.rate == 25 and untimed.shown == (0, 1, 2, 3, 4)

    @pytest.mark.parametrize(
        ("rate", "usual"),
        [("29.96", "30000/1001"), ("23.98", "24000/1001"), ("60.001", "60"), ("17.3", "173/10")],
    )
    def test_rates_that_are_meant(self, rate, usual):
        assert nearest_standard_rate(Fraction(rate)) == Fraction(usual)


class TestOpenClip:
    def test_what_a_file_holds(self, tmp_path):
        path = make(tmp_path / "ä %d.mp4", "-c:a", "aac", *H264, audio="yes")
        clip = open_clip(path)
        assert (clip.width, clip.height, clip.count) == (48, 32, 30)
        assert clip.rate == Fraction(24000, 1001)
        assert clip.look.pixel_aspect == 1
        assert clip.look.colour.matrix == "smpte170m" and not clip.look.colour.full_range
        assert clip.look.sound is not None and clip.look.sound.codecs == ("aac",)
        assert not clip.has_alpha and not clip.deep

    def test_the_sound_of_a_part(self, tmp_path):
        clip = open_clip(make(tmp_path / "a.mov", "-c:a", "aac", *H264, audio="yes", rate="25"))
        part = clip.sound(5, 15)
        assert part is not None
        assert (part.start, part.length) == (Fraction(1, 5), Fraction(2, 5))
        assert open_clip(make(tmp_path / "b.mov")).sound(5, 15) is None

    @pytest.mark.parametrize(
        ("options", "matrix"),
        [
            (("-vf", "scale=1280:720"), "bt709"),
            (("-vf", "setparams=colorspace=bt709"), "bt709"),
            (("-vf", "setparams=colorspace=bt470bg"), "bt470bg"),
            (("-vf", "setparams=colorspace=bt2020nc"), "bt2020nc"),
        ],
    )
    def test_the_matrix_is_as_stated_or_as_usual_for_the_size(self, tmp_path, options, matrix):
        clip = open_clip(make(tmp_path / "a.mp4", *options, *H264, frames=1))
        assert clip.look.colour.matrix == matrix

    def test_a_video_of_rgb_becomes_one_that_players_know(self, tmp_path):
        coded = ("-c:v", "ffv1", "-pix_fmt", "gbrp")
        colour = open_clip(make(tmp_path / "a.mkv", *coded, frames=1)).look.colour
        assert colour.matrix == "bt709" and not colour.full_range

    def test_an_unstated_matrix_is_that_of_the_size(self, tmp_path):
        for size, matrix in (("1280x720", "bt709"), ("720x576", "smpte170m")):
            flat = f"color=0x30a0d0:s={size},scale=out_color_matrix={matrix}:{EXACT_SCALING}"
            path = tmp_path / f"{size}.mkv"
            ffmpeg("-f", "lavfi", "-i", f"{flat},format=yuv444p,setparams=colorspace=unknown",
                   "-frames:v", 1, "-c:v", "ffv1", path)  # fmt: skip
            (frame,) = open_clip(path).frames()
            assert np.abs(to_display(frame)[9, 9].astype(int) - (0x30, 0xA0, 0xD0)).max() <= 2

    def test_full_range_and_pixel_aspect(self, tmp_path):
        options = ("-vf", "scale=out_range=pc,setsar=4/3", "-color_range", "pc")
        look = open_clip(make(tmp_path / "a.mp4", *options, *H264, frames=1)).look
        assert look.colour.full_range and look.pixel_aspect == Fraction(4, 3)

    def test_a_turned_video_is_read_upright(self, tmp_path):
        plain = make(tmp_path / "a.mp4", frames=2)
        turned = tmp_path / "b.mp4"
        ffmpeg("-display_rotation", "90", "-i", plain, "-c", "copy", turned)
        clip = open_clip(turned)
        assert (clip.width, clip.height) == SIZE[::-1]
        upright, lying = (next(open_clip(p).frames()) for p in (turned, plain))
        assert np.abs(np.rot90(lying) - upright).mean() < 0.01

    def test_alpha_and_depth(self, tmp_path):
        coded = ("-c:v", "prores_ks", "-profile:v", "4444", "-pix_fmt", "yuva444p10le")
        clip = open_clip(make(tmp_path / "a.mov", *coded, frames=2))
        assert clip.has_alpha and clip.deep
        assert next(clip.frames()).shape == (32, 48, 4)

    @pytest.mark.parametrize(
        ("name", "coded"),
        [
            ("a.mov", ("prores_ks", "-profile:v", "4444", "-pix_fmt", "yuva444p10le")),
            ("a.webm", ("libvpx-vp9", "-lossless", "1", "-pix_fmt", "yuva420p")),
            ("a.gif", ("gif", "-pix_fmt", "bgr8")),
        ],
    )
    def test_light_is_multiplied_by_alpha(self, tmp_path, name, coded):
        """Left half opaque, right half clear; of a half-transparent one, the light is halved."""
        clear = "0" if name.endswith("gif") else "128"
        grey = f"format=rgba,geq=r=188:g=188:b=188:a='if(lt(X,24),255,{clear})'"
        grey += PALETTE if clear == "0" else ""
        picture = ("-f", "lavfi", "-i", f"color=white:s=48x32:r=25,{grey}", "-frames:v", "2")
        coded = ("-c:v", *coded) if clear == "128" else ()
        ffmpeg(*picture, *coded, tmp_path / name)
        frame = next(open_clip(tmp_path / name).frames())
        share = int(clear) / 255
        for column, alpha in ((4, 1.0), (44, share)):
            light = 0.5 * alpha
            assert np.allclose(frame[4:28, column], (light, light, light, alpha), atol=0.02)

    def test_suffixes(self, tmp_path):
        assert is_clip("a.MP4") and is_clip("b/c.webm")
        assert not is_clip("a.0001.exr") and not is_clip("shot")
        assert is_clip("a.gif") and not is_clip("a.####.gif")
        (tmp_path / "frames.mp4").mkdir()
        assert not is_clip(str(tmp_path / "frames.mp4"))


class TestFrames:
    def test_the_display_codes_come_back(self, tmp_path):
        path = make(tmp_path / "a.mp4")
        codes = shown(path).reshape(30, 32, 48, 3)
        found = np.stack([to_display(frame) for frame in open_clip(path).frames()])
        assert np.abs(found.astype(int) - codes).max() <= 1

    def test_sixteen_bits_keep_what_eight_lose(self, tmp_path):
        ramp = "color=black:s=256x16:r=25,format=gray10le,geq=lum='64+X'"
        path = tmp_path / "a.mkv"
        ffmpeg("-f", "lavfi", "-i", ramp, "-frames:v", 1, "-c:v", "ffv1", path)
        (frame,) = open_clip(path).frames()
        assert len(np.unique(frame[8, :, 0])) == 256

    @pytest.mark.parametrize(
        ("name", "options"),
        [
            ("closed.mp4", H264),
            ("open.mp4", (*H264, "-x264-params", "open-gop=1:scenecut=0")),
            ("no-times.avi", ("-c:v", "mpeg4", "-bf", "2", "-g", "8")),
            ("stream.ts", ("-c:v", "mpeg2video", "-bf", "2", "-g", "8")),
            ("milliseconds.mkv", H264),
        ],
    )
    def test_the_same_pixels_from_any_start(self, tmp_path, name, options):
        clip = open_clip(make(tmp_path / name, *options))
        whole = list(clip.frames())
        assert len(whole) == clip.count == 30
        for start in (1, 7, 8, 9, 15, 16, 17, 22, 25, 29):
            assert np.array_equal(next(clip.frames(start)), whole[start]), start
        assert len(list(clip.frames(clip.count - 3))) == 3 and list(clip.frames(clip.count)) == []

    def test_an_edit_list_hides_frames(self, tmp_path):
        source, cut = make(tmp_path / "a.mp4"), tmp_path / "b.mp4"
        ffmpeg("-ss", "0.5", "-i", source, "-c", "copy", cut)
        clip, whole = open_clip(cut), list(open_clip(source).frames())
        found = list(clip.frames())
        assert len(found) == clip.count < 30
        assert all(map(np.array_equal, found, whole[-len(found) :]))
        assert np.array_equal(next(clip.frames(10)), found[10])

    @pytest.mark.parametrize("codec", ["libx264", "libx265"])
    def test_a_clip_trimmed_inside_a_group_of_pictures_is_whole(self, tmp_path, codec):
        calm = ("-x265-params", "pools=none:frame-threads=1:log-level=none", "-vf", "scale=64:64")
        coded = ("-c:v", codec, "-pix_fmt", "yuv420p", "-g", "20", "-bf", "2")
        coded += calm if codec == "libx265" else ()
        source, cut = make(tmp_path / "a.mp4", *coded, rate="25", frames=50), tmp_path / "b.mp4"
        ffmpeg("-ss", "0.6", "-i", source, "-c", "copy", cut)
        clip, whole = open_clip(cut), list(open_clip(source).frames())
        found = list(clip.frames())
        assert len(found) == clip.count == 35
        assert all(map(np.array_equal, found, whole[15:]))
        for start in (1, 4, 5, 6, 24, 25, 34):
            assert np.array_equal(next(clip.frames(start)), found[start]), start

    def test_a_time_that_is_there_twice_moves_nothing(self, tmp_path, monkeypatch):
        """Of a screen recording that pauses for 10 frames and starts 0.4 s after its sound."""
        source, path = tmp_path / "a.mkv", tmp_path / "b.mkv"
        pausing = ("-vf", "select='not(between(n,15,24))',setpts=PTS+0.4/TB")
        coded = ("-c:a", "pcm_s16le", "-fps_mode", "passthrough", "-c:v", "ffv1")
        make(source, *pausing, *coded, rate="25", frames=30, audio="yes")
        again = "setts=pts='if(eq(N,12),PREV_OUTPTS,PTS)':dts='if(eq(N,12),PREV_OUTDTS,DTS)'"
        ffmpeg("-i", source, "-c", "copy", "-bsf:v", again, path)
        right, clip = open_clip(source), open_clip(path)
        assert clip.packets.mended == 11  # the situation is there
        assert clip.pacing == right.pacing and clip.rate == 25
        assert clip.look.sound is not None and clip.look.sound.start == Fraction("0.4")
        whole, seeks = list(right.frames()), []

        def start_ffmpeg(options: list[str], frame_bytes: int) -> FfmpegReader:
            seeks.append(options[options.index("-ss") + 1] if "-ss" in options else "")
            return FfmpegReader(options, frame_bytes=frame_bytes)

        monkeypatch.setattr(video_reader, "FfmpegReader", start_ffmpeg)
        for start in (0, 10, 11, 12, 13, 30):
            assert np.array_equal(next(clip.frames(start)), whole[start]), start
        # From the first frame on: the other key frames come after the time that is there twice.
        assert len(clip.packets.keys) > 1 and not any(seeks)

    def test_a_missing_time_before_the_first_key_frame(self, tmp_path):
        """Matroska cannot say that frames of an open group of pictures come before 0."""
        opened = (*H264, "-x264-params", "open-gop=1:scenecut=0")
        source, cut = make(tmp_path / "a.mp4", *opened, rate="25", frames=43), tmp_path / "b.mkv"
        ffmpeg("-ss", "0.5", "-i", source, "-c", "copy", cut)
        clip, whole = open_clip(cut), list(open_clip(source).frames())
        found = list(clip.frames())
        assert clip.rate == 25 and not clip.pacing.varies
        assert len(found) == clip.count == 35
        assert all(map(np.array_equal, found, whole[8:]))

    def test_dropped_frames_are_shown_again(self, tmp_path):
        path = tmp_path / "a.mkv"
        dropping = ("-vf", "select='not(between(n,10,11))'", "-fps_mode", "passthrough")
        clip = open_clip(make(path, *dropping, *H264, rate="25", frames=28))
        frames = list(clip.frames())
        assert clip.rate == 25 and clip.count == 30 and clip.pacing.repeated == 2
        assert np.array_equal(frames[9], frames[11]) and not np.array_equal(frames[11], frames[12])
        assert np.array_equal(next(clip.frames(12)), frames[12])

    @pytest.mark.parametrize("rate", [24, 30, 60, 120])
    def test_missing_frames_of_matroska_leave_its_rate(self, tmp_path, rate):
        dropping = ("-vf", "select='not(eq(n,20)+eq(n,41))'", "-fps_mode", "passthrough")
        path = tmp_path / "a.mkv"
        clip = open_clip(make(path, *dropping, "-c:v", "ffv1", rate=str(rate), frames=58))
        assert clip.rate == rate and clip.count == 60
        assert clip.pacing.repeated == 2 and clip.pacing.skipped == 0

    def test_a_reader_goes_forward_and_back(self, tmp_path):
        clip = open_clip(make(tmp_path / "a.mp4"))
        whole = list(clip.frames())
        with closing(ClipReader(clip)) as reader:
            for index in (0, 1, 1, 4, 20, 3):
                assert np.array_equal(reader.read(index), whole[index])
            with pytest.raises(IndexError):
                reader.read(30)

    def test_a_frame_is_read_again_after_a_fault_that_passes(self, tmp_path, monkeypatch):
        sequence = find_frames(str(make(tmp_path / "a.mp4", frames=3)))
        assert isinstance(sequence, ClipSequence)
        whole, faults = list(sequence.clip.frames()), [DamagedFileError("cut off")]
        read = ClipReader.read

        def fail_once(reader: ClipReader, index: int) -> np.ndarray:
            if faults:
                raise faults.pop()
            return read(reader, index)

        monkeypatch.setattr(ClipReader, "read", fail_once)
        assert np.array_equal(sequence.image(2).pixels, whole[1])
        close_sequences(sequence)

    @pytest.mark.parametrize("matrix", ["bt709", "smpte170m", "bt2020nc"])
    @pytest.mark.parametrize("span", ["tv", "pc"])
    def test_what_is_written_comes_back(self, tmp_path, matrix, span):
        path = tmp_path / "a.mp4"
        flat = "color=0x30a0d0:s=48x32:r=50,scale=out_color_matrix=" + MATRICES[matrix]
        tagged = f"{flat}:out_range={span},setparams=colorspace={matrix}:range={span}"
        ffmpeg("-f", "lavfi", "-i", tagged, "-frames:v", 5, *H264, path)
        clip, copy = open_clip(path), tmp_path / "b.mp4"
        with VideoWriter(copy, clip.width, clip.height, clip.rate, clip.look) as video:
            for frame in clip.frames():
                video.write(to_display(frame))
        again = open_clip(copy)
        assert (again.rate, again.count) == (50, 5)
        assert again.look.colour.matrix == matrix == clip.look.colour.matrix
        assert again.look.colour.full_range == clip.look.colour.full_range == (span == "pc")
        planes = [
            np.frombuffer(ffmpeg("-i", p, "-f", "rawvideo", "-"), np.uint8).astype(int)
            for p in (path, copy)
        ]
        assert np.abs(planes[0] - planes[1]).max() <= (span == "pc")  # steps of Y'CbCr
        away = to_display(next(again.frames())).astype(int) - (0x30, 0xA0, 0xD0)
        assert np.abs(away).max() <= 6  # another matrix: 13 and more


class TestFields:
    """Bars that move 6 pixels a field: two instants in a frame look like a comb."""

    BARS = "color=black:s=48x32:r=50,geq=lum='if(lt(mod(X+6*N,24),12),40,220)':cb=128:cr=128"

    def interlaced(self, path: Path, frames: int, group: int = 4) -> Path:
        fields = (
            "-vf",
            "tinterlace=mode=interleave_top",
            "-flags",
            "+ildct+ilme",
            "-g",
            group,
            *STEADY,
        )
        coded = ("-c:v", "mpeg2video", "-q:v", 2)
        ffmpeg("-f", "lavfi", "-i", self.BARS, *fields, "-frames:v", frames, *coded, path)
        return path

    def mixed(self, folder: Path) -> Path:
        """Twelve progressive frames, and twelve interlaced ones after them."""
        coded = ("-c:v", "mpeg2video", "-q:v", 2, "-frames:v", 12)
        still = self.BARS.replace("r=50", "r=25")
        ffmpeg("-f", "lavfi", "-i", still, *coded, folder / "p.ts")
        self.interlaced(folder / "i.ts", 12)
        both, path = folder / "both.txt", folder / "mixed.ts"
        both.write_text("file p.ts\nfile i.ts\n")
        ffmpeg("-f", "concat", "-i", both, "-c", "copy", path)
        return path

    def combed(self, frame: np.ndarray) -> float:
        """Difference of neighbouring rows, of 255."""
        return float(np.abs(np.diff(to_display(frame).astype(int), axis=0)).mean())

    def test_after_progressive_frames_are_refused(self, tmp_path):
        wanted = r"is interlaced from 0\.48 s on, .*--scan deinterlace"
        with pytest.raises(InputError, match=wanted):
            open_clip(self.mixed(tmp_path))

    @pytest.mark.parametrize(("name", "group"), [("long.ts", 6), ("long.mov", 1)])
    def test_late_in_a_long_video_are_refused(self, tmp_path, monkeypatch, name, group):
        """Only key frames are looked at; where all are, the first ones and some later ones."""
        monkeypatch.setattr(video_timing, "EVERY_FRAME", 5)
        still = ("-f", "lavfi", "-i", self.BARS.replace("r=50", "r=25"), "-frames:v", 12)
        ffmpeg(*still, "-c:v", "mpeg2video", "-g", group, tmp_path / "p.mov")
        path = tmp_path / name
        self.interlaced(tmp_path / "i.mov", 12, group)
        (tmp_path / "both.txt").write_text("file p.mov\nfile i.mov\n")
        ffmpeg("-f", "concat", "-i", tmp_path / "both.txt", "-c", "copy", path)
        with pytest.raises(InputError, match=r"is interlaced from 0\.[4-9]\d s on"):
            open_clip(path)

    def test_are_taken_as_they_are_where_the_user_says_progressive(self, tmp_path):
        frames = list(open_clip(self.mixed(tmp_path), "progressive").frames())
        assert len(frames) == 24
        assert self.combed(frames[5]) < 2 and self.combed(frames[18]) > 40

    def test_become_frames_where_the_user_asks_for_it(self, tmp_path):
        path = self.mixed(tmp_path)
        frames = list(open_clip(path, "deinterlace").frames())
        assert len(frames) == 24
        assert max(map(self.combed, frames)) < 12
        kept = list(open_clip(path, "progressive").frames())
        assert all(np.array_equal(*pair) for pair in zip(frames[:11], kept[:11], strict=True))

    def test_are_the_same_from_any_start(self, tmp_path):
        clip = open_clip(self.interlaced(tmp_path / "a.mov", 14), "deinterlace")
        frames = list(clip.frames())
        for start in (1, 4, 7, 8, 13):
            assert np.array_equal(next(clip.frames(start)), frames[start]), start
