"""A proxy between two ends of a UDP connection that loses, doubles and delays datagrams."""

import random
import socket
import threading


class Lossy:
    """Datagrams to `port` go on to `to` and back; each is lost, doubled or late with `share`."""

    def __init__(self, to, share, seed):
        self.to, self.share, self.random = ("127.0.0.1", to), share, random.Random(seed)
        self.counts = {"lost": 0, "doubled": 0, "late": 0, "passed": 0}
        self.front = self._socket()
        self.back = self._socket()
        self.port = self.front.getsockname()[1]
        self.client = None
        self.kept = {}
        self.over = threading.Event()
        self.threads = [
            threading.Thread(target=self._forward, args=(self.front, self.back)),
            threading.Thread(target=self._forward, args=(self.back, self.front)),
        ]
        self.lock = threading.Lock()

    @staticmethod
    def _socket():
        made = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        made.bind(("127.0.0.1", 0))
        made.settimeout(0.02)
        return made

    def __enter__(self):
        for thread in self.threads:
            thread.start()
        return self

    def __exit__(self, *why):
        self.over.set()
        for thread in self.threads:
            thread.join()
        self.front.close()
        self.back.close()

    def _forward(self, source, sink):
        while not self.over.is_set():
            try:
                data, sender = source.recvfrom(65536)
            except (TimeoutError, ConnectionError):
                continue
            if source is self.front:
                self.client = sender
            target = self.to if source is self.front else self.client
            with self.lock:
                chance = self.random.random()
            if chance < self.share:
                self.counts["lost"] += 1
            elif chance < 2 * self.share:
                self.counts["doubled"] += 1
                sink.sendto(data, target)
                sink.sendto(data, target)
            elif chance < 3 * self.share and source not in self.kept:
                self.counts["late"] += 1
                self.kept[source] = data  # it goes behind the next one
                continue
            else:
                self.counts["passed"] += 1
                sink.sendto(data, target)
            if source in self.kept:
                sink.sendto(self.kept.pop(source), target)
