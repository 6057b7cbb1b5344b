"""Runs the jobs of bench/tests/kernels.exs with OpenCV, SciPy and soxr on one thread. Names and output are the same.

    pip install numpy 'opencv-python-headless<5' scipy soxr open3d-cpu
    python bench/python/kernels.py [REPS]
    python bench/python/kernels.py serve

The value of `_cpu` is the median over REPS (default 5) of the process CPU time per operation in microseconds. `serve`
is for bench/tests/kernels_beside.exs: it prints the names of the jobs, and then, for each `NAME CALLS` on standard
input, the microseconds of each call.
"""
import json
import os
import statistics
import sys
import time

# Open3D uses every core unless this is set before it is loaded.
os.environ["OMP_NUM_THREADS"] = "1"

import cv2
import numpy as np

cv2.setNumThreads(1)


def make_image(width, height):
    y, x = np.mgrid[0:height, 0:width].astype(np.int64)
    noise = (x * 7919 + y * 104729 + x * y) % 31
    return np.stack([(x // 5 + noise) % 256, (y // 4 + noise) % 256, ((x + y) // 9) % 256], -1).astype(np.uint8)


def space_jobs():
    """Yields point cloud jobs with NumPy and with Open3D.

    The NumPy code is the usual one, with the rays of the pixels computed in advance, like Situ's table of rays. Open3D's
    points are 64-bit floats.
    """
    y, x = np.mgrid[0:480, 0:640]
    depth = (800 + (x * 7 + y * 13) % 2000).astype(np.uint16)
    right, down = ((x - 319.5) / 525).astype(np.float32), ((y - 239.5) / 525).astype(np.float32)

    def depth_to_points():
        z = depth.astype(np.float32) * np.float32(0.001)
        points = np.stack([z, -right * z, -down * z], -1).reshape(-1, 3)
        return points[points[:, 0] > 0]

    points = depth_to_points()

    def downsample_voxels(size=0.05):
        keys = np.floor(points / size).astype(np.int64) + (1 << 20)
        _, where = np.unique((keys[:, 0] << 42) | (keys[:, 1] << 21) | keys[:, 2], return_inverse=True)
        n = np.bincount(where)
        return np.stack([np.bincount(where, points[:, k]) / n for k in range(3)], -1)

    yield "cloud_from_depth_numpy", 60, depth_to_points
    yield "voxel_downsample_numpy", 20, downsample_voxels
    million = np.zeros((1_000_000, 3), np.float32)
    head = json.dumps({"items": [{"kind": "points", "count": len(million), "at": {"position": [0, million.nbytes]}}]})
    yield "3d_upload_1M_numpy", 10, lambda: b"".join([head.encode(), million.tobytes()])
    yield from transform_jobs()
    try:
        import open3d

        lens = open3d.camera.PinholeCameraIntrinsic(640, 480, 525, 525, 319.5, 239.5)
        image = open3d.geometry.Image(depth)
        create = open3d.geometry.PointCloud.create_from_depth_image
        dense = create(image, lens, depth_scale=1000.0, depth_trunc=100.0)
        yield "cloud_from_depth_open3d", 60, lambda: create(image, lens, depth_scale=1000.0, depth_trunc=100.0)
        yield "voxel_downsample_open3d", 20, lambda: dense.voxel_down_sample(0.05)
    except ImportError:
        print("Open3D is not installed", file=sys.stderr)


def transform_jobs():
    """Yields transform jobs with SciPy: a hand on a moving arm on a moving body, at 1,000 times between two poses.

    One job looks up single times, as a stream of messages requires, and the other one all times together.
    """
    try:
        from scipy.spatial.transform import Rotation, Slerp
    except ImportError:
        return
    at = np.arange(101) * 10_000_000
    turns = Slerp(at, Rotation.from_euler("z", np.arange(101)[:, None] / 50))
    way = np.stack([np.arange(101) / 10, np.zeros(101), np.zeros(101)], -1)
    hand = np.array([0.3, 0.0, 0.0])
    asked = 5_000_000 + np.arange(1000) * 990_000

    def lookup_pose(time):
        arm = turns(time)
        i = int(time // 10_000_000)
        body = way[i] + (way[i + 1] - way[i]) * ((time - at[i]) / 10_000_000)
        return arm.as_matrix(), arm.apply(hand) + [0.0, 0.0, 1.0] + body

    def lookup_each():
        return [lookup_pose(time) for time in asked]

    def lookup_all():
        arm = turns(asked)
        body = np.stack([np.interp(asked, at, way[:, k]) for k in range(3)], -1)
        return arm.as_matrix(), arm.apply(hand) + [0.0, 0.0, 1.0] + body

    yield "transform_lookup_x1000_scipy", 5, lookup_each
    yield "transform_lookup_x1000_scipy_together", 20, lookup_all


def all_jobs():
    """Yields the name of each job, the number of calls per repetition, and a function that runs it once."""
    hd1080, hd720 = make_image(1920, 1080), make_image(1280, 720)
    gray = cv2.cvtColor(hd1080, cv2.COLOR_BGR2GRAY)
    jpeg = cv2.imencode(".jpg", hd720, [cv2.IMWRITE_JPEG_QUALITY, 85])[1]
    i = np.arange(480000)
    audio = (0.5 * np.sin(i * i / 1e6)).astype(np.float32)
    yield "resize_1080p_640x360_opencv", 60, lambda: cv2.resize(hd1080, (640, 360))
    yield "resize_1080p_854x480_opencv", 60, lambda: cv2.resize(hd1080, (854, 480))
    yield "bgr_to_gray_1080p_opencv", 60, lambda: cv2.cvtColor(hd1080, cv2.COLOR_BGR2GRAY)
    yield "jpeg_encode_720p_opencv", 30, lambda: cv2.imencode(".jpg", hd720, [cv2.IMWRITE_JPEG_QUALITY, 85])
    yield "jpeg_decode_720p_opencv", 30, lambda: cv2.imdecode(jpeg, cv2.IMREAD_COLOR)
    yield "gaussian_5x5_gray_1080p_opencv", 40, lambda: cv2.GaussianBlur(gray, (5, 5), 1.1)
    yield "canny_gray_1080p_opencv", 15, lambda: cv2.Canny(gray, 60, 120)
    yield from space_jobs()
    try:
        import soxr

        yield "resample_10s_48k_16k_soxr", 30, lambda: soxr.resample(audio, 48000, 16000, quality="HQ")
    except ImportError:
        print("soxr is not installed", file=sys.stderr)
    try:
        import scipy.signal

        yield "resample_10s_48k_16k_scipy", 10, lambda: scipy.signal.resample_poly(audio, 1, 3)
    except ImportError:
        print("scipy is not installed", file=sys.stderr)


def run_all(reps):
    """Prints the rate and the CPU time of every job."""
    for name, n, job in all_jobs():
        job()
        wall, cpu = [], []
        for _ in range(reps):
            w, c = time.perf_counter(), time.process_time()
            for _ in range(n):
                job()
            wall.append(n / (time.perf_counter() - w))
            cpu.append((time.process_time() - c) / n * 1e6)
        print(f"kernel_{name},{statistics.median(wall):.6g},op/s")
        print(f"kernel_{name}_cpu,{statistics.median(cpu):.6g},us/op")
        print(f"kernel_{name}_cpu.min,{min(cpu):.6g},us/op")


def serve_calls():
    """Runs jobs on request from standard input."""
    table = {name: job for name, _, job in all_jobs()}
    print(" ".join(table), flush=True)
    for line in sys.stdin:
        name, calls = line.split()
        times = []
        for _ in range(int(calls)):
            started = time.perf_counter_ns()
            result = table[name]()
            times.append((time.perf_counter_ns() - started) / 1000)
            del result
        print(*times, flush=True)


if __name__ == "__main__":
    if sys.argv[1:] == ["serve"]:
        serve_calls()
    else:
        run_all(int(sys.argv[1]) if len(sys.argv) > 1 else 5)
