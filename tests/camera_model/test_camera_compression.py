"""Compression: nothing is lost without a bound, bounds hold, rates are met, spoilt streams are refused."""

from __future__ import annotations

import resource
import struct
import subprocess
import sys
import zlib

import cv2
import imagecodecs
import numpy as np
import pytest
from glrender_camera import CameraModel, Compression, ConfigError, Detector, MosaicModel, Optics
from glrender_camera.compression import CODECS, decode

HEIGHT, WIDTH = 150, 211
ENCODED = {"jpeg_ls": "max_error_DN", "jpeg_2000": "rate_bpp", "jpeg_xl": "psnr_db"}


def electrons(seed=0):
    """A textured ball before a dark sky, with shot noise and read noise of 10 e-."""
    rng = np.random.default_rng(seed)
    y, x = np.mgrid[:HEIGHT, :WIDTH]
    lit = np.hypot(x - 100, y - 75) < 60
    mean = np.where(lit, 3e4 * np.clip(1.0 - np.hypot(x - 70, y - 70) / 120.0, 0.0, 1.0)
                    * (1.0 + 0.3 * np.sin(x / 3.0) * np.cos(y / 4.0)), 0.0)
    return rng.poisson(mean) + rng.normal(0.0, 10.0, mean.shape)


def frame_dn(bit_depth, gain=None):
    gain = 2.0**bit_depth / 4e4 if gain is None else gain
    dn = np.clip(np.rint(electrons() * gain + 12.0 * gain), 0, 2**bit_depth - 1)
    return dn.astype(np.uint8 if bit_depth <= 8 else np.uint16)


def model(**more):
    detector = Detector(full_well_electrons=50_000, bit_depth=12, gain_DN_per_electron=0.08, offset_DN=20,
                        read_noise_electrons=10.0, quantum_efficiency=0.6)
    return CameraModel(optics=Optics(aperture_diameter_m=0.02, transmission=0.8, band_nm=(400.0, 900.0)),
                       detector=detector, exposure_s=0.05, **more)


def image():
    y, x = np.mgrid[:HEIGHT, :WIDTH]
    return np.where(np.hypot(x - 100, y - 75) < 60, 4e-10 * (1.5 + np.sin(x / 3.0)), 0.0).astype(np.float32)


@pytest.mark.parametrize("bit_depth", [1, 2, 7, 8, 9, 10, 12, 14, 16])
@pytest.mark.parametrize("codec", CODECS)
def test_without_a_bound_nothing_is_lost(codec, bit_depth):
    noisy = frame_dn(bit_depth)
    for dn in (noisy, np.zeros_like(noisy), np.full_like(noisy, 2**bit_depth - 1)):
        made = decode(Compression(codec=codec).encode(dn, bit_depth), codec, dn.shape, bit_depth)
        np.testing.assert_array_equal(made, dn)
        assert made.dtype == dn.dtype


@pytest.mark.parametrize("shape", [(1, 1), (1, 17), (5, 3), (64, 64)])
@pytest.mark.parametrize("codec", CODECS)
def test_small_frames_and_views_of_frames_too(codec, shape):
    dn = frame_dn(12)[20:20 + 2 * shape[0]:2, 60:60 + shape[1]]
    assert dn.shape == shape
    np.testing.assert_array_equal(decode(Compression(codec=codec).encode(dn, 12), codec, shape, 12), dn)


def test_the_rates_of_a_noisy_frame_are_ordered_as_published():
    """JPEG XL and JPEG-LS below CCSDS 121, all below the 12 bits that are sent without a codec."""
    rates = {codec: len(Compression(codec=codec).encode(frame_dn(12), 12)) * 8 / (HEIGHT * WIDTH) for codec in CODECS}
    assert rates["jpeg_xl"] < rates["ccsds_121"] < 6.0 and rates["jpeg_ls"] < rates["ccsds_121"], rates


