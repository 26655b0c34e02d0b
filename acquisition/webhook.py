"""Posts one message to one address, as a process of its own that can be killed.

Name resolution has no timeout, and a server may send one byte a minute for ever: a deadline holds for a process only.
It reads ``{"url": ..., "message": ..., "timeout_s": ...}`` on stdin, so that what is secret in the address stands in no
list of processes. It imports nothing of ours and starts in a tenth of a second.
"""

from __future__ import annotations

import base64
import json
import sys
from http.client import HTTPException
from typing import Any
from urllib.error import HTTPError, URLError
from urllib.parse import unquote, urlsplit, urlunsplit
from urllib.request import HTTPRedirectHandler, Request, build_opener

PASSING, FINAL = 1, 2
"""Exit status of trouble that may pass, and of trouble that will not."""
PASSING_STATUS = (408, 425, 429)
"""HTTP answers below 500 that ask to try again (RFC 9110, RFC 8470, RFC 6585)."""


class _NoRedirect(HTTPRedirectHandler):
    """To follow a redirect is to send the message as a GET without it, or to somebody who was not named."""

    def redirect_request(self, *args: Any, **options: Any) -> None:
        """Let the redirect be an error."""


def request(url: str, message: Any) -> Request:
    """A POST of a message as JSON; user and password in the address become basic authentication (RFC 7617)."""
    parts = urlsplit(url)
    headers = {"Content-Type": "application/json", "User-Agent": "lightstage"}
    user, at, host = parts.netloc.rpartition("@")
    if at:
        headers["Authorization"] = "Basic " + base64.b64encode(unquote(user).encode()).decode()
    address = urlunsplit((parts.scheme, host, parts.path, parts.query, ""))
    return Request(address, data=json.dumps(message).encode(), headers=headers, method="POST")


def post(url: str, message: Any, timeout_s: float) -> tuple[int, str]:
    """Exit status, and what went wrong as the end of a sentence."""
    try:
        with build_opener(_NoRedirect).open(request(url, message), timeout=timeout_s):
            return 0, ""
    except HTTPError as error:
        error.close()
        passing = error.code >= 500 or error.code in PASSING_STATUS
        moved = "; give the address that it redirects to" if 300 <= error.code < 400 else ""
        return (PASSING if passing else FINAL), f"answers {error.code}{moved}"
    except URLError as error:
        reason = error.reason
        return PASSING, f"cannot be reached ({getattr(reason, 'strerror', None) or reason})"
    except TimeoutError:
        return PASSING, "does not answer"
    except (OSError, HTTPException) as error:
        return PASSING, f"does not answer as a web server does ({type(error).__name__})"


def main() -> int:
    """See the module."""
    given = json.load(sys.stdin.buffer)
    status, trouble = post(given["url"], given["message"], given["timeout_s"])
    sys.stdout.write(f"{trouble}\n")
    return status


if __name__ == "__main__":
    sys.exit(main())
