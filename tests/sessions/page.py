"""The page of the mobile navigator, without a browser: its calls, as the page makes them."""
import json
import re
import secrets
import urllib.request

LIMIT_S = 60


class Page:
    """Opened by what `call web.link` says, once."""

    def __init__(self, said):
        self.origin, token = re.search(r'url="([^"]+)/#([^"]+)"', said).groups()
        self.session = None
        with self.post("session", {"token": token, "number": secrets.token_hex(16)}) as answer:
            self.session = json.load(answer)["session"]

    def post(self, name, body):
        headers = {"Content-Type": "application/json", "Origin": self.origin}
        if self.session:
            headers["Authorization"] = "Bearer " + self.session
        request = urllib.request.Request(self.origin + "/api/" + name, json.dumps(body).encode(), headers, method="POST")
        return urllib.request.build_opener(urllib.request.ProxyHandler({})).open(request, timeout=LIMIT_S)

    def pick(self, x, y, level):
        self.post("destination", {"x": x, "y": y, "level": level}).close()

    def events(self):
        """As they come: name and value; and (None, None) at each beat of the server."""
        event = None
        with self.post("events", {}) as stream:
            for line in stream:
                text = line.decode().rstrip("\n")
                if text.startswith("event: "):
                    event = text[len("event: "):]
                elif text.startswith("data: "):
                    yield event, json.loads(text[len("data: "):])
                elif text.startswith(":"):
                    yield None, None
