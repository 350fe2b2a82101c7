"""The page of a system, as a browser speaks to its server, for tests that need no browser."""
import http.client
import json
import re
import secrets
import time


class Phone:
    """Somebody's connection to the page, from an address of their own."""

    def __init__(self, address, source, session=None):
        self.address = address
        self.connection = http.client.HTTPConnection(*address, timeout=15, source_address=(source, 0))
        self.session = session

    def moved(self, source):
        """The same page from another address, on a connection of its own."""
        return Phone(self.address, source, self.session)

    def ask(self, what, **body):
        headers = {"Content-Type": "application/json", "Origin": "http://%s:%d" % self.address}
        if self.session:
            headers["Authorization"] = "Bearer " + self.session
        self.connection.request("POST", "/api/" + what, json.dumps(body), headers)
        return self.connection.getresponse()

    def call(self, what, **body):
        answer = self.ask(what, **body)
        return answer.status, json.loads(answer.read())

    def login(self, name, password):
        """What it was answered, and after how many milliseconds."""
        begun = time.monotonic()
        answer = self.call("login", name=name, password=password)
        return answer, 1000 * (time.monotonic() - begun)


def phone_of(system, source):
    """The page, opened by a link of its own."""
    link = re.search(r'url="http://([^:]+):(\d+)/#(\w+)"', system.line("call web.link"))
    phone = Phone((link[1], int(link[2])), source)
    _, opened = phone.call("session", token=link[3], number=secrets.token_hex(16))
    phone.session = opened["session"]
    return phone
