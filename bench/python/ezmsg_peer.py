"""The part of `component.py` for ezmsg: two units in two processes."""

import asyncio
import os
import time

import ezmsg.core as ez
import numpy


class Settings(ez.Settings):
    kind: str
    count: int
    period: float


class Camera(ez.Unit):
    SETTINGS = Settings
    OUTPUT = ez.OutputStream(tuple)
    INPUT = ez.InputStream(tuple)

    async def initialize(self):
        self.times, self.began, self.cpu = [], None, 0

    @ez.publisher(OUTPUT)
    async def send(self):
        image = numpy.full((1080, 1920, 3), 2, "uint8")
        await asyncio.sleep(0.5)
        start = time.monotonic()
        for i in range(self.SETTINGS.count):
            wait = start + i * self.SETTINGS.period - time.monotonic()
            if wait > 0:
                await asyncio.sleep(wait)
            yield self.OUTPUT, (time.monotonic(), b"" if self.SETTINGS.kind == "latency" else image)

    @ez.subscriber(INPUT)
    async def take(self, message):
        from component import cpu_of, report

        sent, _value, child = message
        if self.began is None:
            self.began, self.cpu = time.monotonic(), cpu_of(child, os.getpid())
        self.times.append(time.monotonic() - sent)
        if len(self.times) == self.SETTINGS.count:
            wall = time.monotonic() - self.began
            report(self.SETTINGS.kind, self.times, cpu_of(child, os.getpid()) - self.cpu, wall)
            raise ez.NormalTermination


class Echo(ez.Unit):
    INPUT = ez.InputStream(tuple)
    OUTPUT = ez.OutputStream(tuple)

    @ez.subscriber(INPUT, zero_copy=True)
    @ez.publisher(OUTPUT)
    async def on_message(self, message):
        sent, value = message
        yield self.OUTPUT, (sent, value + 1 if hasattr(value, "shape") else value, os.getpid())


class System(ez.Collection):
    SETTINGS = Settings
    CAMERA = Camera()
    ECHO = Echo()

    def configure(self):
        self.CAMERA.apply_settings(self.SETTINGS)

    def network(self):
        return ((self.CAMERA.OUTPUT, self.ECHO.INPUT), (self.ECHO.OUTPUT, self.CAMERA.INPUT))

    def process_components(self):
        return (self.ECHO,)


def run(kind, count, period):
    ez.run(SYSTEM=System(Settings(kind, count, period)))
