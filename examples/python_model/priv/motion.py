"""Finds what moves in front of a camera that stands still."""

import numpy
import situ


class Motion(situ.Component):
    """Learns the mean and the variance of every pixel, and reports the pixels that do not fit.

    `memory` is the number of images that the model remembers; `tolerance` is in standard deviations.
    """

    def setup(self, memory, tolerance):
        self.rate, self.tolerance = 1 / memory, tolerance
        self.mean = None

    def on_image(self, image, message):
        pixels = image.array.astype(numpy.float32)
        if self.mean is None:
            self.mean, self.variance = pixels, numpy.full_like(pixels, 25.0)
        distance = (pixels - self.mean) ** 2
        moving = distance > self.tolerance**2 * self.variance
        # A moving pixel is not background. If it stays as it is, it becomes part of it in minutes.
        rate = numpy.where(moving, self.rate / 100, self.rate)
        self.mean = self.mean + rate * (pixels - self.mean)
        change = numpy.where(moving, 0.0, self.rate) * (distance - self.variance)
        self.variance = numpy.maximum(self.variance + change, 9.0)
        return {"share": float(moving.mean()), "where": boxes(moving)}


def boxes(moving):
    """Returns the rectangle around all moving pixels, in a list that is empty if there are none."""
    rows, columns = moving.any(axis=1).nonzero()[0], moving.any(axis=0).nonzero()[0]
    if len(rows) == 0:
        return []
    x, y = int(columns[0]), int(rows[0])
    size = {"width": int(columns[-1]) - x + 1, "height": int(rows[-1]) - y + 1}
    return [situ.Struct("Situ.Rect", {"x": x, "y": y, **size})]