@pytest.mark.parametrize("bound", [1, 2, 5, 10, 255])
@pytest.mark.parametrize("bit_depth", [8, 12, 16])
def test_the_largest_error_keeps_its_bound(bound, bit_depth):
    dn = frame_dn(bit_depth)
    stream = Compression(codec="jpeg_ls", max_error_DN=bound).encode(dn, bit_depth)
    made = decode(stream, "jpeg_ls", dn.shape, bit_depth).astype(int)
    assert np.abs(made - dn).max() <= bound and made.max() < 2**bit_depth
    assert len(stream) < len(Compression(codec="jpeg_ls").encode(dn, bit_depth))


@pytest.mark.parametrize("codec, rate", [("jpeg_2000", 0.1), ("jpeg_2000", 0.5), ("jpeg_2000", 1.0), ("jpeg_xl", 0.2),
                                         ("jpeg_xl", 0.5), ("jpeg_xl", 1.0)])
def test_rates_are_met_to_a_tenth(codec, rate):
    dn = frame_dn(12)
    stream = Compression(codec=codec, rate_bpp=rate).encode(dn, 12)
    np.testing.assert_allclose(8 * len(stream) / dn.size, rate, rtol=0.1)
    assert decode(stream, codec, dn.shape, 12).shape == dn.shape
    lossless = Compression(codec=codec, rate_bpp=12.0).encode(dn, 12)
    np.testing.assert_array_equal(decode(lossless, codec, dn.shape, 12), dn)


@pytest.mark.parametrize("rate", [0.5, 0.8, 1.1, 1.6])
def test_a_rate_is_met_where_the_transform_that_rounds_has_no_more_to_send(rate):
    """A small body before a quiet sky: JPEG 2000 with rounding ends at 0.9 bit/px, without loss it takes 1.9."""
    rng = np.random.default_rng(3)
    y, x = np.mgrid[:HEIGHT, :WIDTH]
    body = np.hypot(x - 100, y - 75) < 18
    dn = np.rint(48.0 + rng.normal(0.0, 0.45, body.shape) + body * (400.0 + 150.0 * np.sin(x / 2.0))).astype(np.uint16)
    stream = Compression(codec="jpeg_2000", rate_bpp=rate).encode(dn, 12)
    np.testing.assert_allclose(8 * len(stream) / dn.size, rate, rtol=0.1)
    assert np.abs(decode(stream, "jpeg_2000", dn.shape, 12).astype(int) - dn).max() <= 5


def test_a_rate_that_a_codec_does_not_reach_is_told():
    """JPEG XL ends at a distance of 25, which is 0.1 bit/px of this small frame."""
    frame = model(compression=Compression(codec="jpeg_xl", rate_bpp=0.01)).expose(image(), 1)
    assert "(0.01 asked, which the codec does not reach)" in frame.stages["compression"]


@pytest.mark.parametrize("wanted", [40.0, 56.0, 70.0])
@pytest.mark.parametrize("bit_depth", [8, 12, 16])
@pytest.mark.parametrize("codec", ["jpeg_2000", "jpeg_xl"])
def test_a_psnr_is_met_to_a_decibel(codec, bit_depth, wanted):
    """Or, where the codec's rounding does not reach it or costs more, without any loss."""
    dn = frame_dn(bit_depth)
    stream = Compression(codec=codec, psnr_db=wanted).encode(dn, bit_depth)
    error = decode(stream, codec, dn.shape, bit_depth).astype(float) - dn
    if not error.any():
        assert stream == Compression(codec=codec).encode(dn, bit_depth)
        return
    found = 20.0 * np.log10((2**bit_depth - 1) / np.sqrt(np.mean(error**2)))
    assert abs(found - wanted) <= 1.0, found


