"""Python client of the glrender service. ::

    from glrender_client import Client
    with Client("tcp://127.0.0.1:5555") as client:
        reply = client.render(state, camera="navcam", output="dn", exposure_s=0.1, seed=7)

`AsyncClient` is the same for asyncio.
"""

from .aio import AsyncClient
from .client import Client
from .errors import Busy, GlrenderClientError, RequestTimeout, ServerError
from .recording import Difference, Exchange, read_recording, replay
from .wire import Comparison, FrameWarning, Reply, Watched

__all__ = ["AsyncClient", "Busy", "Client", "Comparison", "Difference", "Exchange", "FrameWarning",
           "GlrenderClientError", "Reply", "RequestTimeout", "ServerError", "Watched", "read_recording", "replay"]
