"""Makes the golden files of the image and audio kernels with independent libraries.

    python3 -m venv v && v/bin/pip install numpy 'opencv-python-headless<5' pillow scipy soxr
    v/bin/python make_golden.py IMAGE.png      # any color image; the files here are from NASA's astronaut

Writes source.png (a 192x128 crop of the image) and the results of each library. The tests define the tolerances.
"""
import json
import os
import sys

import cv2
import numpy as np
import scipy.fft
import scipy.signal
import soxr
from PIL import Image

HERE = os.path.dirname(os.path.abspath(__file__))


def save_image(name, bgr):
    cv2.imwrite(os.path.join(HERE, name + ".png"), bgr)


def psi_gray(bgr):
    b, g, r = [bgr[..., i].astype(np.uint32) for i in range(3)]
    return ((4897 * r + 9617 * g + 1868 * b) >> 14).astype(np.uint8)


def psi_convolve(gray, kernel):
    """Convolves as \\psi does: divides the sum over the taps inside the image by their number, truncated towards zero."""
    h, w = gray.shape
    ky, kx = kernel.shape
    out = np.zeros((h, w), np.uint8)
    for y in range(h):
        for x in range(w):
            total = count = 0
            for j in range(ky):
                for i in range(kx):
                    sy, sx = y + j - ky // 2, x + i - kx // 2
                    if 0 <= sy < h and 0 <= sx < w:
                        total += int(kernel[j, i]) * int(gray[sy, sx])
                        count += 1
            out[y, x] = np.clip(int(total / count), 0, 255)
    return out


def make_images(path):
    image = cv2.imread(path)
    src = np.ascontiguousarray(image[20:148, 130:322])
    save_image("source", src)
    rgb = Image.fromarray(src[..., ::-1])
    gray = psi_gray(src)
    save_image("gray", gray)

    size = (80, 60)
    # At this size, no sampling point is exactly between two pixels, where libraries would choose different ones.
    save_image("resize_nearest_pillow", np.array(rgb.resize((64, 32), Image.NEAREST))[..., ::-1])
    save_image("resize_bilinear_opencv", cv2.resize(src, size, interpolation=cv2.INTER_LINEAR))
    save_image("resize_smooth_pillow", np.array(rgb.resize(size, Image.BILINEAR))[..., ::-1])
    save_image("resize_lanczos_pillow", np.array(rgb.resize(size, Image.LANCZOS))[..., ::-1])
    save_image("resize_area_opencv", cv2.resize(src, (96, 64), interpolation=cv2.INTER_AREA))
    save_image("resize_up_bilinear_opencv", cv2.resize(src, (288, 192), interpolation=cv2.INTER_LINEAR))

    matrix = np.array([[0.9, -0.3, 20.5], [0.25, 1.1, -10.25]])
    save_image("warp_affine", cv2.warpAffine(src, matrix, (192, 128), flags=cv2.INTER_LINEAR, borderValue=(10, 20, 30)))
    corners = np.float32([[0, 0], [191, 0], [191, 127], [0, 127]])
    target = np.float32([[20, 10], [180, 0], [160, 120], [0, 100]])
    perspective = cv2.getPerspectiveTransform(corners, target)
    save_image("warp_perspective", cv2.warpPerspective(src, perspective, (192, 128), flags=cv2.INTER_LINEAR))
    save_image("rotate_pillow_90", np.array(rgb.transpose(Image.ROTATE_270))[..., ::-1])

    save_image("blur", cv2.GaussianBlur(src, (9, 9), 1.4))
    save_image("box_blur", cv2.blur(src, (5, 5)))
    save_image("median_blur", cv2.medianBlur(src, 5))
    save_image("canny", cv2.Canny(gray, 60, 120))
    x, y = cv2.Sobel(gray, cv2.CV_16S, 1, 0), cv2.Sobel(gray, cv2.CV_16S, 0, 1)
    save_image("sobel", cv2.addWeighted(cv2.convertScaleAbs(x), 0.5, cv2.convertScaleAbs(y), 0.5, 0))
    kernel = cv2.getStructuringElement(cv2.MORPH_RECT, (3, 3))
    save_image("erode", cv2.erode(gray, kernel))
    save_image("close", cv2.morphologyEx(gray, cv2.MORPH_CLOSE, kernel))
    save_image("equalize", cv2.equalizeHist(gray))
    save_image("convolve", psi_convolve(gray, np.array([[1, 2, 1], [0, 5, 0], [-1, -2, -1]])))

    with open(os.path.join(HERE, "source.jpg"), "wb") as f:
        f.write(cv2.imencode(".jpg", src, [cv2.IMWRITE_JPEG_QUALITY, 90])[1].tobytes())
    decoded = Image.open(os.path.join(HERE, "source.jpg")).convert("RGB")
    save_image("jpeg_decoded_pillow", np.array(decoded)[..., ::-1])

    i420 = cv2.cvtColor(src, cv2.COLOR_BGR2YUV_I420)
    i420.tofile(os.path.join(HERE, "frame.i420"))
    save_image("i420_opencv", cv2.cvtColor(i420, cv2.COLOR_YUV2BGR_I420))

    depth = (gray.astype(np.uint16) * 20)
    cv2.imwrite(os.path.join(HERE, "depth.png"), depth)
    mean = src.reshape(-1, 3).astype(float)
    return {
        "channels": [
            {"min": int(c.min()), "max": int(c.max()), "mean": float(c.mean()), "deviation": float(c.std())}
            for c in mean.T
        ],
        "histogram_blue": np.bincount(src[..., 0].ravel(), minlength=256).tolist(),
        "perspective": perspective.ravel().tolist(),
    }


