"""A transport in memory that matches by topic, type and quality, and latches, as DDS does."""

from __future__ import annotations

import threading
from collections import deque

from clfcbf.ros2.transport import TransportError


class Bus:
    """A network; ``Bus().transport()`` is a participant."""

    def __init__(self):
        self.lock = threading.RLock()
        self.publishers = []
        self.subscriptions = []
        self.sent = []

    def transport(self):
        return BusTransport(self)

    def messages(self, topic):
        """All that was ever published there."""
        with self.lock:
            return [message for name, message in self.sent if name == topic]


class BusTransport:
    def __init__(self, bus):
        self.bus = bus
        self.made = []

    def publisher(self, kind, topic, quality):
        made = BusPublisher(self.bus, kind, topic, quality)
        self.made.append((self.bus.publishers, made))
        with self.bus.lock:
            self.bus.publishers.append(made)
        return made

    def subscription(self, kind, topic, quality):
        made = BusSubscription(self.bus, kind, topic, quality)
        self.made.append((self.bus.subscriptions, made))
        with self.bus.lock:
            self.bus.subscriptions.append(made)
            for publisher in self.bus.publishers:
                if matches(publisher, made) and publisher.quality.latched and quality.latched:
                    made.queue.extend(publisher.kept)
        return made

    def close(self):
        with self.bus.lock:
            for ends, made in self.made:
                made.closed = True
                ends.remove(made)
            self.made = []


class End:
    def __init__(self, bus, kind, topic, quality):
        self.bus, self.kind, self.topic, self.quality = bus, kind, topic, quality
        self.closed = False


class BusPublisher(End):
    def __init__(self, *args):
        super().__init__(*args)
        self.kept = deque(maxlen=self.quality.depth)

    def publish(self, message):
        if self.closed:
            raise TransportError("the transport is closed")
        assert isinstance(message, self.kind)
        with self.bus.lock:
            self.kept.append(message)
            self.bus.sent.append((self.topic, message))
            for subscription in self.bus.subscriptions:
                if matches(self, subscription):
                    subscription.queue.append(message)

    def listeners(self):
        with self.bus.lock:
            return sum(matches(self, each) for each in self.bus.subscriptions)

    def flush(self, timeout):
        return True


class BusSubscription(End):
    def __init__(self, *args):
        super().__init__(*args)
        self.queue = deque(maxlen=self.quality.depth)

    def take(self):
        if self.closed:
            raise TransportError("the transport is closed")
        with self.bus.lock:
            taken = list(self.queue)
            self.queue.clear()
        return taken

    def sources(self):
        with self.bus.lock:
            return sum(matches(each, self) for each in self.bus.publishers)


def matches(publisher, subscription):
    return (
        publisher.topic == subscription.topic
        and publisher.kind is subscription.kind
        and publisher.quality.reliable >= subscription.quality.reliable
        and publisher.quality.latched >= subscription.quality.latched
    )
