"""Regions and several cameras, in shared memory and without: borders, one pixel, outside; in both orders."""

from __future__ import annotations

import math
import sys

import numpy as np
import pytest
import serving
from glrender_client import Client, ServerError
from lending import SCENE, STATE

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="shared memory for clients is Linux's")
PRODUCTS = ["range", "body_id", "facet_id", "incidence", "emission", "phase", "r_body", "sunlit"]
WIDTH, HEIGHT = 256, 192
# Corners (sky), one pixel within the body, a row, a column, all but the border, all.
REGIONS = [(0, 0, 1, 1), (WIDTH - 1, HEIGHT - 1, WIDTH, HEIGHT), (WIDTH - 1, 0, WIDTH, 1), (0, HEIGHT - 1, 1, HEIGHT),
           (127, 95, 128, 96), (0, HEIGHT - 1, WIDTH, HEIGHT), (WIDTH - 1, 0, WIDTH, HEIGHT),
           (1, 1, WIDTH - 1, HEIGHT - 1), (0, 0, WIDTH, HEIGHT)]
OUTSIDE = [(0, 0, WIDTH + 1, 1), (0, 0, 1, HEIGHT + 1), (-1, 0, 1, 1), (WIDTH, 0, WIDTH + 1, 1), (5, 5, 5, 6),
           (6, 5, 5, 6), (0.5, 0, 1, 1), (math.nan, 0, 1, 1), (0, 0, math.inf, 1), (0, 0, 2**63, 1), (0, 0, 1),
           (0, 0, 1, 1, 1), (True, 0, 2, 2), ("0", 0, 1, 1), ()]


@pytest.fixture(scope="module", params=[(), ("--workers", "2")], ids=["in process", "workers"])
def clients(request, tmp_path_factory):
    """One that reads in place, and one that does not."""
    folder = tmp_path_factory.mktemp("region")
    with serving.server(folder, "--zmq", f"ipc://{folder}/z", *request.param, scene=SCENE) as (endpoint, _), \
            Client(endpoint, shared_memory=True) as here, Client(endpoint, shared_memory=False) as there:
        yield here, there


def cut(array, region):
    x0, y0, x1, y1 = region
    return array[y0:y1, x0:x1]


@pytest.mark.parametrize("order", ["C", "F"])
@pytest.mark.parametrize("output", ["dn", "irradiance"])
def test_every_border_is_that_part_of_the_whole_frame(clients, output, order):
    here, there = clients
    options = {"output": output, "products": PRODUCTS, "order": order, **({"seed": 5} if output == "dn" else {})}
    whole = there.render(STATE, "navcam", **options)
    is_body = whole.arrays["body_id"] >= 0
    assert is_body[95, 127] and not is_body[0, 0] and not is_body[-1, -1]
    for region in REGIONS:
        mine, its = (client.render(STATE, "navcam", roi=region, **options) for client in clients)
        assert list(mine.arrays) == ["image", *PRODUCTS] and "shared" not in its.header
        n_bytes = sum(array.nbytes for array in its.arrays.values())
        assert ("shared" in mine.header) == (n_bytes >= 65536)
        for name, array in its.arrays.items():
            expected = cut(whole.arrays[name], region)
            assert array.shape == expected.shape
            np.testing.assert_array_equal(mine.arrays[name], array, strict=True, err_msg=f"{name} of {region}")
            if output == "dn" or array.dtype == np.int32:
                np.testing.assert_array_equal(array, expected, strict=True, err_msg=f"{name} of {region}")
            else:
                # A region of irradiance is drawn alone: the same geometry, its light within the budget of 0.1.
                scale = np.nanmax(np.abs(whole.arrays[name]))
                np.testing.assert_allclose(array, expected, rtol=0.0, equal_nan=True, err_msg=f"{name} of {region}",
                                           atol=scale * (0.1 if name in ("image", "sunlit") else 1e-5))


@pytest.mark.parametrize("region", OUTSIDE, ids=str)
def test_outside_is_refused_by_name_and_leaves_no_memory_behind(clients, region):
    for client in clients:
        for ask, path in [(lambda c: c.render(STATE, "navcam", products=PRODUCTS, roi=region), "roi"),
                          (lambda c: c.render_frames(STATE, [{"camera": "bare"}, {"camera": "navcam", "roi": region}]),
                           "frames[1].roi")]:
            with pytest.raises(ServerError) as caught:
                ask(client)
            assert caught.value.code == "config" and caught.value.path.startswith(path)
    names = {clients[0].render({**STATE, "t_s": float(k)}, "bare").header["shared"]["name"] for k in range(20)}
    assert len(names) <= 8, "20 frames, two of them held at a time"


@pytest.mark.parametrize("order", ["C", "F"])
def test_several_cameras_of_other_sizes_lie_beside_each_other(clients, order):
    """Parts whose sizes are no multiples of the alignment, of one byte to 300 kB, eleven in one slot."""
    frames = [{"camera": "bare", "products": ["r_body"]}, {"camera": "navcam", "output": "dn", "seed": 3},
              {"camera": "navcam", "output": "dn", "seed": 3, "roi": (0, 0, 1, 1), "products": ["sunlit"]},
              {"camera": "navcam", "roi": (10, 20, 143, 97), "products": ["range", "facet_id"]},
              {"camera": "bare", "roi": (159, 159, 160, 160), "products": ["body_id"]}, {"camera": "navcam"}]
    here, there = (client.render_frames(STATE, frames, order=order) for client in clients)
    assert "shared" in here[0].header and "shared" not in there[0].header
    starts = here[0].header["shared"]["offsets"]
    assert len(starts) == 11 and all(start % 64 == 0 for start in starts)
    for k, (mine, its, asked) in enumerate(zip(here, there, frames, strict=True)):
        alone = clients[1].render(STATE, order=order, **asked)
        assert list(mine.arrays) == ["image", *asked.get("products", ())]
        for name, array in alone.arrays.items():
            np.testing.assert_array_equal(mine.arrays[name], array, strict=True, err_msg=f"{name} of frame {k}")
            np.testing.assert_array_equal(its.arrays[name], array, strict=True, err_msg=f"{name} of frame {k}")
