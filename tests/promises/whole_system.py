"""A system as a user runs it, `fiona run` with all its processes, for tests that look at those from outside."""
import json
import os
import shlex
import shutil
import signal
import subprocess
import tempfile
import time

LIMIT_S = 60
GONE = (FileNotFoundError, ProcessLookupError)  # what /proc says of a process that ends


def children(process):
    with open("/proc/%d/task/%d/children" % (process, process), encoding="ascii") as file:
        return [int(one) for one in file.read().split()]


def command_of(process):
    with open("/proc/%d/comm" % process, encoding="ascii") as file:
        return file.read().strip()


class WholeSystem:
    """In a directory of its own, gone afterwards. Its processes, and not those that talk to it, have `more` in their
    environment."""

    def __init__(self, binaries, *arguments, more=None):
        self.binaries = binaries
        self.more = more or {}
        self.directory = tempfile.mkdtemp(prefix="fiona-promise-")
        self.work = os.path.join(self.directory, "work")
        for name in ("work", "run", "state", "home"):
            os.makedirs(os.path.join(self.directory, name), mode=0o700, exist_ok=True)
        self.environment = dict(
            os.environ, PATH=binaries + os.pathsep + os.environ["PATH"], XDG_RUNTIME_DIR=self.directory + "/run",
            XDG_STATE_HOME=self.directory + "/state", HOME=self.directory + "/home", FIONA_STORE=self.directory + "/store",
            FIONA_MARKET=self.directory + "/shop", LC_ALL="C.UTF-8")
        for name in ("XDG_DATA_HOME", "XDG_CONFIG_HOME", "XDG_CACHE_HOME", "FIONA_KEYS"):
            self.environment.pop(name, None)
        self.process = self.said = None
        self.start(*arguments)

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.stop()
        shutil.rmtree(self.directory, ignore_errors=True)

    def start(self, *arguments):
        self.said = open(os.path.join(self.directory, "said"), "w+", encoding="utf-8", errors="backslashreplace")
        self.process = subprocess.Popen(["fiona", "run", "--headless", *arguments], cwd=self.work,
                                        env=dict(self.environment, **self.more), stdin=subprocess.DEVNULL,
                                        stdout=self.said, stderr=subprocess.STDOUT)
        self.eventually("the system runs", lambda: "the system runs" in self.words() or self.process.poll() is not None)
        if self.process.poll() is not None:
            raise AssertionError("it did not start: " + self.words())

    def stop(self):
        if self.process.poll() is None:
            for one in self.processes():
                os.kill(one, signal.SIGCONT)
            self.process.terminate()
            try:
                self.process.wait(LIMIT_S)
            except subprocess.TimeoutExpired:
                for one in reversed(self.processes()):
                    os.kill(one, signal.SIGKILL)
                self.process.wait()
        self.said.close()

    def words(self):
        """What it has said on its own so far."""
        with open(self.said.name, encoding="utf-8", errors="backslashreplace") as file:
            return file.read()

    def run(self, *arguments, agrees=True):
        """A command; its output and exit code, which is to be 0 where it is expected to agree."""
        done = subprocess.run(arguments, cwd=self.work, env=self.environment, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE,
                              stderr=subprocess.STDOUT, timeout=LIMIT_S, check=False)
        text = done.stdout.decode("utf-8", "backslashreplace")
        if agrees and done.returncode != 0:
            raise AssertionError("%s: %s" % (" ".join(arguments), text))
        return text if agrees else (text, done.returncode)

    def line(self, text, agrees=True):
        """A line for the running host."""
        return self.run("fiona", text, agrees=agrees)

    def json(self, text):
        """The same, and what it says as one object."""
        return json.loads(self.run("fiona", "--json", *shlex.split(text)))

    def saved(self):
        """The system as text that gives it back."""
        file = os.path.join(self.work, "saved.fiona")
        self.line('save "%s"' % file)
        with open(file, encoding="utf-8") as text:
            return [line for line in text.read().split("\n") if line and not line.startswith("#")]

    def processes(self):
        """All of them, parents before children, that of `fiona run` first."""
        found = [self.process.pid]
        for one in found:
            try:
                found += children(one)
            except GONE:
                pass
        return found

    def host(self):
        """The process that holds the system; None: there is none now."""
        for one in self.processes():
            try:
                if command_of(one) == "fiona-host":
                    return one
            except GONE:
                pass
        return None

    @staticmethod
    def eventually(what, fits, limit_s=LIMIT_S):
        limit = time.monotonic() + limit_s
        while not (found := fits()):
            if time.monotonic() > limit:
                raise AssertionError("it never happened: " + what)
            time.sleep(0.01)
        return found


def resident_kib(process):
    """Other than pages of files, which come and go as they are read."""
    with open("/proc/%d/status" % process, encoding="ascii") as file:
        return next(int(line.split()[1]) for line in file if line.startswith("RssAnon:"))


def descriptors(process):
    return len(os.listdir("/proc/%d/fd" % process))


def threads(process):
    return len(os.listdir("/proc/%d/task" % process))
