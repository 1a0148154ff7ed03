"""Python client of the glrender service.

    from glrender_client import Client
    with Client("tcp://127.0.0.1:5555") as client:
        reply = client.render(state, camera="navcam", output="dn", exposure_s=0.1, seed=7)
"""

from .client import Client, Reply
from .errors import Busy, GlrenderClientError, RequestTimeout, ServerError

__all__ = ["Busy", "Client", "GlrenderClientError", "Reply", "RequestTimeout", "ServerError"]