@pytest.mark.parametrize("share", [0.25, 0.5, 1.0])
def test_a_share_of_the_noise_is_one_of_what_two_exposures_differ_by(share):
    """RMS on the body over the RMS by which frames of two seeds differ, over sqrt(2)."""
    first, second = (model(compression=None).expose(image(), seed).dn.astype(float) for seed in (1, 2))
    lit = image() > 0.0
    noise = np.std((first - second)[lit]) / np.sqrt(2.0)
    sent = model(compression=Compression(codec="jpeg_ls", share_of_noise=share)).expose(image(), 1)
    assert 0.4 * share < np.std((sent.dn - first)[lit]) / noise < 1.1 * share


def test_a_frame_is_what_the_ground_decodes():
    raw = model().expose(image(), 3)
    sent = model(compression=Compression(codec="jpeg_ls", max_error_DN=5)).expose(image(), 3)
    np.testing.assert_array_equal(sent.dn, decode(sent.stream, "jpeg_ls", sent.dn.shape, 12))
    assert 0 < np.abs(sent.dn.astype(int) - raw.dn).max() <= 5
    assert sent.compressed_bytes == len(sent.stream) and sent.bits_per_pixel == 8 * len(sent.stream) / sent.dn.size
    assert sent.stages["compression"].startswith("jpeg_ls, ") and "largest error 5 DN" in sent.stages["compression"]
    assert raw.stream is raw.bits_per_pixel is raw.compressed_bytes is None
    assert raw.stages["compression"] == "skipped: none given"
    np.testing.assert_array_equal(sent.electrons, raw.electrons)
    again = model(compression=Compression(codec="jpeg_ls", max_error_DN=5)).expose(image(), 3)
    assert again.stream == sent.stream, "same request and seed, same bytes"


def test_faults_come_before_it():
    """A block that is lost is 0 DN in what is compressed."""
    fault = {"kind": "lost_blocks", "n_blocks": 2, "size_px": 32}
    sent = model(compression=Compression(codec="ccsds_121"), faults=[fault]).expose(image(), 3)
    np.testing.assert_array_equal(sent.dn, model(faults=[fault]).expose(image(), 3).dn)
    assert (sent.dn == 0).sum() >= 32 * 32


def test_a_model_of_tables_and_a_mosaic_have_it():
    table = {"preset": "generic_navigation_camera", "compression": {"codec": "jpeg_xl", "psnr_db": 50.0}}
    assert CameraModel.from_dict(table).compression == Compression(codec="jpeg_xl", psnr_db=50.0)
    camera = model()
    bands = {letter: camera.optics for letter in "RGB"}
    mosaic = MosaicModel(optics=bands, detector=camera.detector, exposure_s=0.05,
                         compression=Compression(codec="jpeg_2000"))
    frame = mosaic.expose({letter: image() for letter in "RGB"}, 1)
    np.testing.assert_array_equal(frame.dn, decode(frame.stream, "jpeg_2000", frame.dn.shape, 12))