def make_audio():
    rate, n = 48000, 9600
    t = np.arange(n) / rate
    sweep = 0.6 * scipy.signal.chirp(t, 100, t[-1], 7000) + 0.1 * np.sin(2 * np.pi * 440 * t)
    sweep = sweep.astype(np.float32)
    sweep.tofile(os.path.join(HERE, "sweep_48k.f32"))
    soxr.resample(sweep, 48000, 16000, quality="HQ").astype(np.float32).tofile(os.path.join(HERE, "sweep_16k.f32"))
    return mel_features(soxr.resample(sweep, 48000, 16000, quality="HQ").astype(np.float32))


def mel_features(samples):
    """Returns log-mel and MFCC of the first frame: 400 samples, periodic Hann, FFT 512, 40 HTK bands 0..8000 Hz."""
    frame = samples[:400].astype(np.float64) * scipy.signal.get_window("hann", 400, fftbins=True)
    power = np.abs(np.fft.rfft(frame, 512)) ** 2
    to_mel = lambda f: 2595 * np.log10(1 + f / 700)
    edges = 700 * (10 ** (np.linspace(to_mel(0), to_mel(8000), 42) / 2595) - 1)
    bins = np.arange(257) * 16000 / 512
    bands = []
    for left, mid, right in zip(edges, edges[1:], edges[2:]):
        bands.append(np.maximum(0, np.minimum((bins - left) / (mid - left), (right - bins) / (right - mid))))
    log_mel = np.log(np.maximum(np.array(bands) @ power, 1e-10))
    mfcc = scipy.fft.dct(log_mel, type=2, norm="ortho")[:13]
    return {"log_mel": log_mel.tolist(), "mfcc": mfcc.tolist()}


if __name__ == "__main__":
    numbers = {**make_images(sys.argv[1]), **make_audio()}
    numbers["made_with"] = {"numpy": np.__version__, "opencv": cv2.__version__, "soxr": soxr.__version__}
    with open(os.path.join(HERE, "numbers.json"), "w") as f:
        json.dump(numbers, f, indent=1)