@pytest.mark.parametrize("codec", CODECS)
def test_a_stream_that_is_cut_spoilt_or_of_another_shape_is_refused(codec):
    dn = frame_dn(12)
    stream = Compression(codec=codec).encode(dn, 12)
    assert struct.unpack_from("<II", stream) == (len(stream) - 8, zlib.crc32(stream[8:]))
    spoilt = bytearray(stream)
    spoilt[len(spoilt) // 2] ^= 1
    for bad in (b"", stream[:7], stream[:len(stream) // 2], stream[:-1], stream + b"\0", bytes(spoilt)):
        with pytest.raises(ConfigError, match=f"stream: must be a whole stream of {codec}"):
            decode(bad, codec, dn.shape, 12)
    for shape in ((HEIGHT + 1, WIDTH), (WIDTH, HEIGHT), (HEIGHT // 2, 2 * WIDTH), (HEIGHT - 1, WIDTH)):
        with pytest.raises(ConfigError, match=rf"shape: must be \({HEIGHT}, {WIDTH}\), the stream's own of {codec}"):
            decode(stream, codec, shape, 12)
    with pytest.raises(ConfigError, match="bit_depth: must be (of uint16|12), the stream's own"):
        decode(stream, codec, dn.shape, 8)
    for shape in ((HEIGHT,), (0, WIDTH), (HEIGHT, WIDTH, 1), "frame", (HEIGHT, 70000), (HEIGHT, 2.5)):
        with pytest.raises(ConfigError, match=r"^shape"):
            decode(stream, codec, shape, 12)
    with pytest.raises(ConfigError, match="codec: must be one of 'jpeg_ls', 'jpeg_2000'.*got 'jpeg'"):
        decode(stream, "jpeg", dn.shape, 12)
    with pytest.raises(ConfigError, match="stream: must be bytes, got 'str'"):
        decode("frame.jls", codec, dn.shape, 12)
    other = CODECS[(CODECS.index(codec) + 1) % len(CODECS)]
    with pytest.raises(ConfigError, match=f"stream: must be a stream of {other}|the stream's own of {other}"):
        decode(stream, other, dn.shape, 12)


@pytest.mark.parametrize("codec", CODECS)
def test_a_frame_of_more_bits_than_are_named_is_not_clipped(codec):
    """Of 12 bits, without loss and with it: a camera of 10 bits has no number above 1023."""
    dn = frame_dn(12)
    for losses in ({}, {ENCODED[codec]: 20} if codec in ENCODED else {}):
        stream = Compression(codec=codec, **losses).encode(dn, 12)
        with pytest.raises(ConfigError, match="bit_depth: must (hold the stream's largest number|be 12, the stream's)"):
            decode(stream, codec, dn.shape, 10)


def test_a_codec_that_overshoots_the_depth_within_its_bound_is_not_refused():
    """JPEG-LS with a bound decodes numbers above the detector's largest: they are that."""
    dn = np.where(electrons() > 1e4, 4095, 4080).astype(np.uint16)
    dn[1::2, ::3] = 4094
    stream = Compression(codec="jpeg_ls", max_error_DN=7).encode(dn, 12)
    assert imagecodecs.jpegls_decode(stream[8:]).max() > 4095
    made = decode(stream, "jpeg_ls", dn.shape, 12).astype(int)
    assert made.max() == 4095 and np.abs(made - dn).max() <= 7


@pytest.mark.parametrize("value", [0, 48, 4095])
@pytest.mark.parametrize("bound", [{"psnr_db": 30.0}, {"psnr_db": 110.0}, {"rate_bpp": 0.01}, {"rate_bpp": 0.05}])
@pytest.mark.parametrize("codec", ["jpeg_2000", "jpeg_xl"])
def test_a_blank_frame_is_sent_in_no_more_bytes_than_without_loss(codec, bound, value):
    """Every stream of it may be exact: no PSNR is the nearest then."""
    dn = np.full((64, 72), value, np.uint16)
    stream = Compression(codec=codec, **bound).encode(dn, 12)
    assert len(stream) <= len(Compression(codec=codec).encode(dn, 12))
    assert np.abs(decode(stream, codec, dn.shape, 12).astype(int) - dn).max() <= 0.04 * 4095


def sealed(body):
    return struct.pack("<II", len(body), zlib.crc32(body)) + body


@pytest.mark.parametrize("codec, marker, after, sides", [("jpeg_ls", b"\xff\xf7", 5, ">HH"),
                                                          ("jpeg_2000", b"\xff\x51", 6, ">II")])
def test_a_small_stream_that_declares_a_huge_frame_is_refused_before_it_is_decoded(codec, marker, after, sides):
    """The libraries take memory by the declared size: of 65535 x 65535 pixels, 8 GB and more."""
    body = bytearray(Compression(codec=codec).encode(frame_dn(12), 12)[8:])
    struct.pack_into(sides, body, body.index(marker) + after, 65535, 65535)
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    with pytest.raises(ConfigError, match=rf"shape: must be \(65535, 65535\), the stream's own of {codec}"):
        decode(sealed(bytes(body)), codec, (HEIGHT, WIDTH), 12)
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 100_000, "KiB"


@pytest.mark.parametrize("shape", [(8, 8), (256, 256), (264, 264), (300, 360), (300, 400), (200, 300), (45, 80),
                                   (40, 50), (64, 128), (9, 700), (8, 256), (1, 9000)])
@pytest.mark.parametrize("lossless", [True, False])
@pytest.mark.parametrize("container", [True, False])
def test_the_size_of_jpeg_xl_is_read_in_all_its_forms(shape, lossless, container):
    """Sides of multiples of 8, the seven ratios, and numbers of 9 to 14 bits, by the library's encoder."""
    body = imagecodecs.jpegxl_encode(np.zeros(shape, np.uint16), lossless=lossless, usecontainer=container)
    assert decode(sealed(body), "jpeg_xl", shape, 16).shape == shape
    with pytest.raises(ConfigError, match=rf"shape: must be \({shape[0]}, {shape[1]}\), the stream's own of jpeg_xl"):
        decode(sealed(body[:len(body) // 2 + 20]), "jpeg_xl", (shape[0] + 1, shape[1]), 16)


@pytest.mark.parametrize("table, match", [
    ({}, "codec: missing"), ({"codec": "jpeg"}, "codec: must be one of 'jpeg_ls', 'jpeg_2000'"),
    ({"codec": "jpeg_ls", "rate_bpp": 1.0}, "rate_bpp: is no key of jpeg_ls.*max_error_DN and share_of_noise"),
    ({"codec": "ccsds_121", "psnr_db": 50.0}, "psnr_db: is no key of ccsds_121.*none: it is lossless"),
    ({"codec": "jpeg_2000", "rate_bpp": 1.0, "psnr_db": 50.0}, "psnr_db: must not be given with rate_bpp"),
    ({"codec": "jpeg_ls", "max_error_DN": 0}, "max_error_DN: must be an integer between 1 and 255"),
    ({"codec": "jpeg_ls", "max_error_DN": 2.5}, "max_error_DN: must be an integer"),
    ({"codec": "jpeg_ls", "share_of_noise": 0.0}, "share_of_noise: must be > 0"),
    ({"codec": "jpeg_xl", "psnr_db": float("nan")}, "psnr_db: must be a finite number"),
    ({"codec": "jpeg_xl", "rate": 1.0}, "rate: unknown key"),
])
def test_mistakes_are_refused_by_name(table, match):
    with pytest.raises(ConfigError, match=match):
        Compression.from_dict(table)


def test_without_the_package_the_extra_is_named():
    code = ("import sys; sys.modules['imagecodecs'] = None\n"
            "from glrender_camera import Compression, ConfigError\n"
            "try:\n    Compression(codec='jpeg_ls')\nexcept ConfigError as error:\n    print(error)")
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60)
    assert "codec: needs imagecodecs" in run.stdout and "pip install 'glrender[compression]'" in run.stdout, run.stderr


@pytest.mark.parametrize("bit_depth", [8, 12, 16])
def test_opencv_reads_jpeg_2000_behind_the_eight_bytes(bit_depth):
    dn = frame_dn(bit_depth)
    stream = Compression(codec="jpeg_2000").encode(dn, bit_depth)[8:]
    np.testing.assert_array_equal(cv2.imdecode(np.frombuffer(stream, np.uint8), cv2.IMREAD_UNCHANGED), dn)


@pytest.mark.parametrize("bound", [None, 3])
@pytest.mark.parametrize("bit_depth", [8, 16])
def test_ffmpeg_reads_jpeg_ls_behind_the_eight_bytes(tmp_path, bit_depth, bound):
    """Its decoder shares no line with CharLS; OpenCV makes 8 bits of its 16, a step of 256 DN."""
    dn = frame_dn(bit_depth)
    (tmp_path / "frame.jls").write_bytes(Compression(codec="jpeg_ls", max_error_DN=bound).encode(dn, bit_depth)[8:])
    is_read, picture = cv2.VideoCapture(str(tmp_path / "frame.jls"), cv2.CAP_FFMPEG).read()
    step = 2.0 ** (bit_depth - 8)
    assert is_read and np.abs(picture[..., 0] * step - dn).max() <= (bound or 0) + (256 if bit_depth == 16 else 0)


class Bits:
    """Bits of a stream, the first the highest of its byte."""

    def __init__(self, stream):
        self.text, self.at = "".join(f"{byte:08b}" for byte in stream), 0

    def number(self, n_bits):
        self.at += n_bits
        return int(self.text[self.at - n_bits:self.at] or "0", 2)

    def zeros(self):
        """Zeros before the next one."""
        end = self.text.index("1", self.at)
        count, self.at = end - self.at, end + 1
        return count


def blue_book_decoder(stream, n_pixels, bit_depth):
    """A decoder of CCSDS 121.0-B-3, written from the Blue Book: blocks of 16, a reference in every 64th block.

    Sections 3.2 to 3.5 of the entropy coder's options, 4.2 of the unit-delay predictor and its mapping.
    """
    bits, pixels, largest = Bits(stream), [], 2**bit_depth - 1
    n_id = 3 if bit_depth <= 8 else 4
    while len(pixels) < n_pixels:
        # One run of 64 blocks begins with a reference sample.
        block, before = 0, None
        while block < 64 and len(pixels) < n_pixels:
            option, n_blocks, n_samples = bits.number(n_id), 1, 16
            if option == 0 and bits.number(1) == 0:
                kind = "zeros"
            elif option == 0:
                kind = "pairs"
            else:
                kind = "plain" if option == 2**n_id - 1 else "split"
            mapped = []
            if block == 0:
                before = bits.number(bit_depth)
                pixels.append(before)
                n_samples = 15
            if kind == "zeros":
                n_blocks = bits.zeros() + 1
                if n_blocks == 5:  # the rest of the segment of 64 blocks
                    n_blocks = 64 - block % 64
                elif n_blocks > 5:
                    n_blocks -= 1
                mapped = [0] * (n_samples + 16 * (n_blocks - 1))
            elif kind == "pairs":
                while len(mapped) < 16:
                    code = bits.zeros()
                    total = int((np.sqrt(8.0 * code + 1.0) - 1.0) / 2.0)
                    second = code - total * (total + 1) // 2
                    mapped += [total - second, second]
                mapped = mapped[16 - n_samples:]
            elif kind == "plain":
                mapped = [bits.number(bit_depth) for _ in range(n_samples)]
            else:
                split = option - 1
                high = [bits.zeros() for _ in range(n_samples)]
                mapped = [(each << split) | (bits.number(split) if split else 0) for each in high]
            for each in mapped:
                room = min(before, largest - before)
                if each > 2 * room:
                    step = each - room if room == before else room - each
                else:
                    step = each // 2 if each % 2 == 0 else -(each + 1) // 2
                before += step
                pixels.append(before)
            block += n_blocks
    return pixels[:n_pixels]


@pytest.mark.parametrize("bit_depth", [6, 8, 12, 16])
@pytest.mark.parametrize("kind", ["noise", "flat", "steps"])
def test_a_decoder_of_the_blue_book_reads_ccsds_121(bit_depth, kind):
    """All options of the coder: blocks of zeros, pairs, split samples, and noise that is not coded at all."""
    rng = np.random.default_rng(5)
    dn = frame_dn(bit_depth)[40:100]
    if kind == "flat":
        dn = np.where(dn > 2 ** (bit_depth - 2), dn, 1).astype(dn.dtype)
    elif kind == "steps":
        dn = rng.integers(0, 2**bit_depth, dn.shape).astype(dn.dtype)
        dn[20:40] = rng.random((20, dn.shape[1])) < 0.1
    stream = Compression(codec="ccsds_121").encode(dn, bit_depth)
    np.testing.assert_array_equal(blue_book_decoder(stream[13:], dn.size, bit_depth), dn.ravel())
